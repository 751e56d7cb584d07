"""The keepout zones and speed limits of a map: those of the world's polygons and those of masks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array
from mazebot.common.messages.documents import KeepoutZone, Point2, SpeedZone
from mazebot.common.world.costmap import Cells, Mask
from mazebot.common.world.grids import connected_regions
from mazebot.common.world.polygon_cells import polygon_cells
from mazebot.navigation.costmap.costmap import Costs, GridFrame
from mazebot.navigation.costmap.filters import (
    KEEPOUT,
    FilterInfo,
    FilterMask,
    keepout_costs,
    keepout_values,
    speed_limits,
)

LETHAL_OVERRIDE_COST: Final = 252
"""Nav2's default: what cells of a zone cost the robot that has to leave it."""
_KEPT_OUT: Final = 100

Limits = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class NamedMask:
    """A mask, and what it is called in messages."""

    name: str
    mask: FilterMask


@dataclass(frozen=True, eq=False, slots=True)
class Zones:
    """What filters require of each cell of a costmap's grid."""

    frame: GridFrame
    keepout: Cells
    """(rows, columns) int8: 100 forbidden, less costs in proportion, -1 unknown; or no cells."""
    names: tuple[tuple[str, Mask], ...]
    """The (rows, columns) forbidden cells of each keepout zone."""
    limits_m_s: Limits
    """(rows, columns), infinite where there is no limit; or no cells."""

    @property
    def forbidden(self) -> Mask | None:
        """(rows, columns) cells where base_footprint may not go; None: there are none."""
        return self.keepout >= _KEPT_OUT if self.keepout.size else None

    def costs(
        self, half_width_m: float, leaving_m: tuple[float, float] | None = None
    ) -> Costs | None:
        """(rows, columns) costs of the keepout zones, as `keepout_costs` makes them; None: there
        are none.

        Args:
            half_width_m: cells this near to a forbidden one cost 253.
            leaving_m: a place; the zone around it and those that touch it can be driven through.
        """
        if not self.keepout.size:
            return None
        leaving = self._zone_around(leaving_m) if leaving_m is not None else None
        values = self.keepout if leaving is None else np.where(leaving, np.int8(0), self.keepout)
        costs = keepout_costs(self._mask(values), self.frame, half_width_m)
        if leaving is not None:
            costs[leaving] = LETHAL_OVERRIDE_COST
            # The margin of the zone must not close it in.
            margin = keepout_costs(self._mask(self.keepout), self.frame, half_width_m) > costs
            costs[margin & (values < _KEPT_OUT)] = LETHAL_OVERRIDE_COST
        return costs

    def keepout_at(self, x_m: float, y_m: float) -> str | None:
        """The name of the keepout zone at a place; None: it may be driven to."""
        cell = self.frame.cell(x_m, y_m)
        return None if cell is None else self.keepout_in(cell)

    def keepout_in(self, cell: tuple[int, int]) -> str | None:
        """The name of the keepout zone in a cell, row and column; None: it may be driven to."""
        return next((name for name, where in self.names if where[cell]), None)

    def keepout_near(self, x_m: float, y_m: float, reach_m: float) -> str | None:
        """The name of the keepout zone nearest to a place, within a reach; None: there is none."""
        nearest: tuple[float, str] | None = None
        column, row = self.frame.place(x_m, y_m)
        for name, where in self.names:
            rows, columns = np.nonzero(where)
            if len(rows):
                up, across = rows + 0.5 - row, columns + 0.5 - column
                off_m = math.sqrt((up * up + across * across).min()) * self.frame.resolution_m
                if off_m <= reach_m and (nearest is None or off_m < nearest[0]):
                    nearest = off_m, name
        return None if nearest is None else nearest[1]

    def limits_at(self, points_m: Array) -> Limits:
        """(n,) highest speed at (n, 2) places, m/s; infinite where there is no limit."""
        if not self.limits_m_s.size:
            return np.full(len(points_m), math.inf)
        frame = self.frame
        origin_m = np.array([frame.origin_x_m, frame.origin_y_m])
        column, row = np.floor((points_m - origin_m) / frame.resolution_m).astype(np.int64).T
        inside = (row >= 0) & (row < frame.rows) & (column >= 0) & (column < frame.columns)
        found = self.limits_m_s[row.clip(0, frame.rows - 1), column.clip(0, frame.columns - 1)]
        return np.where(inside, found, math.inf)

    def speed_values(self, max_speed_m_s: float) -> Cells:
        """(rows, columns) the limits as a speed mask of Nav2's with base 100 and multiplier -1: by
        how many percent the highest speed is lowered.
        """
        if not self.limits_m_s.size:
            return np.zeros((self.frame.rows, self.frame.columns), np.int8)
        lowered = 100.0 - 100.0 * np.minimum(self.limits_m_s / max_speed_m_s, 1.0)
        # 100 would be a speed of 0, which is none.
        return np.rint(lowered).clip(0.0, 99.0).astype(np.int8)

    def _mask(self, values: Cells) -> FilterMask:
        return FilterMask(self.frame, values, FilterInfo(KEEPOUT))

    def _zone_around(self, place_m: tuple[float, float]) -> Mask | None:
        cell = self.frame.cell(*place_m)
        if cell is None or self.keepout[cell] < _KEPT_OUT:
            return None
        regions = connected_regions(self.keepout >= _KEPT_OUT)
        return np.asarray(regions == regions[cell])


def zones_of(
    frame: GridFrame,
    max_speed_m_s: float,
    keepout_zones: Sequence[KeepoutZone] = (),
    speed_zones: Sequence[SpeedZone] = (),
    keepout_masks: Sequence[NamedMask] = (),
    speed_masks: Sequence[NamedMask] = (),
) -> Zones | None:
    """All zones on a costmap's grid, where several are the strictest; None: there are none.

    Args:
        frame: the costmap's grid.
        max_speed_m_s: of which limits in percent are.
        keepout_zones: of the world.
        speed_zones: of the world.
        keepout_masks: of type 0.
        speed_masks: of type 1 or 2.

    Raises ValueError with a phrase for a mask of another type.
    """
    shape = (frame.rows, frame.columns)
    names: list[tuple[str, Mask]] = []
    keepout: Cells = np.zeros(shape if keepout_zones or keepout_masks else (0, 0), np.int8)
    limits = np.full(shape if speed_zones or speed_masks else (0, 0), math.inf)
    for zone in keepout_zones:
        names.append((f"keepout zone {zone.name}", cells_of(zone.polygon_m, frame)))
        keepout[names[-1][1]] = _KEPT_OUT
    for named in keepout_masks:
        values = keepout_values(named.mask, frame)
        names.append((f"the keepout zone of {named.name}", values >= _KEPT_OUT))
        keepout = np.maximum(keepout, values)
    for slow in speed_zones:
        limit_m_s = slow.speed_limit_m_s or max_speed_m_s * (slow.percent or 100.0) / 100.0
        where = cells_of(slow.polygon_m, frame)
        limits[where] = np.minimum(limits[where], limit_m_s)
    for named in speed_masks:
        limits = np.minimum(limits, speed_limits(named.mask, frame, max_speed_m_s))
    if not keepout.size and not limits.size:
        return None
    return Zones(frame, keepout, tuple(names), limits)


def cells_of(polygon_m: Sequence[Point2], frame: GridFrame) -> Mask:
    """(rows, columns) cells that a polygon covers or cuts: one thinner than a cell is not lost."""
    return polygon_cells([frame.place(*corner) for corner in polygon_m], frame.rows, frame.columns)
