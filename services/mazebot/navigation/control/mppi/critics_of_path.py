"""MPPI's critics of the path and the goal."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.kernels import kernel
from mazebot.navigation.control.mppi.critic_params import (
    GoalAngleCriticParams,
    GoalCriticParams,
    PathAlignCriticParams,
    PathAngleCriticParams,
    PathFollowCriticParams,
)
from mazebot.navigation.control.mppi.critics import Scene
from mazebot.navigation.control.mppi.critics_of_motion import add_powered
from mazebot.navigation.control.mppi.rollouts import Floats


@kernel(error_model="numpy")
def travel(linear_m_s: Floats, step_s: np.float32, out: Floats) -> None:
    """(steps + 1, batch) length of each trajectory up to each point."""
    out[0] = np.float32(0.0)
    for k in range(1, linear_m_s.shape[0]):
        before, after, speed = out[k - 1], out[k], linear_m_s[k]
        for i in range(after.size):
            after[i] = before[i] + abs(speed[i]) * step_s


@kernel(error_model="numpy")
def furthest_reached(
    end_x: Floats,
    end_y: Floats,
    length_m: Floats,
    collides: NDArray[np.bool_],
    path_x: Floats,
    path_y: Floats,
    spacing_m: np.float32,
) -> int:
    """Largest index of the path point nearest to the end of a trajectory that does not collide,
    among the points within reach of the trajectory's length.
    """
    batch = end_x.size
    best = np.full(batch, np.float32(1e30))
    index = np.zeros(batch, np.int32)
    for j in range(path_x.size):
        px, py, at = path_x[j], path_y[j], np.int32(j)
        along = np.float32(j - 1) * spacing_m
        for i in range(batch):
            dx, dy = end_x[i] - px, end_y[i] - py
            square = dx * dx + dy * dy
            closer = (square < best[i]) & (along <= length_m[i])
            best[i] = square if closer else best[i]
            index[i] = at if closer else index[i]
    furthest = 0
    for i in range(batch):
        if not collides[i] and index[i] > furthest:
            furthest = index[i]
    return furthest


@kernel(error_model="numpy")
def _mean_distance(x: Floats, y: Floats, at_x: np.float32, at_y: np.float32, out: Floats) -> None:
    """Mean distance of all points of a trajectory from one place."""
    out[:] = np.float32(0.0)
    steps = x.shape[0] - 1
    for k in range(1, steps + 1):
        row_x, row_y = x[k], y[k]
        for i in range(out.size):
            dx, dy = row_x[i] - at_x, row_y[i] - at_y
            out[i] += np.float32(math.sqrt(dx * dx + dy * dy))
    share = np.float32(1.0) / np.float32(steps)
    for i in range(out.size):
        out[i] *= share


@kernel(error_model="numpy")
def _mean_angle(
    angular_rad_s: Floats, step_s: np.float32, wanted: np.float32, period: np.float32, out: Floats
) -> None:
    """Mean angle of all points of a trajectory from a heading, which is `wanted` from that now; a
    period of pi where the opposite heading is as good.
    """
    out[:] = np.float32(0.0)
    half = np.float32(0.5)
    steps = angular_rad_s.shape[0] - 1
    per = np.float32(1.0) / period
    turned = np.zeros(out.size, np.float32)
    for k in range(1, steps + 1):
        row = angular_rad_s[k]
        for i in range(out.size):
            turned[i] += row[i] * step_s
            turns = (turned[i] - wanted) * per
            out[i] += abs(turns - np.float32(math.floor(turns + half)))
    share = period / np.float32(steps)
    for i in range(out.size):
        out[i] *= share


@kernel(error_model="numpy")
def _mean_offset(
    x: Floats,
    y: Floats,
    travelled_m: Floats,
    path_x: Floats,
    path_y: Floats,
    path_free: NDArray[np.bool_],
    per_m: np.float32,
    last: int,
    step: int,
    out: Floats,
    count: Floats,
) -> None:
    """Mean distance between every `step`-th point of a trajectory and the path's point at the same
    length, where that is free.
    """
    out[:] = np.float32(0.0)
    count[:] = np.float32(0.0)
    zero, one = np.float32(0.0), np.float32(1.0)
    end, half = np.float32(last), np.float32(0.5)
    weight = np.empty(path_x.size, np.float32)
    for j in range(path_x.size):
        weight[j] = one if path_free[j] else zero
    for k in range(step, x.shape[0], step):
        row_x, row_y, along = x[k], y[k], travelled_m[k]
        for i in range(out.size):
            at = along[i] * per_m + half
            near = np.uint32(np.int32(at if at < end else end))
            dx, dy = row_x[i] - path_x[near], row_y[i] - path_y[near]
            out[i] += weight[near] * np.float32(math.sqrt(dx * dx + dy * dy))
            count[i] += weight[near]
    for i in range(out.size):
        out[i] /= count[i] if count[i] > zero else one


@kernel(error_model="numpy")
def _distance(x: Floats, y: Floats, at_x: np.float32, at_y: np.float32, out: Floats) -> None:
    for i in range(out.size):
        dx, dy = x[i] - at_x, y[i] - at_y
        out[i] = np.float32(math.sqrt(dx * dx + dy * dy))


@kernel(error_model="numpy")
def _bearing(
    x: Floats,
    y: Floats,
    cos_yaw: Floats,
    sin_yaw: Floats,
    at_x: float,
    at_y: float,
    either_way: bool,
    out: Floats,
) -> None:
    """Angle between a heading and the direction to a place."""
    for i in range(out.size):
        dx, dy = at_x - x[i], at_y - y[i]
        ahead = cos_yaw[i] * dx + sin_yaw[i] * dy
        aside = cos_yaw[i] * dy - sin_yaw[i] * dx
        ahead = abs(ahead) if either_way else ahead
        out[i] = abs(portable_kernels.atan2(aside, ahead))


class GoalCritic:
    """Mean distance from the goal."""

    def __init__(self, params: GoalCriticParams) -> None:
        self._params = params

    def score(self, scene: Scene) -> None:
        """See Critic."""
        p, values = self._params, np.empty_like(scene.costs)
        if scene.remaining_m >= p.threshold_to_consider:
            return
        rollouts = scene.rollouts
        goal = np.float32(scene.goal_x_m), np.float32(scene.goal_y_m)
        _mean_distance(rollouts.x_m, rollouts.y_m, *goal, values)
        add_powered(scene.costs, values, np.float32(p.cost_weight), p.cost_power)


class GoalAngleCritic:
    """Mean angle from the goal's heading."""

    def __init__(self, params: GoalAngleCriticParams) -> None:
        self._params = params

    def score(self, scene: Scene) -> None:
        """See Critic."""
        p, values = self._params, np.empty_like(scene.costs)
        if scene.remaining_m >= p.threshold_to_consider:
            return
        period = np.float32(math.pi if p.symmetric_yaw_tolerance else math.tau)
        _mean_angle(
            scene.rollouts.angular_rad_s, np.float32(scene.step_s),
            np.float32(scene.goal_turn_rad), period, values,
        )  # fmt: skip
        add_powered(scene.costs, values, np.float32(p.cost_weight), p.cost_power)


class PathAlignCritic:
    """Mean distance from the path's point at the same length."""

    def __init__(self, params: PathAlignCriticParams) -> None:
        self._params = params

    def score(self, scene: Scene) -> None:
        """See Critic."""
        p, values = self._params, np.empty_like(scene.costs)
        if scene.remaining_m <= p.threshold_to_consider:
            return
        last = scene.furthest
        if last < min(p.offset_from_furthest, len(scene.path_x_m) - 1):
            return
        blocked = int(np.count_nonzero(~scene.path_free[: last + 1]))
        if blocked > p.max_path_occupancy_ratio * (last + 1):
            return
        rollouts = scene.rollouts
        _mean_offset(
            rollouts.x_m, rollouts.y_m, scene.travelled_m, scene.path_x_m, scene.path_y_m,
            scene.path_free, np.float32(1.0 / scene.spacing_m), last, p.trajectory_point_step,
            values, np.empty_like(values),
        )  # fmt: skip
        add_powered(scene.costs, values, np.float32(p.cost_weight), p.cost_power)


class PathFollowCritic:
    """Distance of the last point from the path's point a little beyond the furthest reached."""

    def __init__(self, params: PathFollowCriticParams) -> None:
        self._params = params

    def score(self, scene: Scene) -> None:
        """See Critic."""
        p, values = self._params, np.empty_like(scene.costs)
        if scene.remaining_m <= p.threshold_to_consider:
            return
        last = len(scene.path_x_m) - 1
        index = min(scene.furthest + p.offset_from_furthest, last)
        while index < last and not scene.path_free[index]:
            index += 1
        rollouts = scene.rollouts
        target = scene.path_x_m[index], scene.path_y_m[index]
        _distance(rollouts.x_m[-1], rollouts.y_m[-1], *target, values)
        add_powered(scene.costs, values, np.float32(p.cost_weight), p.cost_power)


class PathAngleCritic:
    """Angle of the last heading from the direction of the path, where the robot looks away."""

    def __init__(self, params: PathAngleCriticParams) -> None:
        self._params = params

    def score(self, scene: Scene) -> None:
        """See Critic."""
        p, values = self._params, np.empty_like(scene.costs)
        if scene.remaining_m <= p.threshold_to_consider:
            return
        index = min(scene.furthest + p.offset_from_furthest, len(scene.path_x_m) - 1)
        target = float(scene.path_x_m[index]), float(scene.path_y_m[index])
        rollouts = scene.rollouts
        here = np.empty(1, np.float32)
        x, y, c, s = rollouts.x_m, rollouts.y_m, rollouts.cos_yaw, rollouts.sin_yaw
        either_way = p.mode == 1
        _bearing(x[0, :1], y[0, :1], c[0, :1], s[0, :1], *target, either_way, here)
        if float(here[0]) <= p.max_angle_to_furthest:
            return
        _bearing(x[-1], y[-1], c[-1], s[-1], *target, either_way, values)
        add_powered(scene.costs, values, np.float32(p.cost_weight), p.cost_power)
