"""Parses and checks numbers, vectors, colours and poses in the text of XML elements."""

from __future__ import annotations

import math
import re

import numpy as np

from mazebot.common.maths.frames import (
    Array,
    rotation_from_quaternion,
    rotation_from_rpy,
    transform_matrix,
)
from mazebot.common.messages.documents import Rgba

MAX_MAGNITUDE = 1e6
"""Larger values are errors, so that products of such poses stay finite."""

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_TRUTH = {"true": True, "1": True, "false": False, "0": False}


def number(text: str | None) -> float:
    """A finite number.

    Raises ValueError with a phrase if the text is not one.
    """
    word = (text or "").strip()
    if not _NUMBER.fullmatch(word):
        raise ValueError(f"{_shown(word)} must be a finite number")
    value = float(word)
    if not abs(value) <= MAX_MAGNITUDE:
        raise ValueError(f"{_shown(word)} must be at most {MAX_MAGNITUDE:g}")
    return value


def numbers(text: str | None, *counts: int) -> tuple[float, ...]:
    """Finite numbers separated by spaces, as many as one of `counts`.

    Raises ValueError with a phrase otherwise.
    """
    words = (text or "").split()
    if len(words) not in counts:
        many = " or ".join(str(count) for count in counts)
        raise ValueError(f"{_shown(text or '')} must be {many} numbers")
    return tuple(number(word) for word in words)


def vector(text: str | None) -> tuple[float, float, float]:
    """Three finite numbers. Raises ValueError with a phrase."""
    x, y, z = numbers(text, 3)
    return x, y, z


def positive(text: str | None) -> float:
    """A finite number above zero. Raises ValueError with a phrase."""
    value = number(text)
    if value <= 0.0:
        raise ValueError(f"{_shown(text or '')} must be > 0")
    return value


def not_negative(text: str | None) -> float:
    """A finite number, zero or above. Raises ValueError with a phrase."""
    value = number(text)
    if value < 0.0:
        raise ValueError(f"{_shown(text or '')} must be >= 0")
    return value


def positives(text: str | None, count: int) -> tuple[float, ...]:
    """Finite numbers above zero. Raises ValueError with a phrase."""
    values = numbers(text, count)
    if min(values) <= 0.0:
        raise ValueError(f"{_shown(text or '')} must be > 0 each")
    return values


def truth(text: str | None) -> bool:
    """True, false, 1 or 0. Raises ValueError with a phrase."""
    value = _TRUTH.get((text or "").strip().lower())
    if value is None:
        raise ValueError(f"{_shown(text or '')} must be true, false, 1 or 0")
    return value


def colour(text: str | None) -> Rgba:
    """Red, green, blue and alpha, each in 0..1; alpha defaults to 1.

    Raises ValueError with a phrase.
    """
    values = numbers(text, 3, 4)
    if not all(0.0 <= value <= 1.0 for value in values):
        raise ValueError(f"{_shown(text or '')} must be within 0..1 each")
    red, green, blue = values[:3]
    return red, green, blue, values[3] if len(values) == 4 else 1.0


def pose(text: str | None, degrees: bool = False, quaternion: bool = False) -> Array:
    """(4, 4) matrix of `x y z roll pitch yaw` or `x y z qx qy qz qw`; identity for an empty text.

    Raises ValueError with a phrase.
    """
    if not (text or "").strip():
        return np.eye(4)
    values = numbers(text, 7 if quaternion else 6)
    x, y, z = values[:3]
    if quaternion:
        length = math.sqrt(sum(value * value for value in values[3:]))
        if length < 1e-6:
            raise ValueError(f"{_shown(text or '')} must have a quaternion of unit length")
        rotation = rotation_from_quaternion(*(value / length for value in values[3:]))
    else:
        unit = math.pi / 180.0 if degrees else 1.0
        rotation = rotation_from_rpy(*(value * unit for value in values[3:]))
    return transform_matrix(rotation, (x, y, z))


def _shown(text: str) -> str:
    """A text in quotes, on one line and shortened."""
    line = " ".join(text.split())
    return f"`{line if len(line) <= 60 else line[:57] + '...'}`"
