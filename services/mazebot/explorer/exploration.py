"""The exploration: from the map so far and the robot's pose to a goal. No topics, no clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2
from mazebot.common.world.costmap import Cells
from mazebot.explorer.choice import Chooser
from mazebot.explorer.floor import Floor, floor_from
from mazebot.explorer.frontiers import Frontier, find_frontiers
from mazebot.explorer.open_floor import Limits, is_outdoors
from mazebot.explorer.params import ExplorerParams
from mazebot.explorer.paths import FAR, Distances, search, way
from mazebot.explorer.view_points import Part, Vain, ViewPoint, view_points

_SEEN_BEFORE_M: Final = 0.3
"""A frontier is looked at from this much nearer than the lidar's range."""
_BEYOND_M: Final = 1.2
"""A goal lies so much farther than where the frontier comes in sight, so that the robot does not
slow down before it sees it."""
_ROOM_M: Final = 0.4
"""Wanted around a goal."""
_SAME_M: Final = 1.0
"""A frontier this near to an earlier one is the same one, which has moved."""
_TURN_OVER_M: Final = 0.5
"""A goal's heading is that of the last part of the way."""


@dataclass(frozen=True, eq=False)
class Aim:
    """Where to drive, and what for."""

    pose: SE2
    """In the map: a reachable place near the frontier."""
    target_m: tuple[float, float]
    """(x, y) in the middle of the frontier's part that is to be seen."""
    way_m: float
    """Cost of the way to where it is seen, as a length through open floor."""
    left_m: tuple[tuple[float, float], ...] = ()
    """Targets that were given up for this one or one before it, and are still to be seen."""

    def is_for_another(self, other: Aim) -> bool:
        """Whether it is for another frontier."""
        return _distance_m(self.target_m, other.target_m) >= _SAME_M


@dataclass(frozen=True, eq=False)
class Survey:
    """What the map shows."""

    floor: Floor
    frontiers: list[Frontier]
    points: list[ViewPoint]
    """Of frontiers that are not set aside, in the order of the ways to them."""
    unseen: list[int]
    """Indices of the frontiers that cannot be seen from any reachable place."""
    aside: list[int]
    """Indices of the frontiers set aside."""
    open: list[int]
    """Indices of those that are open floor, see `Limits`."""
    far: list[int]
    """Indices of those that are too far from the start."""
    vain: list[Vain]
    """What was looked at in vain so far, and is still to be seen."""
    robot: int | None
    """Index of the robot's coarse cell; None: no reachable floor."""
    distances: Distances
    """Costs of the ways from the robot to the coarse cells."""
    parents: Distances
    gaps: bool
    """Whether the floor is that to which the robot fits through gaps; else that of its circle."""


def survey(
    params: ExplorerParams, cells: Cells, resolution_m: float, origin: SE2, robot: SE2, home: SE2,
    before: Survey | None = None, set_aside_m: list[tuple[float, float]] | None = None,
) -> Survey:  # fmt: skip
    """What is to be seen from where the robot is: on the floor of its circle; once nothing is left
    there, also behind gaps that its outline fits through.

    Args:
        params: see ExplorerParams.
        cells: (rows, columns) int8 occupancy, 100 occupied, -1 unknown.
        resolution_m: side of a cell.
        origin: pose of the corner of cell (0, 0).
        robot: map_from_base.
        home: the start.
        before: the survey before this one.
        set_aside_m: (x, y) of targets that are not to be driven to.
    """
    args = (params, cells, resolution_m, origin, robot, home, before, set_aside_m or [])
    if before is not None and before.gaps:
        return _survey(*args, gaps=True)
    seen = _survey(*args, gaps=False)
    if seen.points or params.inscribed_radius >= params.robot_radius:
        return seen
    behind = _survey(*args, gaps=True)
    return behind if behind.points or behind.aside or seen.robot is None else seen


def _survey(
    params: ExplorerParams, cells: Cells, resolution_m: float, origin: SE2, robot: SE2, home: SE2,
    before: Survey | None, set_aside_m: list[tuple[float, float]], *, gaps: bool,
) -> Survey:  # fmt: skip
    floor = floor_from(
        cells, resolution_m, origin, robot, params.robot_radius, params.start_tolerance,
        params.inscribed_radius if gaps else None,
    )  # fmt: skip
    index = floor.coarse_index(robot.x_m, robot.y_m)
    if index is None:
        none = np.empty(0, np.int32)
        return Survey(floor, [], [], [], [], [], [], [], None, floor.prices, none, gaps)
    distances, parents = search(floor.prices, index)
    frontiers = find_frontiers(floor, params.min_frontier_size)
    range_m = params.max_range - _SEEN_BEFORE_M
    row = (robot.y_m - floor.origin_y_m) / floor.resolution_m - 0.5
    column = (robot.x_m - floor.origin_x_m) / floor.resolution_m - 0.5
    vain = [] if before is None else before.vain
    points, unseen, vain = view_points(
        floor, (row, column), distances, frontiers, params.view_clearance, range_m, vain
    )
    limits = Limits(params, floor, home)

    def is_aside(part: Part) -> bool:
        here = floor.center(*part.middle())
        return any(_distance_m(here, one) < _SAME_M for one in set_aside_m)

    points, open_ = _without(points, limits.is_open)
    points, far = _without(points, limits.is_far)
    points, aside = _without(points, is_aside)
    return Survey(
        floor, frontiers, points, unseen, aside, open_, far, vain, index, distances, parents, gaps
    )


def _without(
    points: list[ViewPoint], is_left_out: Callable[[Part], bool]
) -> tuple[list[ViewPoint], list[int]]:
    """The view points for the other parts, and the frontiers of which no part is left."""
    kept, left_out, wanted = [], set(), set()
    for point in points:
        parts = []
        for part in point.parts:
            if is_left_out(part):
                left_out.add(part.frontier)
            else:
                parts.append(part)
                wanted.add(part.frontier)
        if parts:
            kept.append(ViewPoint(point.index, point.cost, parts))
    return kept, sorted(left_out - wanted)


def _enclosed_first(params: ExplorerParams, seen: Survey) -> tuple[Survey, bool]:
    """With the view points for what has walls around it alone, if there is any; and whether there
    is none.
    """
    points, _ = _without(seen.points, lambda part: is_outdoors(seen.floor, part, params.max_range))
    return (replace(seen, points=points), False) if points else (seen, True)


def _outdoor_price_m(seen: Survey, number: int) -> float:
    """What it costs to begin with a view point outdoors, where no tour can be planned, as each look
    moves the frontiers on: what is near the robot and near what was seen comes first.
    """
    point, floor = seen.points[number], seen.floor
    apart_m = min(float(floor.clearance_m[part.middle()]) for part in point.parts)
    return floor.metres(point.cost) + apart_m


def aim(params: ExplorerParams, seen: Survey, home: SE2, current: Aim | None) -> Aim | None:
    """The next goal; None: nothing is left to see.

    Args:
        params: see ExplorerParams.
        seen: the map as it is.
        home: where the tour ends.
        current: the goal so far, which is kept unless another one is clearly better.
    """
    if seen.robot is None or not seen.points:
        return None
    if params.choice == "nearest":
        return _nearest_frontier(seen)
    robot = seen.robot
    seen, outdoors = _enclosed_first(params, seen)
    floor = seen.floor
    if outdoors:
        price: Callable[[int], float] = partial(_outdoor_price_m, seen)
    else:
        end = floor.coarse_index(home.x_m, home.y_m) if params.return_to_init else None
        price = Chooser(
            floor, robot, end, seen.points, params.choice, params.gain_scale,
            params.potential_scale,
        ).price  # fmt: skip
    best = min(range(len(seen.points)), key=price) if len(seen.points) > 1 else 0
    kept = None if current is None else _same(seen, current)
    if kept is not None and kept != best:
        margin = params.hysteresis * floor.metres(seen.points[kept].cost)
        if price(kept) - price(best) <= margin:
            best = kept
    chosen = _aim_at(seen, seen.points[best])
    if kept is None or current is None:
        return chosen
    if best == kept:
        return replace(chosen, left_m=current.left_m)
    if any(_distance_m(chosen.target_m, one) < _SAME_M for one in current.left_m):
        # Back to what was given up for this: to and fro for ever.
        return replace(_aim_at(seen, seen.points[kept]), left_m=current.left_m)
    return replace(chosen, left_m=(*current.left_m, current.target_m))


def is_left(seen: Survey, current: Aim) -> bool:
    """Whether there is a view point for what a goal is for."""
    return _same(seen, current) is not None


def still(seen: Survey, current: Aim) -> Aim:
    """A goal as it was, with the length of the way that is left."""
    index = seen.floor.coarse_index(current.pose.x_m, current.pose.y_m)
    assert index is not None
    return Aim(
        current.pose, current.target_m, seen.floor.metres(int(seen.distances.reshape(-1)[index]))
    )


def _nearest_frontier(seen: Survey) -> Aim:
    """The reachable place beside a frontier with the shortest way to it (Yamauchi, 1997)."""
    floor = seen.floor
    columns = int(floor.prices.shape[1])
    rows = int(floor.prices.shape[0])
    best: tuple[int, int, tuple[int, int]] | None = None
    for point in seen.points:
        for part in point.parts:
            for row, column in (part.cells // floor.factor).tolist():
                around = np.s_[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]
                costs = seen.distances[around]
                down, right = divmod(int(np.argmin(costs)), int(costs.shape[1]))
                r, c = max(row - 2, 0) + down, max(column - 2, 0) + right
                if r < rows and (best is None or int(costs[down, right]) < best[0]):
                    best = int(costs[down, right]), r * columns + c, part.middle()
    assert best is not None
    cost, index, target = best
    x_m, y_m = floor.center(*floor.stand(index))
    target_m = floor.center(*target)
    yaw_rad = portable.atan2(target_m[1] - y_m, target_m[0] - x_m)
    return Aim(SE2(x_m, y_m, yaw_rad), target_m, floor.metres(cost))


def _same(seen: Survey, current: Aim) -> int | None:
    """Index of the view point for what the current goal is for."""
    nearest, found = _SAME_M, None
    for number, point in enumerate(seen.points):
        for part in point.parts:
            away = _distance_m(seen.floor.center(*part.middle()), current.target_m)
            if away < nearest:
                nearest, found = away, number
    return found


def _aim_at(seen: Survey, point: ViewPoint) -> Aim:
    """The goal for a view point: on from there, towards what is to be seen."""
    floor = seen.floor
    target = floor.center(*point.parts[0].middle())
    columns = int(floor.prices.shape[1])
    most = round(_BEYOND_M / (floor.resolution_m * floor.factor) * 100.0)
    distances, parents = search(floor.prices, point.index, most)
    # Not back towards the robot.
    onward = seen.distances.reshape(-1) >= point.cost
    near = np.flatnonzero((distances.reshape(-1) < FAR) & onward)
    # In a gap the robot could not turn; what is seen only from there is come as near to as it may.
    clearances = floor.coarse_clearance_m.reshape(-1)
    in_gap = clearances[point.index] <= floor.radius_m
    if not in_gap:
        near = near[clearances[near] > floor.radius_m]
    places = [floor.stand(int(index)) for index in near]
    centers = np.array([floor.center(*place) for place in places])
    room = np.array([floor.room_m[place] for place in places])
    away = portable.hypot_each(centers[:, 0] - target[0], centers[:, 1] - target[1])
    # Not at a wall, nor where one may come into sight, only because it is a little nearer.
    tight = 0.0 if in_gap else np.maximum(_ROOM_M - room, 0.0) * 5.0
    best = int(np.argmin(away + tight))
    cells = way(seen.parents, point.index) + way(parents, int(near[best]))[1:]
    end = centers[best]
    back = max(len(cells) - 1 - round(_TURN_OVER_M / (floor.resolution_m * floor.factor)), 0)
    row, column = divmod(cells[back], columns)
    start = floor.center(
        row * floor.factor + (floor.factor - 1) / 2, column * floor.factor + (floor.factor - 1) / 2
    )
    dx, dy = float(end[0]) - start[0], float(end[1]) - start[1]
    if abs(dx) + abs(dy) < 0.05:
        dx, dy = target[0] - float(end[0]), target[1] - float(end[1])
    pose = SE2(float(end[0]), float(end[1]), portable.atan2(dy, dx))
    return Aim(pose, target, floor.metres(point.cost))


def _distance_m(one: tuple[float, float], other: tuple[float, float]) -> float:
    dx, dy = one[0] - other[0], one[1] - other[1]
    return float(np.sqrt(dx * dx + dy * dy))
