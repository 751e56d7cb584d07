"""The collision monitor: the last look at a velocity command, on the raw points of the sensors. It
knows nothing of maps, plans and controllers.

Polygons, actions and parameters are those of nav2_collision_monitor. Three things differ on
purpose. An approach is by default limited by the distance in which the robot can brake from its
present velocity, also while it turns, instead of by a time. Arcs are followed exactly instead of in
steps of simulation_time_step; and what is known to move is taken on its way meanwhile, so that the
robot stands when it comes by. And no action holds a robot that moves away from what is too near: it
would never get out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from mazebot.common.config import Params
from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.kernels import kernel
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.safety.braking import (
    braking_scale,
    nearest_after_m,
    points_inside,
    time_to_contact_s,
)
from mazebot.navigation.control.track import Track
from mazebot.navigation.costmap.footprint import WAFFLE, Footprint

PolygonType = Literal["polygon", "circle", "velocity_polygon"]
ActionType = Literal["stop", "slowdown", "limit", "approach", "none"]

ESCAPE: Final = Velocity(0.15, 0.8)
"""Highest speeds of a robot that leaves a stop zone."""
_BESIDE_M: Final = 0.08
"""Points this near to the disc of a thing that moves belong to it."""
NOTHING_MOVES: Final[Array] = np.empty((0, 5))
_GOES_ON_S: Final = (0.5, 1.0)
"""A robot that continues for so long before it brakes may get out of the way of what moves."""
_CREEP_M_S: Final = 0.01
"""An approach allows the outline no slower motion: in the end that would touch too."""
_APART_M: Final = 0.005
"""What is this much nearer than before counts as nearer: half the lidar's noise."""
_NEARER_M: Final = 0.001
"""The same for points that come nearer by themselves."""
_AHEAD_M: Final = 0.03
"""Movement of the outline after which it is looked at again."""


class Action(IntEnum):
    """Of nav2_msgs/CollisionMonitorState."""

    DO_NOTHING = 0
    STOP = 1
    SLOWDOWN = 2
    APPROACH = 3
    LIMIT = 4


def _outline(points: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    if points:
        Footprint.zone(points)
    return points


Points = Annotated[tuple[tuple[float, float], ...], AfterValidator(_outline)]
"""(x, y) in base_footprint, which enclose an area."""


class VelocityPolygonParams(Params):
    """The polygon of a velocity_polygon for a range of commands."""

    points: Points = Field(description="m; [[x, y], ...] in base_footprint")
    linear_min: float = Field(description="m/s; least speed of the commands")
    linear_max: float = Field(description="m/s; highest speed of the commands")
    theta_min: float = Field(description="rad/s; least turning speed of the commands")
    theta_max: float = Field(description="rad/s; highest turning speed of the commands")

    def covers(self, command: Velocity) -> bool:
        """Whether it is meant for a command."""
        v, w = command
        return self.linear_min <= v <= self.linear_max and self.theta_min <= w <= self.theta_max


class PolygonParams(Params):
    """A zone around the robot, and what happens when points are in it; names and defaults as in
    Nav2.
    """

    type: PolygonType = Field("polygon", description="its form")
    action_type: ActionType = Field(description="what happens when points are in it")
    points: Points = Field(
        (),
        description="m; [[x, y], ...] of a polygon in base_footprint, which one with the action "
        "approach encloses; none: the footprint",
    )
    radius: float = Field(0.0, ge=0, description="m; of a circle")
    velocity_polygons: dict[str, VelocityPolygonParams] = Field(
        default_factory=dict,
        description="the first that covers the command is used; none: no action",
    )
    min_points: int = Field(4, ge=1, description="fewer points are noise")
    trigger_consecutive_points: int = Field(
        1, ge=1, description="steps in a row with points before it acts"
    )
    release_consecutive_points: int = Field(
        1, ge=1, description="steps in a row without points before it ends"
    )
    slowdown_ratio: float = Field(0.5, ge=0, le=1, description="factor of a slowdown")
    linear_limit: float = Field(0.5, ge=0, description="m/s; highest speed of a limit")
    angular_limit: float = Field(0.5, ge=0, description="rad/s; highest turning speed of a limit")
    time_before_collision: float = Field(
        2.0,
        ge=0,
        description="s; of an approach: the command is scaled so that it is this long; 0: by the "
        "braking distance",
    )
    sources_names: tuple[str, ...] | None = Field(None, description="sensors; none: all")
    enabled: bool = Field(True, description="whether it is used")

    @model_validator(mode="after")
    def _has_its_form(self) -> PolygonParams:
        if self.type == "circle" and not self.radius > 0.0:
            raise ValueError("radius: must be greater than 0 for a circle")
        if self.type == "velocity_polygon" and not self.velocity_polygons:
            raise ValueError("velocity_polygons: must name at least one")
        if self.action_type == "approach":
            self._has_the_robot_inside()
        return self

    def _has_the_robot_inside(self) -> None:
        """An approach moves the polygon with the robot until something meets its outline."""
        outlines = {"points": self.points} if self.type == "polygon" and self.points else {}
        if self.type == "velocity_polygon":
            outlines = {
                f"velocity_polygons.{name}.points": one.points
                for name, one in self.velocity_polygons.items()
            }
        for name, points in outlines.items():
            try:
                Footprint.of(points)
            except ValueError as error:
                raise ValueError(f"{name}: {error}, for an approach") from error


class BrakingParams(Params):
    """How the robot stops."""

    linear_decel: float = Field(1.0, gt=0, description="m/s2; deceleration")
    angular_decel: float = Field(2.0, gt=0, description="rad/s2; angular deceleration")
    delay: float = Field(
        0.1, ge=0, description="s; from a measurement until brakes act: a lidar's period"
    )
    margin: float = Field(0.01, ge=0, description="m; what is left between robot and obstacle")


class CollisionMonitorParams(Params):
    """Names and defaults as in Nav2; distances by the braking of a waffle."""

    enabled: bool = Field(True, description="whether commands are checked")
    polygons: dict[str, PolygonParams] = Field(
        {"FootprintApproach": PolygonParams(action_type="approach", time_before_collision=0.0)},
        description="the zones around the robot by name",
    )
    observation_sources: tuple[Literal["scan", "depth"], ...] = Field(
        ("scan", "depth"),
        description="sensors; the robot does not move without the scan",
    )
    source_timeout: float = Field(
        0.5, ge=0, description="s; a scan older than this stops the robot; 0: it is never too old"
    )
    stop_pub_timeout: float = Field(
        1.0, ge=0, description="s; a stop is repeated for this long: then another source may drive"
    )
    braking: BrakingParams = BrakingParams()


@dataclass(frozen=True, slots=True)
class SourcePoints:
    """The points of a sensor, moved by odometry to the robot's present pose."""

    stamp_ns: int
    points_m: Array
    """(n, 2) float64, in base_footprint."""


@dataclass(frozen=True, slots=True)
class MonitorState:
    """What the monitor does, and why: nav2_msgs/CollisionMonitorState and what is missing there."""

    action: Action = Action.DO_NOTHING
    polygon_name: str = ""
    source: str = ""
    points: int = 0
    place_m: tuple[float, float] | None = None
    """Of the points the nearest to the robot, in base_footprint."""
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Watched:
    """The command that may be sent."""

    velocity: Velocity
    state: MonitorState
    publish: bool = True
    """False when zero has been repeated for stop_pub_timeout: another source may drive."""


class CollisionMonitor:
    """Judges one command after another."""

    def __init__(
        self,
        params: CollisionMonitorParams,
        footprint: Footprint = WAFFLE,
        sources: Sequence[str] = ("scan",),
    ) -> None:
        """`sources`: the sensors without which the robot may not move."""
        self._sources = sources
        self._params = params
        self.enabled = params.enabled
        """Nav2's toggle service."""
        self._zones = [
            _Zone(name, polygon, footprint, params.braking)
            for name, polygon in params.polygons.items()
        ]
        self._stopped_since_ns: int | None = None

    def step(
        self,
        now_ns: int,
        command: Velocity,
        velocity: Velocity,
        sources: Mapping[str, SourcePoints],
        moving: Array = NOTHING_MOVES,
    ) -> Watched:
        """The command that may be sent instead of one.

        Args:
            now_ns: the time.
            command: that of the controller or of teleoperation.
            velocity: the present one, by odometry.
            sources: the newest points of each sensor.
            moving: (n, 5) float64, things known to move now, as `moving_in_base` gives them.
        """
        if not (math.isfinite(command.linear_m_s) and math.isfinite(command.angular_rad_s)):
            state = MonitorState(Action.STOP, reason="the command is not a finite number")
            return self._publish(now_ns, STOP, state)
        if not self.enabled:
            return self._publish(now_ns, command, MonitorState())
        invalid = self._invalid_source(now_ns, sources)
        if invalid is not None:
            return self._publish(now_ns, STOP, invalid)
        cloud = _Cloud(now_ns, sources, moving)
        best, best_state = command, MonitorState()
        for zone in self._zones:
            if not zone.params.enabled:
                continue
            allowed, state = zone.judge(command, velocity, cloud)
            if state.action is not Action.DO_NOTHING and _slower(allowed, best, best_state):
                best, best_state = allowed, state
        return self._publish(now_ns, best, best_state)

    def _invalid_source(
        self, now_ns: int, sources: Mapping[str, SourcePoints]
    ) -> MonitorState | None:
        timeout_s = self._params.source_timeout
        for name in self._sources:
            if name not in sources:
                return MonitorState(
                    Action.STOP,
                    "invalid source",
                    name,
                    reason=f"invalid source: no {name} received yet",
                )
            age_s = (now_ns - sources[name].stamp_ns) * 1e-9
            if timeout_s > 0.0 and age_s > timeout_s:
                reason = (
                    f"invalid source: {name} is {age_s:.2f} s old, must be at most {timeout_s:g} s"
                )
                return MonitorState(Action.STOP, "invalid source", name, reason=reason)
        return None

    def _publish(self, now_ns: int, velocity: Velocity, state: MonitorState) -> Watched:
        if velocity != STOP:
            self._stopped_since_ns = None
        elif self._stopped_since_ns is None or now_ns < self._stopped_since_ns:
            self._stopped_since_ns = now_ns
        since_ns = self._stopped_since_ns
        timeout_ns = self._params.stop_pub_timeout * 1e9
        return Watched(velocity, state, since_ns is None or now_ns - since_ns <= timeout_ns)


class _Zone:
    """A polygon with its memory."""

    def __init__(
        self, name: str, params: PolygonParams, footprint: Footprint, braking: BrakingParams
    ) -> None:
        self.name = name
        self.params = params
        self._braking = braking
        self._footprint = footprint
        self._kept = footprint.padded(braking.margin)
        self._triggered = False
        self._in_a_row = 0
        if params.type == "circle":
            self._polygons = [Footprint.circle(params.radius)]
        elif params.type == "velocity_polygon":
            self._polygons = [
                Footprint.zone(one.points) for one in params.velocity_polygons.values()
            ]
        elif params.points:
            self._polygons = [Footprint.zone(params.points)]
        else:
            self._polygons = [self._kept]

    def judge(
        self, command: Velocity, velocity: Velocity, cloud: _Cloud
    ) -> tuple[Velocity, MonitorState]:
        """The velocity that this zone allows."""
        polygon = self._polygon(command)
        nothing = command, MonitorState()
        if polygon is None or self.params.action_type == "none":
            return nothing
        points_m, velocities_m_s = cloud.of(self.params.sources_names)
        if self.params.action_type == "approach":
            return self._approach(polygon, command, velocity, points_m, velocities_m_s, cloud)
        inside = points_inside(points_m, polygon.points_m, polygon.circles)
        if not self._trigger(int(inside.sum()) >= self.params.min_points):
            return nothing
        within_m = points_m[inside]
        allowed, action, what = self._restrict(command, within_m)
        return allowed, self._state(action, within_m, cloud, what)

    def _polygon(self, command: Velocity) -> Footprint | None:
        if self.params.type != "velocity_polygon":
            return self._polygons[0]
        covering = (
            polygon
            for one, polygon in zip(
                self.params.velocity_polygons.values(), self._polygons, strict=True
            )
            if one.covers(command)
        )
        return next(covering, None)

    def _trigger(self, found: bool) -> bool:
        """Debounce: whether the zone is triggered after one more step."""
        self._in_a_row = self._in_a_row + 1 if found != self._triggered else 0
        needed = (
            self.params.release_consecutive_points
            if self._triggered
            else self.params.trigger_consecutive_points
        )
        if self._in_a_row >= needed:
            self._triggered, self._in_a_row = found, 0
        return self._triggered

    def _restrict(self, command: Velocity, within_m: Array) -> tuple[Velocity, Action, str]:
        """Stop, slow down or limit."""
        params = self.params
        if params.action_type == "slowdown":
            return _scaled(command, params.slowdown_ratio), Action.SLOWDOWN, "slowing down"
        if params.action_type == "limit":
            scale = _limiting(command, params.linear_limit, params.angular_limit)
            return _scaled(command, scale), Action.LIMIT, "limiting the speed"
        if command != STOP and len(within_m) and self._moves_away(command, within_m):
            scale = _limiting(command, *ESCAPE)
            return _scaled(command, scale), Action.LIMIT, "only motion away from them is allowed"
        return STOP, Action.STOP, "stopping"

    def _moves_away(self, command: Velocity, within_m: Array, nearer_m: float = _APART_M) -> bool:
        """Whether a command brings the footprint no nearer to the nearest of the points."""
        outline = self._footprint
        speed_m_s = abs(command.linear_m_s)
        speed_m_s += abs(command.angular_rad_s) * outline.circumscribed_radius_m
        seconds = _AHEAD_M / max(speed_m_s, 1e-9)
        v, w = float(command.linear_m_s), float(command.angular_rad_s)
        before_m = nearest_after_m(within_m, outline.points_m, v, w, 0.0)
        after_m = nearest_after_m(within_m, outline.points_m, v, w, seconds)
        return bool(after_m >= before_m - nearer_m)

    def _approach(
        self,
        polygon: Footprint,
        command: Velocity,
        velocity: Velocity,
        points_m: Array,
        velocities_m_s: Array,
        cloud: _Cloud,
    ) -> tuple[Velocity, MonitorState]:
        params, braking = self.params, self._braking
        v, w = float(command.linear_m_s), float(command.angular_rad_s)
        met = np.zeros(len(points_m), np.bool_)
        if params.time_before_collision > 0.0:
            contact_s = time_to_contact_s(
                points_m, polygon.points_m, v, w,
                params.time_before_collision, params.min_points, met,
            )  # fmt: skip
            scale = min(contact_s / params.time_before_collision, 1.0)
            what = f"collision in {contact_s:.2f} s"
        else:
            scale = self._braking_scale(
                polygon, command, velocity, points_m, velocities_m_s, braking.delay, met
            )
            what = "within the braking distance"
        if not self._trigger(scale < 1.0) or scale >= 1.0:
            return command, MonitorState()
        allowed = _scaled(command, scale)
        reach_m = self._footprint.circumscribed_radius_m
        if abs(allowed.linear_m_s) + reach_m * abs(allowed.angular_rad_s) < _CREEP_M_S:
            allowed = STOP
        action = Action.APPROACH if allowed != STOP else Action.STOP
        return allowed, self._state(action, points_m[met], cloud, what)

    def _braking_scale(
        self,
        polygon: Footprint,
        command: Velocity,
        velocity: Velocity,
        points_m: Array,
        velocities_m_s: Array,
        delay_s: float,
        met: NDArray[np.bool_],
    ) -> float:
        """The factor of a command after which the robot can still brake. What moves counts if it
        can be avoided by that: not where the robot gets out of its way by continuing, nor where it
        comes into a robot that stands as well and the command brings the robot no nearer.
        """

        def scale_of(command: Velocity, velocities_m_s: Array, delay_s: float) -> float:
            met[:] = False
            return float(braking_scale(
                points_m, velocities_m_s, polygon.points_m, polygon.circles,
                float(velocity.linear_m_s), float(velocity.angular_rad_s),
                float(command.linear_m_s), float(command.angular_rad_s),
                self._braking.linear_decel, self._braking.angular_decel, delay_s,
                self.params.min_points, met,
            ))  # fmt: skip

        scale = scale_of(command, velocities_m_s, delay_s)
        if scale == 1.0 or not velocities_m_s.any():
            return scale
        if any(scale_of(command, velocities_m_s, longer_s) == 1.0 for longer_s in _GOES_ON_S):
            return 1.0
        # As long as the command takes, and its braking.
        stands_s = delay_s + max(
            abs(command.linear_m_s) / self._braking.linear_decel,
            abs(command.angular_rad_s) / self._braking.angular_decel,
        )
        comes = scale_of(STOP, velocities_m_s, stands_s) < 1.0
        if comes and self._moves_away(command, points_m[met], _NEARER_M):
            return scale_of(command, np.zeros_like(velocities_m_s), delay_s)
        return scale_of(command, velocities_m_s, delay_s)

    def _state(self, action: Action, points_m: Array, cloud: _Cloud, what: str) -> MonitorState:
        name = self.name
        if not len(points_m):
            return MonitorState(action, name, reason=f"{name}: {what}")
        place_m = _nearest(points_m)
        source = cloud.source_of(place_m)
        reason = (
            f"{name}: {len(points_m)} points of {source}, the nearest at "
            f"({round(place_m[0], 2) + 0.0:.2f}, {round(place_m[1], 2) + 0.0:.2f}) m: {what}"
        )
        return MonitorState(action, name, source, len(points_m), place_m, reason)


class _Cloud:
    """The points of all sources now, and the velocity of each."""

    def __init__(self, now_ns: int, sources: Mapping[str, SourcePoints], moving: Array) -> None:
        self._points_m: dict[str, Array] = {}
        self._velocities_m_s: dict[str, Array] = {}
        for name, source in sources.items():
            # A copy: a kernel is compiled again for a read-only array.
            points_m = np.array(source.points_m, np.float64, order="C").reshape(-1, 2)
            velocities_m_s = np.zeros_like(points_m)
            for x, y, radius_m, vx, vy in moving.tolist():
                ahead, aside = points_m[:, 0] - x, points_m[:, 1] - y
                near_m = radius_m + _BESIDE_M
                on_it = ahead * ahead + aside * aside <= near_m * near_m
                velocities_m_s[on_it] = (vx, vy)
            # What moves has moved since it was seen.
            points_m += velocities_m_s * ((now_ns - source.stamp_ns) * 1e-9)
            self._points_m[name], self._velocities_m_s[name] = points_m, velocities_m_s

    def of(self, names: Sequence[str] | None) -> tuple[Array, Array]:
        """(n, 2) points of some sources, None: of all, and (n, 2) their velocities."""
        known = [name for name in names or self._points_m if name in self._points_m]
        if len(known) == 1:
            return self._points_m[known[0]], self._velocities_m_s[known[0]]
        nothing = np.empty((0, 2))
        return (
            np.concatenate([nothing, *(self._points_m[name] for name in known)]),
            np.concatenate([nothing, *(self._velocities_m_s[name] for name in known)]),
        )

    def source_of(self, place_m: tuple[float, float]) -> str:
        """Name of the source of a point."""
        return next((name for name, one in self._points_m.items() if _has(one, place_m)), "")


def moving_in_base(tracks: Sequence[Track], map_from_base: SE2) -> Array:
    """(n, 5) x, y, radius and velocity of tracks in the map, along the axes of base_footprint."""
    cos, sin = portable.cos_sin(map_from_base.yaw_rad)
    rows = []
    for track in tracks:
        dx, dy = track.x_m - map_from_base.x_m, track.y_m - map_from_base.y_m
        vx, vy = track.velocity_x_m_s, track.velocity_y_m_s
        place_m = cos * dx + sin * dy, cos * dy - sin * dx
        rows.append((*place_m, track.radius_m, cos * vx + sin * vy, cos * vy - sin * vx))
    return np.array(rows, np.float64).reshape(-1, 5)


def moved_points(points_m: Array, odom_from_then: SE2, odom_from_now: SE2) -> Array:
    """(n, 2) points seen from one pose of the robot, as seen from a later one: Nav2's
    base_shift_correction.
    """
    cos_then, sin_then = portable.cos_sin(odom_from_then.yaw_rad)
    cos_now, sin_now = portable.cos_sin(odom_from_now.yaw_rad)
    return _moved(
        np.ascontiguousarray(points_m), cos_then, sin_then, cos_now, sin_now,
        odom_from_then.x_m - odom_from_now.x_m, odom_from_then.y_m - odom_from_now.y_m,
    )  # fmt: skip


@kernel()
def _moved(
    points_m: Array, cos_then: float, sin_then: float, cos_now: float, sin_now: float,
    dx_m: float, dy_m: float,
) -> Array:  # fmt: skip
    moved = np.empty((len(points_m), 2))
    for i in range(len(points_m)):
        x, y = points_m[i, 0], points_m[i, 1]
        ahead = cos_then * x - sin_then * y + dx_m
        aside = sin_then * x + cos_then * y + dy_m
        moved[i, 0] = cos_now * ahead + sin_now * aside
        moved[i, 1] = cos_now * aside - sin_now * ahead
    return moved


def _scaled(command: Velocity, scale: float) -> Velocity:
    """The same curvature, slower."""
    if scale <= 0.0:
        return STOP
    return Velocity(command.linear_m_s * scale, command.angular_rad_s * scale)


def _limiting(command: Velocity, linear_m_s: float, angular_rad_s: float) -> float:
    """The factor by which a command keeps both limits."""
    scale = 1.0
    if abs(command.linear_m_s) > linear_m_s:
        scale = linear_m_s / abs(command.linear_m_s)
    if abs(command.angular_rad_s) * scale > angular_rad_s:
        scale = angular_rad_s / abs(command.angular_rad_s)
    return scale


def _slower(one: Velocity, other: Velocity, state: MonitorState) -> bool:
    """Whether a velocity is the more restrictive, or the first to restrict at all."""
    if state.action is Action.DO_NOTHING:
        return True
    return abs(one.linear_m_s) + abs(one.angular_rad_s) < abs(other.linear_m_s) + abs(
        other.angular_rad_s
    )


def _nearest(points_m: Array) -> tuple[float, float]:
    squares = points_m[:, 0] * points_m[:, 0] + points_m[:, 1] * points_m[:, 1]
    x, y = points_m[int(np.argmin(squares))]
    return float(x), float(y)


def _has(points_m: Array, place_m: tuple[float, float]) -> bool:
    return bool(((points_m[:, 0] == place_m[0]) & (points_m[:, 1] == place_m[1])).any())
