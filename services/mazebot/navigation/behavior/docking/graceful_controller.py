"""The control law of Park and Kuipers: smooth drives to a pose (A Smooth Control Law for Graceful
Motion of Differential Wheeled Mobile Robots in 2D Environment, ICRA 2011).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.navigation.control.collision import Velocity


@dataclass(frozen=True, slots=True)
class GracefulParams:
    """Names as in opennav_docking's controller."""

    k_phi: float = 3.0
    k_delta: float = 2.0
    beta: float = 0.4
    lambda_: float = 2.0
    """Exponent of the slowdown by curvature: 1 or 2."""
    v_linear_min_m_s: float = 0.04
    v_linear_max_m_s: float = 0.2
    v_angular_max_rad_s: float = 0.75
    slowdown_radius_m: float = 0.25


def graceful_velocity(params: GracefulParams, base_from_target: SE2, backward: bool) -> Velocity:
    """Velocity toward a pose; `backward`: the robot drives back and arrives with its heading.

    With the line of sight to the target at an angle: delta is the robot's heading against it, phi
    the target's, r the distance; curvature = -(1/r) (k_delta (delta - atan(-k_phi phi)) +
    (1 + k_phi / (1 + (k_phi phi)^2)) sin delta).
    """
    sign = -1.0 if backward else 1.0
    x_m, y_m = sign * base_from_target.x_m, sign * base_from_target.y_m
    distance_m = max(math.hypot(x_m, y_m), 1e-3)
    sight_rad = portable.atan2(y_m, x_m)
    delta_rad = wrap_angle(-sight_rad)
    phi = params.k_phi * wrap_angle(base_from_target.yaw_rad - sight_rad)
    curvature = (
        -(
            params.k_delta * (delta_rad + portable.atan2(phi, 1.0))
            + (1.0 + params.k_phi / (1.0 + phi * phi)) * portable.sin(delta_rad)
        )
        / distance_m
    )
    bend = abs(curvature) if params.lambda_ < 2.0 else curvature * curvature
    speed_m_s = min(
        params.v_linear_max_m_s / (1.0 + params.beta * bend),
        params.v_linear_max_m_s * distance_m / params.slowdown_radius_m,
    )
    speed_m_s = max(speed_m_s, params.v_linear_min_m_s)
    rate_rad_s = curvature * speed_m_s
    most = params.v_angular_max_rad_s
    if abs(rate_rad_s) > most:
        # The curvature is kept, so that the robot stays on the curve.
        speed_m_s *= most / abs(rate_rad_s)
        rate_rad_s = math.copysign(most, rate_rad_s)
    return Velocity(sign * speed_m_s, rate_rad_s)
