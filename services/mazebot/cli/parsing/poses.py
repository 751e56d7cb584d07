"""Poses on the command line: `1 2 0.5`, `1,2,0.5`, `1 2` or `1,2`, in every command."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from mazebot.common.config import ConfigError

POSE_OPTIONS = ("--goal", "--start", "--lidar")
"""Options whose pose may be up to three words."""
POSE = "X Y [YAW]"
_MOST_M = 1e6


class GivenPose(NamedTuple):
    """Position in metres and heading in radians, as a person gives it."""

    x_m: float
    y_m: float
    yaw_rad: float = 0.0


def given_pose(who: str, words: str | Iterable[str]) -> GivenPose:
    """The pose that words give; without a third number the heading is 0.

    Raises ConfigError that begins with `who`, the command or the option.
    """
    text = words if isinstance(words, str) else " ".join(words)
    parts = text.replace(",", " ").split()
    numbers = []
    for index, name in enumerate(("X", "Y", "YAW")):
        if index >= len(parts):
            if index < 2:
                given = f"{text!r:.60}: " if text else ""
                raise ConfigError(
                    f"{who}: {given}{name} is missing: must be {POSE}, 2 or 3 numbers"
                )
            break
        numbers.append(_number(f"{who}: {name}", parts[index]))
    if len(parts) > 3:
        raise ConfigError(f"{who}: {text!r:.60}: must be {POSE}, 2 or 3 numbers")
    return GivenPose(*numbers)


def _number(where: str, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        raise ConfigError(f"{where}: {word!r:.60}: must be a valid number") from None
    if not math.isfinite(value):
        raise ConfigError(f"{where}: {value}: must be a finite number")
    if abs(value) > _MOST_M:
        raise ConfigError(f"{where}: {value:g}: must be within -{_MOST_M:g} and {_MOST_M:g}")
    return value


def are_numbers(word: str) -> bool:
    """Whether a word is numbers with commas between them, or one."""
    try:
        return bool([float(part) for part in word.split(",")])
    except ValueError:
        return False
