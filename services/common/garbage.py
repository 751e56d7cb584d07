"""Garbage collection is off during startup, when nearly all new objects stay alive."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


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
        gc.enable()
