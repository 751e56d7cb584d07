"""Nav2's recovery behaviours for failed planning or control, in Nav2's round robin."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

from services.common.frames import SE2, wrap_angle
from services.navigation.collision import STOP, Surroundings, Velocity, first_contact_s


class BehaviorStatus(Enum):
    """The status of a behaviour."""

    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class BehaviorParams:
    """Names as in Nav2's behaviour server and its default tree."""

    spin_dist_rad: float
    max_rotational_vel_rad_s: float
    rotational_acc_lim_rad_s2: float
    spin_time_allowance_s: float
    backup_dist_m: float
    backup_speed_m_s: float
    backup_time_allowance_s: float
    wait_duration_s: float
    simulate_ahead_time_s: float
    echo_radius_m: float


class Behavior(ABC):
    """One recovery, from its first step until it is no longer running."""

    name: ClassVar[str]

    def __init__(self, params: BehaviorParams) -> None:
        self._params = params
        self._start_ns: int | None = None
        self._start = SE2(0.0, 0.0, 0.0)

    def step(
        self, now_ns: int, elapsed_s: float, around: Surroundings
    ) -> tuple[BehaviorStatus, Velocity]:
        """Advance the behaviour: its status, and the velocity to command.

        `elapsed_s` is the time since the last command, within which the speeds may change.
        """
        if self._start_ns is None:
            self._start_ns = now_ns
            self._start = around.map_from_base
        return self._advance((now_ns - self._start_ns) * 1e-9, elapsed_s, around)

    @abstractmethod
    def _advance(
        self, running_s: float, elapsed_s: float, around: Surroundings
    ) -> tuple[BehaviorStatus, Velocity]: ...

    def _collides(self, around: Surroundings, velocity: Velocity) -> bool:
        ahead_s = self._params.simulate_ahead_time_s
        contact_s = first_contact_s(around, velocity, ahead_s, 0.05, self._params.echo_radius_m)
        return contact_s != math.inf


class ClearCostmap(Behavior):
    """Clears the scan's obstacles from the costmap. The caller does it; nothing is driven."""

    name = "clear costmap"

    def _advance(
        self, running_s: float, elapsed_s: float, around: Surroundings
    ) -> tuple[BehaviorStatus, Velocity]:
        return BehaviorStatus.SUCCEEDED, STOP


class Spin(Behavior):
    """Turns on the spot, to scan the surroundings and to get free."""

    name = "spin"

    def __init__(self, params: BehaviorParams) -> None:
        super().__init__(params)
        self._turned_rad = 0.0
        self._last_yaw_rad: float | None = None
        self._rate_rad_s = 0.0

    def _advance(
        self, running_s: float, elapsed_s: float, around: Surroundings
    ) -> tuple[BehaviorStatus, Velocity]:
        p, yaw_rad = self._params, around.map_from_base.yaw_rad
        if self._last_yaw_rad is not None:
            self._turned_rad += wrap_angle(yaw_rad - self._last_yaw_rad)
        self._last_yaw_rad = yaw_rad
        left_rad = p.spin_dist_rad - self._turned_rad
        if left_rad <= 0.0:
            return BehaviorStatus.SUCCEEDED, STOP
        if running_s > p.spin_time_allowance_s:
            return BehaviorStatus.FAILED, STOP
        # The robot lags behind, so it cannot brake harder than this.
        braking_rad_s = math.sqrt(p.rotational_acc_lim_rad_s2 * left_rad)
        wanted_rad_s = min(p.max_rotational_vel_rad_s, max(braking_rad_s, 0.1))
        change_rad_s = p.rotational_acc_lim_rad_s2 * elapsed_s
        self._rate_rad_s = min(
            max(wanted_rad_s, self._rate_rad_s - change_rad_s), self._rate_rad_s + change_rad_s
        )
        velocity = Velocity(0.0, self._rate_rad_s)
        if self._collides(around, velocity):
            return BehaviorStatus.FAILED, STOP
        return BehaviorStatus.RUNNING, velocity


class BackUp(Behavior):
    """Drives straight back."""

    name = "back up"

    def __init__(self, params: BehaviorParams) -> None:
        super().__init__(params)
        self._speed_m_s = 0.0

    def _advance(
        self, running_s: float, elapsed_s: float, around: Surroundings
    ) -> tuple[BehaviorStatus, Velocity]:
        p = self._params
        if self._start.distance_m(around.map_from_base) >= p.backup_dist_m:
            return BehaviorStatus.SUCCEEDED, STOP
        if running_s > p.backup_time_allowance_s:
            return BehaviorStatus.FAILED, STOP
        # 0.15 m/s at no more than 1 m/s2.
        self._speed_m_s = min(p.backup_speed_m_s, self._speed_m_s + elapsed_s)
        velocity = Velocity(-self._speed_m_s, 0.0)
        if self._collides(around, Velocity(-p.backup_speed_m_s, 0.0)):
            return BehaviorStatus.FAILED, STOP
        return BehaviorStatus.RUNNING, velocity


class Wait(Behavior):
    """Waits, since an obstacle may move away."""

    name = "wait"

    def _advance(
        self, running_s: float, elapsed_s: float, around: Surroundings
    ) -> tuple[BehaviorStatus, Velocity]:
        if running_s >= self._params.wait_duration_s:
            return BehaviorStatus.SUCCEEDED, STOP
        return BehaviorStatus.RUNNING, STOP


ROUND_ROBIN: tuple[type[Behavior], ...] = (ClearCostmap, Spin, Wait, BackUp)
"""The order of navigate_to_pose_w_replanning_and_recovery."""

FOR_THE_LOST: tuple[type[Behavior], ...] = (Spin, Wait)
"""For a robot that is not localised: scan the surroundings without driving."""
