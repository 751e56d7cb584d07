"""What holds for every test."""

from __future__ import annotations

import gc
import logging
from collections.abc import Iterator

import pytest


def pytest_collection_finish() -> None:
    """Look for garbage no more among all that was imported: it stays, and it is large."""
    gc.freeze()


@pytest.fixture(autouse=True)
def _logging_as_before() -> Iterator[None]:
    """A run in this process sends all logs to its own console: no later test may see that."""
    root, numba = logging.getLogger(), logging.getLogger("numba")
    handlers, levels = list(root.handlers), (root.level, numba.level)
    yield
    root.handlers = handlers
    root.setLevel(levels[0])
    numba.setLevel(levels[1])
