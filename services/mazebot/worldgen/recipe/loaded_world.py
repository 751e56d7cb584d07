"""A loaded world, and one that is still being built."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import Planar, World
from mazebot.common.world.costmap import FREE
from mazebot.common.world.geometry import TriangleMesh
from mazebot.worldgen.map.occupancy import Grid
from mazebot.worldgen.recipe_model import Recipe

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class LoadedWorld:
    """A world, its assets, and its map as (rows, columns) cells of -1, 0 or 100."""

    world: World
    assets: dict[str, bytes]
    """PNG of textures and .npz of meshes, by their sha256 in hex."""
    map_cells: NDArray[np.int8]
    map_origin: SE2
    meshes: dict[str, TriangleMesh] = field(default_factory=dict)
    """Of the assets that are meshes, by their sha256 in hex."""
    recipe: Recipe | None = None
    """The recipe of the world, including overrides."""


@dataclass(frozen=True, eq=False)
class Draft:
    """A world, built as far as its problems allow."""

    recipe: Recipe
    world: World
    meshes: Mapping[str, TriangleMesh]
    grid: Grid
    cells: NDArray[np.int8]
    """(rows, columns) in the grid, built from the world even if there is a ready map."""
    map_cells: NDArray[np.int8]
    """Of the map used for navigation: the ready one, else `cells`."""
    map_resolution_m: float
    map_origin: SE2

    def is_free(self, place: Planar) -> bool:
        """Whether a pose is on free floor that is connected to the start."""
        cell = self.grid.cell(place.x_m, place.y_m)
        return cell is not None and bool(self.cells[cell] == FREE)
