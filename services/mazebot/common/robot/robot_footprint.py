"""The outline of a TurtleBot3 waffle on the floor."""

from __future__ import annotations

from typing import Final

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
