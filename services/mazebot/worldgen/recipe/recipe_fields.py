"""Which fields a location in a recipe may have, derived from the models."""

from __future__ import annotations

import types
from collections.abc import Sequence
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel

from mazebot.common.problems import Location
from mazebot.worldgen.recipe_model import Recipe


def types_of(annotation: Any) -> list[Any]:
    """The types that a value may have, None left out."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) in (Union, types.UnionType):
        return [t for inner in get_args(annotation) for t in types_of(inner)]
    return [] if annotation is types.NoneType else [annotation]


def types_within(outer: Sequence[Any], part: str | int) -> list[Any]:
    """The types of the values one step further in."""
    found = []
    for kind in outer:
        arguments = get_args(kind)
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            if part in kind.model_fields:
                found += types_of(kind.model_fields[str(part)].annotation)
        elif get_origin(kind) is dict:
            found += types_of(arguments[1])
        elif get_origin(kind) is tuple and isinstance(part, int):
            if len(arguments) == 2 and arguments[1] is Ellipsis:
                found += types_of(arguments[0])
            elif 0 <= part < len(arguments):
                found += types_of(arguments[part])
    return found


def fields_of(kinds: Sequence[Any]) -> list[str]:
    """Names of the fields, each once."""
    models = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
    return list(dict.fromkeys(name for model in models for name in model.model_fields))


def tagged(kinds: Sequence[Any], tag: object) -> list[Any]:
    """The models whose `kind` is `tag`."""
    return [
        kind
        for kind in kinds
        if isinstance(kind, type)
        and issubclass(kind, BaseModel)
        and "kind" in kind.model_fields
        and kind.model_fields["kind"].default == tag
    ]


def place_of(location: Location) -> tuple[Location, list[Any]]:
    """The location in the file, and its types, from the location that pydantic reports.

    pydantic adds the `kind` of tagged unions, and bracketed terms of its own, to the steps.
    """
    kinds: list[Any] = [Recipe]
    place: list[str | int] = []
    for part in location:
        if part == "[key]":
            continue
        chosen = tagged(kinds, part)
        if chosen and len(kinds) > 1:
            kinds = chosen
            continue
        kinds = types_within(kinds, part)
        place.append(part)
    return tuple(place), kinds
