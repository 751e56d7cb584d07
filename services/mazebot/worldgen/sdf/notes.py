"""Reads the notes that exports add to SDF, and rounds numbers for recipes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import FiniteFloat, TypeAdapter, ValidationError

TEXT = TypeAdapter(str)
VECTOR: TypeAdapter[list[float]] = TypeAdapter(list[FiniteFloat])
SAME_DIGITS = 9
SAME = 10.0**-SAME_DIGITS
"""Numbers that differ by less count as equal."""

_T = TypeVar("_T")
_NOISE = 1e-14


def noted(
    found: list[float], note: str | None, otherwise: list[float] | None = None
) -> list[float]:
    """The numbers noted by an export, if they equal those found up to rounding."""
    values = from_json(note, VECTOR)
    if values is not None and len(values) == len(found):
        if all(abs(one - other) <= SAME for one, other in zip(values, found, strict=True)):
            return values
    return found if otherwise is None else otherwise


def number(value: float) -> float:
    """The number without the rounding errors of sines and products."""
    short = round(float(value), 12) + 0.0
    return short if abs(short - value) <= _NOISE * max(1.0, abs(value)) else float(value)


def numbers(values: Iterable[float]) -> list[float]:
    """The same for several."""
    return [number(value) for value in values]


def colour(rgba: Sequence[float]) -> list[float]:
    """Each component clipped to 0..1."""
    return [min(max(float(value), 0.0), 1.0) for value in rgba]


def strength(rgba: Sequence[float]) -> float:
    """Strength of a coloured light, as one number."""
    return number(sum(colour(rgba)[:3]) / 3.0)


def from_json(text: str | None, kind: TypeAdapter[_T]) -> _T | None:
    """A note of an export, from JSON; None if it is invalid, e.g. edited by hand."""
    if text is None:
        return None
    try:
        return kind.validate_json(text)
    except (ValidationError, RecursionError):
        return None


def validated(kind: TypeAdapter[_T], values: Mapping[str, Any]) -> _T | None:
    """The same for values that are parsed already."""
    try:
        return kind.validate_python(values)
    except ValidationError:
        return None
