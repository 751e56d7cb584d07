"""Scans and odometry of a bag."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mazebot.cli.bags.bag import Bag, opened, problem_of
from mazebot.cli.logs.frames import MOVES_M, MOVES_RAD, FixedFrames, Motion, last_part
from mazebot.cli.logs.log import (
    BASES,
    Entry,
    LidarMove,
    Log,
    LoggedScan,
    ScanForm,
    Topics,
)
from mazebot.cli.logs.sources import is_doubtful, why_unused
from mazebot.cli.logs.stamps import Told, stamped_later_s, times_ns
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2, Array, se2_from_matrix, wrap_angle
from mazebot.common.messages import messages as msg
from mazebot.common.messages.scan import Mount
from mazebot.common.problems import words

_MOVING, _STATIC = "/tf", "/tf_static"
_ODOMETRY, _SCAN = "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan"
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_UNIT = 0.01
"""By so much the square of a quaternion's length may differ from 1, as for tf2."""
_AFTER_NS = 1_000
"""A scan comes so much after that of another lidar with the same stamp: times are unique."""


class _Moved(NamedTuple):
    """A pose of odometry."""

    parent: str
    """The frame that it is in."""
    frame: str
    """Whose pose it is, as `child_frame_id` says."""
    odom_from_frame: Array
    """(4, 4)"""


class _Places(NamedTuple):
    """What the fixed transforms say of lidars and odometry; None: they do not lead there."""

    mounts: dict[str, Mount | None]
    """By the frames of the scans."""
    frame_from_base: dict[str, Array | None]
    """By the frames of odometry."""
    bases: dict[str, str]
    """By the frames of the scans."""

    @property
    def are_known(self) -> bool:
        return None not in self.mounts.values() and all(
            one is not None for one in self.frame_from_base.values()
        )


@dataclass
class _Found:
    """What the messages of a bag say, in the order of logging."""

    form: ScanForm
    """What is given of the scans."""
    scans: list[Told] = field(default_factory=list)
    odometry: list[Told] = field(default_factory=list)
    transforms: dict[tuple[str, str], list[Told]] = field(default_factory=dict)
    """Of what moves as the robot does, by its parent and itself."""
    transforms_topic: str = _MOVING
    """Where these are."""
    are_moves_settled: bool = False
    """Add nothing to these any more."""
    frames: FixedFrames = field(default_factory=FixedFrames)
    without_number: int = 0
    """Poses and transforms that are not finite, or have no quaternion."""
    odometry_unused: str = ""
    """Why `/tf` is used although odometry's topic has poses; empty: it is not."""
    without_direction: int = 0
    """Scans whose beams have no direction."""
    without_limits: int = 0
    """Scans whose limits hold no range."""
    wrong_limits: str = ""
    """The last of these."""

    @property
    def lidars(self) -> list[str]:
        """The frames of the scans."""
        return sorted({told.says.frame_id for told in self.scans})

    @property
    def poses(self) -> list[Told]:
        """Those of odometry's topic, or else of `/tf`."""
        if self.odometry and not self.odometry_unused:
            return self.odometry
        return self._of_transforms()

    @property
    def is_doubtful(self) -> bool:
        """Whether `/tf` may be better than the poses that odometry's topic has."""
        if not self.odometry or self.odometry_unused:
            return False
        return is_doubtful(self.odometry, self.scans)

    def compare(self) -> None:
        """Choose between odometry's topic and `/tf`, where that is of the same robot."""
        own = {above for frame in self.lidars for above in self.frames.above(frame)}
        own |= {told.says.frame for told in self.odometry}
        others = [told for told in self._of_transforms() if told.says.frame in own]
        self.odometry_unused = why_unused(self.odometry, others, self.scans)

    def _of_transforms(self) -> list[Told]:
        return _of_robot(self.transforms, self.lidars, self.frames)

    def settle(self) -> None:
        """What there is of transforms is no more changed by what comes."""
        self.frames.settle()
        self.are_moves_settled = bool(self.transforms)


def read(path: Path, form: ScanForm, topics: Topics) -> Log:
    """Read scans and odometry, the latter from `/tf` where the bag has none on its own topic, or
    what is there does not move, or not for most of the time, and `/tf` does. What is given of the
    scans' form replaces what the bag says. The transforms are those of the scans' own namespace,
    and beyond them the ones that have none: these may be another robot's.

    Raises ConfigError with one line that names file and topic, and what is wrong.
    """
    found = _Found(form)
    types = {topics.odom: _ODOMETRY, topics.scan: _SCAN}
    with opened(path, "--log") as bag:
        for space in dict.fromkeys((topics.scan.rstrip("/").rpartition("/")[0], "")):
            moving, static = f"{space}{_MOVING}", f"{space}{_STATIC}"
            _take(found, bag, path, {**types, static: _TRANSFORMS}, static)
            places, types = _places(path, found), {}
            is_wanted = not (found.poses and places.are_known) or found.is_doubtful
            if is_wanted and moving in bag.topics_of(_TRANSFORMS):
                if not found.transforms:
                    found.transforms_topic = moving
                _take(found, bag, path, {moving: _TRANSFORMS}, static)
                found.compare()
                places = _places(path, found)
            if found.poses and places.are_known and not found.is_doubtful:
                break
            found.settle()
        # First, for it may be why a topic has no messages.
        for file, what in bag.damaged.items():
            sys.stderr.write(f"warning: --log: {words(path)}: left out: {words(file)}: {what}\n")
        if not found.scans and found.without_direction:
            raise ConfigError(
                f"--log: {path}: {topics.scan}: angle_min and angle_increment must be finite "
                "radians, and the increment not 0: --angle-min and --angle-increment replace them"
            )
        if not found.scans and found.without_limits:
            raise ConfigError(
                f"--log: {path}: {topics.scan}: {found.wrong_limits}: must be metres, and "
                "range_max larger: --range-min and --range-max replace them"
            )
        if not found.scans:
            raise ConfigError(_missing(path, bag, topics.scan, _SCAN, "--scan-topic"))
        if len(found.lidars) > 1 and form.says_directions:
            named = ", ".join(f"{frame!r:.60}" for frame in found.lidars)
            raise ConfigError(
                f"--angle-min and --angle-increment: {path}: {topics.scan} has scans of "
                f"{len(found.lidars)} lidars, {named}: must be given for one lidar alone"
            )
        if not found.poses and found.without_number:
            raise ConfigError(
                f"--log: {path}: has no odometry: {found.without_number} poses and transforms are "
                "not finite, or their quaternion is not normalized: must be of length 1, as for tf2"
            )
        if not found.odometry and not found.transforms:
            raise ConfigError(_missing(path, bag, topics.odom, _ODOMETRY, "--odom-topic"))
        log = _log(path, found, places, len(bag.moves_ns))
        ends = dict.fromkeys((told.says.parent, told.says.frame) for told in found.poses)
        named = ", ".join(f"{parent!r:.60} to {child!r:.60}" for parent, child in ends)
        source = topics.odom if found.poses is found.odometry else found.transforms_topic
        unused = found.odometry_unused
        return replace(
            log,
            odometry_source=f"{source}, {named}",
            odometry_unused=unused and f"{topics.odom} {unused}: odometry is that of {source}",
            odometry_topics=tuple(sorted(bag.topics_of(_ODOMETRY) - {topics.odom})),
        )


def _log(path: Path, found: _Found, places: _Places, set_back: int) -> Log:
    """`set_back`: how often the recorder's clock was."""
    poses = found.poses
    moving = {
        child: moves
        for frame, base in places.bases.items()
        for child, moves in found.frames.moving(frame, base).items()
    }
    (pose_times_ns, scan_times_ns, *moves_ns), stamps_set_back = times_ns(
        (poses, found.scans, *moving.values())
    )
    motions = {
        child: Motion(np.array(at_ns, np.int64), np.array([told.says for told in moves]))
        for (child, moves), at_ns in zip(moving.items(), moves_ns, strict=True)
    }
    moved = [_odom_from_base(told.says, places) for told in poses]
    entries = [
        Entry(time_ns, odom_from_base, None)
        for time_ns, odom_from_base in zip(pose_times_ns, moved, strict=True)
        if _is_finite(odom_from_base)
    ]
    left_out = len(poses) - len(entries)
    scans: list[LoggedScan] = [told.says for told in found.scans]
    apart_ns = _one_by_one(scan_times_ns, [scan.frame_id for scan in scans])
    mounted = _mounted(path, found, places, scan_times_ns, motions)
    entries += [
        Entry(time_ns, None, scan)
        for time_ns, scan in zip(apart_ns, mounted, strict=True)
        if scan is not None
    ]
    entries.sort(key=lambda entry: (entry.stamp_ns, entry.scan is not None))
    return Log(
        entries,
        unstamped=sum(not told.stamp_ns for told in found.scans),
        # That of the stamps may be the same clock.
        clock_set_back=max(set_back, stamps_set_back),
        odometry_left_out=found.without_number + left_out,
        scans_later_s=stamped_later_s(found.scans, poses),
        scans_left_out=found.without_direction,
        scans_without_limits=found.without_limits,
        unplaced=tuple(frame for frame in found.lidars if places.mounts[frame] is None),
        lidar_moves=_lidar_moves(mounted) if motions else (),
        scans_tilted=mounted.count(None),
        odometry_of=tuple(
            frame
            for frame, frame_from_base in places.frame_from_base.items()
            if frame_from_base is None and frame and last_part(frame) not in BASES
        ),
    )


def _places(path: Path, found: _Found) -> _Places:
    """Where the lidars are on the base, and odometry's frames; the base is that of the lidars, or
    where they have none, what odometry is of.
    """
    lidars, frames = found.lidars, found.frames
    moved = list(dict.fromkeys(told.says.frame for told in found.poses))
    bases = [base for frame in (*lidars, *moved) if (base := frames.base_of(frame))]
    base = (*bases, *moved, "")[0]
    bases_of = {frame: frames.base_of(frame) or base for frame in lidars}
    mounts = {}
    for frame, its_base in bases_of.items():
        try:
            mounts[frame] = frames.mount_of(frame, its_base)
        except ConfigError as error:
            # Of one that moves, each scan tells.
            if not frames.moving(frame, its_base):
                raise ConfigError(f"--log: {path}: {error}") from error
            mounts[frame] = Mount(SE2(0.0, 0.0, 0.0))
    return _Places(mounts, {frame: frames.transform(frame, base) for frame in moved}, bases_of)


def _odom_from_base(moved: _Moved, places: _Places) -> SE2:
    frame_from_base = places.frame_from_base[moved.frame]
    # Of the robot itself, nobody needs the height, which may be NaN.
    if frame_from_base is None or np.array_equal(frame_from_base, np.eye(4)):
        return se2_from_matrix(moved.odom_from_frame)
    # What is not finite is left out.
    with np.errstate(over="ignore", invalid="ignore"):
        return se2_from_matrix(moved.odom_from_frame @ frame_from_base)


def _is_finite(pose: SE2) -> bool:
    return all(map(math.isfinite, pose))


def _mounted(
    path: Path,
    found: _Found,
    places: _Places,
    times_ns: Sequence[int],
    motions: Mapping[str, Motion],
) -> list[LoggedScan | None]:
    """The scans with their lidars' places at these times; None: it was tilted then."""
    scans: list[LoggedScan] = [told.says for told in found.scans]
    mounts = {frame: itertools.repeat(mount) for frame, mount in places.mounts.items()}
    moved = {}
    for frame, base in places.bases.items():
        if not found.frames.moving(frame, base):
            continue
        own_ns = [at for at, scan in zip(times_ns, scans, strict=True) if scan.frame_id == frame]
        at_ns = np.array(own_ns, np.int64)
        try:
            moved[frame] = iter(found.frames.mounts_at(frame, base, at_ns, motions))
        except ConfigError as error:
            raise ConfigError(f"--log: {path}: {error}") from error
    mounted: list[LoggedScan | None] = []
    for scan in scans:
        mount = next(moved.get(scan.frame_id) or mounts[scan.frame_id])
        if mount is not None:
            mounted.append(_placed(scan, mount))
        else:
            mounted.append(None if scan.frame_id in moved else scan)
    return mounted


def _placed(scan: LoggedScan, mount: Mount) -> LoggedScan:
    return replace(
        scan,
        base_from_scan=mount.base_from_scan,
        angle_min_rad=mount.angle_rad(scan.angle_min_rad),
        angle_increment_rad=mount.angle_rad(scan.angle_increment_rad),
    )


def _lidar_moves(scans: Sequence[LoggedScan | None]) -> tuple[LidarMove, ...]:
    """Of the lidars that are not always at one place."""
    places: dict[str, list[SE2]] = {}
    for scan in scans:
        if scan is not None and scan.base_from_scan is not None:
            places.setdefault(scan.frame_id, []).append(scan.base_from_scan)

    def away(first: SE2, other: SE2) -> float:
        turned_rad = abs(wrap_angle(other.yaw_rad - first.yaw_rad))
        return max(first.distance_m(other) / MOVES_M, turned_rad / MOVES_RAD)

    moves = []
    for frame, (first, *others) in sorted(places.items()):
        farthest = max(others, key=lambda other: away(first, other), default=first)
        if away(first, farthest) > 1.0:
            moves.append(LidarMove(frame, first, farthest))
    return tuple(moves)


def _of_robot(
    transforms: Mapping[tuple[str, str], list[Told]],
    lidars: Collection[str],
    frames: FixedFrames,
) -> list[Told]:
    """The poses of the robot that has these lidars, in odometry's frame where it has one."""
    if not transforms:
        return []
    carriers = {above for frame in lidars for above in frames.above(frame)}
    prefixes = {frame.rpartition("/")[0] for frame in lidars}

    def rank(ends: tuple[str, str]) -> tuple[bool, bool, bool, bool, int]:
        parent, child = ends
        is_own, is_base = child.rpartition("/")[0] in prefixes, last_part(child) in BASES
        return (
            child in carriers,
            is_own,
            is_base,
            "odom" in last_part(parent),
            len(transforms[ends]),
        )

    return transforms[max(transforms, key=rank)]


def _one_by_one(times_ns: Iterable[int], lidars: Iterable[str]) -> list[int]:
    """Times of scans, of which those of several lidars at one time come one after the other."""
    there: dict[int, list[str]] = {}
    later_ns = []
    for time_ns, lidar in zip(times_ns, lidars, strict=True):
        at_once = there.setdefault(time_ns, [])
        if lidar not in at_once:
            at_once.append(lidar)
        later_ns.append(time_ns + _AFTER_NS * at_once.index(lidar))
    return later_ns


def _missing(path: Path, bag: Bag, topic: str, kind: str, option: str) -> str:
    what = f"has no {kind} on {topic}"
    if any(one.topic == topic for one in bag.connections):
        what = f"{topic} is empty"
    others = {one.topic for one in bag.connections}
    fit = bag.topics_of(kind) - {topic}
    if fit:
        return f"--log: {path}: {what}: {option} must be one of its {_names(fit)}"
    if topic in others:
        return f"--log: {path}: {what}: must hold {kind}, and there is no other topic of that type"
    return f"--log: {path}: {what}, nor on another topic: it has {_names(others) or 'none'}"


def _names(topics: Iterable[str]) -> str:
    return ", ".join(sorted(topics))


def _take(found: _Found, bag: Bag, path: Path, types: Mapping[str, str], static: str) -> None:
    """Read some topics, given with their types; the transforms of one of them are `static`."""
    wanted = [connection for connection in bag.connections if connection.topic in types]
    for connection in wanted:
        if connection.msgtype != types[connection.topic]:
            raise ConfigError(
                f"--log: {path}: {connection.topic} is {connection.msgtype}: must be "
                f"{types[connection.topic]}"
            )
        if problem := problem_of(connection):
            raise ConfigError(f"--log: {path}: {connection.topic} {problem}")
    for connection, log_ns, data in bag.messages(wanted):
        message = _decoded(path, connection, data)
        if connection.msgtype == _TRANSFORMS:
            _add_transforms(found, log_ns, message, is_static=connection.topic == static)
        elif connection.msgtype == _ODOMETRY:
            _add_pose(found, log_ns, message)
        else:
            _add_scan(found, log_ns, message)


def _decoded(path: Path, connection: Any, data: bytes) -> Any:
    try:
        return msg.TYPESTORE.deserialize_cdr(data, connection.msgtype)
    except Exception as error:
        raise ConfigError(
            f"--log: {path}: a message on {connection.topic} is corrupt: {error}"
        ) from error


def _add_transforms(found: _Found, log_ns: int, message: Any, is_static: bool) -> None:
    for transform in message.transforms:
        # ROS 1 begins them with a slash.
        parent = transform.header.frame_id.lstrip("/")
        child = transform.child_frame_id.lstrip("/")
        matrix = msg.matrix_from_transform(transform.transform)
        if not (_is_unit(transform.transform.rotation) and np.isfinite(matrix).all()):
            found.without_number += 1
        elif is_static:
            found.frames.fix(child, parent, matrix)
        elif last_part(parent) not in BASES and (
            last_part(child) in BASES or "odom" in last_part(parent)
        ):
            if found.are_moves_settled:
                continue
            stamp_ns = msg.ns_from_time(transform.header.stamp)
            poses = found.transforms.setdefault((parent, child), [])
            poses.append(Told(log_ns, stamp_ns, _Moved(parent, child, matrix)))
        else:
            # Where nothing latches, fixed transforms come again and again.
            stamp_ns = msg.ns_from_time(transform.header.stamp)
            found.frames.fix_first(child, parent, Told(log_ns, stamp_ns, matrix))


def _add_pose(found: _Found, log_ns: int, message: Any) -> None:
    parent, child = (
        frame.lstrip("/") for frame in (message.header.frame_id, message.child_frame_id)
    )
    moved = _Moved(parent, child, msg.matrix_from_pose(message.pose.pose))
    is_unit = _is_unit(message.pose.pose.orientation)
    if not (is_unit and _is_finite(se2_from_matrix(moved.odom_from_frame))):
        found.without_number += 1
        return
    found.odometry.append(Told(log_ns, msg.ns_from_time(message.header.stamp), moved))


def _is_unit(q: Any) -> bool:
    return bool(abs(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w - 1.0) <= _UNIT)


def _add_scan(found: _Found, log_ns: int, message: Any) -> None:
    form = found.form
    start_rad = message.angle_min if form.angle_min_rad is None else form.angle_min_rad
    told_rad = form.angle_increment_rad
    step_rad = message.angle_increment if told_rad is None else told_rad
    if not (math.isfinite(start_rad) and math.isfinite(step_rad) and step_rad):
        found.without_direction += 1
        return
    least_m = message.range_min if form.range_min_m is None else form.range_min_m
    longest_m = message.range_max if form.range_max_m is None else form.range_max_m
    if not (math.isfinite(least_m) and least_m < longest_m):
        found.without_limits += 1
        found.wrong_limits = f"range_min {least_m:g} and range_max {longest_m:g}"
        return
    scan = LoggedScan(
        np.asarray(message.ranges, np.float32),
        float(start_rad),
        float(step_rad),
        float(least_m),
        float(longest_m),
        message.header.frame_id.lstrip("/"),
    )
    found.scans.append(Told(log_ns, msg.ns_from_time(message.header.stamp), scan))
