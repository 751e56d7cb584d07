"""Cheapest ways over a grid of cells: whole numbers, so that every machine finds the same ones."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.kernels import kernel

Prices = NDArray[np.int32]
Distances = NDArray[np.int32]

STRAIGHT: Final = 100
"""What a step to a neighbour over a side costs at price 1.0, in hundredths of a cell."""
DIAGONAL: Final = 141
PRICE_ONE: Final = 16
"""Price 1.0: prices are sixteenths. 0: no way."""
HIGHEST_PRICE: Final = 96
FAR: Final = np.iinfo(np.int32).max
_BUCKETS: Final = 1024
"""More than the dearest step: DIAGONAL * HIGHEST_PRICE / PRICE_ONE."""


@kernel("void(int32[:, ::1], int64[::1], int64, int32[::1], int32[:, ::1])")
def _search(
    prices: Prices, sources: NDArray[np.int64], most: int, parents: Distances, distances: Distances
) -> None:
    """Dijkstra's search with buckets (Dial, 1969): each cell is in one list, that of its distance.

    Fills the distance of each cell from the nearest source, up to `most`, and the cell that it was
    reached from; -1 for a source.
    """
    rows, columns = prices.shape
    flat, cost = distances.reshape(-1), prices.reshape(-1)
    heads = np.full(_BUCKETS, -1, np.int32)
    after = np.full(flat.size, -1, np.int32)
    before = np.full(flat.size, -1, np.int32)
    flat[:] = FAR
    parents[:] = -1
    waiting = 0
    for source in sources:
        if cost[source] > 0 and flat[source] != 0:
            flat[source] = 0
            after[source] = heads[0]
            if heads[0] >= 0:
                before[heads[0]] = source
            heads[0] = source
            waiting += 1
    distance = 0
    while waiting > 0 and distance <= most:
        bucket = distance % _BUCKETS
        cell = heads[bucket]
        if cell < 0:
            distance += 1
            continue
        heads[bucket] = after[cell]
        if after[cell] >= 0:
            before[after[cell]] = -1
        waiting -= 1
        row, column = cell // columns, cell % columns
        for down in range(-1, 2):
            for right in range(-1, 2):
                r, c = row + down, column + right
                if (down == 0 and right == 0) or r < 0 or c < 0 or r >= rows or c >= columns:
                    continue
                if prices[r, c] <= 0:
                    continue
                length = STRAIGHT
                if down != 0 and right != 0:
                    if prices[row, c] <= 0 or prices[r, column] <= 0:
                        continue
                    length = DIAGONAL
                to = r * columns + c
                found = distance + length * (cost[cell] + cost[to]) // (2 * PRICE_ONE)
                old = flat[to]
                if found >= old:
                    continue
                if old != FAR:
                    if before[to] >= 0:
                        after[before[to]] = after[to]
                    else:
                        heads[old % _BUCKETS] = after[to]
                    if after[to] >= 0:
                        before[after[to]] = before[to]
                    waiting -= 1
                flat[to] = found
                parents[to] = cell
                place = found % _BUCKETS
                before[to] = -1
                after[to] = heads[place]
                if heads[place] >= 0:
                    before[heads[place]] = to
                heads[place] = to
                waiting += 1
    # What is still waiting has no settled distance.
    for bucket in range(_BUCKETS):
        cell = heads[bucket]
        while cell >= 0:
            flat[cell] = FAR
            cell = after[cell]


def search(prices: Prices, source: int, most: int = FAR - 1) -> tuple[Distances, Distances]:
    """(rows, columns) int32 cost of the cheapest way from a cell, FAR where none leads; and
    (rows * columns,) the index of the cell before each one, -1 at the source.

    Args:
        prices: (rows, columns) int32, in sixteenths; 0 where there is no way.
        source: index of the first cell, row by row.
        most: cells dearer than this are not searched.
    """
    distances = np.empty(prices.shape, np.int32)
    parents = np.empty(prices.size, np.int32)
    _search(prices, np.array([source], np.int64), most, parents, distances)
    return distances, parents


def way(parents: Distances, to: int) -> list[int]:
    """Indices of the cells from the source to a cell."""
    cells = [to]
    while parents[cells[-1]] >= 0:
        cells.append(int(parents[cells[-1]]))
    return cells[::-1]
