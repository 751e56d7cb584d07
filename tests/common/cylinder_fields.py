"""Worlds of the shape of the BARN data set: cylinders in a field of 30 x 30 cells that a cellular
automaton has clumped together, a row of them along each side, open at both ends.

Perille, Truong, Xiao, Stone, Benchmarking Metric Ground Navigation (2020).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

CELLS = 30
CELL_M = 0.15
RADIUS_M = 0.075
SIDE_M = CELLS * CELL_M
ROBOT_RADIUS_M = 0.24
END_M = 1.0
"""Of open floor before and behind the field."""

_PASSAGE_M = 0.32
"""A disc of this radius gets from end to end of every field."""
_FINE = 8
"""Cells of the judge's grid to one of the field's."""


@dataclass(frozen=True, eq=False)
class CylinderField:
    """A field with its south-west corner at the origin, its ends to the south and to the north."""

    seed: int
    centres_m: NDArray[np.float64]
    """(n, 2)"""

    def write(self, folder: Path) -> Path:
        """Write it as a Gazebo world without a start or a place to drive to."""
        models = "".join(
            f"<model name='c{i}'><static>1</static><pose>{x:.4f} {y:.4f} 0.5 0 0 0</pose>"
            f"<link name='link'><collision name='c'>{_GEOMETRY}</collision>"
            f"<visual name='v'>{_GEOMETRY}</visual></link></model>\n"
            for i, (x, y) in enumerate(self.centres_m.tolist())
        )
        file = folder / f"field_{self.seed}.world"
        file.write_text(f"<sdf version='1.6'><world name='default'>\n{models}</world></sdf>\n")
        return file

    def pieces(self, radius_m: float = ROBOT_RADIUS_M) -> tuple[NDArray[np.int32], float]:
        """(rows, columns), the number of the piece of floor that a disc's centre may be on, and the
        side of a cell: judged on exact distances, over the field and its ends.
        """
        far_m, side_m = _distances(self.centres_m)
        return ndimage.label(far_m > radius_m)[0].astype(np.int32), side_m

    def piece_at(self, pieces: NDArray[np.int32], side_m: float, x_m: float, y_m: float) -> int:
        """Number of the piece that a point is on; 0: none."""
        row = math.floor((y_m + END_M) / side_m)
        column = math.floor((x_m + CELL_M) / side_m)
        rows, columns = pieces.shape
        return int(pieces[row, column]) if 0 <= row < rows and 0 <= column < columns else 0


_GEOMETRY = (
    f"<geometry><cylinder><radius>{RADIUS_M}</radius><length>1.0</length></cylinder></geometry>"
)


def cylinder_field(seed: int) -> CylinderField:
    """A field that a robot can cross, with pockets that it cannot come to; the same for a seed."""
    rng = np.random.default_rng([seed, 0xBA])
    while True:
        taken = rng.random((CELLS, CELLS)) < rng.uniform(0.2, 0.3)
        for _ in range(int(rng.integers(1, 3))):
            beside = ndimage.convolve(taken.astype(int), np.ones((3, 3), int), mode="constant")
            taken = np.where(taken, beside >= 3, beside >= 5)
        rows, columns = np.nonzero(taken)
        inside = np.stack([columns + 0.5, rows + 0.5], axis=1) * CELL_M
        along = (np.arange(CELLS) + 0.5) * CELL_M
        sides = [
            np.stack([np.full(CELLS, x_m), along], axis=1)
            for x_m in (-CELL_M / 2.0, SIDE_M + CELL_M / 2.0)
        ]
        centres_m = np.concatenate([inside, *sides])
        far_m, side_m = _distances(centres_m)
        passage = ndimage.label(far_m > _PASSAGE_M)[0]
        middle = passage.shape[1] // 2
        sizes = np.bincount(ndimage.label(far_m > ROBOT_RADIUS_M)[0].ravel())[1:]
        pockets = (sizes * side_m**2 > 0.02).sum() - 1
        if passage[0, middle] == passage[-1, middle] > 0 and pockets > 0:
            return CylinderField(seed, centres_m)


def _distances(centres_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """(rows, columns), from each cell's middle to the nearest cylinder, and the side of a cell."""
    side_m = CELL_M / _FINE
    x_m = np.arange(side_m / 2.0, SIDE_M + 2.0 * CELL_M, side_m) - CELL_M
    y_m = np.arange(side_m / 2.0, SIDE_M + 2.0 * END_M, side_m) - END_M
    middles = np.stack(np.meshgrid(x_m, y_m), axis=-1)
    return np.asarray(cKDTree(centres_m).query(middles)[0]) - RADIUS_M, side_m
