"""The control law of Park and Kuipers: smooth drives to a pose (A Smooth Control Law for Graceful
Motion of Differential Wheeled Mobile Robots in 2D Environment, ICRA 2011).
"""

from __future__ import annotations

import math

from pydantic import Field

from mazebot.common.config import Params
from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, wrap_angle
from mazebot.navigation.control.collision import Velocity


class GracefulParams(Params):
    """Names as in opennav_docking's controller."""

    k_phi: float = Field(3.0, ge=0, description="gain of the heading's convergence")
    k_delta: float = Field(2.0, ge=0, description="gain of the steering")
    beta: float = Field(0.4, ge=0, description="how much curvature slows down")
    lambda_: float = Field(
        2.0, ge=0, description="exponent of the slowdown by curvature, 1 or 2 (Nav2: lambda)"
    )
    v_linear_min: float = Field(0.04, gt=0, description="m/s; lowest speed of the approach")
    v_linear_max: float = Field(0.2, gt=0, description="m/s; highest speed of the approach")
    v_angular_max: float = Field(
        0.75, gt=0, description="rad/s; highest turning speed of the approach"
    )
    slowdown_radius: float = Field(
        0.25, gt=0, description="m; slower than v_linear_max nearer to the target than this"
    )
    rotate_to_heading_angular_vel: float = Field(
        0.5, gt=0, description="rad/s; highest speed of a turn on the spot"
    )


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
        params.v_linear_max / (1.0 + params.beta * bend),
        params.v_linear_max * distance_m / params.slowdown_radius,
    )
    speed_m_s = max(speed_m_s, params.v_linear_min)
    rate_rad_s = curvature * speed_m_s
    most = params.v_angular_max
    if abs(rate_rad_s) > most:
        # The curvature is kept, so that the robot stays on the curve.
        speed_m_s *= most / abs(rate_rad_s)
        rate_rad_s = math.copysign(most, rate_rad_s)
    return Velocity(sign * speed_m_s, rate_rad_s)
