"""Memory that is given back after a start."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from mazebot.common.resident import give_back_unchanged

pytestmark = pytest.mark.skipif(not Path("/proc/self/smaps").is_file(), reason="needs /proc")

_COMPILES = """
import numba
from mazebot.common.resident import give_back_unchanged
from tests.common.test_resident import unchanged_kb

@numba.njit
def twice(x):
    return 2 * x

assert twice(1) == 2
before_kb = unchanged_kb("libllvmlite")
given = give_back_unchanged("libllvmlite")
after_kb = unchanged_kb("libllvmlite")
assert twice(1.5) == 3.0
print(before_kb, given, after_kb)
"""


def unchanged_kb(library: str) -> int:
    """Resident memory, in kB, of what nobody writes to in a library."""
    size, counts = 0, False
    for line in Path("/proc/self/smaps").read_text(encoding="utf-8").splitlines():
        if re.match(r"^[0-9a-f]+-[0-9a-f]+ ", line):
            is_kept = "w" in line.split()[1]
            counts = not is_kept and Path(line.split()[-1]).name.startswith(library)
        elif counts and line.startswith("Rss:"):
            size += int(line.split()[1])
    return size


def test_a_library_given_back_takes_no_memory_and_runs_again() -> None:
    run = subprocess.run(
        [sys.executable, "-c", _COMPILES], capture_output=True, text=True, check=True, timeout=120
    )
    before_kb, given, after_kb = map(int, run.stdout.split())
    assert before_kb > 10_000
    assert given > 1024 * before_kb // 2
    assert after_kb < before_kb // 5


def test_a_library_that_is_not_loaded_gives_nothing_back() -> None:
    assert give_back_unchanged("libnothing_of_this_name") == 0
