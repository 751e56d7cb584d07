"""Types of a kernel's arguments as text, and back."""

from __future__ import annotations

import importlib
from typing import Any

from numba.core import types as numba_types

from mazebot.common.maths.kernels import Types


def text_of(types: Types) -> str:
    """Numba's types as an expression of their constructors."""
    return f"({', '.join(map(_text, types))}{',' if len(types) == 1 else ''})"


def types_of(text: str) -> Types:
    """The types of a text from `text_of`, which is evaluated: it must come from this package."""
    types: Types = eval(text, {"__builtins__": {}}, _NAMES)
    return types


def _text(kind: Any) -> str:
    match kind:
        case numba_types.Array(layout="C", mutable=True, aligned=True):
            return f"{kind.dtype}[{':, ' * (kind.ndim - 1)}::1]"
        case numba_types.NamedTuple() | numba_types.NamedUniTuple():
            cls = kind.instance_class
            return f"record({cls.__module__!r}, {cls.__name__!r}, {text_of(tuple(kind.types))})"
        case numba_types.UniTuple() | numba_types.Tuple():
            return f"Tuple({text_of(tuple(kind.types))})"
        case numba_types.Omitted():
            return f"Omitted({kind.value!r})"
        case _:
            return repr(kind)


def _record(module: str, name: str, parts: Types) -> Any:
    """Of a named tuple; Numba has a type of its own for those of equal parts."""
    cls = getattr(importlib.import_module(module), name)
    if len(set(parts)) == 1:
        return numba_types.NamedUniTuple(parts[0], len(parts), cls)  # type: ignore[no-untyped-call]
    return numba_types.NamedTuple(parts, cls)  # type: ignore[no-untyped-call]


_NAMES = {**vars(numba_types), "bool": numba_types.boolean, "record": _record}
