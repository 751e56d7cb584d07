"""MPPI's critics of obstacles: those of the costmap and the scan, and those that move."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.kernels import kernel
from mazebot.navigation.control.mppi.clearance_window import CELL_M
from mazebot.navigation.control.mppi.critic_params import (
    CostCriticParams,
    MovingObstaclesCriticParams,
    ObstaclesCriticParams,
)
from mazebot.navigation.control.mppi.critics import Scene
from mazebot.navigation.control.mppi.critics_of_motion import add_powered
from mazebot.navigation.control.mppi.rollouts import Floats, Rollouts

_SLACK_M = 0.003
"""A robot that touches an obstacle may come nearer by this: the window is no finer."""
_CONTACT_M = 0.005
_NEARER_M = 0.01


@kernel(error_model="numpy")
def _cell_of(
    x: Floats,
    y: Floats,
    cos_yaw: Floats,
    sin_yaw: Floats,
    ahead: np.float32,
    aside: np.float32,
    low_m: np.float32,
    per_m: np.float32,
    size: np.int32,
    out: NDArray[np.int32],
) -> None:
    """Index in the window of a point fixed on the robot, for each pose."""
    zero, last = np.float32(0.0), np.float32(size - 1)
    a, b = ahead * per_m, aside * per_m
    for i in range(out.size):
        column = (x[i] - low_m) * per_m + cos_yaw[i] * a - sin_yaw[i] * b
        row = (y[i] - low_m) * per_m + sin_yaw[i] * a + cos_yaw[i] * b
        column = column if column > zero else zero
        column = column if column < last else last
        row = row if row > zero else zero
        row = row if row < last else last
        out[i] = np.int32(row) * size + np.int32(column)


@kernel(error_model="numpy")
def _nearer(
    cells: NDArray[np.int32], distance_m: Floats, radius_m: np.float32, out: Floats
) -> None:
    for i in range(out.size):
        here = distance_m[np.uint32(cells[i])] - radius_m
        out[i] = here if here < out[i] else out[i]


@kernel(error_model="numpy")
def clearance_at_step(
    x: Floats,
    y: Floats,
    cos_yaw: Floats,
    sin_yaw: Floats,
    discs: Floats,
    distance_m: Floats,
    low_m: np.float32,
    size: np.int32,
    cells: NDArray[np.int32],
    out: Floats,
) -> None:
    """(batch,) least distance of the discs from an obstacle, for each pose of one step."""
    out[:] = np.float32(1e9)
    per_m = np.float32(1.0 / CELL_M)
    for j in range(discs.shape[0]):
        ahead, aside = discs[j, 0], discs[j, 1]
        _cell_of(x, y, cos_yaw, sin_yaw, ahead, aside, low_m, per_m, size, cells)
        _nearer(cells, distance_m, discs[j, 2], out)


@kernel(error_model="numpy")
def _add_cost(
    clearance_m: Floats,
    fall_per_m: np.float32,
    near_weight: np.float32,
    margin_m: np.float32,
    critical: np.float32,
    least_m: Floats,
    values: Floats,
) -> None:
    """Add exp(-fall * clearance) * near_weight, or `critical` within the margin.

    The exponential is (1 + z/8 + (z/8)^2/2 + (z/8)^3/6)^-8, within 1 % up to z = 4.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    eighth, half, third = np.float32(0.125), np.float32(0.5), np.float32(1.0 / 3.0)
    for i in range(values.size):
        here = clearance_m[i]
        least_m[i] = here if here < least_m[i] else least_m[i]
        z = here * fall_per_m
        z = (z if z > zero else zero) * eighth
        grown = one + z * (one + z * half * (one + z * third))
        grown *= grown
        grown *= grown
        grown *= grown
        soft = near_weight / grown
        values[i] += critical if here < margin_m else soft


@kernel(error_model="numpy")
def _add_repulsion(
    clearance_m: Floats,
    reach_m: np.float32,
    repulsion: np.float32,
    margin_m: np.float32,
    critical: np.float32,
    least_m: Floats,
    values: Floats,
) -> None:
    zero = np.float32(0.0)
    for i in range(values.size):
        here = clearance_m[i]
        least_m[i] = here if here < least_m[i] else least_m[i]
        inner = margin_m - here
        outer = reach_m - here
        outer = outer if outer > zero else zero
        values[i] += critical * inner if inner > zero else repulsion * outer


@kernel(error_model="numpy")
def _near_obstacles(
    rollouts: Rollouts,
    point_step: int,
    discs: Floats,
    distance_m: Floats,
    low_m: np.float32,
    size: np.int32,
    repels: bool,
    fall_or_reach: np.float32,
    weight: np.float32,
    margin_m: np.float32,
    critical: np.float32,
    least_m: Floats,
    values: Floats,
) -> None:
    """Add what each step costs by its clearance: a repulsion, or else a cost that falls."""
    clearance = np.empty(values.size, np.float32)
    cells = np.empty(values.size, np.int32)
    _, _, x, y, c, s = rollouts
    for k in range(point_step, x.shape[0], point_step):
        clearance_at_step(x[k], y[k], c[k], s[k], discs, distance_m, low_m, size, cells, clearance)
        if repels:
            _add_repulsion(clearance, fall_or_reach, weight, margin_m, critical, least_m, values)
        else:
            _add_cost(clearance, fall_or_reach, weight, margin_m, critical, least_m, values)


@kernel(error_model="numpy")
def sequence_clearance_m(
    rollouts: Rollouts,
    steps: int,
    discs: Floats,
    distance_m: Floats,
    low_m: np.float32,
    size: np.int32,
) -> float:
    """Least clearance of a single rollout (steps + 1, 1) in its first steps."""
    clearance = np.empty(1, np.float32)
    cells = np.empty(1, np.int32)
    _, _, x, y, c, s = rollouts
    least = 1e9
    for k in range(1, steps + 1):
        clearance_at_step(x[k], y[k], c[k], s[k], discs, distance_m, low_m, size, cells, clearance)
        least = min(least, np.float64(clearance[0]))
    return least


@kernel(error_model="numpy")
def _mark_collisions(
    least_m: Floats,
    limit_m: np.float32,
    cost: np.float32,
    costs: Floats,
    collides: NDArray[np.bool_],
) -> int:
    """Add the cost of a collision where the clearance is below a limit; how many are free."""
    free = 0
    for i in range(costs.size):
        hit = least_m[i] < limit_m
        collides[i] = collides[i] or hit
        costs[i] += cost if hit else np.float32(0.0)
        free += 0 if collides[i] else 1
    return free


def contact_limit_m(start_clearance_m: float) -> float:
    """Clearance below which a pose collides: a robot that touches already may leave."""
    return min(_CONTACT_M, start_clearance_m - _SLACK_M)


class CostCritic:
    """Nearness of the footprint to obstacles."""

    def __init__(self, params: CostCriticParams) -> None:
        self._params = params

    def score(self, scene: Scene) -> None:
        """See Critic."""
        p = self._params
        margin_m = min(p.collision_margin_distance, scene.start_clearance_m - _SLACK_M)
        # As in Nav2, whose weight is divided by the cost of a lethal cell.
        share = p.cost_weight / 254.0
        near = _Nearness(False, p.cost_scaling_factor, 252.0, margin_m, p.critical_cost, share)
        _score_nearness(scene, p, near)


class ObstaclesCritic:
    """Repulsion from obstacles by their distance."""

    def __init__(self, params: ObstaclesCriticParams) -> None:
        self._params = params

    def score(self, scene: Scene) -> None:
        """See Critic."""
        p = self._params
        near = _Nearness(
            True, p.inflation_radius, p.repulsion_weight, p.collision_margin_distance,
            p.critical_weight, 1.0,
        )  # fmt: skip
        _score_nearness(scene, p, near)


class _Nearness(NamedTuple):
    """What nearness to obstacles costs."""

    repels: bool
    fall_or_reach: float
    weight: float
    margin_m: float
    critical: float
    share: float
    """Of the sum over the steps of a rollout, divided by their number"""


def _score_nearness(
    scene: Scene, params: CostCriticParams | ObstaclesCriticParams, near: _Nearness
) -> None:
    """Add what each rollout costs by its clearances, and mark those that collide."""
    step, batch = params.trajectory_point_step, scene.costs.size
    values, least = np.zeros(batch, np.float32), np.full(batch, 1e9, np.float32)
    near_goal = math.hypot(scene.goal_x_m, scene.goal_y_m) < params.near_goal_distance
    _near_obstacles(
        scene.rollouts, step, scene.discs, scene.window.distance_m, scene.window.low_m,
        np.int32(scene.window.size), near.repels, np.float32(near.fall_or_reach),
        np.float32(0.0 if near_goal else near.weight), np.float32(near.margin_m),
        np.float32(near.critical), least, values,
    )  # fmt: skip
    count = max((len(scene.rollouts.x_m) - 1) // step, 1)
    add_powered(scene.costs, values, np.float32(near.share / count), params.cost_power)
    limit = np.float32(contact_limit_m(scene.start_clearance_m))
    hit = np.float32(params.collision_cost)
    free = _mark_collisions(least, limit, hit, scene.costs, scene.collides)
    scene.failed = scene.failed or free == 0


@kernel(error_model="numpy")
def _meet(
    x: Floats,
    y: Floats,
    cos_yaw: Floats,
    sin_yaw: Floats,
    ahead: np.float32,
    aside: np.float32,
    at_x: np.float32,
    at_y: np.float32,
    radius_m: np.float32,
    margin_m: np.float32,
    meeting_cost: np.float32,
    nearness: Floats,
    meeting: Floats,
) -> None:
    """Add how far the robot's middle is inside the margin; keep the highest cost of a meeting."""
    zero = np.float32(0.0)
    for i in range(nearness.size):
        dx = x[i] + cos_yaw[i] * ahead - sin_yaw[i] * aside - at_x
        dy = y[i] + sin_yaw[i] * ahead + cos_yaw[i] * aside - at_y
        away = np.float32(math.sqrt(dx * dx + dy * dy)) - radius_m
        inside = margin_m - away
        nearness[i] += inside if inside > zero else zero
        cost = meeting_cost if away < zero else zero
        meeting[i] = cost if cost > meeting[i] else meeting[i]


@kernel(error_model="numpy")
def _meetings(
    rollouts: Rollouts,
    point_step: int,
    step_s: float,
    prediction_s: float,
    tracks: Floats,
    ahead: np.float32,
    aside: np.float32,
    reach_m: float,
    growth_m_s: float,
    margin_m: np.float32,
    collision_cost: float,
    nearness: Floats,
    meeting: Floats,
) -> None:
    _, _, x, y, c, s = rollouts
    steps = x.shape[0] - 1
    # A robot that is too near already may leave.
    start_m = np.empty(tracks.shape[0], np.float32)
    for j in range(tracks.shape[0]):
        dx = x[0, 0] + c[0, 0] * ahead - s[0, 0] * aside - tracks[j, 0]
        dy = y[0, 0] + s[0, 0] * ahead + c[0, 0] * aside - tracks[j, 1]
        start_m[j] = math.sqrt(dx * dx + dy * dy) - _NEARER_M
    for k in range(point_step, steps + 1, point_step):
        t = min(k * step_s, prediction_s)
        cost = np.float32(collision_cost * (1.0 - 0.8 * k / steps))
        for j in range(tracks.shape[0]):
            # At a wall it turns back.
            onward = t if t < tracks[j, 5] else max(2.0 * tracks[j, 5] - t, 0.0)
            at_x = np.float32(tracks[j, 0] + tracks[j, 2] * onward)
            at_y = np.float32(tracks[j, 1] + tracks[j, 3] * onward)
            radius = np.float32(tracks[j, 4] + reach_m + growth_m_s * t)
            radius = min(radius, start_m[j])
            _meet(
                x[k], y[k], c[k], s[k], ahead, aside, at_x, at_y, radius, margin_m, cost,
                nearness, meeting,
            )  # fmt: skip


@kernel(error_model="numpy")
def _add_meetings(costs: Floats, meeting: Floats, collides: NDArray[np.bool_]) -> None:
    for i in range(costs.size):
        costs[i] += meeting[i]
        collides[i] = collides[i] or meeting[i] > np.float32(0.0)


class MovingObstaclesCritic:
    """Where tracked obstacles will be: a meeting costs the more the sooner it is, so that a robot
    that cannot avoid one delays it.
    """

    def __init__(self, params: MovingObstaclesCriticParams) -> None:
        self._params = params

    def score(self, scene: Scene) -> None:
        """See Critic."""
        if not len(scene.tracks):
            return
        p, rollouts = self._params, scene.rollouts
        batch = scene.costs.size
        nearness, meeting = np.zeros(batch, np.float32), np.zeros(batch, np.float32)
        steps = len(rollouts.x_m) - 1
        ahead, aside = scene.discs[0, 0], scene.discs[0, 1]
        _meetings(
            rollouts, p.trajectory_point_step, scene.step_s, p.prediction_time, scene.tracks,
            ahead, aside, _reach_m(scene.discs), p.radius_growth, np.float32(p.margin_distance),
            p.collision_cost, nearness, meeting,
        )  # fmt: skip
        share = np.float32(
            p.cost_weight * p.margin_weight / max(steps // p.trajectory_point_step, 1)
        )
        add_powered(scene.costs, nearness, share, p.cost_power)
        _add_meetings(scene.costs, meeting, scene.collides)


def _reach_m(discs: Floats) -> float:
    """Radius about the middle disc's centre that contains all discs."""
    away_m = [
        math.hypot(x - discs[0, 0], y - discs[0, 1]) + radius for x, y, radius in discs.tolist()
    ]
    return float(max(away_m))
