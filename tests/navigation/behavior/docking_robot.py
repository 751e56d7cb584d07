"""A robot before a dock: its camera sees the marker with noise, and its odometry slips."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.navigation.behavior.context import Dock, MarkerPose
from mazebot.navigation.behavior.docking.dock_estimate import Expected
from mazebot.navigation.behavior.docking.docking import (
    Docker,
    DockingParams,
    DockingStep,
    staging_pose,
)
from mazebot.navigation.behavior.motions.motion import TimeToCollision
from mazebot.navigation.config import CONTROL_PERIOD_NS
from mazebot.navigation.control.collision import STOP, Velocity
from tests.navigation.driving import Unicycle

PERIOD_S = CONTROL_PERIOD_NS * 1e-9
MARKER = SE2(2.0, -1.0, 2.2)
CAMERA_AHEAD_M = 0.07
HALF_VIEW_RAD = 0.5


def never(_: Velocity) -> float:
    return math.inf


@dataclass
class DockingRobot:
    """The robot, its odometry and its camera."""

    seed: int
    spread: tuple[float, float, float] = (0.1, 0.1, 0.15)
    """How far the start may be from the staging pose: along, aside (m) and turned (rad)."""
    noise: float = 1.0
    params: DockingParams = field(default_factory=DockingParams)
    away_m: float = 0.4
    """Of the dock from the marker"""
    whole_view_m: float = 0.22
    """Nearer to the marker it is not seen."""
    camera_periods: int = 2
    """Control periods from one picture to the next"""
    aside_rad: float = 0.0
    """From the dock's heading to the marker"""
    side_m: float = 0.0
    """Of the marker's panel"""
    half_view_rad: float = HALF_VIEW_RAD
    """As navigation knows it"""
    time_to_collision: TimeToCollision = never
    double: SE2 | None = None
    """Another marker with the same id, in the dock's marker's frame"""
    pose_error: SE2 | None = None
    """Of the robot's pose in the map, of 2 cm and 1 degree; None: nothing is expected of it"""

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.map_from_marker = MARKER
        marker_from_dock = SE2(self.away_m, 0.0, math.pi - self.aside_rad)
        self.dock = MARKER @ marker_from_dock
        off = SE2(*(self.rng.uniform(-1.0, 1.0, 3) * self.spread).tolist())
        self.robot = Unicycle(staging_pose(self.params, self.dock) @ off)
        self.odom = SE2(*self.rng.uniform(-3.0, 3.0, 3).tolist())
        self.slip = 1.0 + 0.01 * self.rng.standard_normal(2)
        self.command = STOP
        self.sightings: tuple[MarkerPose, ...] = ()
        self.now_ns = 0
        self.blind = False
        dock = Dock(
            "1", MARKER, marker_from_dock, self.whole_view_m, self.side_m, self.half_view_rad
        )
        self.docker = Docker(self.params, dock)
        self.states: list[DockingStep] = []

    def error(self) -> SE2:
        """The robot's true pose in the frame of the docked robot."""
        return self.dock.inverse() @ self.robot.map_from_base

    def step(self) -> DockingStep:
        before = self.robot.map_from_base
        self.robot.drive(self.command, PERIOD_S)
        moved = before.inverse() @ self.robot.map_from_base
        self.odom = self.odom @ SE2(
            moved.x_m * self.slip[0], moved.y_m, moved.yaw_rad * self.slip[1]
        )
        self.now_ns += CONTROL_PERIOD_NS
        if self.now_ns % (self.camera_periods * CONTROL_PERIOD_NS) == 0 and not self.blind:
            self.sightings = self.see() or self.sightings
        step = self.docker.step(
            self.now_ns, PERIOD_S, self.odom, self.sightings, self.time_to_collision,
            self.expected(),
        )  # fmt: skip
        self.command = step.velocity
        self.states.append(step)
        return step

    def expected(self) -> Expected | None:
        if self.pose_error is None:
            return None
        told = self.robot.map_from_base @ self.pose_error
        return Expected(self.odom @ told.inverse() @ MARKER, 0.02, 0.0175)

    def see(self) -> tuple[MarkerPose, ...]:
        """The sightings in a picture; of two the other one's is the last."""
        seen = [self.sighting(self.map_from_marker)]
        if self.double is not None:
            seen.append(self.sighting(self.map_from_marker @ self.double))
        return tuple(one for one in seen if one is not None)

    def sighting(self, map_from_marker: SE2) -> MarkerPose | None:
        """A sighting: 0.8 % of the range in depth, 2 mrad in direction, 1 to 5 hundredths of a
        radian in yaw; 1 in 20 is missing, 1 in 50 has the ambiguous yaw.
        """
        base_from_marker = self.robot.map_from_base.inverse() @ map_from_marker
        ahead_m, aside_m = base_from_marker.x_m - CAMERA_AHEAD_M, base_from_marker.y_m
        range_m, bearing = math.hypot(ahead_m, aside_m), math.atan2(aside_m, ahead_m)
        from_marker = math.atan2(-base_from_marker.y_m, -base_from_marker.x_m)
        seen_from_m = math.hypot(base_from_marker.x_m, base_from_marker.y_m)
        aslant = abs(wrap_angle(from_marker - base_from_marker.yaw_rad))
        draws = self.rng.standard_normal(3) * self.noise
        missed, flipped = self.rng.random(2) < (0.05, 0.02)
        half_side_rad = math.atan2(0.5 * self.side_m, range_m)
        if (
            missed
            or abs(bearing) > HALF_VIEW_RAD - half_side_rad
            or aslant > 1.05
            or seen_from_m < self.whole_view_m
        ):
            return None
        range_m *= 1.0 + 0.008 * draws[0]
        bearing += 0.002 * draws[1]
        yaw = base_from_marker.yaw_rad + (0.01 + 0.04 * range_m) * draws[2]
        if flipped:
            yaw += math.copysign(0.35, draws[2])
        seen = SE2(
            range_m * math.cos(bearing) + CAMERA_AHEAD_M,
            range_m * math.sin(bearing),
            wrap_angle(yaw),
        )
        return MarkerPose(self.now_ns, seen, self.odom)

    def dock_it(self, limit_s: float = 120.0) -> SE2:
        """Step to the end; the robot's true error when it stands."""
        while self.now_ns < limit_s * 1e9:
            if self.step().done:
                self.robot.drive(STOP, 0.5)
                return self.error()
        raise AssertionError(f"not docked after {limit_s} s: {self.error()}")
