"""Random spanning trees of a grid of cells, and shortest paths through its passages.

Cells are counted row by row: cell = row * columns + column. `right_open[row, column]` is true if
the cell and the next one along x are joined, `up_open[row, column]` the next one along y.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.kernels import kernel

Bits = NDArray[np.bool_]

_RIGHT, _UP, _LEFT, _DOWN = 0, 1, 2, 3


def wilson(rows: int, columns: int, seed: int) -> tuple[Bits, Bits]:
    """(right_open, up_open) of a spanning tree; each of all spanning trees is equally likely.

    Wilson, Generating random spanning trees more quickly than the cover time (STOC 1996): loop-
    erased random walks from each cell to the existing tree.
    """
    return _grown(_wilson, rows, columns, seed)


def recursive_backtracker(rows: int, columns: int, seed: int) -> tuple[Bits, Bits]:
    """(right_open, up_open) of a spanning tree with long paths: a random depth-first search."""
    return _grown(_backtracker, rows, columns, seed)


def _grown(
    grow: Callable[[Bits, Bits, NDArray[np.uint8]], bool], rows: int, columns: int, seed: int
) -> tuple[Bits, Bits]:
    """If the random directions do not suffice, the same ones are drawn again, and more."""
    count = 16 * rows * columns
    while True:
        right_open = np.zeros((rows, columns), np.bool_)
        up_open = np.zeros((rows, columns), np.bool_)
        if grow(right_open, up_open, _directions(seed, count)):
            return right_open, up_open
        count *= 2


def _directions(seed: int, count: int) -> NDArray[np.uint8]:
    """Directions 0 to 3, each equally likely: bits of PCG64, whose stream numpy never changes."""
    shifts = np.arange(0, 64, 2).astype(np.uint64)
    words: NDArray[np.uint64] = np.random.PCG64(seed).random_raw(-(-count // len(shifts)))
    directions: NDArray[np.uint8] = (words[:, None] >> shifts & np.uint64(3)).astype(np.uint8)
    return directions.ravel()


@kernel()
def _neighbour(cell: int, direction: int, rows: int, columns: int) -> int:
    """The cell next to one; -1 outside the grid."""
    row, column = cell // columns, cell % columns
    if direction == _RIGHT:
        return cell + 1 if column + 1 < columns else -1
    if direction == _UP:
        return cell + columns if row + 1 < rows else -1
    if direction == _LEFT:
        return cell - 1 if column > 0 else -1
    return cell - columns if row > 0 else -1


@kernel()
def _open(right_open: Bits, up_open: Bits, cell: int, direction: int) -> None:
    columns = right_open.shape[1]
    row, column = cell // columns, cell % columns
    if direction == _RIGHT:
        right_open[row, column] = True
    elif direction == _UP:
        up_open[row, column] = True
    elif direction == _LEFT:
        right_open[row, column - 1] = True
    else:
        up_open[row - 1, column] = True


@kernel()
def _wilson(right_open: Bits, up_open: Bits, directions: NDArray[np.uint8]) -> bool:
    """False if the directions do not suffice. One that leads out of the grid is drawn again, so
    that each neighbour is equally likely.
    """
    rows, columns = right_open.shape
    in_tree = np.zeros(rows * columns, np.bool_)
    last_exit = np.zeros(rows * columns, np.uint8)
    in_tree[rows // 2 * columns + columns // 2] = True
    drawn = 0
    for first in range(rows * columns):
        cell = first
        while not in_tree[cell]:
            if drawn == len(directions):
                return False
            direction = directions[drawn]
            drawn += 1
            following = _neighbour(cell, direction, rows, columns)
            if following >= 0:
                last_exit[cell] = direction
                cell = following
        # Following the last exits leaves out the walk's loops.
        cell = first
        while not in_tree[cell]:
            in_tree[cell] = True
            _open(right_open, up_open, cell, last_exit[cell])
            cell = _neighbour(cell, last_exit[cell], rows, columns)
    return True


@kernel()
def _backtracker(right_open: Bits, up_open: Bits, directions: NDArray[np.uint8]) -> bool:
    """False if the directions do not suffice."""
    rows, columns = right_open.shape
    visited = np.zeros(rows * columns, np.bool_)
    stack = np.zeros(rows * columns, np.int64)
    depth = 1
    visited[0] = True
    drawn = 0
    while depth > 0:
        cell = stack[depth - 1]
        closed_in = True
        for direction in range(4):
            following = _neighbour(cell, direction, rows, columns)
            closed_in &= following < 0 or visited[following]
        if closed_in:
            depth -= 1
            continue
        while True:
            if drawn == len(directions):
                return False
            direction = directions[drawn]
            drawn += 1
            following = _neighbour(cell, direction, rows, columns)
            if following >= 0 and not visited[following]:
                break
        _open(right_open, up_open, cell, direction)
        visited[following] = True
        stack[depth] = following
        depth += 1
    return True


@kernel()
def _joined(right_open: Bits, up_open: Bits, cell: int, direction: int) -> bool:
    columns = right_open.shape[1]
    row, column = cell // columns, cell % columns
    if direction == _RIGHT:
        return bool(right_open[row, column])
    if direction == _UP:
        return bool(up_open[row, column])
    if direction == _LEFT:
        return bool(column > 0 and right_open[row, column - 1])
    return bool(row > 0 and up_open[row - 1, column])


@kernel()
def _search(
    right_open: Bits,
    up_open: Bits,
    source: int,
    steps: NDArray[np.int32],
    queue: NDArray[np.int32],
) -> int:
    """Fill `steps` with the passages from a cell to each (-1: no path); the farthest cell."""
    rows, columns = right_open.shape
    steps[:] = -1
    steps[source] = 0
    queue[0] = source
    head, tail = 0, 1
    while head < tail:
        cell = queue[head]
        head += 1
        for direction in range(4):
            if _joined(right_open, up_open, cell, direction):
                following = _neighbour(cell, direction, rows, columns)
                if steps[following] < 0:
                    steps[following] = steps[cell] + 1
                    queue[tail] = following
                    tail += 1
    return int(queue[tail - 1])


@kernel()
def _farthest_of_all(right_open: Bits, up_open: Bits, inside: Bits) -> tuple[int, int]:
    count = right_open.size
    steps, queue = np.empty(count, np.int32), np.empty(count, np.int32)
    best, first, second = -1, 0, 0
    for source in range(count):
        if inside.flat[source]:
            last = _search(right_open, up_open, source, steps, queue)
            if steps[last] > best:
                best, first, second = steps[last], source, last
    return first, second


def farthest_pair(
    right_open: Bits, up_open: Bits, inside: Bits, every_cell: bool
) -> tuple[int, int]:
    """Two cells with the longest shortest path between them, of cells that are all connected.

    Searches from every cell, or else from any one to its farthest and from there to the farthest
    again: exact for trees, and a lower bound with loops.
    """
    if every_cell:
        return _farthest_of_all(right_open, up_open, inside)
    steps, queue = np.empty(inside.size, np.int32), np.empty(inside.size, np.int32)
    first = _search(right_open, up_open, int(np.argmax(inside)), steps, queue)
    return first, _search(right_open, up_open, first, steps, queue)


def way(right_open: Bits, up_open: Bits, start: int, goal: int) -> NDArray[np.int32]:
    """Cells of a shortest path from start to goal, including both."""
    steps, queue = np.empty(right_open.size, np.int32), np.empty(right_open.size, np.int32)
    _search(right_open, up_open, goal, steps, queue)
    cells = [start]
    while cells[-1] != goal:
        for direction in range(4):
            if _joined(right_open, up_open, cells[-1], direction):
                following = _neighbour(cells[-1], direction, *right_open.shape)
                if steps[following] == steps[cells[-1]] - 1:
                    cells.append(following)
                    break
    return np.array(cells, np.int32)
