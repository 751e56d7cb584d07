"""Mapping's results as messages, and messages as its input."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Planar


def map_message(
    now_ns: int, cells: NDArray[np.int8], resolution_m: float, origin: SE2
) -> msg.OccupancyGrid:
    """(rows, columns) cells of -1, 0 or 100 with their origin, map_from_grid."""
    return msg.occupancy_grid(now_ns, resolution_m, origin, cells)


def marker_name(detection: msg.Detection3D) -> tuple[str, int] | None:
    """Dictionary and id of a detection; None where it names none."""
    dictionary, separator, number = detection.id.rpartition(":")
    if not separator or not dictionary or not number.isascii() or not number.isdigit():
        return None
    return dictionary, int(number)


def planar(pose: SE2) -> Planar:
    """A pose as a document."""
    return Planar(x_m=pose.x_m, y_m=pose.y_m, yaw_rad=pose.yaw_rad)
