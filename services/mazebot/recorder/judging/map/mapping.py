"""Evaluates the map that the robot makes, as it grows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    BodyEntity,
    CoverageStep,
    MapEvaluation,
    MarkerEntity,
    MarkersMapped,
    World,
)
from mazebot.common.messages.slam_documents import ExplorationStatus, PoseGraph
from mazebot.common.world.costmap import FREE, straightened
from mazebot.recorder.judging.map.graph_errors import false_loops, marker_errors
from mazebot.recorder.judging.map.true_map import (
    SCAN_HEIGHT_M,
    SCAN_RANGE_M,
    Lattice,
    MapShares,
    TrueMap,
    true_map,
)
from mazebot.recorder.judging.obstacles import read_meshes
from mazebot.recorder.judging.trajectory import (
    Trajectory,
    absolute_error_m,
    aligned,
    relative_error,
    summed_up,
)

MILESTONES = (0.90, 0.95, 0.99)
_STEP = 0.005
_ENDED = ("complete", "failed")
_NOTHING = MapShares(None, None, None, None)

TruePose = Callable[[int], SE2 | None]


class MappingEvaluation:
    """Compares the newest map, the newest pose graph and the estimated path with the world.

    The truth is made once for a set of static things in the world, when a map has come; a map then
    takes less than a millisecond per 100,000 cells.
    """

    def __init__(self, world: World, assets: Mapping[str, bytes]) -> None:
        """`assets` by sha256 may be filled later."""
        self._world = world
        self._assets = assets
        self._standing: tuple[BodyEntity, ...] = ()
        self._markers: tuple[MarkerEntity, ...] = ()
        self._scan_height_m, self._scan_range_m = SCAN_HEIGHT_M, SCAN_RANGE_M
        self._truth: TrueMap | None = None
        self._lattice: Lattice | None = None
        self._grid: tuple[float, SE2, NDArray[np.int8]] | None = None
        self._is_new = False
        self._shares = _NOTHING
        self._trajectory = Trajectory()
        self._coverage: list[CoverageStep] = []
        self._milestones: list[CoverageStep] = []
        self._graph: PoseGraph | None = None
        self._marker_errors: MarkersMapped | None = None
        self._false_loops: int | None = None
        self._exploration: ExplorationStatus | None = None
        self._explored_s: float | None = None

    @property
    def true_faces_m(self) -> Array | None:
        """(n, 2, 2) segments, from and to, of the walls that can be seen; None before a map."""
        return None if self._truth is None else self._truth.faces_m

    def set_entities(
        self, markers: tuple[MarkerEntity, ...], standing: tuple[BodyEntity, ...]
    ) -> None:
        """Set the world's markers, and the static bodies spawned in it."""
        self._markers, self._marker_errors = markers, None
        if standing != self._standing:
            self._standing = standing
            self._forget_truth()

    def add_scan(self, scan: msg.LaserScan) -> None:
        """Take the lidar's range from a scan."""
        range_m = float(scan.range_max)
        if range_m > 0.0 and range_m != self._scan_range_m:
            self._scan_range_m = range_m
            self._forget_truth()

    def set_scan_height(self, height_m: float) -> None:
        """Set the height of the lidar above the floor."""
        if height_m != self._scan_height_m:
            self._scan_height_m = height_m
            self._forget_truth()

    def add_pose(self, estimate: SE2, truth: SE2) -> None:
        """Add an estimated pose and the true one at its stamp, newer than all before."""
        self._trajectory.add(estimate, truth)

    def add_map(self, grid: msg.OccupancyGrid, time_s: float, driven_m: float | None) -> None:
        """Add a map, with the time and the driven length at its arrival."""
        resolution_m, cells = float(grid.info.resolution), msg.cells_from_grid(grid)
        origin, cells = straightened(resolution_m, msg.se2_from_pose(grid.info.origin), cells)
        self._grid, self._is_new = (resolution_m, origin, cells), True
        covered = self._judged().coverage
        if covered is None:
            return
        step = CoverageStep(time_s=time_s, driven_m=driven_m or 0.0, coverage_share=covered)
        # Steps of a share are few, however often the map changes.
        if not self._coverage or covered >= self._coverage[-1].coverage_share + _STEP:
            self._coverage.append(step)
        for share in MILESTONES[len(self._milestones) :]:
            if covered >= share:
                self._milestones.append(step)

    def add_graph(self, graph: PoseGraph) -> None:
        """Add a pose graph."""
        self._graph, self._marker_errors, self._false_loops = graph, None, None

    def add_exploration(self, status: ExplorationStatus, time_s: float) -> None:
        """Add the explorer's state, with the time of its arrival."""
        if status.state not in _ENDED:
            self._explored_s = None
        elif self._explored_s is None:
            self._explored_s = time_s
        self._exploration = status

    def evaluation(self, driven_m: float | None, true_pose: TruePose) -> MapEvaluation:
        """The evaluation so far; `true_pose` gives map_from_base at a stamp (ns)."""
        graph, shares = self._graph, self._judged()
        estimates, truths = self._trajectory.estimates, self._trajectory.truths
        fitted = aligned(estimates, truths)
        relative = relative_error(estimates, truths)
        if self._marker_errors is None:
            landmarks = graph.landmarks if graph is not None else ()
            self._marker_errors = marker_errors(landmarks, self._markers)
        if self._false_loops is None:
            self._false_loops = 0 if graph is None else false_loops(graph, true_pose)
        exploration = self._exploration
        return MapEvaluation(
            walls_found_share=shares.walls_found,
            walls_true_share=shares.walls_true,
            free_wrong_share=shares.free_wrong,
            coverage_share=shares.coverage,
            free_m2=self._free_m2(),
            coverage=tuple(self._coverage),
            milestones=tuple(self._milestones),
            trajectory_error_m=summed_up(absolute_error_m(estimates, truths)),
            aligned_error_m=summed_up(absolute_error_m(fitted, truths)),
            relative_error_m=summed_up(relative.apart_m),
            relative_error_rad=summed_up(relative.turned_rad),
            markers=self._marker_errors,
            keyframes=len(graph.nodes) if graph is not None else 0,
            loops=graph.loops if graph is not None else 0,
            loops_rejected=graph.loops_rejected if graph is not None else 0,
            false_loops=self._false_loops,
            driven_m=driven_m,
            exploration=exploration.state if exploration is not None else "",
            exploration_reason=exploration.reason if exploration is not None else "",
            explored_s=self._explored_s,
        )

    def _free_m2(self) -> float | None:
        if self._grid is None:
            return None
        resolution_m, _, cells = self._grid
        return int(np.count_nonzero(cells == FREE)) * resolution_m * resolution_m

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """What latched messages do not bring again, as JSON values and as arrays."""
        values = {
            "coverage": [step.model_dump(mode="json") for step in self._coverage],
            "milestones": [step.model_dump(mode="json") for step in self._milestones],
            "explored_s": self._explored_s,
        }
        return values, self._trajectory.state()

    def restore(self, values: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a saved `state()`.

        Raises ValueError, KeyError, TypeError if it is invalid.
        """
        self._trajectory.restore(arrays)
        self._coverage = [CoverageStep.model_validate(step) for step in values["coverage"]]
        self._milestones = [CoverageStep.model_validate(step) for step in values["milestones"]]
        self._explored_s = values["explored_s"]

    def _true_map(self) -> TrueMap:
        return true_map(
            self._world,
            read_meshes((*self._world.bodies, *self._standing), self._assets),
            self._standing,
            self._scan_height_m,
            self._scan_range_m,
        )

    def _forget_truth(self) -> None:
        self._truth = self._lattice = None
        self._is_new = True

    def _judged(self) -> MapShares:
        """Of the newest map."""
        if self._is_new and self._grid is not None:
            resolution_m, origin, cells = self._grid
            if self._lattice is None or not self._lattice.holds(resolution_m, origin):
                if self._truth is None:
                    self._truth = self._true_map()
                self._lattice = Lattice(self._truth, resolution_m, origin)
            self._shares = self._lattice.judge(cells, origin)
            self._is_new = False
        return self._shares
