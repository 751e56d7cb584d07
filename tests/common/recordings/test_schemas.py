"""The JSON schemas in docs/schemas, against what runs leave."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mazebot.common.files.root import ROOT
from mazebot.common.recordings.labels import Labels, write_labels
from tests.common.recordings.made_run import made_run

TYPES = {
    "object": dict, "array": list, "string": str, "boolean": bool, "null": type(None),
}  # fmt: skip
KNOWN = {
    "$ref", "$defs", "$schema", "anyOf", "type", "const", "enum", "properties", "required", "items",
    "additionalProperties", "prefixItems", "minItems", "maxItems", "pattern", "maxLength",
    "minimum", "title", "description", "default",
}  # fmt: skip


def schema_of(name: str) -> dict[str, Any]:
    schema: dict[str, Any] = json.loads((ROOT / f"docs/schemas/{name}.schema.json").read_text())
    return schema


def problems(value: Any, schema: dict[str, Any], root: dict[str, Any], at: str) -> Iterator[str]:
    """What a value has against the part of JSON Schema that ours use; other words are refused."""
    assert set(schema) <= KNOWN, set(schema) - KNOWN
    if "$ref" in schema:
        yield from problems(value, root["$defs"][schema["$ref"].rpartition("/")[2]], root, at)
    if "anyOf" in schema and all(any(problems(value, one, root, at)) for one in schema["anyOf"]):
        yield f"{at}: none of {len(schema['anyOf'])}"
    if "const" in schema and value != schema["const"]:
        yield f"{at}: not {schema['const']}"
    if "enum" in schema and value not in schema["enum"]:
        yield f"{at}: not one of {schema['enum']}"
    kind = schema.get("type")
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind in ("number", "integer"):
        if not is_number or (kind == "integer" and value != int(value)):
            yield f"{at}: no {kind}"
        elif value < schema.get("minimum", value):
            yield f"{at}: too small"
    elif kind is not None and not isinstance(value, TYPES[kind]):
        yield f"{at}: no {kind}"
    elif kind == "object":
        yield from object_problems(value, schema, root, at)
    elif kind == "array":
        firsts = schema.get("prefixItems", [])
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            yield f"{at}: {len(value)} items"
        for number, item in enumerate(value):
            inner = firsts[number] if number < len(firsts) else schema.get("items", {})
            yield from problems(item, inner, root, f"{at}[{number}]")
    elif kind == "string":
        if re.search(schema.get("pattern", ""), value) is None:
            yield f"{at}: not of the pattern"
        if len(value) > schema.get("maxLength", len(value)):
            yield f"{at}: too long"


def object_problems(
    value: dict[str, Any], schema: dict[str, Any], root: dict[str, Any], at: str
) -> Iterator[str]:
    properties, others = schema.get("properties", {}), schema.get("additionalProperties", {})
    for name in schema.get("required", ()):
        if name not in value:
            yield f"{at}.{name}: missing"
    for name, item in value.items():
        if name in properties:
            yield from problems(item, properties[name], root, f"{at}.{name}")
        elif others is False:
            yield f"{at}.{name}: unknown"
        else:
            yield from problems(item, others, root, f"{at}.{name}")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = made_run(tmp_path_factory.mktemp("runs") / "run")
    write_labels(folder, Labels(tags=("keep",), note="good"))
    return folder


@pytest.mark.parametrize("name", ["summary", "series", "labels"])
def test_a_real_run_keeps_to_its_schemas(run: Path, name: str) -> None:
    schema = schema_of(name)
    value = json.loads((run / f"{name}.json").read_text())
    assert list(problems(value, schema, schema, name)) == []
    # And a schema refuses what is none.
    assert list(problems(value | {"nope": 1}, schema, schema, name)) == [f"{name}.nope: unknown"]


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("summary", {"seed": "7"}),
        ("summary", {"goals": [{}]}),
        ("summary", {"messages": {"/scan": {"sent": 1}}}),
        ("series", {"format": 2}),
        ("series", {"events": [{"time_s": 0, "kind": "nope", "text": ""}]}),
        ("series", {"truth": {"x_m": [None]}}),
        ("labels", {"tags": ["a b"]}),
    ],
)
def test_something_else_does_not(run: Path, name: str, change: dict[str, Any]) -> None:
    schema = schema_of(name)
    value = json.loads((run / f"{name}.json").read_text()) | change
    assert list(problems(value, schema, schema, name))


def test_each_field_says_what_it_is() -> None:
    for name in ("summary", "series", "labels"):
        schema = schema_of(name)
        for one in (schema, *schema.get("$defs", {}).values()):
            for field, said in one.get("properties", {}).items():
                assert said.get("description"), f"{name}: {one.get('title')}.{field}"
