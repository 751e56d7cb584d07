"""Overrides `field=value` of a recipe's content."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from mazebot.common.files.yaml_source import parse_value
from mazebot.common.problems import Location, Problem, WorldError, field_name, words
from mazebot.worldgen.recipe.recipe_fields import fields_of, types_of, types_within
from mazebot.worldgen.recipe_model import Recipe

MAX_OVERRIDES = 100
MAX_CHARACTERS = 4000

_UNITS = ("_m", "_rad", "_kg", "_xyzw")
_FIXED = ("name", "extends")


def shown_override(override: str) -> str:
    """In place of the file of a problem: `override maze.seed=3`."""
    text = words(override[:MAX_CHARACTERS])
    return f"override {text if len(text) <= 60 else text[:57] + '...'}".rstrip()


def parse_override(override: str, content: Mapping[Any, Any]) -> tuple[Location, Any]:
    """The location in a recipe's content that an override names, and its value.

    Steps are joined by points. A field's unit suffix may be omitted, and the parts of a list are
    found by number or by name: `walls.3.length=2`, `walls[3].length=2`, `walls.Wall_3.length=2`.
    Values are YAML.

    Raises WorldError.
    """
    shown = shown_override(override)
    if len(override) > MAX_CHARACTERS:
        raise _wrong(shown, f"must have at most {MAX_CHARACTERS} characters")
    field, given, text = override.partition("=")
    if not given or not field.strip():
        raise _wrong(shown, "must be field=value")
    steps = re.sub(r"\[(\d+)\]", r".\1", field.strip(), flags=re.ASCII).split(".")
    kinds: list[Any] = types_of(Recipe)
    here: Any = content
    place: list[str | int] = []
    while steps:
        fields = fields_of(kinds)
        if not place:
            fields = [name for name in fields if name not in _FIXED]
        step: str | int
        if fields:
            step = _field(steps.pop(0), fields, (*place,), shown)
        elif isinstance(here, tuple):
            step = _index(steps.pop(0), here, (*place,), shown)
        else:
            step = _key(steps, here if isinstance(here, Mapping) else {})
        kinds = types_within(kinds, step)
        place.append(step)
        if not kinds:
            raise _wrong(shown, "no such field", field_name((*place,)))
        try:
            here = here[step]
        except (LookupError, TypeError):
            here = None
    try:
        return tuple(place), parse_value(text, shown)
    except WorldError as error:
        # It has one line, and so one problem.
        (problem,) = error.problems
        raise WorldError([problem.model_copy(update={"line": 0})]) from error


def with_value(content: Any, place: Location, value: Any) -> Any:
    """The content with another value at a location; missing mappings on its path are created."""
    if not place:
        return value
    step, rest = place[0], place[1:]
    if isinstance(content, tuple) and isinstance(step, int):
        return (*content[:step], with_value(content[step], rest, value), *content[step + 1 :])
    inner = content if isinstance(content, Mapping) else {}
    return {**inner, step: with_value(inner.get(step), rest, value)}


def _field(step: str, fields: Sequence[str], before: Location, shown: str) -> str:
    short = [name for name in fields if any(name == step + unit for unit in _UNITS)]
    if step in fields:
        return step
    if len(short) == 1:
        return short[0]
    must = f"unknown field: must be one of {', '.join(short or fields)}"
    raise _wrong(shown, must, field_name((*before, step)))


def _index(step: str, content: tuple[Any, ...], before: Location, shown: str) -> int:
    if step.isascii() and step.isdigit() and len(step) < 10:
        if int(step) < len(content):
            return int(step)
    else:
        for index, part in enumerate(content):
            if isinstance(part, Mapping) and part.get("name") == step:
                return index
    must = f"must be a number less than {len(content)}, or a name"
    asked = int(step) if step.isascii() and step.isdigit() and len(step) < 10 else step
    raise _wrong(shown, must, field_name((*before, asked)))


def _key(steps: list[str], content: Mapping[Any, Any]) -> str:
    """The next key, removed from `steps`: names may contain points themselves."""
    for count in range(len(steps), 1, -1):
        if (name := ".".join(steps[:count])) in content:
            del steps[:count]
            return name
    return steps.pop(0)


def _wrong(shown: str, must: str, field: str = "") -> WorldError:
    return WorldError([Problem(file=shown, field=field, must=must)])
