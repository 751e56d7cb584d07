"""Whether the robot is stuck: it is commanded to move, and does not."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths.frames import SE2
from mazebot.navigation.control.collision import Velocity


class StuckDetectorParams(Params):
    """When a robot counts as stuck. Nav2 has no such detector; see its progress checker."""

    time_allowance: float = Field(
        2.0,
        gt=0,
        description="s; motion is compared over the last so many seconds; more where the robot "
        "cannot come by required_distance or required_angle in half of them",
    )
    required_distance: float = Field(
        0.1, gt=0, description="m; with less commanded motion the robot is not judged"
    )
    required_angle: float = Field(
        0.4, gt=0, description="rad; with less commanded turning the robot is not judged"
    )
    least_share: float = Field(
        0.2, gt=0, lt=1, description="share of the motion that must take place"
    )


class Stuck(NamedTuple):
    """Why the robot counts as stuck."""

    slips: bool
    """The wheels turn, and the robot stays; else the wheels do not turn."""
    text: str


_HOLDS_S = 0.2
"""The robot obeys a command no longer than this (physics' `cmd_vel_timeout_s`): in a longer gap, as
while the network was lost, nothing was commanded.
"""
_ROUNDING_M = 1e-6
"""More than what rounding makes of a sum."""


class _Sample(NamedTuple):
    now_ns: int
    commanded_m: float
    commanded_rad: float
    odom_from_base: SE2
    map_from_base: SE2
    commanded_way_m: float
    """Of all commands so far,"""
    odom_way_m: float
    """and the length of the way by odometry."""


class StuckDetector:
    """Compares commands with odometry, and odometry with localisation, over a window of time."""

    def __init__(self, params: StuckDetectorParams) -> None:
        self._params = params
        self._samples: deque[_Sample] = deque()

    def reset(self) -> None:
        """Start again, e.g. with another goal or after a jump of the pose."""
        self._samples.clear()

    def update(
        self,
        now_ns: int,
        command: Velocity,
        odom_from_base: SE2,
        map_from_base: SE2,
        least_s: float = 0.0,
    ) -> Stuck | None:
        """Take what was commanded since the last call and where the robot is; why it is stuck, or
        None. A stop starts again: a robot that stands has not to move. `least_s`: motion is
        compared over no less than this, where it may not be faster now.
        """
        p, samples = self._params, self._samples
        if max(map(abs, command)) < 1e-3:
            samples.clear()
            return None
        elapsed_s = (now_ns - samples[-1].now_ns) * 1e-9 if samples else 0.0
        if not 0.0 <= elapsed_s <= _HOLDS_S:
            samples.clear()
            elapsed_s = 0.0
        commanded_m = abs(command.linear_m_s) * elapsed_s
        commanded_way_m, odom_way_m = commanded_m, 0.0
        if samples:
            last = samples[-1]
            commanded_way_m += last.commanded_way_m
            odom_way_m = last.odom_way_m + odom_from_base.distance_m(last.odom_from_base)
        samples.append(
            _Sample(
                now_ns,
                commanded_m,
                abs(command.angular_rad_s) * elapsed_s,
                odom_from_base,
                map_from_base,
                commanded_way_m,
                odom_way_m,
            )
        )
        allowance_s = max(p.time_allowance, least_s)
        allowance_ns = allowance_s * 1e9
        while len(samples) > 1 and now_ns - samples[1].now_ns >= allowance_ns:
            samples.popleft()
        if now_ns - samples[0].now_ns < allowance_ns:
            return None
        return self._judge(allowance_s)

    def _drives(self) -> bool:
        """Whether the first and the newest sample alone show that the robot drives as commanded: by
        the lengths of the ways, which are no shorter than any distance on them.
        """
        p, first, last = self._params, self._samples[0], self._samples[-1]
        commanded_m = last.commanded_way_m - first.commanded_way_m
        way_m = last.odom_way_m - first.odom_way_m
        odom_m = last.odom_from_base.distance_m(first.odom_from_base)
        true_m = last.map_from_base.distance_m(first.map_from_base)
        return (
            commanded_m - _ROUNDING_M >= p.required_distance
            and odom_m >= p.least_share * (commanded_m + _ROUNDING_M)
            and odom_m >= p.required_distance
            and true_m >= p.least_share * (way_m + _ROUNDING_M)
        )

    def _judge(self, seconds: float) -> Stuck | None:
        if self._drives():
            return None
        samples = list(self._samples)
        commanded_m = sum([each.commanded_m for each in samples[1:]])
        commanded_rad = sum([each.commanded_rad for each in samples[1:]])
        odom_m, odom_rad = _moved([each.odom_from_base for each in samples])
        # Most often the newest pose alone shows that the robot moves.
        ends = _moved([samples[0].map_from_base, samples[-1].map_from_base])
        if not self._lacks(commanded_m, commanded_rad, odom_m, odom_rad) and not self._lacks(
            odom_m, odom_rad, *ends
        ):
            return None
        true_m, true_rad = _moved([each.map_from_base for each in samples])
        if self._lacks(commanded_m, commanded_rad, odom_m, odom_rad):
            text = f"commanded {commanded_m:.2f} m and {commanded_rad:.2f} rad in {seconds:.1f} s, "
            return Stuck(False, f"{text}odometry measured {odom_m:.2f} m and {odom_rad:.2f} rad")
        if self._lacks(odom_m, odom_rad, true_m, true_rad):
            text = f"the wheels turned for {odom_m:.2f} m and {odom_rad:.2f} rad in {seconds:.1f} s"
            return Stuck(
                True, f"{text}, localisation measured {true_m:.2f} m and {true_rad:.2f} rad"
            )
        return None

    def _lacks(self, wanted_m: float, wanted_rad: float, m: float, rad: float) -> bool:
        """Whether motion is missing, and none of either kind takes place."""
        p = self._params
        asked = wanted_m >= p.required_distance or wanted_rad >= p.required_angle
        moves = (wanted_m >= p.required_distance and m >= p.least_share * wanted_m) or (
            wanted_rad >= p.required_angle and rad >= p.least_share * wanted_rad
        )
        return asked and not moves


def _moved(poses: list[SE2]) -> tuple[float, float]:
    """Greatest distance, and greatest turn, from the first pose: noise about one place does not
    add up.
    """
    x_m, y_m, yaw_rad = poses[0]
    return (
        max([math.hypot(x - x_m, y - y_m) for x, y, _ in poses]),
        # As wrap_angle does, without a call for each pose.
        max([abs((yaw - yaw_rad + math.pi) % (2.0 * math.pi) - math.pi) for _, _, yaw in poses]),
    )
