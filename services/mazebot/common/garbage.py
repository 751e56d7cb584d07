"""Memory at startup: garbage collection is off, as nearly all new objects stay alive; when it is
over, what only it needed is given back.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

from mazebot.common.resident import give_back_unchanged

_COMPILER = "libllvmlite"
"""LLVM, a sixth of a process's memory: once the kernels are loaded, hardly anything calls it."""
_YOUNG_OBJECTS = 50_000
"""New objects until the youngest are searched for cycles. Messages have none, and are freed without
a search: with Python's 700, one of many poses is searched several times while it is made.
"""


@contextmanager
def collections_held_off() -> Iterator[None]:
    """No garbage collection until `settled` is called or the context ends."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def settled() -> None:
    """Enable garbage collection where it was held off; existing objects are excluded from it."""
    if not gc.isenabled():
        gc.freeze()
        gc.set_threshold(_YOUNG_OBJECTS, *gc.get_threshold()[1:])
        gc.enable()
        give_back_unchanged(_COMPILER)
