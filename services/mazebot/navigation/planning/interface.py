"""What a global planner is, and what it is made with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, Protocol

from mazebot.common.maths.frames import SE2
from mazebot.navigation.costmap.footprint import Footprint
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.planning.path import PlannedPath

PlannerName = Literal["any_angle", "a_star"]


_NO_LIMIT: Final = 2**62


def iterations_of(setting: int) -> int:
    """PlannerParams.max_iterations for a setting of Nav2's, where 0 and -1 mean no limit."""
    return setting if setting > 0 else _NO_LIMIT


@dataclass(frozen=True, slots=True)
class PlannerParams:
    """How the planner weighs length against cost."""

    cost_travel_multiplier: float
    """A metre through the costliest free cell costs 1 + this many metres; the name is Smac 2D's."""
    max_iterations: int
    """Cells to expand before failing with PLANNER_TIMEOUT: time does not advance within a step."""
    start_tolerance_m: float
    """How far a start inside inflated cells may be from the nearest free one."""
    path_spacing_m: float
    smoothing_iterations: int
    algorithm: PlannerName = "any_angle"
    """`a_star` leaves the path in the cells' 8 directions before it is rounded."""
    allow_unknown: bool = False
    """Whether paths may lead through unknown cells, at the highest cost."""
    footprint: Footprint | None = None
    """None: the robot is the circle of the costmap. Else the costmap's cells of 253 must reach no
    further than `half_width_m`, which is what it needs to drive straight.
    """
    allow_reverse: bool = False
    """Whether it may drive backwards where nothing else is possible."""


class GlobalPlanner(Protocol):
    """What finds a path. One of a user's own is a class with this method, which is made with the
    PlannerParams.
    """

    def plan(
        self, costmap: Costmap, start: SE2, goal: SE2, tolerance_m: float = 0.0
    ) -> PlannedPath:
        """Path from `start` to `goal`, or to a place within the tolerance of it.

        Raises NavigationError with one of Nav2's codes for ComputePathToPose, 203 to 208.
        """
        ...
