"""When Python looks for garbage: not while a process starts, when nearly all that is made stays."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def collections_held_off() -> Iterator[None]:
    """No collections, until the work has `settled` or ends."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def settled() -> None:
    """Let collections begin where they were held off; they leave out all that there is now."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
