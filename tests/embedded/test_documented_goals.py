"""Every goal that the documentation gives as an example is driven to, in both worlds."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mazebot.common.files.root import ROOT
from mazebot.embedded.session import Session

_N = r"(-?\d+(?:\.\d+)?)"
_PATTERNS = (
    rf"mazebot goal {_N} {_N} {_N}",
    rf'GOAL="{_N} {_N} {_N}"',
    rf"GOAL \?= {_N} {_N} {_N}",
    rf"--goal {_N} {_N} {_N}",
    rf"session\.goal\({_N}, {_N}(?:, {_N})?\)",
)
PAGES = (
    ROOT / "README.md", ROOT / "Makefile", ROOT / "CONTRIBUTING.md",
    ROOT / "services" / "mazebot" / "embedded" / "session.py",
    *sorted((ROOT / "docs").glob("*.md")),
)  # fmt: skip


def goals_in(page: Path) -> set[tuple[float, float, float]]:
    text = page.read_text()
    return {
        (float(x), float(y), float(yaw or 0.0))
        for pattern in _PATTERNS
        for x, y, yaw in re.findall(pattern, text)
    }


def test_each_page_that_should_gives_one() -> None:
    given = {page.name for page in PAGES if goals_in(page)}
    assert {"README.md", "Makefile", "session.py", "containers.md", "simulation.md"} <= given


@pytest.mark.parametrize("world", ["original", "enhanced"])
def test_every_documented_goal_is_reached(world: str) -> None:
    goals = sorted(set().union(*map(goals_in, PAGES)))
    with Session(world, camera=False) as session:
        for goal in goals:
            result = session.goal(*goal)
            assert (result.error_code, result.error_msg) == (0, ""), goal
