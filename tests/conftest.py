"""What holds for every test."""

from __future__ import annotations

import ctypes
import gc
import logging
import os
import platform
import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

from mazebot.common.node.executive import MemoryTransport

# The same examples each time, and no test that fails because the machine is busy.
settings.register_profile("mazebot", deadline=None, derandomize=True)
settings.load_profile("mazebot")


_M_TOP_PAD = -2
"""Of mallopt(3): how much the heap grows at a time, and what is left at its end when it shrinks."""

_MOST_ID = 200
"""Characters or bytes of a parameter that stands in a test's name."""


def pytest_configure() -> None:
    """Validate every message of nodes in one process, which a user's run does not. Keep memory that
    is freed: the next test needs as much again, and to give it back to the system and take it anew
    costs a tenth of all processor time.
    """
    MemoryTransport.checks_messages = True
    # On a busy machine every command takes long enough to say that it works.
    os.environ.setdefault("MAZEBOT_PROGRESS", "false")
    if platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).mallopt(_M_TOP_PAD, 64 << 20)
    # A shell starts what runs in its background with SIGINT ignored, and so would every program be
    # that a test ends by Ctrl-C.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """A value of megabytes is no name: workers and reports would carry it about."""
    if isinstance(val, bytes | str) and len(val) > _MOST_ID:
        return f"{argname} of {len(val)}"
    return None


def pytest_collection() -> None:
    """Look for no garbage among what is imported: it stays, and it is large."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Look for garbage again, but no more among all that was imported."""
    gc.freeze()
    gc.enable()


_LONGEST = (
    "tests/docs/test_commands.py",
    "tests/embedded/test_determinism.py",
    "tests/embedded/test_golden_hashes.py",
    "tests/cli/replay/test_service.py",
    "tests/embedded/test_worlds.py",
    "tests/localization/test_global_localization.py",
    "tests/embedded/test_cylinder_fields.py",
    "tests/bench/",
    "tests/docs/test_examples.py",
    "tests/parity/",
    "tests/bringup/",
    "tests/worldgen/test_kernels.py",
    "tests/cli/test_many_recordings.py",
)
"""Where the long tests are, the longest first."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest of the slow tests go first, so that no worker is left with one at the end."""

    def place(item: pytest.Item) -> int:
        if item.get_closest_marker("slow") is None:
            return len(_LONGEST)
        named = (i for i, start in enumerate(_LONGEST) if item.nodeid.startswith(start))
        return next(named, len(_LONGEST))

    items.sort(key=place)


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
