"""Prints docs/recipes.md from the schema of recipes."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from typing import Any

from services.worldgen.recipe import Recipe

_HEAD = """# Recipes, field by field

Generated from `services/worldgen/recipe.py` by `make generate`; do not edit. How worlds are made
and used: [worlds.md](worlds.md).

A recipe is a YAML file in `worlds/`. Everything is in the frame `map`: metres, radians, x and y on
the floor, z up. Unknown fields are refused, and so is what is not finite. A field without a default
must be given.
"""


def recipes_page() -> str:
    """The page's text."""
    schema: dict[str, Any] = Recipe.model_json_schema()
    definitions: dict[str, Any] = schema["$defs"]
    parts = [_HEAD, _section("Recipe", schema, definitions)]
    names = _in_use(schema, definitions)
    parts += [_section(_title(definitions[name]), definitions[name], definitions) for name in names]
    return "\n".join(parts)


def _in_use(schema: dict[str, Any], definitions: dict[str, Any]) -> list[str]:
    """Names of the definitions, in the order in which a reader meets them."""
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


def _title(definition: dict[str, Any]) -> str:
    """`PointLightRecipe` as `Point light`; geometries, which have a `kind`, as such."""
    name = re.sub("(Recipe|Geometry)$", "", definition["title"])
    words = re.sub(r"(?<!^)(?=[A-Z])", " ", name).capitalize()
    return f"{words} geometry" if "kind" in definition["properties"] else words


def _section(title: str, schema: dict[str, Any], definitions: dict[str, Any]) -> str:
    about = " ".join(schema.get("description", "").split())
    lines = [f"## {title}", "", about, "", "| field | value | default | what |", "| --- " * 4 + "|"]
    required = schema.get("required", [])
    for name, field in schema["properties"].items():
        default = "" if name in required else f"`{_value(field.get('default'))}`"
        if default in ("`none`", "``"):
            default = "none"
        what = " ".join(field.get("description", "").split()).replace("|", "\\|")
        lines.append(f"| `{name}` | {_kind(field, definitions)} | {default} | {what} |")
    return "\n".join(lines) + "\n"


def _value(value: object) -> str:
    """As YAML has it, on one line."""
    match value:
        case None:
            return "none"
        case bool():
            return str(value).lower()
        case list() | tuple():
            return f"[{', '.join(_value(item) for item in value)}]" if value else "none"
        case dict():
            return (
                f"{{{', '.join(f'{k}: {_value(v)}' for k, v in value.items())}}}"
                if value
                else "none"
            )
        case float():
            return f"{value:g}"
        case _:
            return str(value)


def _kind(field: dict[str, Any], definitions: dict[str, Any]) -> str:
    """What may stand there, in words."""
    if "$ref" in field:
        title = _title(definitions[field["$ref"].rpartition("/")[2]]).lower()
        return f"[{title}](#{title.replace(' ', '-')})"
    for several in ("anyOf", "oneOf"):
        if several in field:
            kinds = [_kind(one, definitions) for one in field[several] if one.get("type") != "null"]
            return " or ".join(kinds)
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return ", ".join(f"`{one}`" for one in field["enum"])
    match field.get("type"):
        case "array" if "prefixItems" in field:
            items = field["prefixItems"]
            kinds = list(dict.fromkeys(_kind(item, definitions) for item in items))
            return f"[{len(items)} x {' or '.join(kinds)}]"
        case "array":
            return f"list of {_kind(field['items'], definitions)}"
        case "object":
            (inner,) = field.get("patternProperties", {"": {}}).values()
            return f"mapping of names to {_kind(inner, definitions)}"
        case "number":
            return "number" + _bounds(field)
        case "integer":
            return "whole number" + _bounds(field)
        case "boolean":
            return "`true`, `false`"
        case _:
            return "text"


def _bounds(field: dict[str, Any]) -> str:
    low, high = field.get("minimum"), field.get("maximum")
    if low is not None and high is not None:
        return f" {low:g} .. {high:g}"
    parts = [
        f" {sign} {field[key]:g}"
        for key, sign in (
            ("exclusiveMinimum", ">"), ("minimum", ">="), ("exclusiveMaximum", "<"),
            ("maximum", "<="),
        )
        if key in field
    ]  # fmt: skip
    return ",".join(parts)


if __name__ == "__main__":
    sys.stdout.write(recipes_page())
