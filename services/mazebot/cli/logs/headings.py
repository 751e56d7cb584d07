"""Whether the headings of odometry are in radians."""

from __future__ import annotations

import math

import numpy as np

from mazebot.common.maths.frames import Array

_STEP_M, _LEAST_STEPS = 0.1, 20
_SURE, _BETTER = 0.9, 0.15
"""Of 1, how well degrees must explain the directions of the way, and by how much better."""


def first_in_degrees(poses: Array) -> int | None:
    """The first of the poses (n, 3), metres and heading, that says that all headings are in
    degrees: more than a full turn as radians; None: they are radians, or it is not clear.

    A robot that drives forwards or backwards moves where it heads, or opposite: that is so of the
    headings in their right unit alone.
    """
    beyond = np.flatnonzero(np.abs(poses[:, 2]) > math.tau)
    if not len(beyond):
        return None
    chosen = [0]
    for i in range(1, len(poses)):
        if math.hypot(*(poses[i, :2] - poses[chosen[-1], :2])) >= _STEP_M:
            chosen.append(i)
    if len(chosen) <= _LEAST_STEPS:
        return None
    begins = poses[chosen[:-1]]
    way = np.diff(poses[chosen], axis=0)
    along_rad = np.arctan2(way[:, 1], way[:, 0])
    as_radians, as_degrees = (
        float(np.mean(np.cos(along_rad - headings_rad) ** 2))
        for headings_rad in (begins[:, 2], np.radians(begins[:, 2]))
    )
    is_sure = as_degrees >= _SURE and as_degrees >= as_radians + _BETTER
    return int(beyond[0]) if is_sure else None


IN_DEGREES = "must be radians: in degrees, the robot would drive where it heads"
