"""Costmap filters: keepout zones and speed limits from masks, by the rules of Nav2.

A mask is a map whose values, 0 to 100 and -1 for unknown, have the meaning that `FilterInfo`
gives, as nav2_msgs/CostmapFilterInfo does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

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


def on_grid(mask: FilterMask, frame: GridFrame) -> Cells:
    """(rows, columns) values of a mask at the centres of another grid's cells; 0 beyond it."""
    x = frame.origin_x_m + (np.arange(frame.columns) + 0.5) * frame.resolution_m
    y = frame.origin_y_m + (np.arange(frame.rows) + 0.5) * frame.resolution_m
    of = mask.frame
    columns = np.floor((x - of.origin_x_m) / of.resolution_m).astype(np.int64)
    rows = np.floor((y - of.origin_y_m) / of.resolution_m).astype(np.int64)
    inside = ((rows >= 0) & (rows < of.rows))[:, None] & (columns >= 0) & (columns < of.columns)
    found = mask.cells[np.ix_(rows.clip(0, of.rows - 1), columns.clip(0, of.columns - 1))]
    return np.where(inside, found, np.int8(0))


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
    values = on_grid(mask, frame)
    scaled = np.rint(values.astype(np.float64) * (LETHAL_OBSTACLE / 100.0))
    costs = scaled.clip(FREE_SPACE, LETHAL_OBSTACLE).astype(np.uint8)
    lethal = costs == LETHAL_OBSTACLE
    if half_width_m > 0.0 and lethal.any():
        near = distance_cells(lethal) * frame.resolution_m <= half_width_m
        costs[near & ~lethal] = INSCRIBED_INFLATED_OBSTACLE
    return costs
