"""Ports of the nodes of a behaviour tree: names, types and defaults, and the types' text forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

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
    "pose": _on_the_blackboard,
    "poses": _on_the_blackboard,
    "path": _on_the_blackboard,
}
"""How the text of a literal is read, by the type of the port."""
