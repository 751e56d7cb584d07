"""Describes the fields of a JSON schema in words, for the generated pages."""

from __future__ import annotations

import re
from typing import Any


def title_of(definition: dict[str, Any]) -> str:
    """`PointLightRecipe` as `Point light`; a geometry, which has a `kind`, as `Box geometry`."""
    name = re.sub("(Recipe|Geometry)$", "", definition["title"])
    words = re.sub(r"(?<!^)(?=[A-Z])", " ", name).capitalize()
    return f"{words} geometry" if "kind" in definition["properties"] else words


def one_cell(text: str) -> str:
    """A text formatted for one cell of a Markdown table."""
    return " ".join(text.split()).replace("|", "\\|")


def default_in_yaml(value: object) -> str:
    """A default as code; `none` if there is none."""
    text = value_in_yaml(value)
    return "none" if text in ("none", "") else f"`{text}`"


def value_in_yaml(value: object) -> str:
    """A value as YAML on one line."""
    match value:
        case None:
            return "none"
        case bool():
            return str(value).lower()
        case list() | tuple():
            return f"[{', '.join(value_in_yaml(item) for item in value)}]" if value else "none"
        case dict():
            return (
                f"{{{', '.join(f'{k}: {value_in_yaml(v)}' for k, v in value.items())}}}"
                if value
                else "none"
            )
        case float():
            return f"{value:g}"
        case _:
            return str(value)


def kind_in_words(field: dict[str, Any], definitions: dict[str, Any]) -> str:
    """The valid values of a field, in words."""
    if "$ref" in field:
        title = title_of(definitions[field["$ref"].rpartition("/")[2]]).lower()
        return f"[{title}](#{title.replace(' ', '-')})"
    for several in ("anyOf", "oneOf"):
        if several in field:
            kinds = [
                kind_in_words(one, definitions)
                for one in field[several]
                if one.get("type") != "null"
            ]
            return " or ".join(kinds)
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return ", ".join(f"`{one}`" for one in field["enum"])
    match field.get("type"):
        case "array" if "prefixItems" in field:
            items = field["prefixItems"]
            kinds = list(dict.fromkeys(kind_in_words(item, definitions) for item in items))
            return f"[{len(items)} x {' or '.join(kinds)}]"
        case "array":
            return f"list of {kind_in_words(field['items'], definitions)}"
        case "object":
            (inner,) = field.get("patternProperties", {"": {}}).values()
            return f"mapping of names to {kind_in_words(inner, definitions)}"
        case "number":
            return "number" + _bounds(field)
        case "integer":
            return "integer" + _bounds(field)
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
