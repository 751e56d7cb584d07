"""What a controller is: it takes a path and gives a velocity, twenty times a second."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from pydantic import Field, ValidationError

from mazebot.common.config import ConfigError, Params, one_line
from mazebot.common.robot import waffle
from mazebot.navigation.control.collision import STOP, Surroundings, Velocity
from mazebot.navigation.control.goal_checker import GoalCheckerParams
from mazebot.navigation.control.path_handler import PathHandlerParams
from mazebot.navigation.costmap.footprint import WAFFLE, Footprint
from mazebot.navigation.planning.path import PlannedPath


class ControllerParams(Params):
    """The base of a controller's parameters."""


class RobotLimits(Params):
    """What every controller keeps to: with less, where physics or the velocity smoother has lower
    limits.
    """

    max_linear_vel: float = Field(
        waffle.MAX_LINEAR_M_S,
        gt=0,
        description="m/s; speed on a straight path; the robot's own limit is 0.46",
    )
    max_angular_vel: float = Field(
        waffle.MAX_ANGULAR_RAD_S,
        gt=0,
        description="rad/s; highest turning speed; the robot's own limit is 1.9",
    )
    max_linear_accel: float = Field(
        waffle.MAX_LINEAR_ACCELERATION_M_S2,
        gt=0,
        description="m/s2; highest acceleration; the robot's own limit is 1",
    )
    max_angular_accel: float = Field(
        waffle.MAX_ANGULAR_ACCELERATION_RAD_S2,
        gt=0,
        description="rad/s2; highest angular acceleration; the robot's own limit is 2",
    )
    general_goal_checker: GoalCheckerParams = GoalCheckerParams()
    path_handler: PathHandlerParams = PathHandlerParams()

    def shortest_s(
        self, distance_m: float, angle_rad: float, limit_m_s: float = math.inf, share: float = 1.0
    ) -> float:
        """The time that a drive of a length, or a turn by an angle, takes at least from rest, below
        a speed limit, and with a share of the speeds that are then possible.
        """
        linear_m_s = min(self.max_linear_vel, limit_m_s) * share
        return max(
            _shortest_s(distance_m, linear_m_s, self.max_linear_accel),
            _shortest_s(angle_rad, self.max_angular_vel * share, self.max_angular_accel),
        )


def _shortest_s(way: float, speed: float, acceleration: float) -> float:
    ramp = 0.5 * speed * speed / acceleration
    if way <= ramp:
        return math.sqrt(2.0 * way / acceleration)
    return speed / acceleration + (way - ramp) / speed


@dataclass(frozen=True, slots=True)
class Robot:
    """What every controller must know of the robot and of the goal's tolerances."""

    limits: RobotLimits = field(default_factory=RobotLimits)
    """No command may ask for more."""
    footprint: Footprint = WAFFLE
    """The convex outline in base_footprint."""
    control_period_s: float = 0.05
    backward_m_s: float | None = None
    """Highest speed backwards; None: as fast as the limits' max_linear_vel."""
    linear_decel_m_s2: float | None = None
    """Strongest braking; None: as strong as the limits' max_linear_accel."""

    @property
    def max_backward_vel(self) -> float:
        """m/s; the highest speed backwards that a command may ask for."""
        speed = self.backward_m_s
        return self.limits.max_linear_vel if speed is None else speed

    @property
    def max_linear_decel(self) -> float:
        """m/s2; the strongest braking that a command may ask for."""
        decel = self.linear_decel_m_s2
        return self.limits.max_linear_accel if decel is None else decel

    def limited(self, wanted: Velocity, last: Velocity, elapsed_s: float) -> Velocity:
        """The velocity nearest to a wanted one within the limits of speed and acceleration."""
        up = self.limits.max_linear_accel * elapsed_s
        down = self.max_linear_decel * elapsed_s
        dw = self.limits.max_angular_accel * elapsed_s
        v_max, w_max = self.limits.max_linear_vel, self.limits.max_angular_vel
        linear = min(max(wanted.linear_m_s, -self.max_backward_vel), v_max)
        angular = min(max(wanted.angular_rad_s, -w_max), w_max)
        v = last.linear_m_s
        # The other way round, it is no faster than one that begins to drive.
        low = max(v - down, -up) if v > 0.0 else v - up
        high = min(v + down, up) if v < 0.0 else v + up
        return Velocity(
            min(max(linear, low), high),
            min(max(angular, last.angular_rad_s - dw), last.angular_rad_s + dw),
        )


@dataclass(frozen=True, slots=True)
class Control:
    """The controller's output for one control period."""

    velocity: Velocity
    reached: bool
    """The robot stands at the goal, within both tolerances."""
    blocked: bool
    """No velocity along the path is collision-free."""
    distance_remaining_m: float


@runtime_checkable
class Controller(Protocol):
    """A controller, constructed as `Class(params, robot, random)` where `params` is an instance of
    its own `Params` and `random` the one source of random numbers.

    It computes only: no clock, file, topic or thread. `set_path` is called with every new path
    (`same_goal`: it leads to the goal of the path before), `step` once in every control period
    while there is a path, `stop` when the robot was commanded to stop and the path is dropped.
    """

    Params: ClassVar[type[ControllerParams]]

    @property
    def path(self) -> PlannedPath | None:
        """The path being followed."""

    @property
    def index(self) -> int:
        """Index of the path's point that the robot has reached."""

    @property
    def xy_reached(self) -> bool:
        """Whether only the final turn is left."""

    @property
    def velocity(self) -> Velocity:
        """The last command."""

    def set_path(self, path: PlannedPath, same_goal: bool) -> None:
        """Follow a path."""

    def step(self, elapsed_s: float, around: Surroundings) -> Control:
        """Velocity for the next control period; `elapsed_s` has passed since the last one."""

    def stop(self) -> None:
        """Drop the path and the last command."""


@runtime_checkable
class TakesOver(Protocol):
    """A controller that can go on where another one drove, or the same one with other parameters:
    without a stop. Those that are derived from Mazebot's bases can.
    """

    def take_over(self, velocity: Velocity, index: int = 0, xy_reached: bool = False) -> None:
        """Go on from the last command of the one before, which had come to a point of this path;
        called after `set_path`.
        """


class PathlessController:
    """A base for controllers that need no path: keeps what the interface asks for.

    A class derived from it defines `Params` and `command`.
    """

    Params: ClassVar[type[ControllerParams]] = ControllerParams

    def __init__(self, params: Any, robot: Robot, random: np.random.Generator) -> None:
        self.params = params
        self.robot = robot
        self.random = random
        self._path: PlannedPath | None = None
        self._velocity = STOP

    @property
    def path(self) -> PlannedPath | None:
        """See Controller."""
        return self._path

    @property
    def index(self) -> int:
        """See Controller."""
        return 0

    @property
    def xy_reached(self) -> bool:
        """See Controller."""
        return False

    @property
    def velocity(self) -> Velocity:
        """See Controller."""
        return self._velocity

    def set_path(self, path: PlannedPath, same_goal: bool) -> None:
        """See Controller."""
        self._path = path

    def take_over(self, velocity: Velocity, index: int = 0, xy_reached: bool = False) -> None:
        """See TakesOver."""
        self._velocity = velocity

    def stop(self) -> None:
        """See Controller."""
        self._path, self._velocity = None, STOP

    def step(self, elapsed_s: float, around: Surroundings) -> Control:
        """The command, within the robot's limits; the goal is reached where it is near."""
        goal = None if self._path is None else self._path.goal
        to_goal_m = math.inf if goal is None else around.map_from_base.distance_m(goal)
        self._velocity = self.robot.limited(self.command(around), self._velocity, elapsed_s)
        return Control(self._velocity, self.arrived(to_goal_m), False, to_goal_m)

    def arrived(self, to_goal_m: float) -> bool:
        """Whether the drive is over; here within the goal's position tolerance."""
        return to_goal_m <= self.robot.limits.general_goal_checker.xy_goal_tolerance

    def command(self, around: Surroundings) -> Velocity:
        """The wanted velocity."""
        raise NotImplementedError


def make_params(
    params: type[ControllerParams], values: Mapping[str, object], source: str
) -> ControllerParams:
    """A controller's parameters from a mapping; raises ConfigError that names the source, field,
    value and what would be right.
    """
    try:
        return params.model_validate(dict(values))
    except ValidationError as error:
        raise ConfigError(f"{source}: {one_line(error, model=params)}") from error
