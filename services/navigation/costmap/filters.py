"""Costmap filters: keepout zones and speed limits from masks, by the rules of Nav2.

A mask is a map whose values, 0 to 100 and -1 for unknown, mean what `FilterInfo` says, as
nav2_msgs/CostmapFilterInfo does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from services.common.world.costmap import Cells
from services.common.world.grids import distance_cells
from services.navigation.costmap.costmap import (
    FREE_SPACE,
    INSCRIBED_INFLATED_OBSTACLE,
    LETHAL_OBSTACLE,
    Costs,
    GridFrame,
)

KEEPOUT, SPEED_PERCENT, SPEED_M_S = 0, 1, 2
"""Types of nav2_msgs/CostmapFilterInfo."""

NO_SPEED_LIMIT: Final = 0.0

MapMode = Literal["trinary", "scale", "raw"]


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


@dataclass(frozen=True, slots=True)
class SpeedLimit:
    """As nav2_msgs/SpeedLimit."""

    percentage: bool
    """Whether the limit is in percent of the highest speed, else in m/s."""
    speed_limit: float
    """0: no limit."""

    def linear_m_s(self, max_vel_m_s: float) -> float:
        """The highest speed under this limit."""
        if self.speed_limit == NO_SPEED_LIMIT:
            return max_vel_m_s
        if self.percentage:
            return max_vel_m_s * self.speed_limit / 100.0
        return min(max_vel_m_s, self.speed_limit)


def occupancy_of_picture(
    picture: NDArray[np.uint8],
    mode: MapMode = "trinary",
    negate: bool = False,
    occupied_thresh: float = 0.65,
    free_thresh: float = 0.25,
) -> Cells:
    """(rows, columns) occupancy values of a map's or mask's picture, by nav2_map_server's rules;
    row 0 is the lowest of the picture.

    Args:
        picture: (rows, columns) grey values.
        mode: trinary: 100, 0 or -1 by the thresholds. scale: 1 to 99 between them. raw: the grey
            value itself up to 100, else -1.
        negate: whether white is occupied.
        occupied_thresh: cells at least this dark are occupied.
        free_thresh: cells at most this dark are free.
    """
    grey = picture[::-1].astype(np.float64)
    if mode == "raw":
        return np.where(grey <= 100.0, grey, -1.0).astype(np.int8)
    dark = (grey if negate else 255.0 - grey) / 255.0
    between = np.full(grey.shape, -1.0)
    if mode == "scale":
        between = np.rint((dark - free_thresh) / (occupied_thresh - free_thresh) * 98.0 + 1.0)
    values = np.where(dark <= free_thresh, 0.0, between)
    return np.where(dark >= occupied_thresh, 100.0, values).astype(np.int8)


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
    lethal_override_cost: int | None = None,
) -> Costs:
    """(rows, columns) costs of a keepout mask on a costmap's grid: in proportion to the mask's
    value up to 254; 0 outside of it and where it is unknown.

    Args:
        mask: the zones.
        frame: the costmap's grid.
        half_width_m: cells this near to a lethal zone cost 253: not only base_footprint stays out,
            but the robot's side too. Nav2 has 0.
        lethal_override_cost: the cost of lethal cells, for a robot that stands in a zone and has to
            leave it; Nav2's override_lethal_cost has 252. None: 254.

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
    if lethal_override_cost is not None:
        costs[costs >= INSCRIBED_INFLATED_OBSTACLE] = lethal_override_cost
    return costs


def in_keepout(mask: FilterMask, x_m: float, y_m: float) -> bool:
    """Whether a place is in a lethal cell of a keepout mask."""
    cell = mask.frame.cell(x_m, y_m)
    return cell is not None and int(mask.cells[cell]) >= 100


def speed_limit(mask: FilterMask, x_m: float, y_m: float) -> SpeedLimit:
    """The limit at a place; none outside the mask, where it is unknown, and where its value is not
    a speed. A percentage beyond 100 is no limit.

    Raises ValueError with a phrase if the mask is not one of speeds.
    """
    mask.info.check()
    if mask.info.type == KEEPOUT:
        raise ValueError("type 0: must be 1 (percent) or 2 (m/s) for a speed mask")
    percentage = mask.info.type == SPEED_PERCENT
    cell = mask.frame.cell(x_m, y_m)
    value = -1 if cell is None else int(mask.cells[cell])
    limit = mask.info.base + mask.info.multiplier * value
    if value < 0 or limit <= 0.0 or (percentage and limit >= 100.0):
        return SpeedLimit(percentage, NO_SPEED_LIMIT)
    return SpeedLimit(percentage, limit)
