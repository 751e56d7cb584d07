"""Readers of recorded logs: CARMEN's lines, damage, packed files, bags without /odom."""

from __future__ import annotations

import gzip
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from mazebot.cli.logs.log import Entry, Log, ScanForm, Topics
from mazebot.cli.logs.read import read_log
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg

START = SE2(0, 0, 0)
RANGES = [1.0 + i / 100.0 for i in range(180)]


def flaser(
    time_s: float, odom: SE2 = START, laser: SE2 | None = None, ranges: list[float] | None = None
) -> str:
    """A line FLASER."""
    values = ranges or RANGES
    poses = " ".join(str(value) for value in (*(laser or odom), *odom))
    beams = " ".join(str(value) for value in values)
    return f"FLASER {len(values)} {beams} {poses} {time_s:.6f} nohost {time_s % 1000.0:.6f}"


def robotlaser(time_s: float, odom: SE2, laser: SE2, ranges: list[float], farthest: float) -> str:
    """A line ROBOTLASER1 with two remissions."""
    beams = " ".join(str(value) for value in ranges)
    poses = " ".join(str(value) for value in (*laser, *odom))
    step = math.pi / (len(ranges) - 1)
    return (
        f"ROBOTLASER1 0 {-math.pi / 2} {math.pi} {step} {farthest} 0.01 0 {len(ranges)} {beams} "
        f"2 7 8 {poses} 0.1 0.2 0.3 0.4 0.5 {time_s:.6f} pioneer 3.5"
    )


def written(folder: Path, *lines: str, name: str = "robot.log") -> Path:
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


def read(path: Path, form: ScanForm | None = None) -> Log:
    return read_log(path, form or ScanForm())


def scans(log: Log) -> list[Entry]:
    return [entry for entry in log.entries if entry.scan is not None]


def lidar_of(log: Log) -> SE2 | None:
    (place,) = {entry.scan.base_from_scan for entry in scans(log) if entry.scan}
    return place


def refused(path: Path) -> str:
    with pytest.raises(ConfigError) as error:
        read(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("end", ["\r\n", "\r"])
def test_lines_may_end_as_on_other_systems(tmp_path: Path, end: str) -> None:
    path = written(tmp_path, *(flaser(float(i), SE2(0.1 * i, 0.0, 0.0)) for i in range(5)))
    log = read(path)
    path.write_text(path.read_text(), newline=end)
    again = read(path)
    assert [one.stamp_ns for one in again.entries] == [one.stamp_ns for one in log.entries]
    assert len(scans(again)) == 5


class TestCarmen:
    def test_a_log_with_all_kinds_of_lines(self, tmp_path: Path) -> None:
        pose = SE2(1.0, 2.0, 0.5)
        log = read(
            written(
                tmp_path,
                "# CARMEN Logfile",
                "PARAM robot_length 0.5 nohost 0.1",
                "SYNC begin",
                "ODOM 9 9 9 0 0 0 976052856.5 nohost 0.5",
                "RLASER 2 1 1 0 0 0 0 0 0 976052856.9 nohost 0.6",
                "TRUEPOS 0 0 0 0 0 0 1.0 nohost 0.1",
                "",
                flaser(976052857.25, pose),
            )
        )
        (entry,) = log.entries
        assert entry.stamp_ns == 976_052_857_250_000_000
        assert entry.odom_from_base == pytest.approx(pose)
        assert entry.scan is not None
        assert entry.scan.ranges_m == pytest.approx(RANGES)
        assert lidar_of(log) == SE2(0.0, 0.0, 0.0)

    @pytest.mark.parametrize(
        ("beams", "first_deg", "step_deg"),
        [(180, -90, 1), (181, -90, 1), (360, -90, 0.5), (361, -90, 0.5), (401, -50, 0.25),
         (91, -90, 2)],
    )  # fmt: skip
    def test_the_number_of_readings_tells_their_directions(
        self, tmp_path: Path, beams: int, first_deg: float, step_deg: float
    ) -> None:
        (entry,) = scans(read(written(tmp_path, flaser(5.0, ranges=[2.0] * beams))))
        assert entry.scan is not None
        assert math.degrees(entry.scan.angle_min_rad) == pytest.approx(first_deg)
        assert math.degrees(entry.scan.angle_increment_rad) == pytest.approx(step_deg)

    def test_angles_that_are_a_guess_are_told(self, tmp_path: Path) -> None:
        path = written(tmp_path, flaser(5.0, ranges=[2.0] * 682))
        assert read(path).assumed.startswith("line 1: FLASER has 682 readings and no angles: ")
        given = ScanForm(angle_min_rad=-2.0944, angle_increment_rad=0.00615)
        assert read(path, given).assumed == ""
        assert read(written(tmp_path, flaser(5.0, ranges=[2.0] * 181))).assumed == ""

    def test_robotlaser_says_its_own_form(self, tmp_path: Path) -> None:
        robot = SE2(1.0, 2.0, 1.5)
        laser = robot @ SE2(0.2, 0.0, 0.0)
        line = robotlaser(1134864642.9, robot, laser, [2.0, 3.0, 31.0, 32.0], 30.0)
        log = read(written(tmp_path, line))
        (entry,) = log.entries
        assert entry.scan is not None
        np.testing.assert_allclose(entry.scan.ranges_m, [2.0, 3.0, np.nan, np.nan])
        assert entry.scan.angle_increment_rad == pytest.approx(math.pi / 3)
        assert entry.scan.range_max_m == 30.0
        assert lidar_of(log) == pytest.approx(SE2(0.2, 0.0, 0.0))
        assert entry.stamp_ns == pytest.approx(1134864642.9e9, abs=1e3)

    def test_rawlaser_takes_the_odometry_between(self, tmp_path: Path) -> None:
        log = read(
            written(
                tmp_path,
                "ODOM 0 0 0 0 0 0 10.0 h 0.1",
                "RAWLASER1 0 -1.5 3.0 1.5 8 0.01 0 3 1 2 3 0 10.5 h 0.5",
                "ODOM 1 0 0 0 0 0 11.0 h 1.1",
            )
        )
        stamps = [(entry.stamp_ns, entry.scan is not None) for entry in log.steps()]
        assert stamps == [(10 * 10**9, False), (11 * 10**9, False), (10_500_000_000, True)]

    @pytest.mark.parametrize("code", [81.83, 81.91, 80.0])
    def test_codes_of_a_sick_are_no_ranges(self, tmp_path: Path, code: float) -> None:
        (entry,) = scans(read(written(tmp_path, flaser(5.0, ranges=[2.0, code, 12.5]))))
        assert entry.scan is not None
        np.testing.assert_allclose(entry.scan.ranges_m, [2.0, np.nan, 12.5])

    def test_a_longest_range_that_many_readings_have_is_a_code(self, tmp_path: Path) -> None:
        ranges = [*RANGES[:170], *[8.191] * 5, *[8.183] * 5]
        (entry,) = scans(read(written(tmp_path, flaser(5.0, ranges=ranges))))
        assert entry.scan is not None
        assert np.isnan(entry.scan.ranges_m[170:]).all()
        assert np.isfinite(entry.scan.ranges_m[:170]).all()
        # A single longest reading is a wall.
        (entry,) = scans(read(written(tmp_path, flaser(5.0, ranges=[*RANGES[:179], 9.0]))))
        assert entry.scan is not None
        assert entry.scan.ranges_m[179] == 9.0

    def test_poses_corrected_afterwards_are_not_taken_for_the_lasers(self, tmp_path: Path) -> None:
        corrected = [SE2(0, 0, 0), SE2(1.5, 0.2, 0.1), SE2(2.9, 0.4, 0.2)]
        odom = [SE2(0, 0, 0), SE2(1.4, 0.0, 0.0), SE2(2.8, 0.0, 0.0)]
        lines = [
            flaser(5.0 + i, o, c) for i, (o, c) in enumerate(zip(odom, corrected, strict=True))
        ]
        log = read(written(tmp_path, "PARAM robot_frontlaser_offset 0.3", *lines))
        assert [entry.odom_from_base for entry in log.entries] == odom
        assert lidar_of(log) == SE2(0.3, 0.0, 0.0)

    def test_scans_in_disorder_are_sorted_if_the_way_is_shorter_then(self, tmp_path: Path) -> None:
        at = [SE2(0.1 * i, 0, 0) for i in range(6)]
        order = [0, 2, 1, 3, 5, 4]
        log = read(written(tmp_path, *(flaser(10.0 + i, at[i]) for i in order)))
        assert [entry.odom_from_base for entry in log.entries] == at
        assert log.skipped == 0

    def test_times_that_repeat_or_go_back_lie_between_the_others(self, tmp_path: Path) -> None:
        times = [10.0, 11.0, 11.0, 10.5, 12.0]
        lines = [flaser(time_s, SE2(0.1 * i, 0, 0)) for i, time_s in enumerate(times)]
        log = read(written(tmp_path, *lines))
        assert (log.skipped, log.retimed) == (0, 2)
        ways = [entry.odom_from_base.x_m for entry in log.entries if entry.odom_from_base]
        assert ways == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
        seconds = [entry.stamp_ns * 1e-9 for entry in log.entries]
        assert seconds == pytest.approx([10.0, 11.0, 11.0 + 1.0 / 3.0, 11.0 + 2.0 / 3.0, 12.0])

    @pytest.mark.parametrize(
        ("times", "seconds", "retimed"),
        [
            ([0.0] * 4, [0.0, 1.0, 2.0, 3.0], 3),
            # Six digits of a time.
            ([1.01893e9] * 3 + [1.01894e9], [1.01893e9 + i for i in range(3)] + [1.01894e9], 2),
            ([7.0, 7.0, 8.0, 8.0, 8.0], [7.0, 7.5, 8.0, 9.0, 10.0], 3),
            # A clock that ran over, and one that was not set for one scan.
            ([9998.0, 9999.0, 0.0, 1.0], [9998.0, 9999.0, 10000.0, 10001.0], 0),
            ([50.0, 51.0, 0.0, 52.0], [50.0, 51.0, 51.5, 52.0], 1),
        ],
    )
    def test_no_scan_is_lost_for_its_time(
        self, tmp_path: Path, times: list[float], seconds: list[float], retimed: int
    ) -> None:
        at = [SE2(0.3 * i, 0, 0) for i in range(len(times))]
        lines = [
            f"{flaser(time_s, pose).rsplit(maxsplit=3)[0]} {time_s} h {time_s}"
            for time_s, pose in zip(times, at, strict=True)
        ]
        log = read(written(tmp_path, *lines))
        assert [entry.odom_from_base for entry in log.entries] == at
        assert [entry.stamp_ns * 1e-9 for entry in log.entries] == pytest.approx(seconds, abs=1e-6)
        assert (log.skipped, log.retimed) == (0, retimed)

    def test_the_loggers_times_where_the_others_are_all_one(self, tmp_path: Path) -> None:
        lines = [f"{flaser(5.0).rsplit(maxsplit=3)[0]} 1e9 h {0.5 * i}" for i in range(4)]
        log = read(written(tmp_path, *lines))
        assert [entry.stamp_ns for entry in log.entries] == [0, 5 * 10**8, 10**9, 15 * 10**8]
        assert log.retimed == 0

    def test_lines_without_times_are_joined_to_the_odometry_around(self, tmp_path: Path) -> None:
        lines = []
        for i in range(3):
            lines.append(f"ODOM {i} 0 0 0 0 0 0 h 0")
            lines.append("RAWLASER1 0 -1.5 3.0 1.5 8 0.01 0 3 1 2 3 0 0 h 0")
        log = read(written(tmp_path, *lines, "ODOM 3 0 0 0 0 0 0 h 0"))
        order = [entry.scan is not None for entry in log.entries]
        assert order == [False, True, False, True, False, True, False]
        assert log.retimed == 2

    def test_a_clock_that_was_set_back_loses_no_scans(self, tmp_path: Path) -> None:
        times = [5000.0, 5001.0, 100.0, 101.0]
        lines = [flaser(time_s, SE2(0.1 * i, 0, 0)) for i, time_s in enumerate(times)]
        log = read(written(tmp_path, *lines))
        seconds = [entry.stamp_ns * 1e-9 for entry in log.entries]
        assert seconds == pytest.approx([5000.0, 5001.0, 5002.0, 5003.0])

    def test_the_loggers_time_where_the_other_is_not_set(self, tmp_path: Path) -> None:
        line = flaser(0.0).rsplit(maxsplit=1)[0]
        (entry,) = read(written(tmp_path, f"{line} 42.5")).entries
        assert entry.stamp_ns == 42_500_000_000

    def test_a_last_line_that_is_cut_off_is_left_out(self, tmp_path: Path) -> None:
        path = written(tmp_path, flaser(10.0), flaser(11.0))
        whole = path.read_text()
        for keep in (len(whole) // 2 + 30, len(whole) - 30, len(whole) - 12):
            path.write_text(whole[:keep])
            log = read(path)
            assert (len(log.entries), log.skipped) == (1, 1), keep

    def test_a_packed_log_is_the_same(self, tmp_path: Path) -> None:
        path = written(tmp_path, flaser(10.0), flaser(11.0))
        packed = tmp_path / "robot.log.gz"
        packed.write_bytes(gzip.compress(path.read_bytes()))
        assert [e.stamp_ns for e in read(packed).entries] == [10 * 10**9, 11 * 10**9]
        packed.write_bytes(packed.read_bytes()[:-20])
        assert "truncated" in refused(packed)

    def test_what_the_caller_says_holds(self, tmp_path: Path) -> None:
        path = written(tmp_path, flaser(10.0))
        (entry,) = scans(read(path, ScanForm(-1.0, 0.01, 0.2, 10.0)))
        assert entry.scan is not None
        form = entry.scan.angle_min_rad, entry.scan.angle_increment_rad
        assert (*form, entry.scan.range_min_m, entry.scan.range_max_m) == (-1.0, 0.01, 0.2, 10.0)

    @pytest.mark.parametrize(
        ("line", "said"),
        [
            ("FLASER 3 1 2", ":2: 2 readings: must be 3"),
            ("FLASER x 1 2", ":2: num_readings: 'x': must be a finite number"),
            ("FLASER 0 0 0 0 0 0 0 1 h 1", ":2: num_readings: '0': must be 1 to 20000"),
            ("FLASER 2 1 far 0 0 0 0 0 0 1 h 1", ":2: reading 1: 'far': must be metres"),
            ("FLASER 2 1 2 0 0 nan 0 0 0 1 h 1", ":2: laser: 'nan': must be a finite number"),
            ("FLASER 2 1 2 0 0 0 0 0", ":2: robot: '0 0': must be 3 numbers"),
            ("FLASER 2 1 2 0 0 0 0 0 0", ":2: ipc_timestamp: '': must be 1 number"),
            ("ROBOTLASER1 0 0 0 0 80 0 0 1 1", ":2: num_remissions"),
            ("ROBOTLASER1 0 0 0 0 80 0 0 1 1 0 0 0 0 0 0 0 0 0 0 0 0 1 h 1", "angular_resolution"),
            ("ODOM 1 2", ":2: pose: '1 2': must be 3 numbers"),
        ],
    )
    def test_a_damaged_line(self, tmp_path: Path, line: str, said: str) -> None:
        assert said in refused(written(tmp_path, flaser(10.0), line, flaser(12.0)))

    def test_a_log_without_scans(self, tmp_path: Path) -> None:
        path = written(tmp_path, "# CARMEN Logfile", "ODOM 0 0 0 0 0 0 1 h 1")
        assert "has no line ROBOTLASER1, FLASER, RAWLASER1" in refused(path)
        path = written(tmp_path, "RAWLASER1 0 -1.5 3.0 1.5 8 0.01 0 3 1 2 3 0 10.5 h 0.5")
        assert "without ODOM" in refused(path)


class TestCsv:
    @pytest.mark.parametrize(
        ("times_s", "grown_s", "made_up"),
        [
            ((0.0, 0.5, 1.0, 1.5), (0.0, 0.5, 1.0, 1.5), 0),
            ((0.0, 0.0, 1.0, 1.0), (0.0, 0.5, 1.0, 2.0), 2),
            ((7.0, 7.0, 7.0, 7.0), (7.0, 8.0, 9.0, 10.0), 3),
        ],
    )
    def test_the_order_of_the_lines_holds_whatever_their_times(
        self,
        tmp_path: Path,
        times_s: tuple[float, ...],
        grown_s: tuple[float, ...],
        made_up: int,
    ) -> None:
        header = "time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0,range_1"
        rows = [f"{time_s},{i},0,0,1,2" for i, time_s in enumerate(times_s)]
        log = read(written(tmp_path, header, *rows, name="robot.csv"))
        assert [entry.stamp_ns * 1e-9 for entry in log.entries] == pytest.approx(grown_s)
        poses = [entry.odom_from_base for entry in log.entries]
        assert [pose.x_m for pose in poses if pose is not None] == [0.0, 1.0, 2.0, 3.0]
        assert log.retimed == made_up

    @pytest.mark.parametrize("turns", [True, False])
    def test_the_longest_range_of_very_many_beams_is_a_code(
        self, tmp_path: Path, turns: bool
    ) -> None:
        path = tmp_path / "log.csv"
        names = [f"range_{i}" for i in range(60)]
        rows = [",".join(["time_s", "odom_x_m", "odom_y_m", "odom_yaw_rad", *names])]
        for k in range(40):
            ranges = np.linspace(1.0, 3.0, 60)
            ranges[(k * turns + np.arange(15)) % 60] = 10.0
            rows.append(",".join(map(str, [0.1 * k, 0, 0, 0, *ranges])))
        path.write_text("\n".join(rows) + "\n")
        log = read(path, ScanForm(range_max_m=12.0))
        # A robot that stands measures the same.
        assert log.codes_m == ((10.0,) if turns else ())
        for entry in scans(log):
            assert entry.scan is not None
            assert np.isnan(entry.scan.ranges_m).sum() == (15 if turns else 0)


class TestKinds:
    def test_other_files_say_what_they_are(self, tmp_path: Path) -> None:
        path = tmp_path / "some.file"
        for content, said in (
            (b"SQLite format 3\0 and so on", "is not a readable bag: file is not a database"),
            (b"\x89MCAP", "is not a readable bag: not an MCAP file"),
            (b"#ROSBAG V2.0\n", "has no sensor_msgs/msg/LaserScan on /scan"),
            (b"\0\1\2\3", "FLASER or ROBOTLASER1"),
            (b"\x1f\x8b not packed", "corrupt gzip"),
            (b"", "must be 'time_s"),
        ):
            path.write_bytes(content)
            assert said in refused(path)


def write_bag(
    bag: Path, steps: Iterable[int], plugin: StoragePlugin = StoragePlugin.MCAP, packed: str = ""
) -> Path:
    """A bag with a scan and a pose of odometry for each step, 0.5 m further each."""
    store = msg.TYPESTORE
    writer = Writer(bag, version=8, storage_plugin=plugin)
    if packed:
        writer.set_compression(CompressionMode[packed], CompressionFormat.ZSTD)
    with writer:
        odom = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
        scan = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=store)
        for step in steps:
            stamp_ns = 10**9 * (step + 1)
            pose = SE2(0.5 * step, 0.0, 0.0)
            place = msg.PoseWithCovariance(msg.pose_from_se2(pose), np.zeros(36))
            still = msg.TwistWithCovariance(
                msg.Twist(msg.Vector3(0.0, 0.0, 0.0), msg.Vector3(0.0, 0.0, 0.0)), np.zeros(36)
            )
            moved = msg.Odometry(msg.header(stamp_ns, "odom"), "base_footprint", place, still)
            writer.write(odom, stamp_ns, store.serialize_cdr(moved, odom.msgtype))
            sweep = msg.LaserScan(
                msg.header(stamp_ns + 10, "laser"), 0.0, 0.0, 0.01, 0.0, 0.1, 0.1, 9.0,
                np.full(400, step, np.float32), np.zeros(0, np.float32),
            )  # fmt: skip
            writer.write(scan, stamp_ns + 10, store.serialize_cdr(sweep, scan.msgtype))
    return bag


def steps_of(log: Log) -> list[float]:
    return [float(one.scan.ranges_m[0]) for one in scans(log) if one.scan]


class TestBags:
    @pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
    @pytest.mark.parametrize("packed", ["", "MESSAGE", "FILE"])
    def test_the_parts_of_a_bag_are_read_without_its_metadata(
        self,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
        plugin: StoragePlugin,
        packed: str,
    ) -> None:
        together = tmp_path / "together"
        together.mkdir()
        for name, steps in (("a", (4, 5, 6, 7)), ("b", (0, 1, 2, 3))):
            bag = write_bag(tmp_path / name, steps, plugin, packed)
            for file in bag.iterdir():
                if file.name != "metadata.yaml":
                    file.rename(together / file.name)
        log = read_log(together, ScanForm())
        assert steps_of(log) == [*range(8)]
        told = capsys.readouterr().err
        assert told.startswith(f"warning: --log: {together}: has no metadata.yaml: read file by")
        assert told.count("\n") == 1
        empty = tmp_path / "empty"
        empty.mkdir()
        assert "has no metadata.yaml, and there is no .mcap, .db3 or .bag file" in refused(empty)

    @pytest.mark.parametrize("packed", ["", "STORAGE"])
    def test_a_cut_file_is_read_as_far_as_it_goes(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str], packed: str
    ) -> None:
        bag = write_bag(tmp_path / "bag", range(40), packed=packed)
        (file,) = bag.glob("*.mcap")
        whole = file.read_bytes()
        cut = tmp_path / "cut.mcap"
        counts = []
        for share in (0.3, 0.6, 0.98):
            cut.write_bytes(whole[: int(share * len(whole))])
            steps = steps_of(read_log(cut, ScanForm()))
            assert steps == [*range(len(steps))]
            counts.append(len(steps))
            assert f"warning: --log: {cut}: is cut: read as far as it goes" in (
                capsys.readouterr().err
            )
        assert 0 < counts[0] <= counts[1] <= counts[2] <= 40
        # Its metadata.yaml still speaks of the whole file.
        file.write_bytes(whole[: len(whole) // 2])
        assert len(steps_of(read_log(bag, ScanForm()))) > 0
        assert f"{file}: is cut: read as far as it goes" in capsys.readouterr().err
        file.rename(bag / "other.mcap")
        assert len(steps_of(read_log(bag, ScanForm()))) > 0
        assert f"metadata.yaml names {file.name}, missing here" in capsys.readouterr().err

    def test_odometry_of_tf_and_a_topic_of_another_name(self, tmp_path: Path) -> None:
        store = msg.TYPESTORE
        bag = tmp_path / "bag"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            tf = writer.add_connection("/tf", "tf2_msgs/msg/TFMessage", typestore=store)
            scan = writer.add_connection("/front", "sensor_msgs/msg/LaserScan", typestore=store)
            for i in range(4):
                stamp_ns = 10**9 * (i + 1)
                for child, parent, x_m in (("base_link", "odom", 0.5 * i), ("odom", "map", 7.0)):
                    pose = SE2(x_m, 0.0, 0.0)
                    transform = msg.planar_transform_stamped(stamp_ns, parent, child, pose)
                    message = msg.TFMessage([transform])
                    writer.write(tf, stamp_ns, store.serialize_cdr(message, tf.msgtype))
                sweep = msg.LaserScan(
                    msg.header(stamp_ns + 10, "laser"), 0.0, 0.0, 0.1, 0.0, 0.1, 0.1, 9.0,
                    np.ones(5, np.float32), np.zeros(0, np.float32),
                )  # fmt: skip
                writer.write(scan, stamp_ns + 10, store.serialize_cdr(sweep, scan.msgtype))
        log = read_log(bag, ScanForm(), Topics(scan="/front"))
        ways = [entry.odom_from_base.x_m for entry in log.entries if entry.odom_from_base]
        assert ways == pytest.approx([0.0, 0.5, 1.0, 1.5])
        assert len(scans(log)) == 4
        assert (
            "has no sensor_msgs/msg/LaserScan on /scan: --scan-topic must be one of its /front"
            in (refused(bag))
        )


class TestHeadings:
    """A way of 3 m around, in steps of 4 cm, with its headings in some unit."""

    def poses(self, *, turns: float, unit_rad: float, wrapped_rad: float) -> list[SE2]:
        yaws = np.linspace(0.3, 0.3 + turns * math.tau, 150)
        x, y = np.cumsum(0.04 * np.stack([np.cos(yaws), np.sin(yaws)]), axis=1)
        told = (yaws + math.pi) % wrapped_rad - math.pi if wrapped_rad else yaws
        return [SE2(*pose) for pose in zip(x, y, told / unit_rad, strict=True)]

    def csv(self, folder: Path, poses: list[SE2]) -> Path:
        rows = [f"{i / 10},{x:.4f},{y:.4f},{yaw:.4f},2,2" for i, (x, y, yaw) in enumerate(poses)]
        header = "time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0,range_1"
        return written(folder, header, *rows, name="log.csv")

    @pytest.mark.parametrize("wrapped_rad", [0.0, math.tau])
    def test_degrees_are_refused(self, tmp_path: Path, wrapped_rad: float) -> None:
        poses = self.poses(turns=1.5, unit_rad=math.radians(1.0), wrapped_rad=wrapped_rad)
        log = self.csv(tmp_path, poses)
        with pytest.raises(ConfigError) as error:
            read(log)
        assert str(error.value).startswith(f"--log: {log}: odom_yaw_rad: 17.1887 at time_s 0: must")
        carmen = written(tmp_path, *(flaser(i / 10, pose) for i, pose in enumerate(poses)))
        with pytest.raises(ConfigError) as error:
            read(carmen)
        assert str(error.value).startswith(f"--log: {carmen}:1: theta: 17.1887: must be radians")

    def test_radians_of_many_turns_are_taken(self, tmp_path: Path) -> None:
        poses = self.poses(turns=4.0, unit_rad=1.0, wrapped_rad=0.0)
        assert max(pose.yaw_rad for pose in poses) > 3.0 * math.tau
        assert read(self.csv(tmp_path, poses)).scans == len(poses)
