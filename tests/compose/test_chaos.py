"""`make chaos CONTAINERS=1`: what goes wrong with containers in mid-drive."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.bench.test_chaos import trials_of

pytestmark = [
    pytest.mark.compose,
    pytest.mark.usefixtures("image"),
    pytest.mark.skipif(os.getuid() != 0, reason="only root may kill a container's process"),
]


@pytest.mark.timeout(300)
def test_a_service_that_is_killed_or_cut_off_comes_back(tmp_path: Path) -> None:
    faults = "kill-navigation", "cut-localization-5s"
    trials = trials_of(tmp_path, "--containers", *(f"--fault={one}" for one in faults))
    assert sorted(str(trial["fault"]) for trial in trials) == sorted(faults)
