"""Thousands of runs in a folder."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from mazebot.common.recordings.catalog import INDEX
from tests.common.recordings.made_run import made_run

RUNS = 2_000
READ_ALL = """
import json, sys
from pathlib import Path
for file in sorted(Path(sys.argv[1]).glob("*/summary.json")):
    json.loads(file.read_text())
"""
MOST = 6.0
"""Time of the processor for the whole command, from its start: of that for reading the summaries,
in another process at the same time. On a quiet machine it is below a second.
"""
FILES = ("summary.json", "series.json", "config.yaml")
LARGE = ("run.rrd", "run.mcap", "digests.bin", "report.html", "thumbnail.png")


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copies of a real run, with the number of goals and topics that a tour has."""
    folder = tmp_path_factory.mktemp("many")
    one = made_run(tmp_path_factory.mktemp("one") / "run")
    summary = json.loads((one / "summary.json").read_text())
    summary["goals"] *= 6
    (one / "summary.json").write_text(json.dumps(summary, indent=2))
    assert (one / "summary.json").stat().st_size > 10_000
    first = datetime(2026, 1, 1)  # noqa: DTZ001 - local
    for number in range(RUNS):
        run = folder / f"{first + timedelta(minutes=37 * number):%Y-%m-%d_%H-%M-%S}_room"
        run.mkdir()
        for name in FILES:
            shutil.copy(one / name, run / name)
        for name in LARGE:
            (run / name).touch()
        os.utime(run / "summary.json", (1_000_000_000, 1_000_000_000))
    return folder


def listed_s(folder: Path) -> float:
    """Time of the processor that a listing takes, in a process of its own."""
    said, seconds = measured("-m", "mazebot.cli", "recordings", "list", "--dir", str(folder))
    assert len(said.splitlines()) == RUNS + 2
    return seconds


def measured(*arguments: str) -> tuple[str, float]:
    """What a program of Python prints, and its time of the processor."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, *arguments]
    done = subprocess.run(command, capture_output=True, check=True, text=True, timeout=60)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@pytest.mark.slow
def test_two_thousand_runs_are_listed_nearly_as_fast_as_they_are_read(many: Path) -> None:
    def cold_s() -> float:
        (many / INDEX).unlink(missing_ok=True)
        return listed_s(many)

    listed_s(many)  # byte code and disk

    def read_s() -> float:
        return measured("-c", READ_ALL, str(many))[1]

    # In turn, so that a machine that changes its speed changes it for all.
    rounds = [(read_s(), cold_s(), listed_s(many)) for _ in range(5)]
    read, cold, again = (min(each) for each in zip(*rounds, strict=True))
    assert cold < MOST * read, rounds
    assert again < cold
