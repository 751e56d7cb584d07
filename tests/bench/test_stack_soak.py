"""A stack that is driven in for long."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from mazebot.bench.chaos.scratch import scratch_folder
from mazebot.bench.chaos.soak import Life, Sample, failures_of, lives_of, lost_of, main
from mazebot.bench.chaos.trial import Trial
from mazebot.common.config import ConfigError


def test_each_process_is_judged_after_its_warm_up() -> None:
    steady = [Sample("physics", 1, 10.0 * n, 200.0 - 5.0 * min(n, 5), 20) for n in range(60)]
    leaks = [Sample("navigation", 2, 10.0 * n, 150.0 + 2.0 * n, 20 + n) for n in range(60)]
    short = [Sample("physics", 3, 10.0 * n, 100.0 + 9.0 * n, 20) for n in range(9)]
    unseen = [Sample("router", 4, 10.0 * n, 50.0, None) for n in range(60)]
    physics, navigation, again, router = lives_of([*steady, *leaks, *short, *unseen])
    assert (physics.service, physics.lasted_s, physics.peak_mb) == ("physics", 590.0, 200.0)
    assert physics.growth_mb == pytest.approx(0.0, abs=1e-6)
    assert physics.files == 0
    assert navigation.growth_mb == pytest.approx(2.0 * 53)
    assert (navigation.files, navigation.peak_mb) == (53, 268.0)
    assert (again.growth_mb, again.files) == (None, None)
    assert router.files is None
    assert router.growth_mb == pytest.approx(0.0, abs=1e-6)


def test_what_did_not_hold_is_told() -> None:
    well = Trial("kill-physics", 0, goal="reached", next_goal="reached")
    assert failures_of([well], [Life("physics", 600.0, 200.0, 63.0, 16)], {}) == []
    stuck = Trial("kill-router", 1, problem="not within 60 s: an active navigation", contacts=2)
    lives = [
        Life("physics", 600.0, 300.0, 65.0, 17),
        # What it has recorded.
        Life("recorder", 600.0, 900.0, 500.0, 0),
    ]
    assert failures_of([well, stuck], lives, {"/navigation/result": 1}) == [
        "kill-router: not recovered: not within 60 s: an active navigation",
        "kill-router: 2 contacts",
        "physics: grew by 65 MB in 600 s",
        "physics: 17 more open files",
        "/navigation/result: 1 messages lost",
    ]


def test_only_what_may_never_be_lost_counts(tmp_path: Path) -> None:
    for run, lost in (("one", 0), ("two", 3)):
        (tmp_path / run).mkdir()
        skipped = ("/scan", "/simulation/stats", "/behavior_tree", "/none_of_ours")
        counts = {name: {"lost": 7} for name in skipped}
        counts["/navigation/result"] = {"lost": lost}
        (tmp_path / run / "summary.json").write_text(json.dumps({"messages": counts}))
    assert lost_of(tmp_path) == {"/navigation/result": 3}
    # Each of its messages counts, also for late readers.
    (tmp_path / "one" / "summary.json").write_text(
        json.dumps({"messages": {"/world/assets": {"lost": 1}}})
    )
    assert lost_of(tmp_path, {"two"}) == {"/world/assets": 1}
    (tmp_path / "one" / "summary.json").write_text(json.dumps({"messages": {}}))
    # There was no router for a while.
    assert lost_of(tmp_path, {"two"}) == {}


def test_what_a_run_wrote_stays_until_it_has_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with scratch_folder("soak-") as held:
        (held.path / "run.mcap").touch()
        held.is_needed = False
    assert not held.path.exists()
    assert not capsys.readouterr().err

    def fails() -> None:
        with scratch_folder("soak-") as broken:
            (broken.path / "run.mcap").touch()
            raise ConfigError("no router")

    with pytest.raises(ConfigError):
        fails()
    (kept,) = tmp_path.glob("soak-*/run.mcap")
    (line,) = capsys.readouterr().err.splitlines()
    assert str(kept.parent) in line

    def is_interrupted() -> None:
        with scratch_folder("soak-"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        is_interrupted()
    assert list(tmp_path.glob("soak-*")) == [kept.parent]
    assert not capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--minutes", "0"], ["--minutes-a-world", "0"]])
def test_what_cannot_be_done_is_one_line(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert arguments[0] in line


@pytest.mark.slow
@pytest.mark.longest
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(900)
def test_a_stack_lives_on_through_kills_and_worlds(tmp_path: Path) -> None:
    report = tmp_path / "soak.json"
    command = [
        sys.executable, "-m", "mazebot.bench.chaos.soak", "--minutes", "1.5", "--minutes-a-world",
        "1", "--json", str(report),
    ]  # fmt: skip
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, timeout=800, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(report.read_text())
    assert found["worlds"] == ["sim_house_enhanced", "sim_house_rooms"]
    assert len(found["trials"]) == 2
    assert all(trial["recovered"] for trial in found["trials"])
    assert not found["lost"]
    assert not found["broken_recordings"]
