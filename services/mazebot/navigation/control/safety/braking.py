"""Kernels of the collision monitor: points in a polygon, and contact with them while braking."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel, shared_kernel
from mazebot.navigation.costmap.footprint import signed_distance_m
from mazebot.navigation.costmap.sweep import first_contact_points_s, moved

Flags = NDArray[np.bool_]

_DEEPER_M: Final = 5e-4
"""A point inside the polygon may come deeper by this: less than any motion that is meant."""
_STEP_M: Final = 0.015
"""Largest movement of the outline between two poses examined."""
_MOST_STEP_S: Final = 0.05
_HALVINGS: Final = 5
"""Of the range in which the scale of a command is sought: it is right within 1/32."""


@kernel()
def points_inside(obstacles_m: Array, points_m: Array, circles: Array) -> Flags:
    """(n,) whether each of (n, 2) points is inside a polygon; arrays as in `Footprint`."""
    inside = np.zeros(len(obstacles_m), np.bool_)
    outer2 = circles[3] * circles[3]
    for i in range(len(obstacles_m)):
        x, y = obstacles_m[i, 0], obstacles_m[i, 1]
        dx, dy = x - circles[0], y - circles[1]
        if dx * dx + dy * dy <= outer2:
            inside[i] = signed_distance_m(points_m, x, y) <= 0.0
    return inside


@kernel()
def nearest_after_m(
    obstacles_m: Array, points_m: Array, linear_m_s: float, angular_rad_s: float, seconds: float
) -> float:
    """Distance of the nearest of (n, 2) points from the polygon after a motion; below 0 inside."""
    x, y, c, s = moved(linear_m_s, angular_rad_s, seconds)
    nearest_m = np.inf
    for i in range(len(obstacles_m)):
        dx, dy = obstacles_m[i, 0] - x, obstacles_m[i, 1] - y
        nearest_m = min(nearest_m, signed_distance_m(points_m, c * dx + s * dy, c * dy - s * dx))
    return nearest_m


@kernel()
def time_to_contact_s(
    obstacles_m: Array,
    points_m: Array,
    linear_m_s: float,
    angular_rad_s: float,
    horizon_s: float,
    min_points: int,
    met: Flags,
) -> float:
    """Time until so many of (n, 2) points are in the polygon; inf if not within the horizon. `met`
    is set for them.
    """
    contacts_s = np.empty(len(obstacles_m))
    found = first_contact_points_s(
        obstacles_m, points_m, linear_m_s, angular_rad_s, horizon_s, _DEEPER_M, contacts_s
    )
    if found < min_points:
        return np.inf
    # Numba takes a second to compile np.sort.
    left_s, last_s = contacts_s.copy(), np.inf
    for _ in range(min_points):
        next_one = 0
        for i in range(1, len(left_s)):
            if left_s[i] < left_s[next_one]:
                next_one = i
        last_s = left_s[next_one]
        left_s[next_one] = np.inf
    for i in range(len(obstacles_m)):
        met[i] = contacts_s[i] <= last_s
    return float(last_s)


@kernel()
def braking_scale(
    obstacles_m: Array,
    velocities_m_s: Array,
    points_m: Array,
    circles: Array,
    linear_m_s: float,
    angular_rad_s: float,
    command_m_s: float,
    command_rad_s: float,
    linear_decel_m_s2: float,
    angular_decel_rad_s2: float,
    delay_s: float,
    min_points: int,
    met: Flags,
) -> float:
    """The largest factor, 0 to 1, by which a command may be obeyed for the delay and the robot can
    then still brake without so many points getting into its polygon.

    Args:
        obstacles_m: (n, 2), in base_footprint.
        velocities_m_s: (n, 2), of the points over the floor, along the axes of base_footprint now.
        points_m: `Footprint.points_m` of the robot with its margin.
        circles: `Footprint.circles` of it.
        linear_m_s: present speed.
        angular_rad_s: present turning speed.
        command_m_s: speed wanted.
        command_rad_s: turning speed wanted.
        linear_decel_m_s2: braking, as the highest acceleration.
        angular_decel_rad_s2: likewise.
        delay_s: until brakes act.
        min_points: fewer are noise.
        met: (n,), is set for the points that limit the command.
    """
    v_max = max(abs(linear_m_s), abs(command_m_s))
    w_max = max(abs(angular_rad_s), abs(command_rad_s))
    farthest_m = math.sqrt(circles[0] * circles[0] + circles[1] * circles[1]) + circles[3]
    reach_m = v_max * (delay_s + 0.5 * v_max / linear_decel_m_s2) + farthest_m + 0.01
    longest_s = delay_s + max(v_max / linear_decel_m_s2, w_max / angular_decel_rad_s2)
    near = np.empty((len(obstacles_m), 5))
    index = np.empty(len(obstacles_m), np.int64)
    count = 0
    for i in range(len(obstacles_m)):
        x, y = obstacles_m[i, 0], obstacles_m[i, 1]
        vx, vy = velocities_m_s[i, 0], velocities_m_s[i, 1]
        within_m = reach_m + math.sqrt(vx * vx + vy * vy) * longest_s
        if x * x + y * y <= within_m * within_m:
            near[count, 0], near[count, 1] = x, y
            near[count, 2], near[count, 3] = vx, vy
            near[count, 4] = min(signed_distance_m(points_m, x, y), 0.0) - _DEEPER_M
            index[count] = i
            count += 1
    hits = np.zeros(count, np.bool_)
    if count < min_points or not _hits(
        near[:count], points_m, circles, linear_m_s, angular_rad_s, command_m_s, command_rad_s,
        linear_decel_m_s2, angular_decel_rad_s2, delay_s, min_points, hits,
    ):  # fmt: skip
        return 1.0
    for i in range(count):
        met[index[i]] = hits[i]
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        scale = 0.5 * (low + high)
        if _hits(
            near[:count], points_m, circles, linear_m_s, angular_rad_s,
            command_m_s * scale, command_rad_s * scale,
            linear_decel_m_s2, angular_decel_rad_s2, delay_s, min_points, hits,
        ):  # fmt: skip
            high = scale
        else:
            low = scale
    return low


@shared_kernel()
def _hits(
    near: Array,
    points_m: Array,
    circles: Array,
    v: float,
    w: float,
    command_m_s: float,
    command_rad_s: float,
    linear_decel_m_s2: float,
    angular_decel_rad_s2: float,
    delay_s: float,
    min_points: int,
    hits: Flags,
) -> bool:
    """Whether a command for the delay, and braking after it, bring so many points of (n, 5), x, y,
    their velocity and the depth allowed, into the polygon.
    """
    hits[:] = False
    found = 0
    farthest_m = math.sqrt(circles[0] * circles[0] + circles[1] * circles[1]) + circles[3]
    outer2 = circles[3] * circles[3]
    x, y, yaw, t = 0.0, 0.0, 0.0, 0.0
    while True:
        speed_m_s = max(abs(v), abs(command_m_s) if t < delay_s else 0.0)
        speed_m_s += farthest_m * max(abs(w), abs(command_rad_s) if t < delay_s else 0.0)
        dt = min(_STEP_M / max(speed_m_s, 1e-9), _MOST_STEP_S)
        if t < delay_s:
            dt = min(dt, delay_s - t + 1e-12)
        v_next = _towards(v, command_m_s if t < delay_s else 0.0, linear_decel_m_s2 * dt)
        w_next = _towards(w, command_rad_s if t < delay_s else 0.0, angular_decel_rad_s2 * dt)
        c, s = portable_kernels.cos_sin(yaw + 0.25 * (w + w_next) * dt)
        x += 0.5 * (v + v_next) * dt * c
        y += 0.5 * (v + v_next) * dt * s
        yaw += 0.5 * (w + w_next) * dt
        v, w = v_next, w_next
        t += dt
        c, s = portable_kernels.cos_sin(yaw)
        middle_x = x + c * circles[0] - s * circles[1]
        middle_y = y + s * circles[0] + c * circles[1]
        for i in range(len(near)):
            px, py = near[i, 0] + near[i, 2] * t, near[i, 1] + near[i, 3] * t
            ex, ey = px - middle_x, py - middle_y
            if hits[i] or ex * ex + ey * ey > outer2:
                continue
            dx, dy = px - x, py - y
            inside_m = signed_distance_m(points_m, c * dx + s * dy, c * dy - s * dx)
            if inside_m < near[i, 4]:
                hits[i] = True
                found += 1
        if found >= min_points:
            return True
        if t >= delay_s and v == 0.0 and w == 0.0:
            return False


@shared_kernel(inline=True)
def _towards(value: float, target: float, most: float) -> float:
    """The value, changed towards a target by at most so much."""
    return min(max(target, value - most), value + most)
