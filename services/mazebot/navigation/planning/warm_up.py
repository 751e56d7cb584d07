"""Runs every kernel of planning once, so that nothing is compiled while the robot moves."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Final

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.navigation.costmap.footprint import WAFFLE
from mazebot.navigation.costmap.layered_costmap import Costmap, InflationParams, frame_of, inflate
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.planner import GridPlannerParams, Planner, PlannerParams

_RESOLUTION_M: Final = 0.05
_PARAMS: Final = PlannerParams(
    GridPlannerParams(cost_travel_multiplier=1.0, max_iterations=100_000, start_tolerance=0.5),
    _RESOLUTION_M, 100, footprint=WAFFLE,
)  # fmt: skip
_IN_THE_ROOM: Final = SE2(0.5, 0.5, 0.0)


def run_planning_kernels() -> None:
    """Plan in a room of 2 m: through it, out of it, into its walls, and where it is too narrow."""
    room = _room(WAFFLE.half_width_m)
    room.clearance_at(*_IN_THE_ROOM[:2])
    planner = Planner(replace(_PARAMS, allow_reverse=True))
    planner.plan(room, _IN_THE_ROOM, SE2(1.0, 0.9, 0.0))
    questions = (
        # A goal in the wall, a start near it, a closed room, and a dead end too narrow to turn in.
        (_IN_THE_ROOM, SE2(0.0, 0.5, 0.0)),
        (SE2(0.15, 0.5, 0.0), SE2(1.0, 0.9, 0.0)),
        (_IN_THE_ROOM, SE2(2.6, 0.5, 0.0)),
        (_IN_THE_ROOM, SE2(1.3, 2.5, 0.0)),
    )
    for start, goal in questions:
        for tolerance_m in (0.0, 0.3):
            with contextlib.suppress(NavigationError):
                planner.plan(room, start, goal, tolerance_m, room)
    shortest = GridPlannerParams(cost_travel_multiplier=0.0)
    planner = Planner(replace(_PARAMS, footprint=None, settings=shortest))
    planner.plan(_room(0.1), _IN_THE_ROOM, SE2(1.0, 0.9, 0.0))


def _room(inscribed_radius_m: float) -> Costmap:
    cells = np.full((60, 60), 100, np.int8)
    cells[1:40, 1:40] = 0
    cells[1:40, 45:59] = 0
    cells[40:58, 22:31] = 0
    frame = frame_of(_RESOLUTION_M, SE2(0.0, 0.0, 0.0), cells)
    lethal = cells > 0
    params = InflationParams(
        custom_inscribed_radius=inscribed_radius_m, inflation_radius=0.7, cost_scaling_factor=10.0
    )
    return inflate(frame, lethal, np.zeros_like(lethal), params)
