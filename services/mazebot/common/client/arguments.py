"""The arguments that a program gives to a public class, checked by their annotations."""

from __future__ import annotations

import collections.abc
import functools
import inspect
import math
import numbers
import os
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import BaseModel, TypeAdapter, ValidationError

from mazebot.common.config import ConfigError, must, one_line, printable

C = TypeVar("C")
B = TypeVar("B", bound=BaseModel)

_NOTHING: Mapping[str, str] = {}
_VARIADIC = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
_ITERABLES = (collections.abc.Iterable, collections.abc.Sequence)


def checks_arguments(error: type[ConfigError]) -> Callable[[type[C]], type[C]]:
    """Have the constructor and the public methods of a class check what they are given by their
    annotations, before anything is done: they raise `error` in one line, which names the argument,
    what it must be, and its value.

    A number is finite, unless its default is not; no text is a number, no number a truth value.
    Numpy's scalars are those of Python. What the annotations leave open, such as a union of
    several types, is passed on.
    """

    def decorate(of: type[C]) -> type[C]:
        for name, member in list(vars(of).items()):
            if name.startswith("_") and name != "__init__":
                continue
            if isinstance(member, classmethod):
                setattr(of, name, classmethod(_checking(member.__func__, error)))
            elif inspect.isfunction(member):
                setattr(of, name, _checking(member, error))
        return of

    return decorate


def refusal(name: str, what: str, value: object) -> str:
    """The line that refuses an argument: what it must be, and what it is."""
    return printable(f"{name}: {what} (got {' '.join(f'{value!r:.80}'.split())})")


def built(
    kind: type[B],
    fields: Mapping[str, object],
    error: type[ConfigError] = ConfigError,
    names: Mapping[str, str] = _NOTHING,
) -> B:
    """A document or a configuration from a program's arguments; `names`: of the arguments, by field
    where they differ.

    Raises `error`, in one line, where they are invalid.
    """
    try:
        return kind(**fields)
    except ValidationError as invalid:
        raise error(one_line(invalid, names=names)) from invalid


def _checking(function: Callable[..., Any], error: type[ConfigError]) -> Callable[..., Any]:
    signature = inspect.signature(function)
    named = list(signature.parameters.values())[1:]
    checked = {one.name: one for one in named if one.kind not in _VARIADIC}
    if not checked:
        return function

    @functools.cache
    def kinds() -> dict[str, Any]:
        return get_type_hints(function, include_extras=True)

    @functools.wraps(function)
    def call(*given: Any, **by_name: Any) -> Any:
        try:
            bound = signature.bind(*given, **by_name)
        except TypeError:
            # Python tells best what is missing, or too much.
            return function(*given, **by_name)
        for name, value in bound.arguments.items():
            if name not in checked or name not in kinds():
                continue
            try:
                bound.arguments[name] = taken(kinds()[name], value, checked[name].default)
            except ValueError as invalid:
                raise error(refusal(name, _problem(invalid), value)) from None
        return function(*bound.args, **bound.kwargs)

    return call


def _problem(error: ValueError) -> str:
    return must(error.errors()[0]["msg"]) if isinstance(error, ValidationError) else str(error)


def taken(kind: Any, value: Any, default: object = None) -> Any:
    """A value as its kind, an annotation, has it. Raises ValueError, with what it must be."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        plain = taken(inner[0], value, default)
        return TypeAdapter(kind).validate_python(plain) if inner[0] in _SCALARS else plain
    if origin in (Union, types.UnionType):
        return _one_of(inner, value, default)
    if origin is Literal:
        if value not in inner:
            raise ValueError(f"must be one of {', '.join(map(repr, inner))}")
        return value
    if origin is tuple:
        return _tuple(inner, value)
    if origin in _ITERABLES:
        return _tuple((inner[0], ...), value)
    if origin is collections.abc.Callable:
        if not callable(value):
            raise ValueError("must be a function")
        return value
    if kind in _SCALARS:
        return _SCALARS[kind](_plain(value), default)
    of = origin or kind
    if isinstance(of, type) and not isinstance(value, of):
        raise ValueError(f"must be a {of.__name__}")
    return value


def _one_of(kinds: tuple[Any, ...], value: Any, default: object) -> Any:
    if value is None and types.NoneType in kinds:
        return None
    others = [one for one in kinds if one is not types.NoneType]
    if set(others) == {str, Path}:
        return _path(value, None)
    # Of several kinds, whoever uses the value tells which one it must be.
    return taken(others[0], value, default) if len(others) == 1 else value


def _tuple(kinds: tuple[Any, ...], value: Any) -> tuple[Any, ...]:
    if isinstance(value, str | bytes | Mapping):
        raise ValueError("must be a list")
    try:
        items = tuple(value)
    except TypeError:
        raise ValueError("must be a list") from None
    if kinds[-1] is ...:
        kinds = kinds[:1] * len(items)
    if len(items) != len(kinds):
        raise ValueError(f"must be a list of {len(kinds)}")
    return tuple(taken(kind, item) for kind, item in zip(kinds, items, strict=True))


def _plain(value: Any) -> Any:
    """Numpy's scalar as that of Python."""
    if not (isinstance(value, np.generic | np.ndarray) and value.ndim == 0):
        return value
    scalar = value if isinstance(value, np.generic) else value[()]
    # 0.2 in 32 bits is 0.2: its next number in 64 bits is a little more, which is one step more.
    return float(str(scalar)) if isinstance(scalar, np.floating) else scalar.item()


def _number(value: Any, default: object) -> float:
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise ValueError("must be a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not (math.isfinite(number) or (number == math.inf == default)):
        raise ValueError("must be a finite number")
    return number


def _integer(value: Any, _: object) -> int:
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise ValueError("must be an integer")
    return int(value)


def _truth(value: Any, _: object) -> bool:
    if not isinstance(value, bool):
        raise ValueError("must be True or False")
    return value


def _text(value: Any, _: object) -> str:
    if not isinstance(value, str):
        raise ValueError("must be a string")
    return value


def _path(value: Any, _: object) -> Path:
    if not isinstance(value, str | os.PathLike):
        raise ValueError("must be a path")
    return Path(value)


_SCALARS: dict[Any, Callable[[Any, object], Any]] = {
    float: _number, int: _integer, bool: _truth, str: _text, Path: _path,
}  # fmt: skip
