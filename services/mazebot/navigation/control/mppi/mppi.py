"""Model predictive path integral control (Williams et al., ICRA 2017), with Nav2's critics.

In every period some two thousand control sequences near the last best one are rolled out and
judged, and their mean, weighted by how cheap each is, becomes the new sequence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mazebot.common.config import ConfigError
from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.navigation.control.collision import STOP, Surroundings, Velocity, first_contact_s
from mazebot.navigation.control.controller import ControllerParams, Robot
from mazebot.navigation.control.mppi.clearance_window import CELL_M, ClearanceWindow, covering_discs
from mazebot.navigation.control.mppi.critic_params import MPPIParams
from mazebot.navigation.control.mppi.critic_table import critics_in_order
from mazebot.navigation.control.mppi.critics import Critic, Scene
from mazebot.navigation.control.mppi.critics_of_motion import ConstraintCritic
from mazebot.navigation.control.mppi.critics_of_obstacles import (
    clearance_at_step,
    contact_limit_m,
    sequence_clearance_m,
)
from mazebot.navigation.control.mppi.critics_of_path import furthest_reached, travel
from mazebot.navigation.control.mppi.rollouts import (
    HISTORY,
    SAVITZKY_GOLAY,
    Floats,
    Limits,
    Rollouts,
    add_control_cost,
    correlated_noise,
    roll_out,
    smooth,
    softmax,
    weighted_mean,
)
from mazebot.navigation.control.path_follower import BRAKES, SLOWEST_M_S, PathFollower
from mazebot.navigation.control.path_handler import LocalPath
from mazebot.navigation.planning.path import PlannedPath

_PATH_SPACING_M = 0.05
_BANK = 4
"""The bank of noise is this many times as wide as a batch; each step takes another part of it."""
_ALIGNED_RAD = 0.2
"""A turn on the spot that has started continues until the heading error is this small."""
_CANDIDATES: tuple[tuple[float, float], ...] = tuple(
    (v, w) for v in (1.0, 0.6, 0.3, 0.0, -0.5) for w in (0.0, 0.2, -0.2, 0.5, -0.5, 0.9, -0.9)
)
"""Constant controls tried in every period, as shares of the highest: a stop, turns on the spot and
arcs, to which noise about the last sequence alone may not lead.
"""


@dataclass(frozen=True, slots=True)
class Trajectories:
    """Some rollouts of a period, for drawing, the cheapest first."""

    points_m: Array
    """(n, steps + 1, 2) in the map frame."""
    costs: Array
    """(n,)."""
    optimal_m: Array
    """(steps + 1, 2), where the chosen control sequence leads."""


class MPPIController(PathFollower):
    """Follows paths by sampling."""

    Params: ClassVar[type[ControllerParams]] = MPPIParams

    def __init__(self, params: MPPIParams, robot: Robot, random: np.random.Generator) -> None:
        robot = _within(params, robot)
        super().__init__(
            robot, params.rotate_to_heading_angular_vel, params.rotate_to_heading_decel
        )
        if robot.control_period_s > params.model_dt + 1e-9:
            period = f"the control period of {robot.control_period_s} s"
            raise ConfigError(f"mppi: model_dt: must be at least {period} (got {params.model_dt})")
        self._params = params
        self._shifts = abs(robot.control_period_s - params.model_dt) < 1e-9
        """Each period uses up one element of the sequence."""
        self._random = random
        self._batch = params.batch_size
        self._discs = covering_discs(robot.footprint)
        horizon_s = params.time_steps * params.model_dt
        reach_m = max(params.vx_max, -params.vx_min) * horizon_s
        self._window = ClearanceWindow(reach_m + robot.footprint.circumscribed_radius_m + 0.1)
        self._robot_limits = self._limits = _limits(params, robot)
        self._critics = _critics(params)
        highest = np.array([params.vx_max, params.wz_max])
        self._constant = np.asarray(np.array(_CANDIDATES) * highest, np.float32)
        self._noise = self._new_noise()
        self._one = Rollouts.empty(params.time_steps, 1)
        self._still = (np.zeros((params.time_steps, 1), np.float32),) * 2
        self._none = np.zeros((0, 2), np.float32)
        self._turning = False
        self.shortfalls = 0
        """How often the batch was made smaller, see `batch_size`."""
        self._origin: tuple[float, float] | None
        """Where the rollouts of the last period begin; None: it had none."""
        self._resize(self._batch)
        self._begin()

    @property
    def batch_size(self) -> int:
        """Number of trajectories. The caller makes it smaller where control periods are missed,
        which `shortfalls` counts, and larger again later. How long a step takes must not change
        what it computes where none is missed.
        """
        return self._batch

    @batch_size.setter
    def batch_size(self, value: int) -> None:
        size = min(max(value, 2 * len(_CANDIDATES)), self._params.batch_size)
        if size < self._batch:
            self.shortfalls += 1
        if size != self._batch:
            self._resize(size)

    def _resize(self, size: int) -> None:
        self._batch = size
        steps = self._params.time_steps
        self._rollouts = Rollouts.empty(steps, size)
        self._travelled = np.zeros((steps + 1, size), np.float32)
        self._costs = np.zeros(size, np.float32)
        self._collides = np.zeros(size, np.bool_)
        self._weights = np.zeros(size)
        self._chosen = np.zeros(size, np.int64)

    def _new_noise(self) -> tuple[Floats, Floats]:
        p = self._params
        columns = self._params.batch_size * _BANK
        linear, angular = (
            correlated_noise(self._random, p.time_steps, columns, std, p.noise_correlation)
            for std in (p.vx_std, p.wz_std)
        )
        return linear, angular

    def _begin(self) -> None:
        steps = self._params.time_steps
        self._linear, self._angular = np.zeros(steps, np.float32), np.zeros(steps, np.float32)
        self._history: list[Velocity] = [STOP] * HISTORY
        self._since_optimised = self._params.periods_per_optimisation
        """Periods that the sequence was used for; it begins as used up."""
        self._turning = False
        self._origin = None

    def take_over(self, velocity: Velocity, index: int = 0, xy_reached: bool = False) -> None:
        """See TakesOver. The sequence begins as going on at that velocity."""
        super().take_over(velocity, index, xy_reached)
        self._linear[:], self._angular[:] = velocity
        self._history = [velocity] * HISTORY

    def _drive(
        self, elapsed_s: float, around: Surroundings, path: PlannedPath
    ) -> tuple[Velocity, bool]:
        p = self._params
        local = self._handler.local(path, around.map_from_base, _PATH_SPACING_M)
        turned = self._turn_to_path(elapsed_s, around, local)
        if turned is not None:
            self._origin = None
            self._remember(turned)
            return turned, False
        limit_m_s = min(around.speed_limit_m_s, self._stopping_m_s(local))
        if self._since_optimised < p.periods_per_optimisation and not (
            around.tracks or around.turning
        ):
            # Shifted, it is still the best that is known: no newer scan has come.
            velocity = self._from_sequence(elapsed_s, limit_m_s)
            if self._can_stop(around, velocity):
                self._remember(velocity)
                return velocity, False
        start = self._velocity
        if not p.open_loop and around.velocity is not None:
            start = self._robot.limited(around.velocity, self._velocity, elapsed_s)
        self._origin = around.map_from_base[:2]
        self._limits = self._limits_at(limit_m_s)
        self._window.update(around, without_tracks=p.prediction)
        for attempt in range(1 + p.retry_attempt_limit):
            if attempt:
                # Around a standstill: a sequence that collides leads nowhere.
                self._linear[:] = self._angular[:] = 0.0
            if self._optimise(start, around, local):
                velocity = self._from_sequence(elapsed_s, limit_m_s)
                if self._can_stop(around, velocity):
                    self._since_optimised = 0
                    self._remember(velocity)
                    return velocity, False
        self._begin()
        velocity = self._robot.limited(STOP, self._velocity, elapsed_s)
        return velocity, True

    def _from_sequence(self, elapsed_s: float, speed_limit_m_s: float) -> Velocity:
        # The limit may be lower than that of the place where the sequence was found.
        linear = min(max(float(self._linear[0]), -speed_limit_m_s), speed_limit_m_s)
        wanted = Velocity(linear, float(self._angular[0]))
        return self._robot.limited(wanted, self._velocity, elapsed_s)

    def _stopping_m_s(self, local: LocalPath) -> float:
        """The highest speed from which the robot can brake before its path ends, where it brakes
        for much of the time that the rollouts last: too few of them show that it passes the end.
        """
        decel, highest_m_s = self._robot.max_linear_decel, self._robot.limits.max_linear_vel
        if highest_m_s <= 0.25 * decel * self._params.time_steps * self._params.model_dt:
            return math.inf
        return max(math.sqrt(2.0 * BRAKES * decel * local.remaining_m), SLOWEST_M_S)

    def _limits_at(self, speed_limit_m_s: float) -> Limits:
        """The robot's limits below that of the place; a robot that is faster brakes."""
        limits = self._robot_limits
        highest = np.float32(max(speed_limit_m_s, 0.0))
        return limits._replace(
            linear_max_m_s=min(limits.linear_max_m_s, highest),
            linear_min_m_s=max(limits.linear_min_m_s, -highest),
        )

    def _remember(self, velocity: Velocity) -> None:
        """Shift the sequence by the period that the command is for."""
        self._history = [*self._history[1:], velocity]
        self._since_optimised += 1
        if not self._shifts:
            return
        for sequence in (self._linear, self._angular):
            sequence[:-1] = sequence[1:]

    def _turn_to_path(
        self, elapsed_s: float, around: Surroundings, local: LocalPath
    ) -> Velocity | None:
        """A turn on the spot towards the path, where the robot looks away from it and is slow."""
        p, pose = self._params, around.map_from_base
        target = local.points_m[min(6, len(local.points_m) - 1)]
        there = pose.inverse() @ SE2(float(target[0]), float(target[1]), 0.0)
        away_rad = portable.atan2(there.y_m, there.x_m)
        limit = p.rotate_to_heading_min_angle
        if self._turning:
            limit = min(limit, _ALIGNED_RAD)
        slow = abs(self._velocity.linear_m_s) < 0.15
        near_goal = local.ends and local.remaining_m < 0.15
        self._turning = abs(away_rad) > limit and slow and not near_goal
        if not self._turning:
            return None
        velocity, blocked = self._turn(elapsed_s, around, away_rad)
        if blocked:
            self._turning = False
            return None
        self._linear[:], self._angular[:] = 0.0, 0.0
        self._since_optimised = self._params.periods_per_optimisation
        return velocity

    def _optimise(self, start: Velocity, around: Surroundings, local: LocalPath) -> bool:
        """Improve the sequence; whether it stays free of collisions."""
        p, scene = self._params, None
        for _ in range(p.iteration_count):
            self._roll_out(start, around.map_from_base.yaw_rad)
            scene = self._scene(around, local)
            for name, critic in self._critics:
                if name == "GoalCritic":
                    self._set_furthest(scene)
                if critic is not None:
                    critic.score(scene)
                if scene.failed:
                    return False
            self._update()
        return scene is not None and self._is_valid(start, around, scene)

    def _roll_out(self, start: Velocity, yaw_rad: float) -> None:
        p, rollouts, size = self._params, self._rollouts, self._batch
        if p.regenerate_noises:
            self._noise = self._new_noise()
        _set_start(rollouts, start, yaw_rad)
        first = int(self._random.integers(0, p.batch_size * _BANK - size))
        roll_out(
            self._linear, self._angular, *self._noise, first, self._constant, self._limits, rollouts
        )

    def _scene(self, around: Surroundings, local: LocalPath) -> Scene:
        pose, window, goal = around.map_from_base, self._window, local.goal
        self._costs[:] = 0.0
        self._collides[:] = False
        ahead_m = np.asarray(local.points_m - np.array(pose[:2]), np.float32)
        path_x, path_y = (np.ascontiguousarray(column) for column in ahead_m.T)
        return Scene(
            rollouts=self._rollouts,
            step_s=self._params.model_dt,
            costs=self._costs,
            collides=self._collides,
            path_x_m=path_x,
            path_y_m=path_y,
            path_free=_free(window, ahead_m, self._robot.footprint.half_width_m),
            spacing_m=local.spacing_m,
            remaining_m=local.remaining_m if local.leads_away else math.inf,
            goal_x_m=goal.x_m - pose.x_m,
            goal_y_m=goal.y_m - pose.y_m,
            goal_turn_rad=wrap_angle(goal.yaw_rad - pose.yaw_rad),
            window=window,
            discs=self._discs,
            start_clearance_m=float(self._clearances(self._rollouts, slice(0, 1), 0)[0]),
            tracks=self._moving(around),
            travelled_m=self._travelled,
        )

    def _moving(self, around: Surroundings) -> Floats:
        p = self._params
        if not p.prediction:
            return np.empty((0, 6), np.float32)
        return _tracks(around, self._window, p.time_steps * p.model_dt)

    def _set_furthest(self, scene: Scene) -> None:
        rollouts = scene.rollouts
        travel(rollouts.linear_m_s, np.float32(scene.step_s), scene.travelled_m)
        scene.furthest = int(
            furthest_reached(
                rollouts.x_m[-1], rollouts.y_m[-1], scene.travelled_m[-1], scene.collides,
                scene.path_x_m, scene.path_y_m, np.float32(scene.spacing_m),
            )
        )  # fmt: skip

    def _clearances(self, rollouts: Rollouts, columns: slice, step: int) -> Floats:
        """(n,) clearance of some rollouts at one step."""
        x = rollouts.x_m[step, columns]
        out, cells = np.empty(x.size, np.float32), np.empty(x.size, np.int32)
        clearance_at_step(
            x, rollouts.y_m[step, columns], rollouts.cos_yaw[step, columns],
            rollouts.sin_yaw[step, columns], self._discs, self._window.distance_m,
            self._window.low_m, np.int32(self._window.size), cells, out,
        )  # fmt: skip
        return out

    def _update(self) -> None:
        """Replace the sequence by the weighted mean of the speeds of all rollouts."""
        p, rollouts, costs = self._params, self._rollouts, self._costs
        # The inverse covariance of noise with this correlation, for sustained deviations.
        gamma = p.gamma * (1.0 - p.noise_correlation) / (1.0 + p.noise_correlation)
        for values, mean, std in (
            (rollouts.linear_m_s, self._linear, p.vx_std),
            (rollouts.angular_rad_s, self._angular, p.wz_std),
        ):
            add_control_cost(costs, values, mean, np.float32(gamma / (std * std)))
        self._best = int(softmax(costs, p.temperature, self._weights))
        weighted_mean(rollouts.linear_m_s, self._weights, self._linear, self._chosen)
        weighted_mean(rollouts.angular_rad_s, self._weights, self._angular, self._chosen)
        if p.sgf_order:
            past = np.array(self._history, np.float32)
            smooth(self._linear, np.ascontiguousarray(past[:, 0]), SAVITZKY_GOLAY)
            smooth(self._angular, np.ascontiguousarray(past[:, 1]), SAVITZKY_GOLAY)

    def _is_valid(self, start: Velocity, around: Surroundings, scene: Scene) -> bool:
        """Whether the sequence is free of collisions; the mean of one trajectory to the left of an
        obstacle and one to its right may not be: then the best single one is taken.
        """
        free = self._follows_free(start, around, scene)
        if not free and not self._collides[self._best]:
            self._linear[:] = self._rollouts.linear_m_s[1:, self._best]
            self._angular[:] = self._rollouts.angular_rad_s[1:, self._best]
            free = self._follows_free(start, around, scene)
        return free

    def _follows_free(self, start: Velocity, around: Surroundings, scene: Scene) -> bool:
        p, one = self._params, self._one
        _set_start(one, start, around.map_from_base.yaw_rad)
        roll_out(self._linear, self._angular, *self._still, 0, self._none, self._limits, one)
        steps = min(round(p.collision_lookahead_time / p.model_dt), p.time_steps)
        clearance_m = sequence_clearance_m(
            one, steps, self._discs, self._window.distance_m, self._window.low_m,
            np.int32(self._window.size),
        )  # fmt: skip
        return bool(clearance_m >= contact_limit_m(scene.start_clearance_m))

    def _can_stop(self, around: Surroundings, velocity: Velocity) -> bool:
        """Whether the command stays free for as long as braking takes, exactly and with the scan
        itself.
        """
        robot = self._robot
        horizon_s = 2.0 * robot.control_period_s + max(
            abs(velocity.linear_m_s) / robot.max_linear_decel,
            0.5 * abs(velocity.angular_rad_s) / robot.limits.max_angular_accel,
        )
        return first_contact_s(around, velocity, 0.6 * horizon_s) == math.inf

    def trajectories(self, count: int = 30) -> Trajectories | None:
        """Rollouts of the last period, for drawing: the cheapest, the dearest, and between them
        evenly by their rank. None where it had none.
        """
        if self._origin is None:
            return None
        ranks = np.linspace(0, self._batch - 1, min(count, self._batch)).astype(np.int64)
        order = np.argsort(self._costs, kind="stable")[ranks]
        rollouts, one = self._rollouts, self._one
        at = np.array(self._origin)
        points = np.stack([rollouts.x_m[:, order].T, rollouts.y_m[:, order].T], axis=-1)
        optimal = np.stack([one.x_m[:, 0], one.y_m[:, 0]], axis=-1)
        return Trajectories(
            points.astype(np.float64) + at,
            self._costs[order].astype(np.float64),
            optimal.astype(np.float64) + at,
        )


def _within(params: MPPIParams, robot: Robot) -> Robot:
    """A robot that does not go beyond the parameters' limits, nor beyond its own."""
    limits = robot.limits
    own = {
        "max_linear_vel": min(params.vx_max, limits.max_linear_vel),
        "max_angular_vel": min(params.wz_max, limits.max_angular_vel),
        "max_linear_accel": min(params.ax_max, limits.max_linear_accel),
        "max_angular_accel": min(params.az_max, limits.max_angular_accel),
    }
    return replace(
        robot,
        limits=limits.model_copy(update=own),
        backward_m_s=min(-params.vx_min, robot.max_backward_vel),
        linear_decel_m_s2=min(-params.ax_min, robot.max_linear_decel),
    )


def _limits(params: MPPIParams, robot: Robot) -> Limits:
    """Of the rollouts."""
    dt, limits = params.model_dt, robot.limits
    return Limits(
        np.float32(-robot.max_backward_vel),
        np.float32(limits.max_linear_vel),
        np.float32(limits.max_angular_vel),
        np.float32(limits.max_linear_accel * dt),
        np.float32(robot.max_linear_decel * dt),
        np.float32(limits.max_angular_accel * dt),
        np.float32(dt),
    )


def _critics(params: MPPIParams) -> tuple[tuple[str, Critic | None], ...]:
    """Those that are used, by name; None in the place of a goal critic that is not."""
    made: list[tuple[str, Critic | None]] = []
    for name, critic in critics_in_order():
        own = getattr(params, name)
        if not own.enabled:
            if name == "GoalCritic":
                made.append((name, None))
        elif critic is ConstraintCritic:
            made.append((name, ConstraintCritic(own, params.vx_min, params.vx_max)))
        else:
            made.append((name, critic(own)))
    return tuple(made)


def _set_start(rollouts: Rollouts, start: Velocity, yaw_rad: float) -> None:
    c, s = portable.cos_sin(yaw_rad)
    values = (*start, 0.0, 0.0, c, s)
    for array, value in zip(rollouts, values, strict=True):
        array[0] = value


def _free(window: ClearanceWindow, points_m: Floats, half_width_m: float) -> NDArray[np.bool_]:
    """(n,) whether the robot, looking along the path, can be at its points, (n, 2)."""
    cells = ((points_m - window.low_m) * (1.0 / CELL_M)).astype(np.int64)
    cells = np.minimum(np.maximum(cells, 0), window.size - 1)
    return np.asarray(window.distance_m[cells[:, 1] * window.size + cells[:, 0]] > half_width_m)


def _tracks(around: Surroundings, window: ClearanceWindow, horizon_s: float) -> Floats:
    """(k, 6) the moving obstacles from where the robot is, see Scene."""
    pose = around.map_from_base
    rows = []
    for t in (*around.tracks, *around.turning):
        x, y = t.x_m - pose.x_m, t.y_m - pose.y_m
        vx, vy = t.velocity_x_m_s, t.velocity_y_m_s
        until_s = window.time_to_wall_s(x, y, vx, vy, 0.8 * t.radius_m, horizon_s)
        rows.append((x, y, vx, vy, t.radius_m, until_s))
    return np.array(rows, np.float32).reshape(-1, 6)
