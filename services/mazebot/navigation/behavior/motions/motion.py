"""What the behaviours of the behaviour server share: Spin, BackUp, DriveOnHeading, Wait and
AssistedTeleop are motions that are stepped until they are done.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths.frames import SE2
from mazebot.common.robot.waffle import MAX_ANGULAR_RAD_S, MAX_LINEAR_M_S
from mazebot.navigation.control.collision import STOP, Velocity

_STANDS_M_S, _STANDS_RAD_S = 0.05, 0.15
TimeToCollision = Callable[[Velocity], float]
"""Seconds until the robot touches something at a constant velocity; inf: not within the look-ahead.
"""

WhatIsThere = Callable[[Velocity, float], str]
"""What the robot meets after some seconds at a constant velocity, for messages."""


def any_obstacle(_velocity: Velocity, _seconds: float) -> str:
    """What the robot meets where there are no zones."""
    return "obstacle"


class BehaviorServerParams(Params):
    """Names as in Nav2's behaviors; lower limits where Nav2's exceed those of this robot."""

    max_rotational_vel: float = Field(1.0, gt=0, description="rad/s; highest speed of a spin")
    min_rotational_vel: float = Field(
        0.1, ge=0, description="rad/s; lowest speed at the end of a spin"
    )
    rotational_acc_lim: float = Field(1.6, gt=0, description="rad/s2; acceleration of a spin")
    acceleration_limit: float = Field(0.8, gt=0, description="m/s2; acceleration of a drive")
    deceleration_limit: float = Field(
        -0.8, lt=0, description="m/s2; deceleration at the end of a drive, negative"
    )
    minimum_speed: float = Field(
        0.02,
        ge=0,
        description="m/s; lowest speed at the end of a drive; a request below it is driven as it "
        "is",
    )
    simulate_ahead_time: float = Field(
        2.0, gt=0, description="s; a motion must be free of collisions for this long ahead"
    )
    projection_time: float = Field(
        1.0,
        gt=0,
        description="s; assisted teleoperation slows down where a collision is nearer than this",
    )
    teleop_linear_limit: float = Field(
        MAX_LINEAR_M_S, gt=0, description="m/s; highest speed of assisted teleoperation"
    )
    teleop_angular_limit: float = Field(
        MAX_ANGULAR_RAD_S,
        gt=0,
        description="rad/s; highest turning speed of assisted teleoperation",
    )


class MotionStep(NamedTuple):
    """The answer of a motion to one step."""

    done: bool
    velocity: Velocity


@dataclass(frozen=True, slots=True)
class Moment:
    """The robot at one step of a motion."""

    running_s: float
    """Time since the first step."""
    elapsed_s: float
    """Time since the last command, within which the speeds may change."""
    odom_from_base: SE2
    velocity: Velocity
    """By odometry."""
    time_to_collision: TimeToCollision
    obstacle: WhatIsThere

    @property
    def stands(self) -> bool:
        """Whether the robot stands, or does within a period or two of a stop."""
        v, w = self.velocity
        return abs(v) <= _STANDS_M_S and abs(w) <= _STANDS_RAD_S


class Motion(ABC):
    """A behaviour, from its first step until it is done or raises NavigationError."""

    def __init__(self) -> None:
        self._start_ns: int | None = None
        self._last_ns = 0
        self.feedback = 0.0
        """What the action's feedback reports: angle turned, distance driven, or time."""

    def step(
        self,
        now_ns: int,
        control_period_s: float,
        odom_from_base: SE2,
        velocity: Velocity,
        time_to_collision: TimeToCollision,
        obstacle: WhatIsThere = any_obstacle,
    ) -> MotionStep:
        """Advance by one control period, with the velocity that odometry measures.

        Raises NavigationError with a code of the 700s where it cannot continue.
        """
        elapsed_s = control_period_s
        if self._start_ns is None:
            self._start_ns = now_ns
        else:
            # A late step is followed by one in time: less than a period after it.
            elapsed_s = min(max((now_ns - self._last_ns) * 1e-9, 0.0), control_period_s)
        self._last_ns = now_ns
        running_s = (now_ns - self._start_ns) * 1e-9
        return self._advance(
            Moment(running_s, elapsed_s, odom_from_base, velocity, time_to_collision, obstacle)
        )

    @abstractmethod
    def _advance(self, at: Moment) -> MotionStep: ...


STANDING = MotionStep(False, STOP)
DONE = MotionStep(True, STOP)


def is_over(running_s: float, time_allowance_s: float) -> bool:
    """Whether a behaviour has used up its time. An allowance of 0, or below, is no limit, as in
    Nav2.
    """
    return 0.0 < time_allowance_s < running_s


def toward(last: float, wanted: float, most: float) -> float:
    """The speed nearest to a wanted one that differs from the last by no more than `most`."""
    return min(max(wanted, last - most), last + most)
