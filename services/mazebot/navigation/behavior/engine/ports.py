"""Ports of the nodes of a behaviour tree: names, types and defaults, and the types' text forms."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from mazebot.common.maths.frames import MAP_FRAME, SE2, yaw_from_quaternion
from mazebot.navigation.behavior.context import COSTMAPS, CostmapName
from mazebot.navigation.behavior.engine.script import read_script

PortType = Literal[
    "text", "number", "integer", "natural", "times", "flag", "codes", "pose", "poses", "path",
    "script", "status", "any", "costmap", "layers",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Port:
    """An input port, an output port, or both."""

    name: str
    type: PortType = "text"
    default: str | None = None
    """Text that holds where the XML gives none."""
    output: bool = False
    """The node writes it."""
    required: bool = False
    """The XML must connect it or give its value."""
    no_effect: str = ""
    """What to warn of where the XML gives it, since it has no effect; empty: it has one."""
    unless: tuple[str, ...] = ()
    """Texts that have an effect all the same."""


def out(name: str, kind: PortType = "any") -> Port:
    """An output port."""
    return Port(name, kind, output=True)


def as_number(value: object) -> float:
    """The number that a port holds. Raises ValueError."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"must be a number (got {value!r:.40})")
    try:
        number = float(value)
    except ValueError:
        raise ValueError(f"must be a number (got {value!r:.40})") from None
    if math.isnan(number):
        raise ValueError("must be a number (got nan)")
    return number


def as_integer(value: object) -> int:
    """The whole number that a port holds. Raises ValueError."""
    number = as_number(value)
    if not number.is_integer():
        raise ValueError(f"must be an integer (got {value!r:.40})")
    return int(number)


def as_natural(value: object) -> int:
    """The whole number of at least 0 that a port holds. Raises ValueError."""
    number = as_integer(value)
    if number < 0:
        raise ValueError(f"must be at least 0 (got {value!r:.40})")
    return number


def as_times(value: object) -> int:
    """How often: a whole number of at least 0, or -1 for without end. Raises ValueError."""
    number = as_integer(value)
    if number < -1:
        raise ValueError(f"must be at least 0, or -1 for without end (got {value!r:.40})")
    return number


_FLAGS = {"true": True, "1": True, "false": False, "0": False}


def as_flag(value: object) -> bool:
    """The truth value that a port holds, as BehaviorTree.CPP reads it. Raises ValueError."""
    flag = value if isinstance(value, bool) else _FLAGS.get(str(value).strip().lower())
    if flag is None:
        raise ValueError(f"must be true or false (got {value!r:.40})")
    return flag


def as_codes(value: object) -> tuple[int, ...]:
    """Error codes, written `100;104;105`. Raises ValueError."""
    if isinstance(value, int):
        return (value,)
    if isinstance(value, tuple | list):
        return tuple(as_integer(code) for code in value)
    parts = str(value or "").replace(",", ";").split(";")
    return tuple(as_integer(part) for part in parts if part.strip())


def _on_the_blackboard(value: object) -> object:
    raise ValueError(f"must be a blackboard entry {{...}} (got {value!r:.40})")


def as_status(value: object) -> str:
    """The name of an answer of a node. Raises ValueError."""
    name = str(value).strip().upper()
    if name not in ("RUNNING", "SUCCESS", "FAILURE", "SKIPPED"):
        raise ValueError(f"must be RUNNING, SUCCESS, FAILURE or SKIPPED (got {value!r:.40})")
    return name


def as_costmap(value: object) -> CostmapName:
    """Which costmap a clear service is of: Nav2's names have a part with the costmap's. Raises
    ValueError.
    """
    parts = str(value).split("/")
    for name in COSTMAPS:
        if f"{name}_costmap" in parts:
            return name
    raise ValueError(f"must begin with local_costmap/ or global_costmap/ (got {value!r:.80})")


CLEARABLE_LAYERS = ("obstacle_layer", "voxel_layer")
"""Nav2's names for what clearing a costmap clears, which here is one layer."""


def as_layers(value: object) -> tuple[str, ...]:
    """Names of layers to clear, written `obstacle_layer;voxel_layer`. Raises ValueError."""
    parts = value if isinstance(value, tuple | list) else str(value or "").replace(",", ";")
    parts = parts.split(";") if isinstance(parts, str) else parts
    names = tuple(part for part in (str(one).strip() for one in parts) if part)
    for name in names:
        if name not in CLEARABLE_LAYERS:
            raise ValueError(
                f"must be empty or of {', '.join(CLEARABLE_LAYERS)}, which can be cleared "
                f"(got {name!r:.60})"
            )
    return names


_POSE = "stamp;map;x;y;z;qx;qy;qz;qw"
_FIELDS = _POSE.count(";") + 1
_UNIT = 1e-3
"""The square of a unit quaternion's length may differ from 1 by this."""


def as_pose(value: object) -> SE2:
    """The pose in the map that a port holds, or the planar part of the one that it writes
    `stamp;map;x;y;z;qx;qy;qz;qw`, as Nav2 does. Raises ValueError.
    """
    if isinstance(value, SE2):
        return value
    if not isinstance(value, str) or value.count(";") != _FIELDS - 1:
        raise ValueError(f"must be a blackboard entry {{...}} or {_POSE} (got {value!r:.80})")
    return _read_pose(value.split(";"))


def as_poses(value: object) -> tuple[SE2, ...]:
    """The poses in the map that a port holds, or that it writes as `as_pose` takes them, one after
    the other. Raises ValueError.
    """
    if not isinstance(value, str):
        if not isinstance(value, Sequence) or not all(isinstance(pose, SE2) for pose in value):
            raise ValueError(f"must be poses (got {value!r:.80})")
        return tuple(value)
    fields = value.split(";")
    if len(fields) % _FIELDS:
        raise ValueError(
            f"must be a blackboard entry {{...}}, or {_POSE} for each pose (got {value!r:.80})"
        )
    return tuple(
        _read_pose(fields[first : first + _FIELDS]) for first in range(0, len(fields), _FIELDS)
    )


def _read_pose(fields: Sequence[str]) -> SE2:
    written = ";".join(fields)
    frame = fields[1].strip()
    if frame not in ("", MAP_FRAME):
        raise ValueError(f"frame {frame!r:.40}: must be {MAP_FRAME} or empty (got {written!r:.80})")
    as_integer(fields[0])
    x_m, y_m, z_m, qx, qy, qz, qw = map(as_number, fields[2:])
    if not all(map(math.isfinite, (x_m, y_m, z_m))):
        raise ValueError(f"x, y and z must be finite (got {written!r:.80})")
    if not abs(qx * qx + qy * qy + qz * qz + qw * qw - 1.0) < _UNIT:
        raise ValueError(f"qx;qy;qz;qw must be a unit quaternion (got {written!r:.80})")
    return SE2(x_m, y_m, yaw_from_quaternion(qx, qy, qz, qw))


READERS: dict[PortType, Callable[[object], object]] = {
    "text": str,
    "number": as_number,
    "integer": as_integer,
    "natural": as_natural,
    "times": as_times,
    "flag": as_flag,
    "codes": as_codes,
    "script": read_script,
    "status": as_status,
    "any": str,
    "costmap": as_costmap,
    "layers": as_layers,
    "pose": as_pose,
    "poses": as_poses,
    "path": _on_the_blackboard,
}
"""How the text of a literal is read, by the type of the port."""
