"""What holds for every test."""

from __future__ import annotations

import gc
import logging
from collections.abc import Iterator

import pytest
from hypothesis import settings

# The same examples each time, and no test that fails because the machine is busy.
settings.register_profile("mazebot", deadline=None, derandomize=True)
settings.load_profile("mazebot")


def pytest_collection_finish() -> None:
    """Look for garbage no more among all that was imported: it stays, and it is large."""
    gc.freeze()


_ROOT, _NUMBA = logging.getLogger(), logging.getLogger("numba")
_LEVELS = _ROOT.level, _NUMBA.level


@pytest.fixture(autouse=True)
def _logging_as_before() -> Iterator[None]:
    """A run in this process sends all logs to its own console: no later test may see that, nor
    where a fixture of a whole module was the one to run it.
    """
    handlers = [each for each in _ROOT.handlers if type(each).__module__.startswith("_pytest.")]
    yield
    _ROOT.handlers = handlers
    _ROOT.setLevel(_LEVELS[0])
    _NUMBA.setLevel(_LEVELS[1])
