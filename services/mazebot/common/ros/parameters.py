"""rcl_interfaces: the parameters of each node, listed, read, described and set by `ros2 param`.

A parameter has the dotted name of docs/parameters.md; where its last part is unique in the node,
that is enough to read or set it.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any, Final

from pydantic import BaseModel

from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import QUERIES, Query
from mazebot.common.node.node import Node
from mazebot.common.ros.call import Response, Steps, answered
from mazebot.common.ros.interfaces import interfaces

NOT_SET, BOOL, INTEGER, DOUBLE, STRING = range(5)
BOOL_ARRAY, INTEGER_ARRAY, DOUBLE_ARRAY, STRING_ARRAY = 6, 7, 8, 9
_FIELDS: Final = {
    BOOL: "bool_value", INTEGER: "integer_value", DOUBLE: "double_value", STRING: "string_value",
    BOOL_ARRAY: "bool_array_value", INTEGER_ARRAY: "integer_array_value",
    DOUBLE_ARRAY: "double_array_value", STRING_ARRAY: "string_array_value",
}  # fmt: skip
_BYTE_ARRAY = 5
_SCALARS = {bool: BOOL, int: INTEGER, float: DOUBLE, str: STRING}
_USE_SIM_TIME = "use_sim_time"
_SETTERS: Final[Mapping[str, Query[doc.SetParameters, doc.SetParametersReply]]] = {
    query.owner: query for query in QUERIES if query.request is doc.SetParameters
}
_LARGEST: Final = 1e9
"""Where a range has one end only: the largest number on the wire."""


def values_of(node: Node) -> dict[str, Any]:
    """The parameters of a node by dotted name, as JSON values without mappings."""
    return {**dict(_flat("", node.parameters().values)), _USE_SIM_TIME: True}


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _flat(f"{name}.{key}" if name else key, inner)
    else:
        yield name, value


def type_of(value: Any) -> int:
    """rcl_interfaces/msg/ParameterType of a JSON value; of one that has none in ROS, a text's."""
    if value is None:
        return NOT_SET
    if isinstance(value, list):
        kinds = {type(one) for one in value}
        if kinds and kinds <= {int, float} and float in kinds:
            return DOUBLE_ARRAY
        if len(kinds) > 1 or not kinds <= {*_SCALARS}:
            return STRING
        return _SCALARS[kinds.pop()] + 5 if kinds else STRING_ARRAY
    return _SCALARS.get(type(value), STRING)


def value_message(value: Any) -> Response:
    """rcl_interfaces/msg/ParameterValue of a JSON value."""
    kind = type_of(value)
    if kind == NOT_SET:
        return {}
    if kind == STRING and not isinstance(value, str):
        value = json.dumps(value)
    return {"type": kind, _FIELDS[kind]: value}


def value_in(message: Any) -> Any:
    """The JSON value of a rcl_interfaces/msg/ParameterValue. Raises ValueError where it is none."""
    if message.type == NOT_SET:
        return None
    if message.type not in _FIELDS:
        given = "byte_array" if message.type == _BYTE_ARRAY else message.type
        raise ValueError(f"type {given}: must be a bool, a number, a text, or a list of these")
    value = getattr(message, _FIELDS[message.type])
    return value.tolist() if hasattr(value, "tolist") else value


def _value_like(now: Any, message: Any) -> Any:
    """The JSON value of a rcl_interfaces/msg/ParameterValue for a parameter that is `now`.

    Raises ValueError where it has another type. An integer is taken for a double, and a parameter
    that is not set has any type.
    """
    value, given, wanted = value_in(message), message.type, type_of(now)
    if (given, wanted) == (INTEGER, DOUBLE):
        return float(value)
    if (given, wanted) == (INTEGER_ARRAY, DOUBLE_ARRAY):
        return [float(one) for one in value]
    # A list without elements does not tell its type.
    if given == wanted or NOT_SET in (given, wanted) or [] in (now, value):
        return value
    must, got = (_FIELDS[kind].removesuffix("_value") for kind in (wanted, given))
    raise ValueError(f"Wrong parameter type: must be {must} (got {got})")


def _whole_name(node: Node, name: str, values: Mapping[str, Any]) -> str:
    """The dotted name that a name means; itself where it means none."""
    if name in values:
        return name
    alias = node.parameter_aliases.get(name)
    if alias is not None:
        return alias
    ends = [each for each in values if each.endswith(f".{name}")]
    return ends[0] if len(ends) == 1 else name


def _is_live(node: Node, name: str) -> bool:
    return node.name in _SETTERS and name.startswith(node.live_parameters)


def _list(request: Any, node: Node) -> Response:
    names = []
    for name in values_of(node):
        for prefix in request.prefixes or [""]:
            inner = name.removeprefix(f"{prefix}.") if prefix else name
            fits = not prefix or name == prefix or inner != name
            if fits and (not request.depth or inner.count(".") < request.depth):
                names.append(name)
                break
    prefixes = list(dict.fromkeys(name.rpartition(".")[0] for name in names if "." in name))
    return {"result": {"names": names, "prefixes": prefixes}}


def _get(request: Any, node: Node) -> Response:
    values = values_of(node)
    wanted = [values.get(_whole_name(node, name, values)) for name in request.names]
    return {"values": [value_message(value) for value in wanted]}


def _get_types(request: Any, node: Node) -> Response:
    values = values_of(node)
    return {
        "types": [type_of(values.get(_whole_name(node, name, values))) for name in request.names]
    }


def _describe(request: Any, node: Node) -> Response:
    values = values_of(node)
    return {"descriptors": [_descriptor(node, name, values) for name in request.names]}


def _descriptor(node: Node, name: str, values: Mapping[str, Any]) -> Response:
    whole = _whole_name(node, name, values)
    if whole not in values:
        return {"name": name}
    value, schema = values[whole], _schema_of(type(node.config), whole)
    kind = type_of(value)
    ranges: dict[str, list[dict[str, float]]] = {}
    low, high = (
        schema.get(name, schema.get(f"exclusive{name.title()}")) for name in ("minimum", "maximum")
    )
    if (low is not None or high is not None) and kind in (INTEGER, DOUBLE):
        ends = {
            "from_value": -_LARGEST if low is None else low,
            "to_value": _LARGEST if high is None else high,
        }
        if kind == INTEGER:
            ranges = {"integer_range": [{key: int(end) for key, end in ends.items()}]}
        else:
            ranges = {"floating_point_range": [{key: float(end) for key, end in ends.items()}]}
    return {
        "name": name,
        "type": kind,
        "description": schema.get("description", ""),
        "additional_constraints": _constraints(schema),
        "read_only": not _is_live(node, whole),
        **ranges,
    }


def _constraints(schema: Mapping[str, Any]) -> str:
    """What is valid and no range of ROS can say."""
    for kind in (schema, *schema.get("anyOf", ())):
        if "enum" in kind:
            return f"must be one of {', '.join(map(str, kind['enum']))}"
    signs = {"exclusiveMinimum": ">", "exclusiveMaximum": "<"}
    return ", ".join(f"{signs[key]} {schema[key]:g}" for key in signs if key in schema)


def _schema_of(model: type[BaseModel], name: str) -> Mapping[str, Any]:
    """The JSON schema of the field with a dotted name; empty: there is none."""
    schema = _schema(model)
    definitions, found = schema.get("$defs", {}), schema
    for part in name.split("."):
        if "$ref" in found:
            found = definitions[found["$ref"].rpartition("/")[2]]
        inner = found.get("properties", {}).get(part, found.get("additionalProperties"))
        if not isinstance(inner, dict):
            return {}
        found = inner
    return found


@functools.cache
def _schema(model: type[BaseModel]) -> dict[str, Any]:
    return model.model_json_schema()


def _set_all(given: list[Any], node: Node) -> Steps:
    """Set all of some parameters or, where one is refused, none; returns what SetParametersResult
    has.
    """
    values = values_of(node)
    wanted: dict[str, Any] = {}
    for parameter in given:
        name = _whole_name(node, parameter.name, values)
        if name not in values:
            known = {each.rpartition(".")[2]: each for each in values}
            known |= {each: each for each in values}
            near = get_close_matches(parameter.name, known, 1)
            hint = f"; did you mean {known[near[0]]}?" if near else ""
            return _refused(parameter.name, f"no parameter of /{node.name}{hint}")
        try:
            value = _value_like(values[name], parameter.value)
        except ValueError as error:
            return _refused(name, str(error))
        if not _is_live(node, name):
            if value == values[name]:
                continue
            variable = f"MAZEBOT_{node.name}_{name.replace('.', '__')}".upper()
            return _refused(name, f"read only: it is read at the start, from {variable} or others")
        wanted[name] = value
    if wanted:
        reply = yield _SETTERS[node.name], doc.SetParameters(values=wanted)
        if reply.error:
            return {"successful": False, "reason": reply.error}
    return {"successful": True}


def _refused(name: str, reason: str) -> Response:
    return {"successful": False, "reason": f"{name}: {reason}"}


def _set(request: Any, node: Node) -> Steps:
    results = []
    for parameter in request.parameters:
        results.append((yield from _set_all([parameter], node)))
    return {"results": results}


def _set_atomically(request: Any, node: Node) -> Steps:
    return {"result": (yield from _set_all(request.parameters, node))}


def parameter_event(node: Node, now_ns: int, changed: Mapping[str, Any]) -> msg.ParameterEvent:
    """That parameters of a node have these values now."""
    parameters = [{"name": name, "value": value_message(value)} for name, value in changed.items()]
    event: msg.ParameterEvent = interfaces().make(
        msg.ParameterEvent.__msgtype__,
        {
            "stamp": msg.time_from_ns(now_ns),
            "node": f"/{node.name}",
            "changed_parameters": parameters,
        },
    )
    return event


def _row(name: str, kind: str, handle: Any, about: str) -> tuple[str, str, Any, str]:
    return name, f"rcl_interfaces/srv/{kind}", handle, about


PARAMETER_SERVICES: Final = (
    _row("list_parameters", "ListParameters", answered(_list), "the names of its parameters"),
    _row("get_parameters", "GetParameters", answered(_get), "their values"),
    _row("get_parameter_types", "GetParameterTypes", answered(_get_types), "their types"),
    _row(
        "describe_parameters", "DescribeParameters", answered(_describe),
        "their meaning and range, and whether they are read only",
    ),
    _row("set_parameters", "SetParameters", _set, "set each that can be set while it runs"),
    _row(
        "set_parameters_atomically", "SetParametersAtomically", _set_atomically,
        "set all of some, or none",
    ),
)  # fmt: skip
