"""What a recorded log holds, whatever file it comes from."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.robot.waffle import BASE_FROM_SCAN

if TYPE_CHECKING:
    from mazebot.common.messages.scan import Scan


BASES = ("base_footprint", "base_link")
"""A robot's own frame, the one on the floor first."""
CLOCK_SET_S = 10.0
"""A clock that goes back by more, and on from there, was set or has run over."""
_MADE_UP_S = 1.0
"""At most, between scans that have no time of their own: slower than any robot."""

_GAP_S, _GAP_STEPS, _MOST_GAP_S = 1.0, 3.0, 3.0
"""Odometry that comes so much later than the one before, and than usual, is missing between;
whatever is usual, after the last.
"""
_GAP_MOVED_M, _GAP_TURNED_RAD = 0.1, 0.1
"""A robot that moved less was about there meanwhile."""
_GAPS_SHOWN, _JUMPS_SHOWN = 5, 5


@dataclass(frozen=True)
class LoggedScan:
    """A scan as the log has it; NaN is a beam that measured nothing."""

    ranges_m: NDArray[np.float32]
    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    range_max_m: float
    frame_id: str = ""
    base_from_scan: SE2 | None = None
    """The lidar's pose on the robot; None: the log does not say it."""

    def at(self, base_from_scan: SE2 | None, stamp_ns: int) -> Scan:
        """The scan, by a lidar at this place of the robot; None: where the log has it, or else the
        TurtleBot3's.
        """
        # It loads Numba, which no other command needs.
        from mazebot.common.messages.scan import Scan  # noqa: PLC0415

        return Scan(
            self.ranges_m,
            self.angle_min_rad,
            self.angle_increment_rad,
            self.range_min_m,
            self.range_max_m,
            base_from_scan or self.base_from_scan or BASE_FROM_SCAN,
            stamp_ns,
        )


@dataclass(frozen=True)
class Entry:
    """What the log has at one time: odometry, a scan, or both."""

    stamp_ns: int
    odom_from_base: SE2 | None
    scan: LoggedScan | None


class Gap(NamedTuple):
    """Odometry is missing between two stamps."""

    from_ns: int
    to_ns: int


class OdometryJump(NamedTuple):
    """A step of odometry that no robot makes: the way after it goes on from before it."""

    stamp_ns: int
    """Of the pose after it."""
    way_m: float
    turn_rad: float


class LidarMove(NamedTuple):
    """That a lidar is not always at one place of the robot."""

    frame: str
    first: SE2
    farthest: SE2
    """Of all its places, from the first one."""


class Reach(NamedTuple):
    """How far a lidar sees, where that is far less than it states."""

    longest_m: float
    """Of all its returns."""
    stated: str
    """Its range_max in m, as text: it may be inf, and nobody computes with it."""


@dataclass
class Log:
    """All entries, the earliest first."""

    entries: list[Entry]
    skipped: int = 0
    """Lines left out: the last one, where it is cut off."""
    retimed: int = 0
    """Scans whose time is not later than that of the ones before: they follow them in the file's
    order, at times that are made up.
    """
    unstamped: int = 0
    """Scans whose stamp is 0: their time is that of logging."""
    clock_set_back: int = 0
    """How often the clock of the stamps was set back: what follows goes on from there."""
    odometry_left_out: int = 0
    """Poses and transforms that are not finite, or have no quaternion."""
    odometry_unused: str = ""
    """Why a bag's topic of odometry is not used, and what is, in one line; empty: it is used."""
    scans_later_s: float = 0.0
    """How much later than odometry scans are stamped, by when they were logged."""
    scans_left_out: int = 0
    """Scans whose beams have no direction: angles that are not finite, or an increment of 0."""
    over_a_turn: int = 0
    """Scans left out because their beams go round more than once."""
    scans_without_limits: int = 0
    """Scans whose range_min or range_max is not a number, or the latter not larger."""
    no_returns: str = ""
    """That no range of all scans is a return, in one line; empty: some are."""
    codes_m: tuple[float, ...] = ()
    """Ranges below range_max that stand for no return, of each lidar that has one."""
    dropouts: tuple[float, ...] = ()
    """Shares of the beams that dropped out, of each lidar of which many do."""
    unused: str = ""
    """What scans the log has beside those that are used, in one line; empty: none."""
    assumed: str = ""
    """What is a guess, as the log does not say it, in one line; empty: nothing."""
    reaches: tuple[Reach, ...] = ()
    """Of the lidars whose longest return counts as range_max."""
    unplaced: tuple[str, ...] = ()
    """Frames of lidars of which the log should say where they are, and does not."""
    lidar_moves: tuple[LidarMove, ...] = ()
    """Each scan of these lidars has the place of its own time."""
    scans_tilted: int = 0
    """Scans left out because their lidar, which moves, was tilted then."""
    odometry_of: tuple[str, ...] = ()
    """Frames, other than the base, whose poses odometry has, and the log does not say where on the
    robot they are.
    """
    odometry_source: str = ""
    """Topic and frames of a bag's odometry; empty: it is no bag."""
    odometry_topics: tuple[str, ...] = ()
    """The bag's other topics with odometry."""
    odometry_jumps: tuple[OdometryJump, ...] = ()
    """Steps that were taken out."""

    @property
    def scans(self) -> int:
        """How many scans there are."""
        return sum(entry.scan is not None for entry in self.entries)

    def scans_by_lidar(self) -> dict[str, list[tuple[float, LoggedScan]]]:
        """Of each frame of scans, their times in s and themselves, the earliest first."""
        found: dict[str, list[tuple[float, LoggedScan]]] = {}
        for entry in self.entries:
            if entry.scan is not None:
                found.setdefault(entry.scan.frame_id, []).append(
                    (entry.stamp_ns * 1e-9, entry.scan)
                )
        return found

    def odometry(self) -> Array:
        """(k, 4) time in s and odom_from_base, the yaw not wrapped."""
        poses = [
            (entry.stamp_ns * 1e-9, *entry.odom_from_base)
            for entry in self.entries
            if entry.odom_from_base is not None
        ]
        found = np.array(poses).reshape(-1, 4)
        found[:, 3] = np.unwrap(found[:, 3])
        return found

    def with_odometry_scaled(self, factor: float) -> Log:
        """The log with x and y of odometry's poses times this."""
        return replace(self, entries=[_scaled(entry, factor) for entry in self.entries])

    def gaps(self) -> list[Gap]:
        """Where odometry is missing for long, and has moved then: how it was at the scans between
        is not known.
        """
        poses = [
            (entry.stamp_ns, entry.odom_from_base)
            for entry in self.entries
            if entry.odom_from_base is not None
        ]
        steps_s = np.diff([stamp_ns for stamp_ns, _ in poses]) * 1e-9
        if not len(steps_s):
            return []
        least_s = min(max(_GAP_S, _GAP_STEPS * float(np.median(steps_s))), _MOST_GAP_S)
        long = [
            Gap(from_ns, to_ns)
            for (from_ns, before), (to_ns, after) in itertools.pairwise(poses)
            if (to_ns - from_ns) * 1e-9 > least_s
            and not before.is_near(after, _GAP_MOVED_M, _GAP_TURNED_RAD)
        ]
        scans_ns = [entry.stamp_ns for entry in self.entries if entry.scan is not None]
        return [
            gap
            for gap in long
            if bisect_right(scans_ns, gap.from_ns) < bisect_left(scans_ns, gap.to_ns)
        ]

    def remarks(self) -> list[str]:
        """What to say of times and poses that are not used as they are."""
        found, gaps = [], self.gaps()
        for gap in gaps[:_GAPS_SHOWN]:
            found.append(
                f"odometry has a gap of {(gap.to_ns - gap.from_ns) * 1e-9:.1f} s at "
                f"{gap.from_ns * 1e-9:.3f} s: where the robot was at the scans in it is not known"
            )
        if len(gaps) > _GAPS_SHOWN:
            found.append(f"odometry has {len(gaps) - _GAPS_SHOWN} more gaps")
        source = f" on {self.odometry_source}" if self.odometry_source else ""
        for jump in self.odometry_jumps[:_JUMPS_SHOWN]:
            found.append(
                f"odometry{source} jumps by {jump.way_m:.2f} m and {jump.turn_rad:.2f} rad at "
                f"{jump.stamp_ns * 1e-9:.3f} s, faster than a robot: taken to go on as before"
            )
        if len(self.odometry_jumps) > _JUMPS_SHOWN:
            found.append(f"odometry has {len(self.odometry_jumps) - _JUMPS_SHOWN} more jumps")
        if self.retimed:
            found.append(
                f"{self.retimed} of {self.scans} scans are not later than those before: they "
                "follow in the file's order, at times that are made up"
            )
        if self.unstamped:
            found.append(
                f"{self.unstamped} of {self.scans} scans have the stamp 0: they are taken to be of "
                "when they were logged"
            )
        if self.clock_set_back:
            found.append(set_back_remark(self.clock_set_back))
        if self.odometry_left_out:
            found.append(
                f"{self.odometry_left_out} poses of odometry and transforms are not finite, or "
                "their quaternion is not normalized: left out"
            )
        if self.scans_left_out:
            found.append(
                f"{self.scans_left_out} scans have an angle_min or angle_increment that is not "
                "finite, or an increment of 0: left out"
            )
        if self.over_a_turn:
            found.append(
                f"{self.over_a_turn} scans have beams over more than a turn by their "
                "angle_increment, which must be radians: left out"
            )
        if self.scans_without_limits:
            found.append(
                f"{self.scans_without_limits} scans have a range_min or range_max that is not a "
                "number, or a range_max that is not larger than range_min: left out"
            )
        for move in self.lidar_moves:
            found.append(
                f"the lidar {move.frame!r:.60} moves on the robot, from {_posed(move.first)} to "
                f"{_posed(move.farthest)} and elsewhere: each scan is taken from where it was"
            )
        if self.scans_tilted:
            found.append(
                f"{self.scans_tilted} scans are of when the lidar was tilted: left out: it must be "
                "level, or upside down"
            )
        found += [one for one in (self.odometry_unused, self.unused, self.no_returns) if one]
        for code_m in self.codes_m:
            found.append(
                f"{code_m:g} m is what very many beams of all directions measure: taken for a "
                "code of no return, which shows no free space either"
            )
        for share in self.dropouts:
            found.append(
                f"{100.0 * share:.0f} % of the beams have no return between others near them that "
                "have: they dropped out, and show no free space"
            )
        for reach in self.reaches:
            found.append(
                f"no return is longer than {reach.longest_m:.2f} m, and range_max is "
                f"{reach.stated} m: beams without one show free space up to the longest return"
            )
        return found

    def warning_of_place(self) -> str:
        """What to say where it is not known how the lidar is to what odometry has the pose of, in
        one line; empty: it is.
        """
        bases, told = " or ".join(BASES), []
        if self.unplaced:
            told.append(
                f"no transforms lead from the scans' frame {_named(self.unplaced)} to {bases}: "
                f"the lidar is taken to be at {BASE_FROM_SCAN.x_m} 0 0 on the robot: --lidar says "
                "where it is"
            )
        if self.odometry_of:
            told.append(
                f"no transforms lead from {_named(self.odometry_of)}, the child frame of odometry, "
                f"to {bases}: it is taken to be the robot's: --lidar says where the lidar is in it"
            )
        return "; ".join(told)

    def steps(self) -> Iterator[Entry]:
        """Odometry and scans one at a time, a scan after the odometry that follows it: its own time
        lies between two then; in a gap of odometry, after the one before it.
        """
        ends_ns = {gap.to_ns for gap in self.gaps()}
        waiting: list[Entry] = []
        for entry in self.entries:
            if entry.stamp_ns in ends_ns:
                yield from waiting
                waiting = []
            if entry.odom_from_base is not None:
                yield Entry(entry.stamp_ns, entry.odom_from_base, None)
            if entry.scan is not None:
                waiting.append(Entry(entry.stamp_ns, None, entry.scan))
            if entry.odom_from_base is not None:
                yield from waiting
                waiting = []
        yield from waiting


def interpolated(
    odometry: NDArray[np.float64], times_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n, 3) odom_from_base at (n,) times, by (k, 4) with its own times, of which there are some;
    the yaw is not wrapped.
    """
    columns = [np.interp(times_s, odometry[:, 0], odometry[:, k]) for k in (1, 2, 3)]
    return np.column_stack(columns)


def _scaled(entry: Entry, factor: float) -> Entry:
    pose = entry.odom_from_base
    if pose is None:
        return entry
    return replace(entry, odom_from_base=SE2(pose.x_m * factor, pose.y_m * factor, pose.yaw_rad))


def _named(frames: Iterable[str]) -> str:
    return ", ".join(f"{frame!r:.60}" for frame in frames)


def _posed(pose: SE2) -> str:
    return f"({pose.x_m:.2f} m, {pose.y_m:.2f} m, {pose.yaw_rad:.2f} rad)"


def set_back_remark(count: int) -> str:
    """What to say of a clock that was set back so often."""
    times = "once" if count == 1 else f"{count} times"
    return f"the clock was set back {times}: what follows goes on from there"


@dataclass(frozen=True)
class ScanForm:
    """What the caller says of the scans; None: what the log says, or else the format's default."""

    angle_min_rad: float | None = None
    angle_increment_rad: float | None = None
    range_min_m: float | None = None
    range_max_m: float | None = None

    @property
    def says_directions(self) -> bool:
        """Whether anything is given of the beams' directions."""
        return self.angle_min_rad is not None or self.angle_increment_rad is not None

    def ranges_m(self, default_min_m: float, default_max_m: float) -> tuple[float, float]:
        """The least and the longest range.

        Raises ConfigError where the longest is not longer.
        """
        least = default_min_m if self.range_min_m is None else self.range_min_m
        longest = default_max_m if self.range_max_m is None else self.range_max_m
        if not least < longest:
            raise ConfigError(
                f"--range-max: {longest:g}: must be > --range-min, {least:g}, which is >= 0"
            )
        return least, longest


@dataclass(frozen=True)
class Topics:
    """Names of a bag's topics."""

    scan: str = "/scan"
    odom: str = "/odom"

    @property
    def are_given(self) -> bool:
        """Whether they are others than a bag mostly has."""
        return self != Topics()


@dataclass
class Where:
    """A line of a file, to name in an error."""

    path: Path
    line: int = field(default=1)

    def wrong(self, problem: str) -> ConfigError:
        """The error to raise about this line."""
        return ConfigError(f"--log: {self.path}:{self.line}: {problem}")


def growing(times_s: list[float]) -> tuple[list[float], int]:
    """Times in the same order that grow, and how many of them had to be made up.

    A time that is not later than those before is put between them and the next later one. Where a
    clock was set back, or has run over, all later times are moved.
    """
    grown: list[float] = []
    moved_s, made_up, waiting = 0.0, 0, 0
    for i, own_s in enumerate(times_s):
        time_s = own_s + moved_s
        if grown:
            back_s = grown[-1] - CLOCK_SET_S
            after_s = times_s[i + 1] + moved_s if i + 1 < len(times_s) else -math.inf
            if time_s < after_s < back_s:
                moved_s += grown[-1] + (waiting + 1) * _MADE_UP_S - time_s
                time_s = own_s + moved_s
            if time_s <= grown[-1]:
                waiting += 1
                continue
            grown += _between(grown[-1], time_s, waiting)
        made_up += waiting
        waiting = 0
        grown.append(time_s)
    if grown:
        grown += _between(grown[-1], math.inf, waiting)
    return grown, made_up + waiting


def _between(begin_s: float, end_s: float, count: int) -> list[float]:
    step_s = min((end_s - begin_s) / (count + 1), _MADE_UP_S)
    return [begin_s + (i + 1) * step_s for i in range(count)]
