"""Where our settings for Nav2's parameters are, and how Nav2's values become ours."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType, NoneType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, PydanticUserError, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from mazebot.common.config import must
from mazebot.common.nav2_params.parameter import Value
from mazebot.common.robot import waffle

Models = Mapping[str, type[BaseModel]]
"""The configuration of each section of a settings file, such as `navigation`."""

LIDAR_MAX_RANGE_M = 3.5
"""The LDS-01's longest range (ROBOTIS, LDS-01 specifications)."""


def _within(each: Value, most: float, most_turning: float) -> Value:
    """A value for x, y and yaw, within the robot's limits for x and yaw."""
    x, y, yaw = each
    return [min(max(x, -most), most), y, min(max(yaw, -most_turning), most_turning)]


NOT_TAKEN = object()
"""What a conversion makes of a value that Nav2 takes and that has no like here: ours counts."""
NO_LIMIT = 1e6
"""Seconds, metres or radians, where Nav2 has infinity or another word for no limit."""


def _no_limit(value: Value) -> Value:
    return NO_LIMIT if value in {-1.0, math.inf} else value


# A controller that counts on more than the robot's own limits mistakes where it will be.
CONVERSIONS: Mapping[str, Callable[[Value], Value]] = MappingProxyType(
    {
        # AMCL takes the smaller of the two, and -1 as the range that the scan states.
        "lidar_max_range": lambda range_m: None if range_m < 0 else min(range_m, LIDAR_MAX_RANGE_M),
        "lidar_min_range": lambda range_m: None if range_m < 0 else range_m,
        "no_limit": _no_limit,
        "whole_path": lambda range_m: NO_LIMIT if range_m < 0 else _no_limit(range_m),
        "always": lambda _: True,
        "in_front": lambda offset_m: -abs(offset_m),
        "gain": lambda gain: gain or NOT_TAKEN,
        "smoothing": lambda order: order // 2 * 2,
        "angle_mode": lambda mode: NOT_TAKEN if mode == 2 else mode,
        "max_speed": lambda speed: min(speed, waffle.MAX_LINEAR_M_S),
        "min_speed": lambda speed: max(speed, -waffle.MAX_LINEAR_M_S),
        "max_turn": lambda speed: min(speed, waffle.MAX_ANGULAR_RAD_S),
        "max_accel": lambda accel: min(accel, waffle.MAX_LINEAR_ACCELERATION_M_S2),
        "min_accel": lambda accel: max(accel, -waffle.MAX_LINEAR_ACCELERATION_M_S2),
        "max_turn_accel": lambda accel: min(accel, waffle.MAX_ANGULAR_ACCELERATION_RAD_S2),
        "speed_limit": lambda speed: None if speed < 0 else min(speed, waffle.MAX_LINEAR_M_S),
        "backward_limit": lambda speed: -min(speed, waffle.MAX_LINEAR_M_S),
        "least_speed": lambda speed: max(min(speed, 0.0), -waffle.MAX_LINEAR_M_S),
        "backward": lambda allowed: None if allowed else 0.0,
        "turn_limit": lambda speed: min(speed, waffle.MAX_ANGULAR_RAD_S),
        "accel_limit": lambda accel: min(accel, waffle.MAX_LINEAR_ACCELERATION_M_S2),
        "turn_accel_limit": lambda accel: min(abs(accel), waffle.MAX_ANGULAR_ACCELERATION_RAD_S2),
        "most_velocity": lambda each: _within(
            each, waffle.MAX_LINEAR_M_S, waffle.MAX_ANGULAR_RAD_S
        ),
        "least_velocity": lambda each: _within(
            each, waffle.MAX_LINEAR_M_S, waffle.MAX_ANGULAR_RAD_S
        ),
        "most_accel": lambda each: _within(
            each, waffle.MAX_LINEAR_ACCELERATION_M_S2, waffle.MAX_ANGULAR_ACCELERATION_RAD_S2
        ),
        "least_accel": lambda each: _within(
            each, waffle.MAX_LINEAR_ACCELERATION_M_S2, waffle.MAX_ANGULAR_ACCELERATION_RAD_S2
        ),
    }
)
"""From Nav2's value to ours; None: our default has this meaning."""
SAME_MEANING = frozenset(
    {"always", "lidar_max_range", "lidar_min_range", "no_limit", "whole_path", "smoothing"}
)
"""The conversions to values that do here what those of Nav2 do there."""
LIMITS = frozenset(
    {
        "speed_limit",
        "backward_limit",
        "least_speed",
        "turn_limit",
        "accel_limit",
        "turn_accel_limit",
    }
)
"""The conversions of limits of which several may have the same setting: the lowest counts."""
_LEAST = 1e-3
"""What is nearest to a bound that is not a value itself, in any unit."""


def setting(place: str, target: str, instance: str, models: Models) -> tuple[str, FieldInfo] | None:
    """Our setting of a name below a place, with its field; None: there is none."""
    section = place.partition(".")[0]
    path = f"{section}.{target[1:]}" if target.startswith("/") else f"{place}.{target}"
    path = path.replace("*", instance)
    found = _field(path, models) if target else None
    return None if found is None else (path, found)


def problems_of(path: str, value: Value, models: Models) -> list[tuple[str, str]]:
    """What is wrong with all the values of a section together: names below it, and what they must
    be.
    """
    _, owner = _found(path, models)
    if owner is None:
        return []
    try:
        owner.model_validate(value)
    except ValidationError as caught:
        found = []
        for error in caught.errors():
            text = must(error["msg"])
            # What a section says of itself begins with the name that it means.
            name, _, rest = text.partition(": ")
            at = ".".join(map(str, error["loc"]))
            found.append((at, text) if at or not rest else (name, rest))
        return found
    return []


def disorder(
    section: str, values: Mapping[str, Value], models: Models
) -> list[tuple[str, str, Value]]:
    """Where the values of a section are beyond others that they belong to, such as a maximum below
    its minimum: the names of both settings, and the value of the first.
    """
    try:
        models[section].model_validate(values)
    except ValidationError as caught:
        found = []
        for error in caught.errors():
            if error["type"] == "order":
                *spaces, name = (section, *map(str, error["loc"]))
                above = ".".join(spaces)
                found.append(
                    (f"{above}.{name}", f"{above}.{error['ctx']['other']}", error["input"])
                )
        return found
    return []


def valid_for(field: FieldInfo, value: Value) -> str:
    """What the field's value must be, where this one is not valid; empty: it is."""
    annotation = field.rebuild_annotation()
    try:
        _adapter(annotation).validate_python(value)
    except ValidationError as error:
        return must(error.errors()[0]["msg"])
    return ""


def nearest(field: FieldInfo, value: Value) -> Value:
    """The value within the field's bounds that is nearest to this one, element by element of a
    list; the value itself where there are no bounds.
    """
    return _within_bounds(_adapter(field.rebuild_annotation()).json_schema(), value)


def _within_bounds(schema: Mapping[str, Any], value: Value) -> Value:
    # Of `X | None`, X.
    schema = next(iter(schema.get("anyOf", [])), schema)
    if isinstance(value, list):
        parts = schema.get("prefixItems", [])
        parts = parts if len(parts) == len(value) else [{}] * len(value)
        return [_within_bounds(part, one) for part, one in zip(parts, value, strict=True)]
    if isinstance(value, bool | str):
        return value
    least, most = schema.get("minimum"), schema.get("maximum")
    if "exclusiveMinimum" in schema:
        least = schema["exclusiveMinimum"] + _LEAST
    if "exclusiveMaximum" in schema:
        most = schema["exclusiveMaximum"] - _LEAST
    within = value if least is None else max(value, least)
    return type(value)(within if most is None else min(within, most))


def _adapter(annotation: Any) -> TypeAdapter[Any]:
    try:
        return TypeAdapter(annotation, config=ConfigDict(allow_inf_nan=False))
    except PydanticUserError:
        # A model has its own configuration.
        return TypeAdapter(annotation)


def _field(path: str, models: Models) -> FieldInfo | None:
    """The field of a dotted name, whose first part is the section."""
    field, owner = _found(path, models)
    # A whole section is no setting of one parameter.
    return None if owner is not None else field


def _found(path: str, models: Models) -> tuple[FieldInfo | None, type[BaseModel] | None]:
    """The field of a dotted name, and the section that it is; None: there is none."""
    section, *parts = path.split(".")
    owner: type[BaseModel] | None = models.get(section)
    field = None
    at = iter(parts)
    for part in at:
        if owner is None:
            return None, None
        field = owner.model_fields.get(part)
        if field is None:
            return None, None
        owner = None
        for kind in _alternatives(field.annotation):
            # Of a mapping, the next part is a key.
            inner = get_args(kind)[1] if get_origin(kind) is dict else kind
            if inner is not kind and next(at, None) is None:
                return field, None
            if isinstance(inner, type) and issubclass(inner, BaseModel):
                owner = inner
    return field, owner


def _alternatives(annotation: object) -> Iterator[object]:
    """The types of `X | None`, or the type itself."""
    if get_origin(annotation) is Union or type(annotation).__name__ == "UnionType":
        yield from (one for one in get_args(annotation) if one is not NoneType)
    else:
        yield annotation
