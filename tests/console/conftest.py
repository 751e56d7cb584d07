"""A console over a folder with two runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.console.runs import make_run, summary
from tests.console.served import Served, console

FIRST, SECOND = "2026-01-01_10-00-00_sim_house", "2026-01-02_10-00-00_maze"


def _filled(folder: Path) -> Path:
    recordings = folder / "recordings"
    make_run(recordings, FIRST, summary(3), with_series=True)
    make_run(recordings, SECOND, summary(1), with_series=True)
    (folder / "secret.txt").write_text("outside")
    return recordings


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    with console(_filled(tmp_path)) as running:
        yield running


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """For tests that change nothing."""
    with console(_filled(tmp_path_factory.mktemp("console"))) as running:
        yield running
