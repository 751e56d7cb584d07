"""What a global planner is, and what it is made with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, Protocol

from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths.frames import SE2
from mazebot.common.world.costmap import START_TOLERANCE_M
from mazebot.navigation.costmap.footprint import Footprint
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.planning.path import PlannedPath

PlannerName = Literal["any_angle", "a_star"]


_NO_LIMIT: Final = 2**62


class GridPlannerParams(Params):
    """How the planners weigh length against cost; names as in Nav2's Smac 2D."""

    tolerance: float = Field(
        0.0,
        ge=0,
        description="m; a goal that is occupied is replaced by the nearest free pose within this",
    )
    cost_travel_multiplier: float = Field(
        1.5,
        ge=0,
        description="extra path length that one metre through the costliest free cells "
        "counts for, in metres",
    )
    max_iterations: int = Field(
        -1,
        ge=-1,
        description="the planner gives up after expanding this many cells; 0 or -1: never, so that "
        "a map of any size is searched to its end (Nav2: 1000000)",
    )
    start_tolerance: float = Field(
        START_TOLERANCE_M,
        ge=0,
        description="m; planning from a start inside an obstacle begins at the nearest "
        "free cell within this distance",
    )

    @property
    def most_cells(self) -> int:
        """Cells to expand before failing with PLANNER_TIMEOUT: time does not advance within a
        step.
        """
        return self.max_iterations if self.max_iterations > 0 else _NO_LIMIT


@dataclass(frozen=True, slots=True)
class PlannerParams:
    """What a planner is made with."""

    settings: GridPlannerParams
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
