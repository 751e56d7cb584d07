"""`mazebot map build` on logs that are made up here."""

from __future__ import annotations

import json
import math
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from mazebot.cli.app import app
from mazebot.cli.map import build, build_run
from mazebot.cli.map.build_run import Built, turn_disagreement
from mazebot.common.config import ConfigError
from mazebot.common.messages.slam_documents import PoseGraph
from mazebot.common.world.map_files import read_map
from tests.cli import robot_logs

RUNNER = CliRunner()
FILES = ("map.pgm", "map.yaml", "pose_graph.json", "trajectory.csv", "trajectory.tum")


class Hall:
    """A drive in rounds through a hall, as files."""

    def __init__(self, folder: Path) -> None:
        rng = np.random.default_rng(5)
        floor = robot_logs.hall(rng, boxes=20, rounds=2)
        self.log = robot_logs.make(floor, rng, every=8)
        self.carmen = self.log.write_carmen(folder / "hall.log")
        self.relations = self.log.write_relations(folder / "hall.relations", rng, 300)
        self.segments = np.array(floor.segments)


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Hall:
    return Hall(tmp_path_factory.mktemp("hall"))


def told(*arguments: str) -> str:
    result = RUNNER.invoke(app, ["map", "build", *arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture(scope="module")
def built(hall: Hall, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, object]]:
    out = tmp_path_factory.mktemp("built")
    text = told(
        "--log", str(hall.carmen), "--out", str(out), "--relations", str(hall.relations),
        "--draw", str(out / "hall.png"), "--json",
    )  # fmt: skip
    return out, json.loads(text)


class TestMap:
    def test_the_trajectory_is_right_where_odometry_is_not(
        self, hall: Hall, built: tuple[Path, dict[str, object]]
    ) -> None:
        _, figures = built
        drift = np.hypot(*(hall.log.odom[-1] - (hall.log.truth[-1] - hall.log.truth[0]))[:2])
        assert drift > 0.5
        errors = figures["relations"]
        assert isinstance(errors, dict)
        assert errors["used"] == 300
        assert errors["translation_m"]["mean"] < 0.01
        assert errors["rotation_deg"]["mean"] < 0.2

    def test_walls_are_where_they_are(
        self, hall: Hall, built: tuple[Path, dict[str, object]]
    ) -> None:
        out, _ = built
        chart = read_map(out / "map.yaml")
        rows, columns = np.nonzero(chart.cells == 100)
        assert len(rows) > 500
        # The map's frame is odometry's at the start; the hall's axes are turned by the first yaw.
        start = hall.log.truth[0]
        x = chart.origin.x_m + (columns + 0.5) * chart.resolution_m
        y = chart.origin.y_m + (rows + 0.5) * chart.resolution_m
        first = np.loadtxt(out / "trajectory.csv", delimiter=",", skiprows=1)[0, 1:]
        turn = start[2] - first[2]
        c, s = math.cos(turn), math.sin(turn)
        in_hall = np.stack(
            [
                start[0] + c * (x - first[0]) - s * (y - first[1]),
                start[1] + s * (x - first[0]) + c * (y - first[1]),
            ],
            axis=1,
        )
        off_m = np.min([_away_m(in_hall, segment) for segment in hall.segments], axis=0)
        assert np.mean(off_m < 0.1) > 0.97

    def test_all_files_are_there_and_agree(
        self, hall: Hall, built: tuple[Path, dict[str, object]]
    ) -> None:
        out, figures = built
        assert figures["files"] == [str(out / name) for name in ("map.yaml", "map.pgm", *FILES[2:])]
        graph = PoseGraph.model_validate_json((out / "pose_graph.json").read_bytes())
        assert figures["keyframes"] == len(graph.nodes) > 10
        assert figures["loops"] == graph.loops
        csv = np.loadtxt(out / "trajectory.csv", delimiter=",", skiprows=1)
        tum = np.loadtxt(out / "trajectory.tum")
        assert len(csv) == figures["scans_used"] == len(hall.log.times_s)
        np.testing.assert_allclose(csv[:, 0], hall.log.times_s, atol=1e-5)
        np.testing.assert_allclose(tum[:, :3], csv[:, :3], atol=1e-6)
        yaw = 2.0 * np.arctan2(tum[:, 6], tum[:, 7])
        np.testing.assert_allclose(np.cos(yaw - csv[:, 3]), 1.0, atol=1e-9)
        drawn = cv2.imread(str(out / "hall.png"))
        assert drawn is not None
        assert len(np.unique(drawn.reshape(-1, 3), axis=0)) > 4

    def test_the_same_log_gives_the_same_bytes(
        self, hall: Hall, built: tuple[Path, dict[str, object]], tmp_path: Path
    ) -> None:
        text = told("--log", str(hall.carmen), "--out", str(tmp_path))
        for name in FILES:
            assert (tmp_path / name).read_bytes() == (built[0] / name).read_bytes(), name
        for word in ("keyframes", "loops", "time per scan", "times as fast", "map.yaml"):
            assert word in text

    def test_parameters_of_a_file_count(self, hall: Hall, tmp_path: Path) -> None:
        params = tmp_path / "slam.yaml"
        params.write_text(
            "slam_toolbox:\n  ros__parameters:\n    resolution: 0.1\n    solver_plugin: x\n"
        )
        log = tmp_path / "short.log"
        log.write_text("".join(hall.carmen.read_text().splitlines(keepends=True)[:40]))
        figures = json.loads(
            told(
                "--log", str(log), "--out", str(tmp_path / "new"), "--params", str(params), "--json"
            )
        )
        assert figures["map"]["resolution_m"] == 0.1


class TestLogsAsTheyAre:
    """What of a log is not as it should be is said, and its map is whole, or an error."""

    def lines(self, hall: Hall, every: int = 6) -> list[list[str]]:
        """FLASER lines of the hall, as words."""
        lines = [line.split() for line in hall.carmen.read_text().splitlines()]
        return [words for words in lines if words[0] == "FLASER"][:180:every]

    def written(self, tmp_path: Path, lines: list[list[str]]) -> Path:
        log = tmp_path / "robot.log"
        log.write_text("".join(" ".join(words) + "\n" for words in lines))
        return log

    def test_times_that_are_all_one(self, hall: Hall, tmp_path: Path) -> None:
        lines = [[*words[:-3], "1.01893e+09", "host", "0"] for words in self.lines(hall)]
        log = self.written(tmp_path, lines)
        text = told("--log", str(log), "--out", str(tmp_path / "out"))
        assert "29 of 30 scans are not later than those before" in text
        assert len(np.loadtxt(tmp_path / "out" / "trajectory.tum")) == 30

    def test_a_jump_is_told_where(self, hall: Hall, tmp_path: Path) -> None:
        lines = self.lines(hall)
        for words in lines[20:]:
            for i in (-9, -6):
                words[i] = str(float(words[i]) + 4.0)
        log = self.written(tmp_path, lines)
        text = told("--log", str(log), "--out", str(tmp_path / "out"))
        (jump,) = (line for line in text.splitlines() if line.startswith("jump"))
        assert f"{float(lines[19][-3]):.3f} to {float(lines[20][-3]):.3f} s" in jump

    def test_a_map_of_a_small_part_is_an_error(self, tmp_path: Path) -> None:
        # Odometry ends early.
        rows = [f"{i},{0.1 * i},0,0,2,2,2,2" for i in range(4)]
        log = tmp_path / "log.csv"
        header = "time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0,range_1,range_2,range_3"
        log.write_text("\n".join([header, *rows]) + "\n")
        params = tmp_path / "p.yaml"
        params.write_text("minimum_time_interval: 3\n")
        # Left out on purpose: no error.
        options = ("--log", str(log), "--out", str(tmp_path / "out"))
        assert "2 within minimum_time_interval" in told(*options, "--params", str(params))
        rows = [f"RAWLASER1 0 -1.5 3.0 1.5 8 0.01 0 3 1 2 3 0 {i} h {i}" for i in range(1, 9)]
        odometry = [f"ODOM {0.1 * i} 0 0 0 0 0 {i} h {i}" for i in range(1, 4)]
        carmen = tmp_path / "raw.log"
        carmen.write_text("\n".join([*odometry, *rows]) + "\n")
        with pytest.raises(ConfigError) as error:
            told("--log", str(carmen), "--out", str(tmp_path / "out"))
        assert str(error.value).startswith(f"--log: {carmen}: 3 of 8 scans could be used")
        assert "5 without odometry at their time" in str(error.value)

    def test_scans_of_a_lidar_that_repeats_itself_are_left_out(self, tmp_path: Path) -> None:
        rows = [f"{i},{0.1 * i},0,0{',2' * 23},2.{min(i, 1)}" for i in range(6)]
        log = tmp_path / "log.csv"
        ranges = ",".join(f"range_{beam}" for beam in range(24))
        header = f"time_s,odom_x_m,odom_y_m,odom_yaw_rad,{ranges}"
        log.write_text("\n".join([header, *rows]) + "\n")
        with pytest.raises(ConfigError) as error:
            told("--log", str(log), "--out", str(tmp_path / "out"))
        assert "2 of 6 scans could be used, 4 repeated while the robot moves" in str(error.value)

    def test_scans_that_do_not_fit_each_other_are_told(self, hall: Hall, tmp_path: Path) -> None:
        log = self.written(tmp_path, self.lines(hall, every=3))
        options = ("map", "build", "--log", str(log), "--out", str(tmp_path / "out"), "--json")
        right = RUNNER.invoke(app, options)
        assert json.loads(right.stdout)["fit_median"] > 0.7
        assert "warning" not in right.stderr
        # A full turn, of which the lidar saw the half.
        wrong = RUNNER.invoke(
            app, [*options, "--angle-min", "0", "--angle-increment", str(2.0 * math.pi / 180)]
        )
        assert json.loads(wrong.stdout)["fit_median"] < 0.5
        (said,) = (line for line in wrong.stderr.splitlines() if "warning" in line)
        assert f"--log: {log}: the scans do not fit each other" in said
        assert "--angle-increment" in said

    def test_a_map_that_contradicts_itself_is_told(self, hall: Hall, tmp_path: Path) -> None:
        """By odometry alone, whose heading goes to and fro, walls stand in several places."""
        lines = self.lines(hall, every=3)
        for i, words in enumerate(lines):
            for place in (-7, -4):
                words[place] = str(float(words[place]) + 0.3 * math.sin(i))
        params = tmp_path / "p.yaml"
        params.write_text("use_scan_matching: false\ndo_loop_closing: false\n")
        options = ("map", "build", "--log", str(self.written(tmp_path, lines)), "--json")
        out = ("--out", str(tmp_path / "out"))
        right = RUNNER.invoke(app, [*options, *out])
        assert json.loads(right.stdout)["contradicted_median"] < 0.15
        wrong = RUNNER.invoke(app, [*options, *out, "--params", str(params)])
        assert json.loads(wrong.stdout)["contradicted_median"] > 0.2
        assert "the map contradicts itself" in wrong.stderr
        assert "the map contradicts itself" not in right.stderr

    @pytest.mark.parametrize(("fit", "contradicted", "is_told"), [
        (0.95, 0.18, False), (0.95, 0.2, True), (0.75, 0.14, False), (0.75, 0.16, True),
    ])  # fmt: skip
    def test_what_contradicts_is_judged_by_what_fits(
        self, capsys: pytest.CaptureFixture[str], fit: float, contradicted: float, is_told: bool
    ) -> None:
        slam = SimpleNamespace(left_out=Counter())
        built = SimpleNamespace(
            slam=slam, fit_median=fit, contradicted=contradicted, turn_disagreement=0.1,
            times_s=[0.0], scans=1,
        )  # fmt: skip
        build.warn_of_fit(Path("a.log"), cast("Built", built))
        assert ("the map contradicts itself" in capsys.readouterr().err) == is_told

    def test_scans_that_turn_against_odometry_are_told(
        self, hall: Hall, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Mirrored, they may fit each other as well as ever."""
        times_s = np.arange(60.0)
        yaws = 3.0 * np.sin(0.2 * times_s)
        odometry = np.stack([times_s, times_s, 0.0 * times_s, yaws + 0.01 * times_s], axis=1)
        poses = np.stack([times_s, 0.0 * times_s, wrapped(yaws)], axis=1)
        assert turn_disagreement(times_s, poses, odometry) < 0.1
        assert turn_disagreement(times_s, poses * (1.0, 1.0, -1.0), odometry) > 1.5
        straight = odometry * (1.0, 1.0, 1.0, 0.01)
        assert turn_disagreement(times_s, poses * (1.0, 1.0, -0.01), straight) == 0.0
        monkeypatch.setattr(build_run, "turn_disagreement", lambda *_: 1.99)
        log = self.written(tmp_path, self.lines(hall, every=3))
        options = ("map", "build", "--log", str(log), "--out", str(tmp_path / "out"))
        (said,) = (
            line for line in RUNNER.invoke(app, options).stderr.splitlines() if "warning" in line
        )
        assert f"--log: {log}: the scans do not turn as odometry does: by 199 %" in said

    def test_scans_after_the_robot_was_carried_off_are_told(
        self, hall: Hall, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        log = self.written(tmp_path, self.lines(hall, every=1))
        options = ("map", "build", "--log", str(log), "--out", str(tmp_path / "out"))
        monkeypatch.setattr(build, "check_turn", lambda *_: None)
        mirrored = RUNNER.invoke(
            app,
            [*options, "--angle-min", str(math.pi / 2), "--angle-increment", str(-math.pi / 180)],
        )
        assert mirrored.exit_code != 0
        (said,) = (line for line in mirrored.stderr.splitlines() if "warning" in line)
        assert "of 180 scans were left out, after the robot was carried off: check" in said
        assert "--angle-increment" in said


def wrapped(angles_rad: np.ndarray) -> np.ndarray:
    return np.mod(angles_rad + math.pi, math.tau) - math.pi


def _away_m(points: np.ndarray, segment: np.ndarray) -> np.ndarray:
    a, b = segment[:2], segment[2:]
    along = b - a
    t = np.clip(((points - a) @ along) / max(float(along @ along), 1e-12), 0.0, 1.0)
    return np.asarray(np.hypot(*(a + t[:, None] * along - points).T))


class TestMistakes:
    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("resolutoin: 0.05", ":1: resolutoin: no such parameter: must be resolution"),
            ("resolution: 0", ":1: resolution: 0: must be greater than or equal to 0.01"),
            ("mapping:\n  do_loop_closing: perhaps", ":2: do_loop_closing: 'perhaps'"),
            ("mapping: 5", "must be names of parameters"),
        ],
    )
    def test_parameters(self, hall: Hall, tmp_path: Path, text: str, said: str) -> None:
        params = tmp_path / "params.yaml"
        params.write_text(text + "\n")
        with pytest.raises(ConfigError) as error:
            told("--log", str(hall.carmen), "--out", str(tmp_path), "--params", str(params))
        assert said in str(error.value)
        assert str(params) in str(error.value)

    def test_a_log_whose_scans_cannot_be_used(self, tmp_path: Path) -> None:
        log = tmp_path / "log.csv"
        log.write_text("time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0\n0,0,0,0,\n")
        with pytest.raises(ConfigError, match="has no scan"):
            told("--log", str(log), "--out", str(tmp_path / "out"))
