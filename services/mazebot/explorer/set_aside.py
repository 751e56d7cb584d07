"""Frontiers that could not be reached: set aside until the map around them is another one."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mazebot.common.world.costmap import Cells
from mazebot.explorer.floor import Floor

_AROUND_M = 1.0
_CHANGED_CELLS = 8
"""A wall's cells come and go with noise: fewer are no change."""
_MOST_TRIES = 3
"""A place that has failed so often is given up, however the map changes."""
_SAME_M = 1.0


@dataclass(eq=False)
class _Place:
    target_m: tuple[float, float]
    around: Cells | None
    """None: as it is at the next look."""
    tries: int = 1
    open: bool = False
    """May be driven to again."""


class SetAside:
    """The places that are not to be driven to for now."""

    def __init__(self) -> None:
        self._places: list[_Place] = []

    def places(self) -> list[tuple[float, float, int]]:
        """x, y and number of tries of each place that has failed."""
        return [(*place.target_m, place.tries) for place in self._places]

    def restore(self, places: Iterable[tuple[float, float, int]]) -> None:
        """Set the places aside that `places` told of."""
        self._places = [_Place((x_m, y_m), None, tries) for x_m, y_m, tries in places]

    def targets_m(self) -> list[tuple[float, float]]:
        """(x, y) of the places that are set aside."""
        return [place.target_m for place in self._places if not place.open]

    def add(self, floor: Floor, target_m: tuple[float, float]) -> None:
        """Set a target aside that could not be reached, or seen."""
        around = _around(floor, target_m)
        for place in self._places:
            if math.dist(place.target_m, target_m) < _SAME_M:
                place.tries += 1
                place.around, place.target_m, place.open = around, target_m, False
                return
        self._places.append(_Place(target_m, around))

    def look(self, floor: Floor) -> bool:
        """Open the places around which the map has changed; whether there is one."""
        found = False
        for place in self._places:
            if place.open or place.tries >= _MOST_TRIES:
                continue
            now = _around(floor, place.target_m)
            if place.around is None:
                place.around = now
            if np.count_nonzero(now != place.around) >= _CHANGED_CELLS:
                place.open = found = True
        return found

    def open_untried(self) -> bool:
        """Let each place that has failed only once be tried once more; whether there is one."""
        found = False
        for place in self._places:
            if not place.open and place.tries == 1:
                place.open = found = True
        return found


def _around(floor: Floor, target_m: tuple[float, float]) -> Cells:
    """The square of cells around a place; unknown beyond the map."""
    reach = round(_AROUND_M / floor.resolution_m)
    # Maps of one run are aligned to whole cells, wherever they begin.
    row, column = floor.cell(*target_m)
    made = np.full((2 * reach + 1, 2 * reach + 1), -1, np.int8)
    rows, columns = floor.cells.shape
    top, left = max(row - reach, 0), max(column - reach, 0)
    part = floor.cells[top : min(row + reach + 1, rows), left : min(column + reach + 1, columns)]
    if part.size:
        down, right = top - (row - reach), left - (column - reach)
        made[down : down + part.shape[0], right : right + part.shape[1]] = part
    return made
