"""The particles as a message, and what the world tells of its map."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import MAP_FRAME, SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import UnseenArea
from mazebot.common.messages.rows import poses_from_array
from mazebot.localization.likelihood_field import OCCUPIED

_MAX_PARTICLES_SHOWN = 500


def cloud_message(now_ns: int, particles: Array) -> msg.PoseArray:
    """At most 500 of the (n, 3) particles: x, y in metres and yaw in radians."""
    # Of no particles, as where the search for the pose has no hypothesis left, it is empty.
    shown = particles[:: max(1, -(-len(particles) // _MAX_PARTICLES_SHOWN))]
    cos, sin = portable_kernels.cos_sin_each(shown[:, 2] / 2.0)
    zeros = np.zeros(len(shown))
    poses = np.column_stack([shown[:, :2], zeros, zeros, zeros, sin, cos])
    return msg.PoseArray(header=msg.header(now_ns, MAP_FRAME), poses=poses_from_array(poses))


def unseen_cells(
    cells: NDArray[np.int8], resolution_m: float, map_from_grid: SE2, areas: Sequence[UnseenArea]
) -> NDArray[np.bool_]:
    """(rows, columns) of bool: the occupied cells whose centres lie in areas of the map."""
    unseen = np.zeros(cells.shape, np.bool_)
    c, s = portable.cos_sin(map_from_grid.yaw_rad)
    grid_from_map = map_from_grid.inverse()
    for area in areas:
        (left, low), (right, top) = area.low_m, area.high_m
        corners = [grid_from_map @ SE2(x, y, 0.0) for x in (left, right) for y in (low, top)]
        rows = _cells([corner.y_m / resolution_m for corner in corners], cells.shape[0])
        columns = _cells([corner.x_m / resolution_m for corner in corners], cells.shape[1])
        x, y = (columns + 0.5) * resolution_m, (rows[:, None] + 0.5) * resolution_m
        x, y = map_from_grid.x_m + c * x - s * y, map_from_grid.y_m + s * x + c * y
        unseen[np.ix_(rows, columns)] |= (left < x) & (x < right) & (low < y) & (y < top)
    return np.asarray(unseen & (cells >= OCCUPIED))


def _cells(places: Sequence[float], count: int) -> NDArray[np.int64]:
    """The cells of 0 to `count` - 1 between places in cells."""
    return np.arange(max(0, math.floor(min(places))), min(count, math.ceil(max(places))))
