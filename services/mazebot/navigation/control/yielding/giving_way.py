"""Gets out of the way of what moves towards the robot and does not stop: a person head-on in a
corridor, a post that would push it to a wall.

The controller passes what crosses its path, and what leaves room beside the path. This acts where
both would end in contact: going on along the path, and standing. The robot then goes to the nearest
place that nothing is predicted to come to, and stands there until the way is free.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.world.costmap import Clearance
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.track import Track
from mazebot.navigation.control.yielding.refuge_search import (
    PIECE_S,
    clearance_at_m,
    find_refuge,
    lanes_m,
    nearest_walker_m,
    to_refuge_m,
)
from mazebot.navigation.control.yielding.walkers import STEP_S, Walker, Walkers, ways_of
from mazebot.navigation.costmap.costmap import Costmap
from mazebot.navigation.costmap.footprint import Footprint
from mazebot.navigation.planning.path import PlannedPath

_LOG = logging.getLogger("navigation")

_MOVES_M_S = 0.12
_BESIDE_M = 0.05
"""Room that the robot needs beside a thing that passes, in addition to its half width."""
_LEAVES_M = 0.04
"""Where it stands this far from a thing's way, it is not in it."""
_DECEL_M_S2 = 0.8
_LAG_S = 0.1
_TO_HEADING, _TO_PATH = 2.5, 6.0
"""Rates of turning by the error of the heading (1/s) and aside of the motion (rad/m2)."""
_BETTER_M = 0.02
"""Another refuge is gone to only if it is better by this."""
_OVERLAP_M = 0.05
"""A motion on which a thing comes nearer than this is given up; a prediction errs."""
_HORIZONS = (1.0, 0.5, 0.25)
"""Shares of the horizon for which a refuge is looked for"""
_ON_WAY_M = 0.03
"""From what moves, on the way to a refuge"""
_KEPT = 0.25
"""A refuge is given up where less than this share of the clearance is left."""
_STANDS_M_S = 0.08
_CHECK_NS = 200_000_000
_WINDOW_M = 6.0


class GivingWayParams(Params):
    """When and how the robot gets out of the way."""

    enabled: bool = Field(False, description="whether it does: experimental")
    look_ahead: float = Field(
        7.0, gt=0, description="s; a thing that comes to the robot later than this is left alone"
    )
    look_ahead_standing: float = Field(
        6.0, gt=0, description="s; the same where the robot follows no path"
    )
    horizon: float = Field(
        12.0, gt=0, description="s; nothing may come to the place that it goes to for this long"
    )
    speed: float = Field(0.38, gt=0, le=0.46, description="m/s; of the robot on its way there")
    clearance: float = Field(
        0.1,
        ge=0,
        description="m; from what passes, at the place that it goes to; half of it where there is "
        "no such place",
    )
    wall_margin: float = Field(0.015, ge=0, description="m; from what stands")
    clear_time: float = Field(
        0.4, ge=0, description="s; it goes on when its way has been free for so long"
    )


@dataclass(frozen=True, slots=True)
class Scene:
    """What the robot knows, in one frame: that of the map, or of the odometry where it has no pose
    in the map.
    """

    pose: SE2
    velocity: Velocity
    costmap: Costmap
    """Of what stands."""
    tracks: tuple[Track, ...]
    path: PlannedPath | None = None
    """That the robot follows; None: it stands, or does not know."""


class _Prediction(NamedTuple):
    ways: Array
    """(n, steps, 2) in cells"""
    radii_m: Array


class GivingWay:
    """One robot's; `step` is called in each control period."""

    def __init__(self, params: GivingWayParams, footprint: Footprint) -> None:
        self._params, self._footprint = params, footprint
        self._walkers = Walkers()
        self.active = False
        self._motion: Array | None = None
        """(n, 6) what `find_refuge` gave, with places in metres."""
        self._piece = 1
        self._horizon_s = params.horizon
        """For so long the end of the motion is in nobody's way."""
        self._checked_ns = 0
        self._free_since_ns: int | None = None
        self._in_map = True

    @property
    def is_enabled(self) -> bool:
        """Whether it does."""
        return self._params.enabled

    def reset(self) -> None:
        """Forget all."""
        self._walkers.clear()
        self._end()

    def _end(self) -> None:
        self.active, self._motion, self._free_since_ns = False, None, None

    def step(self, now_ns: int, scene: Scene, in_map: bool) -> Velocity | None:
        """The velocity that gets the robot out of the way, or lets it stand there; None where
        nothing comes.
        """
        if not self.is_enabled:
            return None
        if in_map != self._in_map:
            self._in_map = in_map
            self.reset()
        known = self._walkers.update(now_ns * 1e-9, scene.tracks)
        coming = [each for each in known if self._may_come(each, scene.pose)]
        if not coming and not self.active:
            return None
        prediction = self._predict(coming, scene)
        threatened = bool(coming) and self._is_threatened(scene, coming, prediction)
        if threatened:
            self._free_since_ns = None
            if not self.active:
                self.active, self._checked_ns = True, now_ns - _CHECK_NS
                at = min(coming, key=lambda one: math.dist(one[:2], scene.pose[:2]))
                _LOG.info(
                    "Giving way to something at (%.2f, %.2f) that comes at %.2f m/s",
                    at.x_m, at.y_m, at.speed_m_s,
                )  # fmt: skip
        elif self.active:
            self._free_since_ns = self._free_since_ns or now_ns
            if now_ns - self._free_since_ns >= self._params.clear_time * 1e9:
                self._end()
        if not self.active:
            return None
        if now_ns - self._checked_ns >= _CHECK_NS and coming:
            self._checked_ns = now_ns
            self._check(scene, prediction)
        return self._follow(scene)

    def _may_come(self, walker: Walker, pose: SE2) -> bool:
        """Whether it moves, and may be at the robot within the horizon."""
        near_m = math.dist(walker[:2], pose[:2]) - walker.radius_m
        moves = walker.speed_m_s > _MOVES_M_S
        return moves and near_m < min(walker.speed_m_s * self._params.horizon, _WINDOW_M)

    def _predict(self, coming: Sequence[Walker], scene: Scene) -> _Prediction:
        frame = scene.costmap.frame
        ways = ways_of(coming, scene.costmap.distance_m, frame, self._params.horizon)
        ways = (ways - np.array((frame.origin_x_m, frame.origin_y_m))) / frame.resolution_m
        return _Prediction(
            np.ascontiguousarray(ways), np.array([each.radius_m for each in coming], np.float64)
        )

    def _is_threatened(
        self, scene: Scene, coming: Sequence[Walker], prediction: _Prediction
    ) -> bool:
        """Whether the robot is met where it stands, and on its path too."""
        path = scene.path
        within_s = self._params.look_ahead if path is not None else self._params.look_ahead_standing
        steps = round(within_s / STEP_S) + 1
        ways = np.ascontiguousarray(prediction.ways[:, :steps])
        if self.active and path is not None:
            # It stands aside: what would it meet on its path?
            return self._meets_on_path(scene, path, ways, prediction.radii_m)
        if not self._meets_standing(scene, ways, prediction.radii_m):
            return False
        return path is None or self._meets_on_path(scene, path, ways, prediction.radii_m)

    def _meets_standing(self, scene: Scene, ways: Array, radii_m: Array) -> bool:
        pose = self._in_cells(scene, scene.pose)
        outline, cell_m = self._footprint.points_m, scene.costmap.frame.resolution_m
        return any(
            nearest_walker_m(ways, radii_m, cell_m, outline, pose, i * STEP_S, STEP_S) < _LEAVES_M
            for i in range(ways.shape[1])
        )

    def _meets_on_path(self, scene: Scene, path: PlannedPath, ways: Array, radii_m: Array) -> bool:
        frame = scene.costmap.frame
        first = path.nearest(scene.pose.x_m, scene.pose.y_m, 0, math.inf)
        times_s = STEP_S * np.arange(ways.shape[1])
        along_m = float(path.along_m[first]) + self._params.speed * times_s
        x_m = np.interp(along_m, path.along_m, path.points_m[:, 0])
        y_m = np.interp(along_m, path.along_m, path.points_m[:, 1])
        column = (x_m - frame.origin_x_m) / frame.resolution_m
        row = (y_m - frame.origin_y_m) / frame.resolution_m
        apart = portable.hypot_each(ways[:, :, 0] - column, ways[:, :, 1] - row)
        reach_m = radii_m + self._footprint.half_width_m + _BESIDE_M
        return bool((apart * frame.resolution_m < reach_m[:, None]).any())

    def _check(self, scene: Scene, prediction: _Prediction) -> None:
        """Look for a refuge, where the one that was found is none any more."""
        steps = round(self._horizon_s / STEP_S) + 1
        before_m = -math.inf
        if self._motion is not None:
            lanes = self._lanes(scene, prediction, steps)
            if self._is_good(scene, prediction, lanes):
                return
            before_m = self._end_clearance_m(scene, lanes)
        found, end_m, self._horizon_s = self._search(scene, prediction)
        if end_m < before_m + _BETTER_M:
            # A change of mind costs time.
            return
        frame = scene.costmap.frame
        found[:, :2] *= frame.resolution_m
        found[:, :2] += np.array((frame.origin_x_m, frame.origin_y_m))
        self._motion, self._piece = found, 1

    def _lanes(self, scene: Scene, prediction: _Prediction, steps: int) -> Clearance:
        frame = scene.costmap.frame
        ways = np.ascontiguousarray(prediction.ways[:, :steps])
        return lanes_m(ways, prediction.radii_m, frame.rows, frame.columns, frame.resolution_m)

    def _search(self, scene: Scene, prediction: _Prediction) -> tuple[Array, float, float]:
        """The way to a refuge, how far from all lanes it is, and for how long. Where there is none,
        one for a shorter time: the robot retreats before what comes. Where there is none of these,
        where it is least in the way.
        """
        params, outline = self._params, self._footprint
        distance_m, cell_m = scene.costmap.distance_m, scene.costmap.frame.resolution_m
        start = self._in_cells(scene, scene.pose)
        v = scene.velocity.linear_m_s
        direction = 0 if abs(v) < _STANDS_M_S else (1 if v > 0.0 else -1)
        best: tuple[Array, float] | None = None
        radius_m = float(outline.circles[2])
        for share in _HORIZONS:
            horizon_s = share * params.horizon
            lanes = self._lanes(scene, prediction, round(horizon_s / STEP_S) + 1)
            for wanted_m in (params.clearance, 0.5 * params.clearance):
                lengths = to_refuge_m(
                    distance_m, lanes, cell_m, radius_m, wanted_m, int(start[0]), int(start[1])
                )
                if not np.isfinite(lengths).any():
                    continue
                found, end_m = find_refuge(
                    distance_m, lanes, lengths, cell_m, outline.points_m, outline.circles, start,
                    direction, prediction.ways, prediction.radii_m, STEP_S, params.speed,
                    params.wall_margin, _ON_WAY_M, wanted_m,
                )  # fmt: skip
                if end_m >= wanted_m:
                    return found, end_m, horizon_s
                if best is None or (share == 1.0 and end_m > best[1]):
                    best = found, end_m
        if best is None:
            lanes = self._lanes(scene, prediction, prediction.ways.shape[1])
            best = find_refuge(
                distance_m, lanes, np.zeros_like(lanes), cell_m, outline.points_m,
                outline.circles, start, direction, prediction.ways, prediction.radii_m, STEP_S,
                params.speed, params.wall_margin, _ON_WAY_M, params.clearance,
            )  # fmt: skip
        return *best, params.horizon

    def _is_good(self, scene: Scene, prediction: _Prediction, lanes: Clearance) -> bool:
        """Whether the motion still leads out of the way, before it is met."""
        assert self._motion is not None
        frame, outline = scene.costmap.frame, self._footprint
        if self._end_clearance_m(scene, lanes) < _KEPT * self._params.clearance:
            return False
        rest = self._motion[self._piece :]
        begin_s = float(self._motion[self._piece - 1, 5]) if len(rest) else 0.0
        for piece in rest:
            pose = self._in_cells(scene, SE2(*piece[:3].tolist()))
            near_m = nearest_walker_m(
                prediction.ways, prediction.radii_m, frame.resolution_m, outline.points_m, pose,
                float(piece[5]) - begin_s, STEP_S,
            )  # fmt: skip
            if near_m < -_OVERLAP_M:
                return False
        return True

    def _end_clearance_m(self, scene: Scene, lanes: Clearance) -> float:
        """How far from all lanes the motion ends."""
        assert self._motion is not None
        outline, done = self._footprint, self._piece >= len(self._motion)
        last = scene.pose if done else SE2(*self._motion[-1, :3].tolist())
        return clearance_at_m(
            lanes, scene.costmap.frame.resolution_m, outline.points_m, outline.circles,
            self._in_cells(scene, last),
        )  # fmt: skip

    def _follow(self, scene: Scene) -> Velocity:
        """The velocity along the motion."""
        motion, pose = self._motion, scene.pose
        if motion is None:
            return STOP
        while self._piece < len(motion):
            target, piece = SE2(*motion[self._piece, :3].tolist()), motion[self._piece]
            v, w = float(piece[3]), float(piece[4])
            here = target.inverse() @ pose
            if v != 0.0:
                left_m = -here.x_m * math.copysign(1.0, v)
                if left_m > 0.02:
                    return self._on_curve(scene, target, v, w, left_m)
            elif abs(wrap_angle(target.yaw_rad - pose.yaw_rad)) > 0.06:
                turn = wrap_angle(target.yaw_rad - pose.yaw_rad)
                rate = min(math.sqrt(2.0 * abs(turn)), abs(w) * 1.2)
                return Velocity(0.0, math.copysign(rate, turn))
            self._piece += 1
        return STOP

    def _on_curve(self, scene: Scene, target: SE2, v: float, w: float, left_m: float) -> Velocity:
        assert self._motion is not None
        rest_m = left_m
        for piece in self._motion[self._piece + 1 :]:
            if float(piece[3]) * v <= 0.0:
                break
            rest_m += abs(v) * PIECE_S
        lag_m = _LAG_S * abs(scene.velocity.linear_m_s)
        speed = min(abs(v), math.sqrt(2.0 * _DECEL_M_S2 * max(rest_m - lag_m, 0.002)))
        # Where it should be on the curve that ends at the target.
        back_s = min(left_m / abs(v), PIECE_S)
        half_rad = -0.5 * w * back_s
        c, s = portable.cos_sin(target.yaw_rad + half_rad)
        should = SE2(
            target.x_m - v * back_s * c, target.y_m - v * back_s * s,
            wrap_angle(target.yaw_rad - w * back_s),
        )  # fmt: skip
        error = scene.pose.inverse() @ should
        signed = math.copysign(speed, v)
        share = speed / abs(v)
        rate = w * share + _TO_PATH * signed * error.y_m + _TO_HEADING * share * error.yaw_rad
        return Velocity(signed, min(max(rate, -1.6), 1.6))

    def _in_cells(self, scene: Scene, pose: SE2) -> Array:
        return np.array((*scene.costmap.frame.place(pose.x_m, pose.y_m), pose.yaw_rad), np.float64)
