"""Costmap filters: keepout zones and speed limits from masks, by the rules of Nav2.

A mask is a map whose values, 0 to 100 and -1 for unknown, have the meaning that `FilterInfo`
gives, as nav2_msgs/CostmapFilterInfo does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mazebot.common.world.costmap import Cells
from mazebot.common.world.grids import distance_cells
from mazebot.navigation.costmap.costmap import (
    FREE_SPACE,
    INSCRIBED_INFLATED_OBSTACLE,
    LETHAL_OBSTACLE,
    Costs,
    GridFrame,
)

KEEPOUT, SPEED_PERCENT, SPEED_M_S = 0, 1, 2
"""Types of nav2_msgs/CostmapFilterInfo."""

_T = TypeVar("_T", bound=np.generic)


@dataclass(frozen=True, slots=True)
class FilterInfo:
    """How the values of a mask are meant: base + multiplier * value."""

    type: int = KEEPOUT
    base: float = 0.0
    multiplier: float = 1.0

    def check(self) -> None:
        """Raises ValueError with a phrase that names the field."""
        if self.type not in (KEEPOUT, SPEED_PERCENT, SPEED_M_S):
            raise ValueError(
                f"type {self.type}: must be 0 (keepout), 1 (speed in percent) or 2 (speed in m/s)"
            )
        for name, value in (("base", self.base), ("multiplier", self.multiplier)):
            if not math.isfinite(value):
                raise ValueError(f"{name} {value}: must be a finite number")
        if self.type == KEEPOUT and (self.base, self.multiplier) != (0.0, 1.0):
            raise ValueError(
                f"base {self.base:g}, multiplier {self.multiplier:g}: must be 0 and 1 for keepout"
            )


@dataclass(frozen=True, slots=True)
class FilterMask:
    """A mask in the map frame."""

    frame: GridFrame
    cells: Cells
    """(rows, columns) int8, 0 to 100, -1 unknown."""
    info: FilterInfo


def on_grid(
    values: NDArray[_T], of: GridFrame, frame: GridFrame, strictest: np.ufunc, beyond: float
) -> NDArray[_T]:
    """(rows, columns) values of a mask on another grid: those at its cells' centres; of a mask
    with a finer grid the strictest in each cell, so that a thin line is not lost.

    Args:
        values: (rows, columns) of the mask.
        of: its grid.
        frame: the other grid.
        strictest: of two values, such as np.maximum.
        beyond: the value where there is no mask.
    """
    if of.resolution_m < frame.resolution_m:
        across = _first_within(
            frame.origin_x_m - of.origin_x_m, frame.columns, frame, of.columns, of
        )
        up = _first_within(frame.origin_y_m - of.origin_y_m, frame.rows, frame, of.rows, of)
        within = _reduced(values, up, strictest, beyond)
        return _reduced(within.T, across, strictest, beyond).T
    x = frame.origin_x_m + (np.arange(frame.columns) + 0.5) * frame.resolution_m
    y = frame.origin_y_m + (np.arange(frame.rows) + 0.5) * frame.resolution_m
    columns = np.floor((x - of.origin_x_m) / of.resolution_m).astype(np.int64)
    rows = np.floor((y - of.origin_y_m) / of.resolution_m).astype(np.int64)
    inside = ((rows >= 0) & (rows < of.rows))[:, None] & (columns >= 0) & (columns < of.columns)
    found = values[np.ix_(rows.clip(0, of.rows - 1), columns.clip(0, of.columns - 1))]
    return np.where(inside, found, values.dtype.type(beyond))


def _first_within(
    from_mask_m: float, count: int, frame: GridFrame, of_count: int, of: GridFrame
) -> NDArray[np.int64]:
    """(count + 1,) of each of a grid's rows, and of the one after the last, the first row of a
    mask whose centre is in it or after it; of columns as well.
    """
    begin_m = from_mask_m + np.arange(count + 1) * frame.resolution_m
    first = np.ceil(begin_m / of.resolution_m - 0.5)
    return np.asarray(first.clip(0, of_count), np.int64)


def _reduced(
    values: NDArray[_T], first: NDArray[np.int64], strictest: np.ufunc, beyond: float
) -> NDArray[_T]:
    """The strictest of the rows from each of `first` to the next one; `beyond` of none."""
    none = np.full((1, values.shape[1]), beyond, values.dtype)
    found = strictest.reduceat(np.concatenate([values, none]), first, axis=0)[:-1]
    return np.where((first[:-1] < first[1:])[:, None], found, none)


def keepout_values(mask: FilterMask, frame: GridFrame) -> Cells:
    """(rows, columns) values of a keepout mask on a costmap's grid; 0 beyond the mask."""
    return on_grid(mask.cells, mask.frame, frame, np.maximum, 0)


def speed_limits(mask: FilterMask, frame: GridFrame, max_speed_m_s: float) -> NDArray[np.float64]:
    """(rows, columns) m/s, the limits of a speed mask on a costmap's grid; infinite where there is
    none: beyond the mask, where it is 0 or unknown, or where the limit is 0 or less, or 100 percent
    and more.

    Raises ValueError with a phrase if the mask is not one of speed limits.
    """
    mask.info.check()
    if mask.info.type == KEEPOUT:
        raise ValueError("type 0: must be 1 (percent) or 2 (m/s) for a speed mask")
    limits = mask.info.base + mask.info.multiplier * mask.cells.astype(np.float64)
    none = (mask.cells <= 0) | (limits <= 0.0)
    if mask.info.type == SPEED_PERCENT:
        none |= limits >= 100.0
        limits *= max_speed_m_s / 100.0
    limits[none] = math.inf
    return on_grid(limits, mask.frame, frame, np.minimum, math.inf)


def keepout_costs(
    mask: FilterMask,
    frame: GridFrame,
    half_width_m: float = 0.0,
) -> Costs:
    """(rows, columns) costs of a keepout mask on a costmap's grid: in proportion to the mask's
    value up to 254; 0 outside of it and where it is unknown.

    Args:
        mask: the zones.
        frame: the costmap's grid.
        half_width_m: cells this near to a lethal zone cost 253: not only base_footprint stays out,
            but the robot's side too. Nav2 has 0.

    Raises ValueError with a phrase if the mask is not one of keepout zones.
    """
    mask.info.check()
    if mask.info.type != KEEPOUT:
        raise ValueError(f"type {mask.info.type}: must be 0 for a keepout mask")
    values = keepout_values(mask, frame)
    scaled = np.rint(values.astype(np.float64) * (LETHAL_OBSTACLE / 100.0))
    costs = scaled.clip(FREE_SPACE, LETHAL_OBSTACLE).astype(np.uint8)
    lethal = costs == LETHAL_OBSTACLE
    if half_width_m > 0.0 and lethal.any():
        near = distance_cells(lethal) * frame.resolution_m <= half_width_m
        costs[near & ~lethal] = INSCRIBED_INFLATED_OBSTACLE
    return costs
