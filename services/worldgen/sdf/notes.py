"""What exports write where SDF has no word for it, read again, and numbers as recipes have them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import FiniteFloat, TypeAdapter, ValidationError

TEXT = TypeAdapter(str)
VECTOR: TypeAdapter[list[float]] = TypeAdapter(list[FiniteFloat])
SAME_DIGITS = 9
SAME = 10.0**-SAME_DIGITS
"""Numbers that differ by less are one."""

_T = TypeVar("_T")
_NOISE = 1e-14


def noted(
    found: list[float], note: str | None, otherwise: list[float] | None = None
) -> list[float]:
    """The numbers that an export has noted, where they are those found but for rounding."""
    said = from_json(note, VECTOR)
    if said is not None and len(said) == len(found):
        if all(abs(one - other) <= SAME for one, other in zip(said, found, strict=True)):
            return said
    return found if otherwise is None else otherwise


def number(value: float) -> float:
    """Without what sines and products have added behind the last digits."""
    short = round(float(value), 12) + 0.0
    return short if abs(short - value) <= _NOISE * max(1.0, abs(value)) else float(value)


def numbers(values: Iterable[float]) -> list[float]:
    """The same of several."""
    return [number(value) for value in values]


def colour(rgba: Sequence[float]) -> list[float]:
    """Each part from 0 to 1."""
    return [min(max(float(value), 0.0), 1.0) for value in rgba]


def strength(rgba: Sequence[float]) -> float:
    """Of a light of some colour, as one number."""
    return number(sum(colour(rgba)[:3]) / 3.0)


def from_json(text: str | None, kind: TypeAdapter[_T]) -> _T | None:
    """What exports note as JSON; None where it is something else, by a hand's doing."""
    if text is None:
        return None
    try:
        return kind.validate_json(text)
    except (ValidationError, RecursionError):
        return None


def validated(kind: TypeAdapter[_T], values: Mapping[str, Any]) -> _T | None:
    """The same of what is JSON no more."""
    try:
        return kind.validate_python(values)
    except ValidationError:
        return None
