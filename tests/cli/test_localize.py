"""`mazebot localize` on logs that are written here."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from typer.testing import CliRunner

from mazebot.cli.app import app
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.world.map_files import write_map
from tests.localization import offline

RUNNER = CliRunner()
Row = tuple[int, SE2 | None, np.ndarray | None]
HEADER = "time_s,odom_x_m,odom_y_m,odom_yaw_rad"


class Drive:
    """A drive of some seconds through the house: the map's file, odometry, ranges, the truth."""

    def __init__(self, folder: Path, seconds: float = 12.0) -> None:
        place = offline.shipped("sim_house")
        rng = np.random.default_rng(3)
        robot = offline.Robot(place, place.free_pose(rng), place.localization(1), rng)
        self.start = robot.pose
        self.map = write_map(folder, "house", place.cells, place.resolution_m, place.origin)
        self.rows: list[tuple[int, SE2, np.ndarray | None]] = []
        for i in range(round(seconds * 20)):
            robot.wander()
            self.rows.append((robot.now_ns, robot.odom, None if i % 2 == 0 else robot.ranges))
        self.end = robot.pose

    def csv(self, path: Path) -> Path:
        beams = range(offline.BEAMS)
        lines = [f"{HEADER}," + ",".join(f"range_{i}" for i in beams)]
        for stamp_ns, odom, ranges in self.rows:
            values = [f"{stamp_ns * 1e-9:.3f}", *(f"{value:.6f}" for value in odom)]
            values += ["" if ranges is None else f"{ranges[i]:.3f}" for i in beams]
            lines.append(",".join(values))
        path.write_text("\n".join(lines) + "\n")
        return path

    def mcap(self, folder: Path, rows: Sequence[Row] = ()) -> Path:
        """A bag of the rows, of which each may lack odometry or ranges; empty: of the drive."""
        store = msg.TYPESTORE
        with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            odom = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
            scan = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=store)
            for stamp_ns, pose, ranges in rows or self.rows:
                if pose is not None:
                    message = msg.Odometry(
                        msg.header(stamp_ns, "odom"),
                        "base_footprint",
                        msg.PoseWithCovariance(msg.pose_from_se2(pose), np.zeros(36)),
                        msg.TwistWithCovariance(
                            msg.Twist(msg.Vector3(0.0, 0.0, 0.0), msg.Vector3(0.0, 0.0, 0.0)),
                            np.zeros(36),
                        ),
                    )
                    writer.write(odom, stamp_ns, store.serialize_cdr(message, odom.msgtype))
                if ranges is not None:
                    sweep = msg.LaserScan(
                        msg.header(stamp_ns, "base_scan"), 0.0, 0.0, math.tau / 360, 0.0, 0.1,
                        0.12, 3.5, ranges.astype(np.float32), np.zeros(0, np.float32),
                    )  # fmt: skip
                    writer.write(scan, stamp_ns, store.serialize_cdr(sweep, scan.msgtype))
        return next(folder.glob("*.mcap"))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return Drive(tmp_path_factory.mktemp("map"))


def told(*arguments: str) -> str:
    result = RUNNER.invoke(app, ["localize", *arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout


def wrong(drive: Drive, *arguments: str) -> str:
    with pytest.raises(ConfigError) as error:
        told("--map", str(drive.map), *arguments)
    assert "\n" not in str(error.value)
    return str(error.value)


def last_pose(text: str) -> SE2:
    x_m, y_m, yaw_rad = text.strip().splitlines()[-1].split(",")[3:6]
    return SE2(float(x_m), float(y_m), float(yaw_rad))


class TestLogs:
    def test_from_nothing_on_a_csv_file_with_a_picture(self, drive: Drive, tmp_path: Path) -> None:
        log, picture = drive.csv(tmp_path / "log.csv"), tmp_path / "way.png"
        text = told(
            "--map", str(drive.map), "--log", str(log), "--global", "--draw", str(picture)
        )  # fmt: skip
        lines = text.splitlines()
        assert lines[0].startswith("time_s,state,quality,x_m,y_m,yaw_rad,std_x_m")
        assert len(lines) == 1 + sum(ranges is not None for _, _, ranges in drive.rows)
        assert lines[1].split(",")[1] == "searching"
        assert lines[-1].split(",")[1] == "localized"
        assert last_pose(text).distance_m(drive.end) < 0.05
        drawn = cv2.imread(str(picture))
        assert drawn is not None
        assert len(np.unique(drawn.reshape(-1, 3), axis=0)) > 4

    def test_from_a_given_start_as_json(self, drive: Drive, tmp_path: Path) -> None:
        log = drive.csv(tmp_path / "log.csv")
        begin = [str(value) for value in drive.start @ SE2(0.1, 0.1, 0.1)]
        text = told(
            "--map", str(drive.map), "--log", str(log), "--start", *begin, "--json"
        )  # fmt: skip
        fixes = json.loads(text)
        assert {fix["state"] for fix in fixes} == {"localized"}
        assert SE2(*fixes[-1]["pose"]).distance_m(drive.end) < 0.05
        assert np.array(fixes[-1]["covariance"]).shape == (3, 3)

    def test_a_log_that_is_not_of_this_map_is_no_success(
        self, drive: Drive, tmp_path: Path
    ) -> None:
        hall = offline.rectangle(40.0, 30.0)
        other = write_map(tmp_path, "hall", hall.cells, hall.resolution_m, hall.origin)
        arguments = ["--map", str(other), "--log", str(drive.csv(tmp_path / "log.csv"))]
        result = RUNNER.invoke(app, ["localize", *arguments, "--global"])
        assert result.exit_code == 1
        assert "localized at none of 120 scans" in result.stderr
        states = {line.split(",")[1] for line in result.stdout.splitlines()[1:]}
        assert states == {"searching"}

    def test_an_mcap_file_and_its_folder_give_the_same(self, drive: Drive, tmp_path: Path) -> None:
        file = drive.mcap(tmp_path / "bag")
        texts = [
            told("--map", str(drive.map), "--log", str(path), "--global")
            for path in (file, tmp_path / "bag")
        ]
        assert texts[0] == texts[1]
        assert last_pose(texts[0]).distance_m(drive.end) < 0.05


class TestMistakes:
    def test_a_file_that_is_not_there(self, drive: Drive, tmp_path: Path) -> None:
        assert "no such file" in wrong(drive, "--log", str(tmp_path / "none.csv"))

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("time,x,y,yaw\n", f"must be '{HEADER},range_0,range_1,...'"),
            (f"{HEADER}\n", "0 columns of ranges"),
            (f"{HEADER},range_1\n", "column 'range_1': must be range_0"),
            (f"{HEADER},range_0\n", "has no rows"),
            (f"{HEADER},range_0\n0,0,0\n", ":2: 3 values: must be 5"),
            (f"{HEADER},range_0\n0,0,nan,0,1\n", ":2: odom_y_m: 'nan': must be a finite number"),
            (f"{HEADER},range_0\n0,0,0,0,far\n", "range_0: 'far': must be metres, inf or empty"),
            (f"{HEADER},range_0\n0,0,0,0,\n", "has no scan with odometry"),
        ],
    )
    def test_a_csv_file(self, drive: Drive, tmp_path: Path, text: str, said: str) -> None:
        log = tmp_path / "log.csv"
        log.write_text(text)
        message = wrong(drive, "--log", str(log))
        assert said in message
        assert str(log) in message

    def test_a_file_that_is_no_mcap(self, drive: Drive, tmp_path: Path) -> None:
        log = tmp_path / "log.mcap"
        log.write_bytes(b"nothing of the kind")
        assert "is neither MCAP nor SQLite" in wrong(drive, "--log", str(log))

    @pytest.mark.parametrize(
        ("options", "said"),
        [
            (["--global", "--start", "0", "0", "0"], "--global"),
            (["--start", "0", "nan", "0"], "--start: Y: nan: must be a finite number"),
            (["--range-min", "4"], "--range-max: 3.5: must be > --range-min"),
            (["--angle-increment", "0"], "--angle-increment"),
            (["--draw", "/no/such/folder/way.png"], "--draw"),
        ],
    )
    def test_an_option(self, drive: Drive, tmp_path: Path, options: list[str], said: str) -> None:
        assert said in wrong(drive, "--log", str(drive.csv(tmp_path / "log.csv")), *options)

    def test_a_map_that_is_not_there(self, tmp_path: Path, drive: Drive) -> None:
        with pytest.raises(ConfigError, match=r"none\.yaml"):
            told("--map", str(tmp_path / "none.yaml"), "--log", str(drive.csv(tmp_path / "l.csv")))


class TestScansAndOdometry:
    """Odometry that comes rarely, or ends: the pose is that at the scan's time, or none."""

    def fixes(
        self, drive: Drive, folder: Path, every: int, until: int | None = None
    ) -> tuple[list[dict[str, Any]], str]:
        """By a bag with every so manyth pose of odometry, and none from a step on."""
        told_of = [
            (stamp_ns, pose if i % every == 0 and (until is None or i < until) else None, ranges)
            for i, (stamp_ns, pose, ranges) in enumerate(drive.rows)
        ]
        bag = drive.mcap(folder / "bag", told_of)
        begin = [str(value) for value in drive.start]
        arguments = ["--map", str(drive.map), "--log", str(bag), "--start", *begin, "--json"]
        result = RUNNER.invoke(app, ["localize", *arguments, "--lidar", "0", "0", "0"])
        if isinstance(result.exception, ConfigError):
            raise result.exception
        assert result.exit_code == 0
        return json.loads(result.stdout), result.stderr

    def test_rare_odometry_makes_no_pose_late(self, drive: Drive, tmp_path: Path) -> None:
        often, _ = self.fixes(drive, tmp_path / "often", 1)
        rare, _ = self.fixes(drive, tmp_path / "rare", 10)
        at = {fix["time_s"]: SE2(*fix["pose"]) for fix in often}
        off_m = [at[fix["time_s"]].distance_m(SE2(*fix["pose"])) for fix in rare]
        assert len(off_m) > 100
        assert np.mean(off_m) < 0.03

    def test_scans_after_the_end_of_odometry_are_not_counted(
        self, drive: Drive, tmp_path: Path
    ) -> None:
        fixes, said = self.fixes(drive, tmp_path, 1, until=160)
        ended_s = drive.rows[159][0] * 1e-9
        assert fixes[-1]["time_s"] < ended_s + 0.25
        assert f"localized at {len(fixes)} of {len(fixes)} scans; " in said
        assert f"{120 - len(fixes)} left out, without odometry at their time" in said

    def test_most_scans_without_odometry_are_no_success(self, drive: Drive, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match="must be at least half of them"):
            self.fixes(drive, tmp_path, 1, until=60)
