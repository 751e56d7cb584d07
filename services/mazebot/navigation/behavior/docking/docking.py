"""DockRobot and UndockRobot at a marker: the states of opennav_docking, a graceful approach, and a
final straight steered by the marker's lateral and heading error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.context import Dock, MarkerPose
from mazebot.navigation.behavior.docking.dock_estimate import (
    DockEstimate,
    Expected,
    SightingParams,
)
from mazebot.navigation.behavior.docking.graceful_controller import (
    GracefulParams,
    graceful_velocity,
)
from mazebot.navigation.behavior.motions.motion import TimeToCollision, toward
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.errors import NavigationError

LEAST_STAGING_SHARE = 0.5
"""Where there is no room for more, docking begins from this share of the way to the staging pose,
and undocking ends there.
"""


class DockState(IntEnum):
    """States of the feedback of DockRobot."""

    NONE = 0
    NAV_TO_STAGING_POSE = 1
    INITIAL_PERCEPTION = 2
    CONTROLLING = 3
    WAIT_FOR_CHARGE = 4
    RETRY = 5


class DockingParams(Params):
    """Names as in Nav2's docking server and its SimpleNonChargingDock."""

    staging_x_offset: float = Field(
        -0.7, lt=0, description="m; place of the staging pose along the docked robot's heading"
    )
    initial_perception_timeout: float = Field(
        8.0,
        gt=0,
        description="s; how long the marker is searched for at the staging pose; while it is seen, "
        "three times external_detection_timeout from the last sighting on",
    )
    external_detection_timeout: float = Field(
        1.0,
        gt=0,
        description="s; by an older sighting the robot does not drive on to the dock: it stands, "
        "and waits twice as long for the next one",
    )
    dock_approach_timeout: float = Field(
        40.0, gt=0, description="s; an approach that takes longer is tried again"
    )
    max_retries: int = Field(3, ge=0, description="approaches after the first one")
    dock_prestaging_tolerance: float = Field(
        0.5, ge=0, description="m; nearer to the staging pose than this, it is not driven to first"
    )
    undock_linear_tolerance: float = Field(
        0.05, gt=0, description="m; undocking ends within this distance of the staging pose"
    )
    undock_angular_tolerance: float = Field(
        0.1, gt=0, description="rad; undocking ends within this angle of the staging pose"
    )
    lateral_tolerance: float = Field(
        0.012,
        gt=0,
        description="m; docked within this to the side: Nav2 tests the straight distance alone "
        "(docking_threshold), here each error has its own bound",
    )
    longitudinal_tolerance: float = Field(
        0.015, gt=0, description="m; docked within this along the axis"
    )
    yaw_tolerance: float = Field(0.014, gt=0, description="rad; docked within this angle")
    views: int = Field(
        15, ge=1, description="sightings before the approach, and standing before the verdict"
    )
    final_straight: float = Field(0.3, gt=0, description="m; length of the final straight")
    straight_speed: float = Field(0.06, gt=0, description="m/s; speed on the final straight")
    lateral_length: float = Field(
        0.07, gt=0, description="m; on the final straight, errors fall to 1/e over about this"
    )
    acceleration: float = Field(0.3, gt=0, description="m/s2; highest acceleration")
    angular_acceleration: float = Field(
        1.5, gt=0, description="rad/s2; highest angular acceleration"
    )
    controller: GracefulParams = GracefulParams()


@dataclass(frozen=True, slots=True)
class DockingStep:
    """The answer to one step."""

    state: DockState
    velocity: Velocity
    num_retries: int
    done: bool


def staging_pose(params: DockingParams, map_from_dock: SE2) -> SE2:
    """Where docking begins: before the dock, on its axis."""
    return map_from_dock @ SE2(params.staging_x_offset, 0.0, 0.0)


class _Limited:
    """The last command, from which the next may differ by as much as the accelerations allow."""

    def __init__(self, params: DockingParams) -> None:
        self._params = params
        self.velocity = STOP

    def toward(self, wanted: Velocity, elapsed_s: float) -> Velocity:
        p = self._params
        self.velocity = Velocity(
            toward(self.velocity.linear_m_s, wanted.linear_m_s, p.acceleration * elapsed_s),
            toward(
                self.velocity.angular_rad_s,
                wanted.angular_rad_s,
                p.angular_acceleration * elapsed_s,
            ),
        )
        return self.velocity


class Docker:
    """One docking, from near the staging pose on."""

    def __init__(
        self,
        params: DockingParams,
        dock: Dock,
        odom_from_dock: SE2 | None = None,
    ) -> None:
        """Begin to dock.

        Args:
            params: how to dock.
            dock: the marker, and where the robot docks before it.
            odom_from_dock: where the dock should be; None: anywhere ahead.
        """
        self._params = params
        self._marker_from_dock = dock.marker_from_dock
        self._dock = dock
        self._expected = odom_from_dock
        self._sighting = SightingParams()
        self._estimate = DockEstimate(self._sighting)
        self._elsewhere = ""
        """Where alone the marker's id was last seen, if that is too far off"""
        self._limited = _Limited(params)
        self._state = DockState.INITIAL_PERCEPTION
        self._since_ns: int | None = None
        self._began_ns = 0
        self._hidden_ns = 0
        """When the marker was last out of the picture, by odometry."""
        self._retries = 0
        self._returns = 0
        """Times that the robot went back for more room, with no attempt in between"""
        self._aligning = False
        self._judges_since_ns: int | None = None
        self._seen_from_dock = self._marker_from_dock.x_m >= dock.whole_view_m and self._in_picture(
            _DOCKED
        )

    @property
    def odom_from_dock(self) -> SE2 | None:
        """Pose of the docked robot by the marker; None before the first sighting."""
        if self._estimate.count == 0:
            return None
        return self._estimate.odom_from_marker @ self._marker_from_dock

    def step(
        self,
        now_ns: int,
        elapsed_s: float,
        odom_from_base: SE2,
        sightings: Sequence[MarkerPose],
        time_to_collision: TimeToCollision,
        expected: Expected | None = None,
    ) -> DockingStep:
        """Advance by one control period.

        Args:
            now_ns: the time.
            elapsed_s: since the last step.
            odom_from_base: pose of the robot by odometry.
            sightings: all that had the marker's id in the newest picture with any.
            time_to_collision: at a constant velocity.
            expected: where the marker should be: sightings too far from there are of another one
                with its id; None: anywhere.

        Raises NavigationError with FAILED_TO_DETECT_DOCK or FAILED_TO_CONTROL when the retries are
        spent.
        """
        if self._since_ns is None:
            self._since_ns = self._began_ns = now_ns
        oldest_ns = self._began_ns - self._params.external_detection_timeout * 1e9
        marker = self._nearest([s for s in sightings if s.stamp_ns >= oldest_ns], expected)
        if marker is not None:
            self._estimate.add(marker)
        try:
            return self._work(now_ns, elapsed_s, odom_from_base, time_to_collision)
        except NavigationError as error:
            if self._retries >= self._params.max_retries:
                raise
            self._retries += 1
            self._enter(DockState.RETRY, now_ns)
            if self._estimate.count == 0 or error.code is ErrorCode.FAILED_TO_DETECT_DOCK:
                self._enter(DockState.INITIAL_PERCEPTION, now_ns)
            return self._answer(STOP, elapsed_s)

    def _nearest(
        self, sightings: Sequence[MarkerPose], expected: Expected | None
    ) -> MarkerPose | None:
        """The sighting nearest to where the marker should be, and not too far from there."""
        if not sightings:
            return None
        if expected is None:
            about = self._estimate.odom_from_marker
            return min(sightings, key=lambda one: one.odom_from_marker.distance_m(about))
        about = expected.odom_from_marker
        near = min(sightings, key=lambda one: one.odom_from_marker.distance_m(about))
        range_m = near.odom_from_base.distance_m(about)
        reach_m = expected.reach_m(self._sighting, range_m)
        self._elsewhere = ""
        if near.odom_from_marker.distance_m(about) <= reach_m:
            return near
        should = self._dock.map_from_marker
        seen = should @ (about.inverse() @ near.odom_from_marker)
        self._elsewhere = (
            f"; one with its id was seen at ({seen.x_m:.2f}, {seen.y_m:.2f}), expected at "
            f"({should.x_m:.2f}, {should.y_m:.2f}): must be within {reach_m:.2f} m of there"
        )
        return None

    def _work(
        self, now_ns: int, elapsed_s: float, base: SE2, time_to_collision: TimeToCollision
    ) -> DockingStep:
        if self._state is DockState.INITIAL_PERCEPTION:
            return self._perceive(now_ns, elapsed_s, base)
        dock = self.odom_from_dock
        assert dock is not None
        dock_from_base = dock.inverse() @ base
        if self._state is DockState.RETRY:
            return self._return_to_staging(now_ns, elapsed_s, dock_from_base, time_to_collision)
        return self._approach(now_ns, elapsed_s, base, dock_from_base, time_to_collision)

    def _perceive(self, now_ns: int, elapsed_s: float, base: SE2) -> DockingStep:
        p, estimate = self._params, self._estimate
        running_s, patience_s = self._running_s(now_ns), _PATIENCE * p.external_detection_timeout
        waits = estimate.count > 0 and self._waited_s(now_ns, 0) <= patience_s
        if estimate.new >= p.views and self._stands(elapsed_s):
            dock = self.odom_from_dock
            assert dock is not None
            at = dock.inverse() @ base
            # Further back there is nothing to gain.
            near = at.x_m > p.staging_x_offset - p.dock_prestaging_tolerance
            too_near = near and _needs_more_room(p, at) and self._returns < _MOST_RETURNS
            self._returns = self._returns + 1 if too_near else 0
            self._enter(DockState.RETRY if too_near else DockState.CONTROLLING, now_ns)
            return self._answer(STOP, elapsed_s)
        most_s = p.initial_perception_timeout
        if waits and estimate.new > 0:
            most_s = max(most_s, p.views * patience_s)
        if running_s > most_s:
            raise NavigationError(
                ErrorCode.FAILED_TO_DETECT_DOCK,
                f"the dock's marker was detected {estimate.new} times in {running_s:.1f} s: must "
                f"be at least {p.views} times, at most {patience_s:g} s apart{self._elsewhere}",
            )
        if waits:
            bearing_rad = _bearing(base, estimate.odom_from_marker)
            # In the middle of the picture, so that it stays in view on the way.
            turning = abs(bearing_rad) > 0.35 or (
                abs(self._limited.velocity.angular_rad_s) > 0.0 and abs(bearing_rad) > 0.1
            )
            return self._answer(self._turn(bearing_rad if turning else 0.0), elapsed_s)
        return self._answer(self._search(running_s, base), elapsed_s)

    def _search(self, running_s: float, base: SE2) -> Velocity:
        """Look to where the dock should be, then to both sides of it."""
        expected_rad = 0.0
        if self._expected is not None:
            marker = self._expected @ self._marker_from_dock.inverse()
            expected_rad = _bearing(base, marker)
            if abs(expected_rad) > 0.45:
                return self._turn(expected_rad)
        # Once to the left, twice as far to the right, and so on.
        left = int(running_s / 1.5 + 0.5) % 2 == 0
        rate = self._params.controller.rotate_to_heading_angular_vel
        return Velocity(0.0, rate if left else -rate)

    def _approach(
        self,
        now_ns: int,
        elapsed_s: float,
        base: SE2,
        at: SE2,
        time_to_collision: TimeToCollision,
    ) -> DockingStep:
        p = self._params
        self._check_approach(now_ns, at, time_to_collision)
        if self._waits_for_marker(now_ns, base, at):
            return self._answer(STOP, elapsed_s)
        if self._aligning:
            return self._align(now_ns, elapsed_s, at)
        if at.x_m < -p.final_straight:
            # Beyond the beginning of the straight, so that the speed does not vanish there.
            target = SE2(-p.final_straight + p.controller.slowdown_radius, 0.0, 0.0)
            wanted = graceful_velocity(p.controller, at.inverse() @ target, backward=False)
            slowing = p.straight_speed + math.sqrt(
                2.0 * 0.5 * p.acceleration * (-p.final_straight - at.x_m)
            )
            if wanted.linear_m_s > slowing:
                share = slowing / wanted.linear_m_s
                wanted = Velocity(slowing, wanted.angular_rad_s * share)
            return self._answer(wanted, elapsed_s)
        left_m = -at.x_m - self._limited.velocity.linear_m_s * elapsed_s
        if left_m <= 0.0:
            self._aligning, self._judges_since_ns = True, None
            return self._align(now_ns, elapsed_s, at)
        speed_m_s = min(p.straight_speed, math.sqrt(p.acceleration * left_m))
        return self._answer(self._along_axis(at, max(speed_m_s, 0.01)), elapsed_s)

    def _in_picture(self, at: SE2) -> bool:
        """Whether the camera looks towards the marker, from a pose in the docked robot's frame."""
        marker = self._marker_from_dock.inverse()
        half_side_rad = portable.atan2(0.5 * self._dock.side_m, at.distance_m(marker))
        return abs(_bearing(at, marker)) <= self._dock.half_view_rad - half_side_rad

    def _is_hidden(self, base: SE2, at: SE2) -> bool:
        """Whether the marker is out of the picture because of where the robot looks, and odometry
        is good enough to continue by: a curve to a dock far aside leads there.
        """
        exact = self._estimate.position_std_m(base) <= self._params.lateral_tolerance
        return exact and not self._in_picture(at)

    def _check_approach(self, now_ns: int, at: SE2, time_to_collision: TimeToCollision) -> None:
        p = self._params
        # The verdict has its own time: it needs longer with a slow camera.
        judging = self._judges_since_ns is not None
        if self._running_s(now_ns) > p.dock_approach_timeout and not judging:
            raise NavigationError(
                ErrorCode.FAILED_TO_CONTROL,
                f"failed to reach the dock within {p.dock_approach_timeout:.0f} s: "
                f"{-at.x_m:.3f} m before it, {at.y_m:.3f} m to the side",
            )
        speed = self._limited.velocity
        if speed.linear_m_s > 0.0:
            contact_s = time_to_collision(speed)
            if contact_s < speed.linear_m_s / p.acceleration + 0.5:
                raise NavigationError(
                    ErrorCode.FAILED_TO_CONTROL,
                    f"obstacle in the way, {-at.x_m:.2f} m before the dock",
                )

    def _waits_for_marker(self, now_ns: int, base: SE2, at: SE2) -> bool:
        """Whether the last sighting is too old to drive on by. Raises NavigationError with
        FAILED_TO_DETECT_DOCK where the next one should have come long ago.
        """
        p = self._params
        if self._is_hidden(base, at):
            self._hidden_ns = now_ns
        lost_s = self._waited_s(now_ns, self._hidden_ns)
        # So near the end odometry is good enough, and so near the marker it has to be.
        by_odometry = (
            at.x_m >= -0.5 * p.final_straight
            or (self._marker_from_dock @ at).x_m < self._dock.whole_view_m
        )
        if by_odometry:
            return False
        if lost_s > _PATIENCE * p.external_detection_timeout:
            raise NavigationError(
                ErrorCode.FAILED_TO_DETECT_DOCK,
                f"the dock's marker was not detected for {lost_s:.1f} s, {-at.x_m:.2f} m before "
                f"the dock{self._elsewhere}",
            )
        return lost_s > p.external_detection_timeout

    def _align(self, now_ns: int, elapsed_s: float, at: SE2) -> DockingStep:
        """Turn to the dock's heading on the spot, then judge by new sightings; by odometry alone
        only where the marker cannot be seen from the dock.
        """
        p, estimate = self._params, self._estimate
        turn_rad = -at.yaw_rad
        judging = self._judges_since_ns is not None
        if abs(turn_rad) > (p.yaw_tolerance if judging else 0.3 * p.yaw_tolerance):
            self._judges_since_ns = None
            return self._answer(self._turn(turn_rad), elapsed_s)
        if not self._stands(elapsed_s):
            return self._answer(STOP, elapsed_s)
        if self._judges_since_ns is None:
            self._judges_since_ns = now_ns
            estimate.count_anew()
        if estimate.new < p.views:
            waited_s = self._waited_s(now_ns, self._judges_since_ns)
            if waited_s <= _PATIENCE * p.external_detection_timeout:
                return self._answer(STOP, elapsed_s)
            if self._seen_from_dock:
                raise NavigationError(
                    ErrorCode.FAILED_TO_DETECT_DOCK,
                    f"the dock's marker was detected {estimate.new} times from the dock, and not "
                    f"for {waited_s:.1f} s: must be at least {p.views} times{self._elsewhere}",
                )
        if abs(at.y_m) > p.lateral_tolerance or at.x_m > p.longitudinal_tolerance:
            raise NavigationError(
                ErrorCode.FAILED_TO_CONTROL,
                f"docked {at.y_m:.3f} m to the side and {at.x_m:.3f} m too far: must be within "
                f"{p.lateral_tolerance} m and {p.longitudinal_tolerance} m",
            )
        if at.x_m < -p.longitudinal_tolerance:
            self._aligning = False
            return self._answer(STOP, elapsed_s)
        return DockingStep(self._state, STOP, self._retries, True)

    def _return_to_staging(
        self, now_ns: int, elapsed_s: float, at: SE2, time_to_collision: TimeToCollision
    ) -> DockingStep:
        p = self._params
        far_m = p.staging_x_offset - at.x_m
        back = far_m >= p.dock_prestaging_tolerance or (
            far_m >= 0.0 and not _needs_more_room(p, at)
        )
        if back or self._running_s(now_ns) > p.dock_approach_timeout:
            self._enter(DockState.INITIAL_PERCEPTION, now_ns)
            return self._answer(STOP, elapsed_s)
        wanted = self._along_axis(at, -p.straight_speed * 2.0)
        if time_to_collision(wanted) < 1.0:
            # As far back as there is room.
            self._enter(DockState.INITIAL_PERCEPTION, now_ns)
            if at.x_m > -p.final_straight:
                raise NavigationError(
                    ErrorCode.FAILED_TO_CONTROL,
                    f"obstacle behind the robot, {-at.x_m:.2f} m before the dock",
                )
            return self._answer(STOP, elapsed_s)
        return self._answer(wanted, elapsed_s)

    def _along_axis(self, at: SE2, speed_m_s: float) -> Velocity:
        """Drive along the dock's axis, ahead or back: lateral and heading error fall like a
        critically damped spring over the length driven.
        """
        p = self._params
        inverse = 1.0 / p.lateral_length
        sine = portable.sin(at.yaw_rad)
        ahead = 1.0 if speed_m_s > 0.0 else -1.0
        lateral = min(max(at.y_m, -0.06), 0.06)
        per_metre = -ahead * inverse * inverse * lateral - 2.0 * inverse * sine
        most = p.controller.v_angular_max
        rate = min(max(per_metre * abs(speed_m_s), -most), most)
        return Velocity(speed_m_s, rate)

    def _turn(self, angle_rad: float) -> Velocity:
        p = self._params
        if abs(angle_rad) < 1e-6:
            return STOP
        rate = min(
            math.sqrt(p.angular_acceleration * abs(angle_rad)),
            p.controller.rotate_to_heading_angular_vel,
            2.0 * abs(angle_rad) + 0.01,
        )
        return Velocity(0.0, math.copysign(rate, angle_rad))

    def _stands(self, elapsed_s: float) -> bool:
        v, w = self._limited.velocity
        return abs(v) < 1e-3 and abs(w) <= self._params.angular_acceleration * elapsed_s

    def _enter(self, state: DockState, now_ns: int) -> None:
        self._state, self._since_ns = state, now_ns
        self._aligning, self._judges_since_ns = False, None
        self._estimate.count_anew()

    def _running_s(self, now_ns: int) -> float:
        return (now_ns - (self._since_ns or 0)) * 1e-9

    def _waited_s(self, now_ns: int, since_ns: int) -> float:
        """Since the last sighting: a slow camera needs longer for all of them."""
        return (now_ns - max(since_ns, self._estimate.last_stamp_ns)) * 1e-9

    def _answer(self, wanted: Velocity, elapsed_s: float) -> DockingStep:
        velocity = self._limited.toward(wanted, elapsed_s)
        return DockingStep(self._state, velocity, self._retries, False)


_DOCKED = SE2(0.0, 0.0, 0.0)
_MOST_RETURNS = 2
_PATIENCE = 3.0
"""Times `external_detection_timeout`, for which a robot that stands waits for the next sighting."""


def _needs_more_room(params: DockingParams, dock_from_base: SE2) -> bool:
    """Whether the dock is too near, or too far aside, to be reached in one curve."""
    room_m = -dock_from_base.x_m - params.final_straight
    return room_m < 0.1 or abs(dock_from_base.y_m) > 0.45 * room_m


def _bearing(base: SE2, target: SE2) -> float:
    """Direction to a target in the robot's frame."""
    at = base.inverse() @ target
    return portable.atan2(at.y_m, at.x_m)


class Undocker:
    """One undocking: straight back from the dock to its staging pose."""

    def __init__(self, params: DockingParams, max_undocking_time_s: float = 30.0) -> None:
        self._params = params
        self._time_s = max_undocking_time_s
        self._limited = _Limited(params)
        self._start: SE2 | None = None
        self._start_ns = 0

    def step(
        self,
        now_ns: int,
        elapsed_s: float,
        odom_from_base: SE2,
        time_to_collision: TimeToCollision,
    ) -> DockingStep:
        """Advance by one control period.

        Raises NavigationError with FAILED_TO_CONTROL where something is behind the robot, and with
        DOCKING_TIMEOUT.
        """
        p = self._params
        if self._start is None:
            self._start, self._start_ns = odom_from_base, now_ns
        at = self._start.inverse() @ odom_from_base
        left_m = at.x_m - p.staging_x_offset
        if left_m <= p.undock_linear_tolerance and abs(at.yaw_rad) <= (p.undock_angular_tolerance):
            if abs(self._limited.velocity.linear_m_s) <= p.acceleration * elapsed_s:
                return DockingStep(DockState.NONE, STOP, 0, True)
        if (now_ns - self._start_ns) * 1e-9 > self._time_s:
            raise NavigationError(
                ErrorCode.DOCKING_TIMEOUT,
                f"undocking timed out after {self._time_s:.0f} s: {left_m:.2f} m left",
            )
        speed_m_s = p.controller.v_linear_max
        if left_m > 0.0 and time_to_collision(Velocity(-speed_m_s, 0.0)) < 1.0:
            if at.x_m <= LEAST_STAGING_SHARE * p.staging_x_offset:
                if self._limited.velocity == STOP:
                    return DockingStep(DockState.NONE, STOP, 0, True)
                velocity = self._limited.toward(STOP, elapsed_s)
                return DockingStep(DockState.CONTROLLING, velocity, 0, False)
            raise NavigationError(
                ErrorCode.FAILED_TO_CONTROL, "undocking: obstacle behind the robot"
            )
        slow = math.sqrt(p.acceleration * max(left_m, 0.0))
        wanted = Velocity(-min(speed_m_s, slow), -0.5 * at.yaw_rad)
        return DockingStep(DockState.CONTROLLING, self._limited.toward(wanted, elapsed_s), 0, False)
