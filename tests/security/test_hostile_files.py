"""Files from strangers are refused, or read within limits, in one line and without a traceback."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

from mazebot.common.files.root import ROOT

if TYPE_CHECKING:
    from tests.security.hostile_files import Hostile

MOST_MB = 256
TIMEOUT_S = 280
_LONGEST_LINE = 2000


@pytest.mark.slow
def test_hostile_files_are_refused_in_one_line_within_time_and_memory() -> None:
    # It packs gigabytes as it is loaded, which whoever only collects this file is spared.
    from tests.security.hostile_files import CASES

    # One process that has imported all readers; each file has a child and a deadline of its own.
    done = subprocess.run(
        [sys.executable, "-m", "tests.security.run_hostile", "--json"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    outcomes = {one["name"]: one for one in map(json.loads, done.stdout.splitlines())}
    assert len(outcomes) == len(CASES)
    problems = {case.name: _wrong(case, outcomes[case.name]) for case in CASES}
    assert {name: wrong for name, wrong in problems.items() if wrong} == {}


def _wrong(case: Hostile, outcome: dict[str, Any]) -> str:
    """What is wrong with the outcome of a case; empty: nothing."""
    told = outcome["stdout"] + outcome["stderr"]
    shown = f"exit code {outcome['exit_code']}, {outcome['seconds']} s: {told[:400]!r}"
    if outcome["exit_code"] not in case.exit_codes:
        return f"must exit with one of {case.exit_codes}: {shown}"
    if outcome["extra_mb"] > MOST_MB:
        return f"takes {outcome['extra_mb']:.0f} MB: {shown}"
    if "Traceback" in told:
        return f"has a traceback: {shown}"
    if not all(line.isprintable() for line in told.replace("\t", " ").split("\n")):
        return f"prints control characters: {shown}"
    if any(len(line) > _LONGEST_LINE for line in told.splitlines()):
        return f"prints a line of more than {_LONGEST_LINE} characters: {shown}"
    missing = [words for words in case.words if not any(word in told for word in words.split("|"))]
    return f"must name {missing}: {shown}" if missing else ""
