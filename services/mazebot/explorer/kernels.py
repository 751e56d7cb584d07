"""Compiles the explorer's kernels before the robot moves."""

from __future__ import annotations

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.explorer.exploration import aim, survey
from mazebot.explorer.frontiers import guessed_m2
from mazebot.explorer.params import ExplorerParams


def compile_kernels(params: ExplorerParams) -> None:
    """Look at a room with three openings, so that nothing is compiled while the robot moves."""
    cells = np.full((80, 80), -1, np.int8)
    cells[20:60, 20:60] = 100
    cells[22:58, 22:58] = 0
    cells[34:46, 20:22] = cells[34:46, 58:60] = cells[20:22, 34:46] = 0
    home = SE2(2.0, 2.0, 0.0)
    seen = survey(params, cells, 0.05, SE2(0.0, 0.0, 0.0), home, home)
    aim(params.model_copy(update={"choice": "tour"}), seen, home, None)
    guessed_m2(seen.floor, seen.frontiers)
