"""One recorded run for all tests here."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.replay import runs


@pytest.fixture(scope="package")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return runs.make(tmp_path_factory.mktemp("replay") / "short")
