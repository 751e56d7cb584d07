"""The same configuration gives the same bytes, whatever else the machine has to do."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mazebot.common.files.root import ROOT
from mazebot.common.recordings.comparing.digests import read_digests
from mazebot.common.recordings.comparing.run_comparison import compare
from mazebot.embedded.demo import DemoOptions, run

RUNS = 2
BURN = "import hashlib\nwhile True: hashlib.sha256(bytes(1_000_000))"


@contextlib.contextmanager
def busy_cpu(processes: int) -> Iterator[None]:
    """Others that want every core all the time."""
    busy = [subprocess.Popen([sys.executable, "-c", BURN]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def drive(out_dir: Path, **options: Any) -> dict[str, Any]:
    """The summary of a run in a process of its own, whose hash seed is another each time."""
    fields = {"world_name": "enhanced", "out_dir": str(out_dir), **options}
    script = (
        "import sys\nfrom pathlib import Path\n"
        "from mazebot.embedded.demo import DemoOptions, run\n"
        f"fields = {fields!r}\nfields['out_dir'] = Path(fields['out_dir'])\n"
        "sys.exit(run(DemoOptions(**fields)))"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "random"}
    subprocess.run(
        [sys.executable, "-c", script], check=True, cwd=ROOT, env=environment, capture_output=True
    )
    return summary_of(out_dir)


def summary_of(out_dir: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((out_dir / "summary.json").read_text())
    return summary


def assert_same(first: Path, second: Path) -> None:
    comparison = compare(*(read_digests(run_ / "digests.bin") for run_ in (first, second)))
    assert comparison.differences == ()
    assert comparison.lost == (0, 0)
    assert comparison.ends_ns[0] == comparison.ends_ns[1]
    one, other = summary_of(first), summary_of(second)
    for name in ("world_hash", "seed", "state_hash", "image_hash", "sim_time_s", "goals"):
        assert one[name] == other[name], name
    assert one["state_hash"]


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(240)
def test_a_run_is_the_same_under_load_and_another_with_another_seed(tmp_path: Path) -> None:
    short: dict[str, Any] = {
        "world_name": "enhanced", "camera": False, "renderer": "none", "goal": (0.5, 0.0, 0.0),
    }  # fmt: skip
    for name, seed in (("first", 7), ("other", 8)):
        assert run(DemoOptions(out_dir=tmp_path / name, seed=seed, **short)) == 0
    with busy_cpu(1):
        drive(tmp_path / "busy", seed=7, **short)
    assert_same(tmp_path / "first", tmp_path / "busy")
    with pytest.raises(AssertionError):
        assert_same(tmp_path / "first", tmp_path / "other")


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(3600)
def test_whole_tours_with_the_camera_are_the_same_under_load(tmp_path: Path) -> None:
    drive(tmp_path / "0")
    with busy_cpu(1):
        for number in range(1, RUNS):
            summary = drive(tmp_path / str(number))
            assert summary["image_hash"]
            assert_same(tmp_path / "0", tmp_path / str(number))
