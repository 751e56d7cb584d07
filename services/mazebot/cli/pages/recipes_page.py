"""Prints docs/recipes.md from the schema of recipes."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

from mazebot.cli.pages.schema_words import default_in_yaml, kind_in_words, one_cell, title_of
from mazebot.worldgen.recipe_model import Recipe

_HEAD = """# Recipes, field by field

Generated from `services/mazebot/worldgen/recipe_model.py` by `make generate`; do not edit.
How worlds are made and used: [worlds.md](worlds.md).

A recipe is a YAML file in `worlds/`. Everything is in the frame `map`: metres, radians, x and y on
the floor, z up. Unknown fields and non-finite numbers are rejected. A field without a default is
required.
"""


def recipes_page() -> str:
    """Return the text of the page."""
    schema: dict[str, Any] = Recipe.model_json_schema()
    definitions: dict[str, Any] = schema["$defs"]
    parts = [_HEAD, _section("Recipe", schema, definitions)]
    names = _in_use(schema, definitions)
    parts += [
        _section(title_of(definitions[name]), definitions[name], definitions) for name in names
    ]
    return "\n".join(parts)


def _in_use(schema: dict[str, Any], definitions: dict[str, Any]) -> list[str]:
    """Names of the definitions, in the order of their first reference."""
    found: dict[str, None] = {}
    waiting = [schema]
    while waiting:
        for name in _references(waiting.pop(0)):
            if name not in found:
                found[name] = None
                waiting.append(definitions[name])
    return list(found)


def _references(node: object) -> Iterator[str]:
    if isinstance(node, dict):
        for key, value in node.items():
            if key == "$ref":
                yield value.rpartition("/")[2]
            elif key not in ("discriminator", "$defs"):
                yield from _references(value)
    elif isinstance(node, list):
        for value in node:
            yield from _references(value)


def _section(title: str, schema: dict[str, Any], definitions: dict[str, Any]) -> str:
    about = " ".join(schema.get("description", "").split())
    lines = [f"## {title}", "", about, "", "| field | value | default | what |", "| --- " * 4 + "|"]
    required = schema.get("required", [])
    for name, field in schema["properties"].items():
        default = "" if name in required else default_in_yaml(field.get("default"))
        what = one_cell(field.get("description", ""))
        lines.append(f"| `{name}` | {kind_in_words(field, definitions)} | {default} | {what} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(recipes_page())
