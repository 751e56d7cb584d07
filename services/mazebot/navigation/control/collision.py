"""Collision checks of the robot's footprint along a motion: on the costmap, and with scan echoes.

The costmap has the walls but depends on the estimated pose; the echoes need no pose. A motion must
pass both checks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.world.costmap import Mask
from mazebot.navigation.control.track import Track
from mazebot.navigation.costmap.footprint import WAFFLE, Footprint
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.costmap.sweep import first_contact_costmap_s, first_contact_points_s


class Velocity(NamedTuple):
    """Velocity of base_footprint in its own frame."""

    linear_m_s: float
    angular_rad_s: float


STOP = Velocity(0.0, 0.0)
_STANDS: Final = Velocity(0.01, 0.05)
"""Of a robot that stands odometry measures no more."""


def stands(measured: Velocity) -> bool:
    """Whether the robot stands, by its measured velocity."""
    return all(abs(speed) <= limit for speed, limit in zip(measured, _STANDS, strict=True))


ECHO_SLACK_M: Final = 0.01
"""Standard deviation of the lidar's noise: an echo this much nearer than before is no approach."""
MAP_SLACK_M: Final = 0.002
"""The same for the costmap, which has no noise."""
_STEP_CELLS: Final = 0.5
"""Of a motion that is tested for keepout zones."""
_STRAIGHT_RAD: Final = 1e-6
"""A motion that turns by less is straight."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The robot's pose, and the obstacles around it."""

    map_from_base: SE2
    costmap: Costmap
    echoes_m: Array
    """(n, 2) float64, the newest scan's echoes in the robot's current base frame."""
    footprint: Footprint = WAFFLE
    tracks: tuple[Track, ...] = ()
    """Moving obstacles now, in the costmap's frame."""
    velocity: Velocity | None = None
    """Measured by odometry; None: not known."""
    min_echoes: int = 1
    """So many echoes in the footprint are a contact; fewer are noise. In a corridor little wider
    than the robot, single ones are always too near.
    """
    turning: tuple[Track, ...] = ()
    """Obstacles that stand and are expected to turn back, with the velocity they will have."""
    speed_limit_m_s: float = math.inf
    """Of the place, as Nav2's speed filter publishes it; controllers keep below it."""
    forbidden: Mask | None = None
    """(rows, columns) cells of the costmap in keepout zones, which base_footprint must not enter;
    None: there are none.
    """


def first_contact_s(around: Surroundings, velocity: Velocity, horizon_s: float) -> float:
    """Time until the robot's footprint touches something at a constant velocity; inf if it does
    not within the horizon.

    A turn on the spot is a motion like any other. A robot that already touches an obstacle may move
    as long as it does not come nearer, so that it can get away. Entering a keepout zone is a
    contact too; in one, the robot may move.

    Args:
        around: the robot's pose, its footprint, and the obstacles around it.
        velocity: held for the whole horizon.
        horizon_s: time to simulate ahead.
    """
    frame = around.costmap.frame
    footprint = around.footprint
    on_map_s = first_contact_costmap_s(
        around.costmap.distance_m,
        frame.resolution_m,
        footprint.points_m,
        footprint.circles,
        float((around.map_from_base.x_m - frame.origin_x_m) / frame.resolution_m),
        float((around.map_from_base.y_m - frame.origin_y_m) / frame.resolution_m),
        float(around.map_from_base.yaw_rad),
        float(velocity.linear_m_s),
        float(velocity.angular_rad_s),
        float(horizon_s),
        MAP_SLACK_M,
    )
    entry = first_entry(around, velocity, horizon_s)
    if entry is not None:
        on_map_s = min(on_map_s, entry[0])
    if not len(around.echoes_m) or velocity == STOP:
        return float(on_map_s)
    contacts_s = np.empty(len(around.echoes_m))
    first_contact_points_s(
        # A copy: a kernel is compiled again for a read-only array.
        np.array(around.echoes_m, np.float64, order="C"),
        footprint.points_m,
        float(velocity.linear_m_s),
        float(velocity.angular_rad_s),
        float(horizon_s),
        ECHO_SLACK_M,
        contacts_s,
    )
    if around.min_echoes > len(contacts_s):
        return float(on_map_s)
    return float(min(on_map_s, np.sort(contacts_s)[max(around.min_echoes, 1) - 1]))


def first_entry(
    around: Surroundings, velocity: Velocity, horizon_s: float
) -> tuple[float, tuple[int, int]] | None:
    """Time until base_footprint enters a forbidden cell at a constant velocity, and the row and
    column of that; None if it does not within the horizon, or is in one.
    """
    frame, pose, forbidden = around.costmap.frame, around.map_from_base, around.forbidden
    if forbidden is None:
        return None
    here = frame.cell(pose.x_m, pose.y_m)
    v, w = velocity
    if v == 0.0 or (here is not None and forbidden[here]):
        return None
    steps = math.ceil(abs(v) * horizon_s / (_STEP_CELLS * frame.resolution_m)) + 1
    times_s = horizon_s * np.arange(1, steps + 1) / steps
    # Along a chord: as long as the arc times sin(x) / x, at half its turn.
    half_rad = 0.5 * w * times_s
    _, sine = portable_kernels.cos_sin_each(half_rad)
    turned = np.abs(half_rad) > _STRAIGHT_RAD
    shorter = np.where(turned, sine / np.where(turned, half_rad, 1.0), 1.0)
    c, s = portable_kernels.cos_sin_each(pose.yaw_rad + half_rad)
    chord_m = v * times_s * shorter
    column, row = frame.place(pose.x_m, pose.y_m)
    columns = np.floor(column + chord_m * c / frame.resolution_m).astype(np.int64)
    rows = np.floor(row + chord_m * s / frame.resolution_m).astype(np.int64)
    inside = (rows >= 0) & (rows < frame.rows) & (columns >= 0) & (columns < frame.columns)
    entered = inside & forbidden[rows.clip(0, frame.rows - 1), columns.clip(0, frame.columns - 1)]
    if not entered.any():
        return None
    first = np.argmax(entered)
    return float(times_s[first]), (int(rows[first]), int(columns[first]))
