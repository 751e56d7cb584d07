"""Logs whose odometry has another unit than metres, or is missing for a while."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mazebot.cli.app import app
from mazebot.cli.logs.jumps import without_jumps
from mazebot.cli.logs.log import Entry, Log, LoggedScan
from mazebot.cli.logs.scale import check_scale, way_ratio
from mazebot.cli.map import build
from mazebot.cli.map.build_run import run
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.odometry_history import NO_ODOMETRY
from mazebot.mapping.params import SlamParams
from tests.cli import robot_logs

RUNNER = CliRunner()
STEP_S = 0.05
ANGLES_RAD = np.radians(np.arange(-90.0, 90.0))


def written(path: Path, unit: float) -> Path:
    """A drive through a hall, with so many of odometry's units in a metre."""
    rng = np.random.default_rng(5)
    log = robot_logs.make(robot_logs.hall(rng, boxes=20, rounds=1), rng, every=8)
    log.odom[:, :2] *= unit
    return log.write_carmen(path)


def asked(log: Path, command: str, out: Path, *options: str) -> list[str]:
    where = ["--out", str(out)]
    if command == "localize":
        where = ["--map", str(out / "map.yaml"), "--start", "0 0 0"]
    return [*command.split(), "--log", str(log), *where, *options]


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hall")
    result = RUNNER.invoke(app, asked(written(folder / "right.log", 1.0), "map build", folder))
    assert (result.exit_code, "warning" in result.stderr) == (0, False)
    return folder


@pytest.mark.parametrize("command", ["map build", "localize"])
@pytest.mark.parametrize(
    ("unit", "said"),
    [
        (100.0, "is in centimetres, must be metres: --odom-scale 0.01 makes"),
        (1000.0, "is in millimetres, must be metres: --odom-scale 0.001 makes"),
        (39.37, "is in inches, must be metres: --odom-scale 0.0254 makes"),
        (10.0, "must be metres: --odom-scale 0.0"),
        (0.5, "must be metres: --odom-scale 1.9"),
    ],
)
def test_odometry_of_another_unit_is_refused_with_what_to_give(
    mapped: Path, tmp_path: Path, command: str, unit: float, said: str
) -> None:
    log = written(tmp_path / "hall.log", unit)
    (line,) = str(RUNNER.invoke(app, asked(log, command, mapped)).exception).splitlines()
    assert line.startswith(f"--log: {log}: odometry's way is ")
    assert said in line


def test_with_its_scale_given_the_map_is_that_of_metres(mapped: Path, tmp_path: Path) -> None:
    log = written(tmp_path / "cm.log", 100.0)
    out = tmp_path / "out"
    result = RUNNER.invoke(app, asked(log, "map build", out, "--odom-scale", "0.01"))
    assert (result.exit_code, "warning" in result.stderr) == (0, False)
    poses, right = (np.loadtxt(folder / "trajectory.tum") for folder in (out, mapped))
    np.testing.assert_allclose(poses[:, :3], right[:, :3], atol=0.02)


def test_of_scans_that_contradict_most_steps_no_map_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build, "check_scale", lambda *_: None)
    log = written(tmp_path / "cm.log", 100.0)
    log.write_text("".join(log.read_text().splitlines(keepends=True)[:20]))
    result = RUNNER.invoke(app, asked(log, "map build", tmp_path / "out"))
    assert isinstance(result.exception, ConfigError)
    assert "the scans contradict odometry at" in str(result.exception)
    assert not (tmp_path / "out").exists()


def logged(
    segments: Array, poses: Array, odometry: Array, every: int, without: slice = slice(0)
) -> Log:
    """Odometry each 50 ms, other than some of it, and a scan of `every` poses."""
    rng = np.random.default_rng(1)
    missing = range(len(poses))[without]
    entries = []
    for i, (pose, odom) in enumerate(zip(poses, odometry, strict=True)):
        scan = None
        if i % every == 0:
            ranges_m = robot_logs.sweep(segments, pose, ANGLES_RAD, rng, 0.01)
            scan = LoggedScan(
                ranges_m.astype(np.float32), float(ANGLES_RAD[0]), math.radians(1.0), 0.05, 30.0,
                base_from_scan=SE2(0.0, 0.0, 0.0),
            )  # fmt: skip
        pose_of = None if i in missing else SE2(*odom.tolist())
        entries.append(Entry(round(i * STEP_S * 1e9), pose_of, scan))
    return Log(entries)


def test_a_corridor_does_not_tell_how_far_it_was() -> None:
    walls = np.array([(-500.0, -1.0, 500.0, -1.0), (-500.0, 1.0, 500.0, 1.0)])
    poses = robot_logs.drive([(0.0, 0.0), (20.0, 0.0)])
    assert way_ratio(logged(walls, poses, poses * (0.5, 0.5, 1.0), 4), None) is None


def test_scans_a_metre_apart_do_not_refute_wheels_that_slip() -> None:
    rng = np.random.default_rng(5)
    floor = robot_logs.hall(rng, boxes=20, rounds=1)
    poses = robot_logs.drive(floor.way)
    odometry = robot_logs.odometry(poses, rng, way_scale=0.9, slip=0.3)
    check_scale("x", logged(np.array(floor.segments), poses, odometry, 50), None)


class TestGaps:
    def hall(self, missing_s: float, every_s: float = STEP_S) -> tuple[Log, Array]:
        """A drive without odometry from 30 s on for a time; the truth."""
        rng = np.random.default_rng(5)
        floor = robot_logs.hall(rng, boxes=20, rounds=1)
        poses = robot_logs.drive(floor.way)
        odometry = robot_logs.odometry(poses, rng)
        begin = round(30.0 / STEP_S)
        without = slice(begin, begin + round(missing_s / STEP_S))
        log = logged(np.array(floor.segments), poses, odometry, 4, without)
        often = round(every_s / STEP_S)
        entries = [
            entry if i % often == 0 else Entry(entry.stamp_ns, None, entry.scan)
            for i, entry in enumerate(log.entries)
        ]
        return Log(entries), poses

    def test_no_way_is_made_up_where_odometry_is_missing(self) -> None:
        log, poses = self.hall(8.0)
        built = run(log, SlamParams())
        assert 35 <= built.slam.left_out[NO_ODOMETRY] <= 40
        (remark,) = log.remarks()
        assert remark.startswith("odometry has a gap of 8.1 s at 29.950 s")
        truth = SE2(*poses[0]).inverse()
        right = [truth @ SE2(*poses[round(time_s / STEP_S)]) for time_s in built.times_s]
        first = SE2(*built.poses[0]).inverse()
        off_m = [
            (first @ SE2(*pose)).distance_m(at) for pose, at in zip(built.poses, right, strict=True)
        ]
        assert max(off_m) < 0.1

    def test_odometry_that_comes_too_rarely_has_gaps_and_does_not_tell_of_its_scale(self) -> None:
        log, _ = self.hall(0.0, 12.0)
        assert log.gaps()
        assert way_ratio(log, None) is None

    @pytest.mark.parametrize(("missing_s", "every_s"), [(0.5, STEP_S), (0.0, 1.5)])
    def test_odometry_that_is_rare_or_late_has_no_gap(
        self, missing_s: float, every_s: float
    ) -> None:
        log, _ = self.hall(missing_s, every_s)
        assert not log.gaps()
        assert not log.remarks()


class TestJumps:
    """Of odometry that has a pose each 50 ms."""

    LOG = Path("run.mcap")

    def way(self) -> list[SE2]:
        """A curve at 1 m/s."""
        turns_rad = 0.01 * np.arange(600)
        ways = 0.05 * np.column_stack([np.cos(turns_rad), np.sin(turns_rad)])
        places = np.cumsum(ways, axis=0).tolist()
        return [
            SE2(x_m, y_m, turn) for (x_m, y_m), turn in zip(places, turns_rad.tolist(), strict=True)
        ]

    def log(self, poses: list[SE2], step_s: float = STEP_S) -> Log:
        return Log([Entry(round(i * step_s * 1e9), pose, None) for i, pose in enumerate(poses)])

    def steps(self, log: Log) -> Array:
        poses = [entry.odom_from_base for entry in log.entries if entry.odom_from_base]
        return np.array([a.inverse() @ b for a, b in itertools.pairwise(poses)])

    @pytest.mark.parametrize(
        "jump", [SE2(1.5, 0.0, 0.0), SE2(-30.0, 7.0, 2.0), SE2(0.0, 0.0, math.pi)]
    )
    def test_the_way_goes_on_over_a_jump_as_before(self, jump: SE2) -> None:
        way = self.way()
        poses = [*way[:200], *(jump @ pose for pose in way[200:400]), *way[400:]]
        log = without_jumps(self.LOG, self.log(poses))
        np.testing.assert_allclose(self.steps(log), self.steps(self.log(way)), atol=1e-3)
        assert [one.stamp_ns * 1e-9 for one in log.odometry_jumps] == pytest.approx([10.0, 20.0])
        assert "jumps by" in log.remarks()[0]
        assert "at 10.000 s" in log.remarks()[0]

    def test_two_that_are_mixed_are_refused(self) -> None:
        aside = SE2(3.0, -2.0, 0.7)
        poses = [aside @ pose if i % 3 else pose for i, pose in enumerate(self.way())]
        log = self.log(poses)
        with pytest.raises(
            ConfigError, match=r"run\.mcap: two odometries are mixed: \d+ of 600 po"
        ):
            without_jumps(self.LOG, log)
        log.odometry_source, log.odometry_topics = "/odom, 'odom' to 'base_link'", ("/wheels",)
        with pytest.raises(ConfigError, match=r"on /odom, .*: --odom-topic must be .* /wheels"):
            without_jumps(self.LOG, log)

    @pytest.mark.parametrize("unit", [1.0, 15.0, 1000.0])
    def test_no_other_way_is_a_jump(self, unit: float) -> None:
        """Of cars, in millimetres, told late, or with rounded times."""
        way = [SE2(pose.x_m * unit, pose.y_m * unit, pose.yaw_rad) for pose in self.way()]
        held = [way[i - i % 8] for i in range(len(way))]
        stalled = [*way[:100], *[way[99]] * 9, *way[109:]]
        rounded = self.log(way)
        rounded.entries = [
            Entry(round(one.stamp_ns, -9), one.odom_from_base, None) for one in rounded.entries
        ]
        rare = self.log([*way[:300], *(SE2(9.0, 0.0, 1.0) @ pose for pose in way[300:])], 1.0)
        for log in (self.log(way), self.log(held), self.log(stalled), rounded, rare):
            assert without_jumps(self.LOG, log) is log
