"""The base of all configurations, and their errors in one line."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Self, TypeVar, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import InitErrorDetails, PydanticCustomError, to_jsonable_python


class ConfigError(Exception):
    """An error in the user's input; its text is the one line to show."""

    details: str = ""
    """Lines to show below that one: where in the user's own code it is."""


class Params(BaseModel):
    """The base of all settings: unknown names, numbers that are not finite, true and false in place
    of a number, and a least value above the greatest (min_x and max_x, x_min and x_max) are errors.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    @field_validator("*", mode="before")
    @classmethod
    def _is_no_truth_value(cls, value: object, info: ValidationInfo) -> object:
        kinds = set(_plain_types(cls.model_fields[info.field_name or ""].annotation))
        if kinds & {int, float} and bool not in kinds and _has_truth_value(value):
            raise ValueError("must be a number, not true or false")
        return value

    @model_validator(mode="after")
    def _has_limits_in_order(self) -> Self:
        for low, high in limit_pairs(type(self)):
            self._check_order(low, high)
        return self

    def _check_order(self, low: str, high: str, apart: bool = False) -> None:
        """Raise pydantic's ValidationError for one of two numeric fields where the first is above
        the second; with `apart`, also where they are equal. Its `other` is the other field.
        """
        least, greatest = getattr(self, low), getattr(self, high)
        if least < greatest or (least == greatest and not apart):
            return
        default = type(self).model_fields[low].default
        if least == default:
            name, value, rule = high, greatest, f"{'more than' if apart else 'at least'} {low}"
        else:
            name, value, rule = low, least, f"{'less than' if apart else 'at most'} {high}"
        other = greatest if name == low else least
        message = PydanticCustomError(
            "order", f"must be {rule}, {other:g}", {"other": high if name == low else low}
        )
        error = InitErrorDetails(type=message, loc=(name,), input=value)
        raise ValidationError.from_exception_data(type(self).__name__, [error])


def limit_pairs(model: type[BaseModel]) -> list[tuple[str, str]]:
    """The names of numeric fields that are the least and the greatest value of the same thing:
    their names differ by min and max only.
    """
    pairs = []
    for low, field in model.model_fields.items():
        high = "_".join("max" if part == "min" else part for part in low.split("_"))
        other = model.model_fields.get(high)
        if high != low and other is not None:
            if field.annotation in (int, float) and other.annotation in (int, float):
                pairs.append((low, high))
    return pairs


def _plain_types(annotation: Any) -> Iterator[Any]:
    """The types of which an annotation is made up."""
    arguments = get_args(annotation)
    if not arguments:
        yield annotation
    for argument in arguments:
        yield from _plain_types(argument)


def _has_truth_value(value: object) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_has_truth_value, value))
    return isinstance(value, bool)


class ServiceConfig(Params):
    """The fields common to every service's configuration."""

    seed: int = Field(
        7, ge=0, le=2**63 - 1, description="the run's seed; each random stream derives from it"
    )


C = TypeVar("C", bound=ServiceConfig)


def section_model(field: FieldInfo) -> type[BaseModel] | None:
    """The model of a field that is a section of settings; None: it is a setting."""
    kind = field.annotation
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None


def setting_names(model: type[BaseModel], prefix: str = "") -> list[str]:
    """The dotted names of all sections and settings."""
    names = []
    for name, field in model.model_fields.items():
        names.append(f"{prefix}{name}")
        inner = section_model(field)
        if inner is not None:
            names += setting_names(inner, f"{prefix}{name}.")
    return names


def changed_defaults(config: ServiceConfig) -> dict[str, Any]:
    """The defaults, as JSON values, of the settings that have another value, by dotted names."""
    changed: dict[str, Any] = {}
    for name, field in type(config).model_fields.items():
        if not field.is_required():
            default = field.get_default(call_default_factory=True)
            changed |= _changed(name, getattr(config, name), default)
    defaults: dict[str, Any] = to_jsonable_python(changed)
    return defaults


def _changed(name: str, value: object, default: object) -> dict[str, object]:
    if isinstance(default, BaseModel) and isinstance(value, type(default)):
        return {
            path: each
            for inner in type(default).model_fields
            for path, each in _changed(
                f"{name}.{inner}", getattr(value, inner), getattr(default, inner)
            ).items()
        }
    return {} if value == default else {name: default}


def value_of(values: Mapping[str, Any], name: str) -> Any:
    """The value of a dotted name in nested mappings; None: there is none."""
    found: Any = values
    for part in name.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


def put_value(values: dict[str, Any], name: str, value: Any) -> None:
    """Set the value of a dotted name in nested mappings."""
    *sections, last = name.split(".")
    for section in sections:
        values = values.setdefault(section, {})
    values[last] = value


def with_values(config: C, values: Mapping[str, Any]) -> C:
    """A configuration with other values of dotted names. Raises ConfigError in one line, which
    names the parameter and what would be valid.
    """
    changed = config.model_dump()
    for name, value in values.items():
        put_value(changed, name, value)
    try:
        return type(config).model_validate(changed)
    except ValidationError as error:
        raise ConfigError(one_line(error, model=type(config))) from error


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """The values of both, those of `above` where both have one; mappings are joined likewise."""
    both = {**below, **above}
    for name in {*below} & {*above}:
        if isinstance(below[name], dict) and isinstance(above[name], dict):
            both[name] = merged(below[name], above[name])
    return both


class PlainText:
    """Annotation of a list field whose flag or variable is read as plain text, not as JSON."""


def _listed(value: object) -> object:
    """The names in a text with commas, as flags and the environment give it."""
    if isinstance(value, str):
        return tuple(name.strip() for name in value.split(",") if name.strip())
    return value


Names = Annotated[tuple[str, ...], PlainText, BeforeValidator(_listed)]
"""A list of names, with commas in a flag or a variable."""


def _none_if_empty(value: object) -> object:
    return None if value == "" else value


OptionalPath = Annotated[Path | None, BeforeValidator(_none_if_empty)]
"""A file or folder that need not be given: nothing is none, as Compose sets variables to it."""


def one_line(
    error: ValidationError,
    source: Callable[[str], str] = lambda _: "",
    model: type[BaseModel] | None = None,
    names: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """The errors, field by field, in one line; `source` returns the origin of the value of a dotted
    name. With the `model` that was to be made, the nearest name of an unknown field is suggested.
    `names`: of the fields that are shown by another one.
    """
    parts = []
    for problem in error.errors():
        words = [str(part) for part in problem["loc"]]
        field = ".".join([names.get(one, one) for one in words[:1]] + words[1:]) or "(whole)"
        origin = source(field) if problem["loc"] else ""
        got = f"{problem['input']!r:.80}{f' from {origin}' if origin else ''}"
        hint = ""
        if model is not None and problem["type"] == "extra_forbidden":
            hint = _nearest_hint(model, problem["loc"])
        parts.append(f"{field}: {must(problem['msg'])} (got {got}){hint}")
    return printable("; ".join(parts))


def printable(text: str) -> str:
    """A text with codes in place of control characters: what a stranger sends is shown, too. Bytes
    of a file's name that the locale cannot read are shown as UTF-8, or each by its code.
    """
    if text.isprintable():
        return text
    text = _UNREAD.sub(_read, text)
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)


_UNREAD = re.compile("[\udc80-\udcff]+")
"""How Python has bytes that it could not read in a text."""


def _read(unread: re.Match[str]) -> str:
    return os.fsencode(unread[0]).decode("utf-8", "backslashreplace")


def _nearest_hint(model: type[BaseModel], location: tuple[int | str, ...]) -> str:
    """The field nearest to the one at a location, as a suggestion; empty if none is near."""
    inner: type[BaseModel] | None = model
    for part in location[:-1]:
        field = inner.model_fields.get(str(part)) if inner is not None else None
        inner = None if field is None else section_model(field)
    near = get_close_matches(str(location[-1]), inner.model_fields, 1) if inner is not None else []
    return f"; did you mean {near[0]}?" if near else ""


def must(message: str) -> str:
    """A message of pydantic, rephrased as what the value must be."""
    text = message.removeprefix("Value error, ").replace("Input should be", "must be")
    # For a text that is not a number, the part after the comma adds nothing.
    return " ".join(text.partition(", unable to")[0].split())


def fail(message: str) -> None:
    """Print one line on standard error and exit with code 2."""
    sys.stderr.write(f"error: {' '.join(message.split())}\n")
    raise SystemExit(2)
