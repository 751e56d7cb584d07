"""The static layer: the cells of a map as costs, by Nav2's rules."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mazebot.common.world.costmap import Cells
from mazebot.navigation.costmap.costmap import LETHAL_OBSTACLE, NO_INFORMATION, Costs


@dataclass(frozen=True, slots=True)
class StaticParams:
    """How the values of a map become costs; names as in Nav2's costmap."""

    track_unknown_space: bool = True
    """Otherwise unknown cells are free."""
    lethal_cost_threshold: int = 100
    """A cell with at least this value is lethal."""
    trinary_costmap: bool = True
    """Otherwise values below the threshold cost in proportion."""
    unknown_cost_value: int = -1
    """The value of unknown cells, which is 255 in Nav2's unsigned bytes."""


NAV2_STATIC: Final = StaticParams()


def static_costs(cells: Cells, params: StaticParams) -> Costs:
    """(rows, columns) costs of (rows, columns) occupancy values."""
    values = np.arange(-128, 128)
    threshold = max(params.lethal_cost_threshold, 1)
    scaled = np.zeros(256) if params.trinary_costmap else values * (LETHAL_OBSTACLE / threshold)
    table = scaled.clip(0.0, 252.0).astype(np.uint8)
    table[values >= params.lethal_cost_threshold] = LETHAL_OBSTACLE
    unknown = values < 0 if params.unknown_cost_value < 0 else values == params.unknown_cost_value
    table[unknown] = NO_INFORMATION if params.track_unknown_space else 0
    return table[cells.astype(np.int16) + 128]
