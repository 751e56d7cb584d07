"""Size and limits of the robot, a TurtleBot3 waffle.

Sizes are those of ROBOTIS's specification and URDF
(https://emanual.robotis.com/docs/en/platform/turtlebot3/features/#specifications); the limits of
speed and acceleration are those of the simulated one, gz_waffle of
nav2_minimal_turtlebot_simulation, which is faster than ROBOTIS's 0.26 m/s and 1.82 rad/s.
"""

from __future__ import annotations

from typing import Final

from mazebot.common.maths.frames import SE2

MAX_LINEAR_M_S: Final = 0.46
MAX_ANGULAR_RAD_S: Final = 1.9
MAX_LINEAR_ACCELERATION_M_S2: Final = 1.0
MAX_ANGULAR_ACCELERATION_RAD_S2: Final = 2.0
WHEEL_SEPARATION_M: Final = 0.287
WHEEL_RADIUS_M: Final = 0.033
WAFFLE_RADIUS_M: Final = 0.22
"""Of the disc that models it: Nav2's `robot_radius` for a waffle."""
FOOT_M, TOP_M = 0.02, 0.22
"""Heights above the floor of what counts as an obstacle: above what counts as floor, up to the top
with its camera (0.214 m) and a little more. Its wheels roll over an edge of 6 mm from 0.12 m/s on,
of 10 mm from 0.36 m/s on; one of 15 mm stops it.
"""
LIDAR_HEIGHT_M: Final = 0.132
"""Of base_scan above the floor, in models/turtlebot3_waffle/model.urdf."""
BASE_FROM_SCAN: Final = SE2(-0.064, 0.0, 0.0)
"""The lidar's place."""
WAFFLE_FOOTPRINT_M: Final = (
    (0.0685, 0.1325),
    (0.030, 0.153),
    (-0.030, 0.153),
    (-0.1965, 0.1325),
    (-0.1965, -0.1325),
    (-0.030, -0.153),
    (0.030, -0.153),
    (0.0685, -0.1325),
)
"""Corners in base_footprint, counter-clockwise: the convex hull of the collision shapes in
models/turtlebot3_waffle/model.urdf, seen from above. The body is a square of 0.265 m whose middle
is 0.064 m behind the axle; the flanks of the wheels stand out 2 cm on either side.
"""
