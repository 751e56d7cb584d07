"""Problems of a world, one line each."""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import BaseModel, ConfigDict

from mazebot.common.config import ConfigError, printable

Location = tuple[str | int, ...]

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxtuple, _SHORT.maxdict, _SHORT.maxset = 4, 6, 6, 6
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 80
_MAX_VALUE = 60


class Problem(BaseModel):
    """A problem in the user's input: the location, the invalid value, and what would be valid."""

    model_config = ConfigDict(frozen=True)

    file: str = ""
    """As short as possible; empty if it is not about a file."""
    line: int = 0
    """From 1; 0 if there is none."""
    field: str = ""
    """`walls[3].length_m`; empty if it is about the whole file."""
    value: str = ""
    """As in the file, shortened; empty if there is none."""
    must: str
    fatal: bool = True
    """Whether the world cannot run; else it runs without the invalid part, or as it is."""

    def __str__(self) -> str:
        """`worlds/house.yaml:12: walls[3].length_m: -1: must be > 0`."""
        place = f"{self.file}:{self.line}" if self.line else self.file
        text = ": ".join(part for part in (place, self.field, self.value, self.must) if part)
        return words(text)


class WorldError(ConfigError):
    """A world that cannot be loaded: one line with file, field, value, and what would be valid."""

    def __init__(self, what: str | Sequence[Problem]) -> None:
        self.problems: tuple[Problem, ...] = () if isinstance(what, str) else tuple(what)
        if isinstance(what, str):
            super().__init__(what)
        else:
            more = f" (and {len(what) - 1} more)" if len(what) > 1 else ""
            super().__init__(f"{what[0]}{more}")


@dataclass(frozen=True)
class Mistake:
    """A problem by its location in a recipe, before its file and line are known."""

    location: Location
    value: object
    must: str
    """`{other}` in it is replaced by the other location."""
    fatal: bool = True
    other: Location = ()


def field_name(location: Location) -> str:
    """`walls[3].length_m`."""
    field = ""
    for part in location:
        index = isinstance(part, int) and field
        field += f"[{part}]" if index else f".{part}" if field else str(part)
    return words(field)


def shown_value(value: object) -> str:
    """A value on one line, shortened, whatever it is."""
    try:
        text = _SHORT.repr(value)
    except (ValueError, RecursionError):
        return "a number with more digits than Python prints"
    text = words(text)
    return text if len(text) <= _MAX_VALUE else text[: _MAX_VALUE - 3] + "..."


def words(text: object) -> str:
    """A text as one printable line."""
    return printable(" ".join(str(text).split()))
