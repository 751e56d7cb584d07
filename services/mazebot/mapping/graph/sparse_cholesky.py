"""Solves sparse, symmetric, positive definite equations of (3, 3) blocks: L D L^T, L with unit
blocks on its diagonal.

The elimination is that of T. Davis (Algorithm 849, ACM TOMS 31, 2005), with blocks for numbers; the
order is that of minimum degree. It is here because SciPy's SuperLU uses BLAS, whose last bits vary
by processor, and because blocks of three suit planar poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel

Ints = NDArray[np.int64]
Bits = NDArray[np.uint64]


class Structure(NamedTuple):
    """Where the blocks of a matrix are, in the order of elimination."""

    position: Ints
    """(n,) at which each variable is eliminated."""
    first: Ints
    """(n + 1,) the blocks above the diagonal in column k are first[k] to first[k + 1]."""
    row: Ints
    """(b,) rows of these blocks, ascending in each column."""
    slot: Ints
    """(p,) block of each pair of variables given."""
    parent: Ints
    """(n,) in the elimination tree; -1: none."""
    factor_first: Ints
    """(n + 1,) the blocks of L in column k are factor_first[k] to factor_first[k + 1]."""


@dataclass(frozen=True)
class Factor:
    """A factorised matrix."""

    structure: Structure
    rows: Ints
    """(b,) rows of the blocks of L, column by column."""
    blocks: Array
    """(b, 3, 3) of L."""
    inverses: Array
    """(n, 3, 3) of the blocks of D."""

    def solve(self, given: Array) -> Array:
        """Solve for (n, 3) right-hand sides by the original numbering."""
        position = self.structure.position
        x = np.empty((len(position), 3))
        x[position] = given
        _solve(self.structure.factor_first, self.rows, self.blocks, self.inverses, x)
        return np.asarray(x[position])


def analyse(count: int, pairs: Ints) -> Structure:
    """The structure of a matrix of `count` variables with blocks off the diagonal at these (p, 2)
    pairs of different variables.
    """
    order = _minimum_degree(count, np.ascontiguousarray(pairs))
    position = np.empty(count, np.int64)
    position[order] = np.arange(count)
    placed = position[pairs]
    keys = placed.max(axis=1) * count + placed.min(axis=1) if len(pairs) else np.empty(0, np.int64)
    unique, slot = np.unique(keys, return_inverse=True)
    row, column = unique % max(count, 1), unique // max(count, 1)
    first = np.zeros(count + 1, np.int64)
    np.cumsum(np.bincount(column, minlength=count), out=first[1:])
    parent = np.full(count, -1, np.int64)
    factor_first = np.zeros(count + 1, np.int64)
    np.cumsum(_column_counts(first, row, parent), out=factor_first[1:])
    return Structure(position, first, row, slot, parent, factor_first)


def factorize(structure: Structure, diagonal: Array, above: Array) -> Factor | None:
    """L D L^T of the (n, 3, 3) blocks of the diagonal and the (b, 3, 3) above it, both in the
    order of elimination; None where the matrix is not positive definite.
    """
    size = int(structure.factor_first[-1])
    rows, blocks = np.empty(size, np.int64), np.empty((size, 3, 3))
    inverses = np.empty_like(diagonal)
    definite = _factorize(
        structure.first,
        structure.row,
        structure.parent,
        structure.factor_first,
        diagonal,
        above,
        rows,
        blocks,
        inverses,
    )
    return Factor(structure, rows, blocks, inverses) if definite else None


@kernel("int64(uint64)")
def _ones(word: int) -> int:
    """How many bits are set: they are summed in pairs, fours and eights (Warren 2012, 5-1)."""
    x = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    ones: int = np.int64((x * np.uint64(0x0101010101010101)) >> np.uint64(56))  # type: ignore[assignment]
    return ones


@kernel("int64[::1](int64, int64[:, ::1])")
def _minimum_degree(count: int, pairs: Ints) -> Ints:
    """The order in which each variable eliminated is one of those with the fewest neighbours, the
    first of them by number. Neighbours are bits: eliminating a variable joins its neighbours.
    """
    words = (count + 63) // 64
    bits = np.zeros((count, words), np.uint64)
    one = np.uint64(1)
    for p in range(pairs.shape[0]):
        i, j = pairs[p, 0], pairs[p, 1]
        bits[i, j >> 6] |= one << np.uint64(j & 63)
        bits[j, i >> 6] |= one << np.uint64(i & 63)
    degree = np.zeros(count, np.int64)
    for i in range(count):
        for w in range(words):
            degree[i] += _ones(bits[i, w])
    order = np.empty(count, np.int64)
    neighbours = np.empty(count, np.int64)
    for k in range(count):
        best = -1
        for i in range(count):
            if degree[i] >= 0 and (best < 0 or degree[i] < degree[best]):
                best = i
        order[k] = best
        degree[best] = -1
        found = 0
        for w in range(words):
            word = bits[best, w]
            bit = 0
            while word != np.uint64(0):
                if word & one:
                    neighbours[found] = w * 64 + bit
                    found += 1
                word >>= one
                bit += 1
        for f in range(found):
            i = neighbours[f]
            total = 0
            for w in range(words):
                bits[i, w] |= bits[best, w]
            bits[i, best >> 6] &= ~(one << np.uint64(best & 63))
            bits[i, i >> 6] &= ~(one << np.uint64(i & 63))
            for w in range(words):
                total += _ones(bits[i, w])
            degree[i] = total
    return order


@kernel("int64[::1](int64[::1], int64[::1], int64[::1])")
def _column_counts(first: Ints, row: Ints, parent: Ints) -> Ints:
    """Blocks in each column of L; writes the elimination tree to `parent`."""
    count = first.size - 1
    counts = np.zeros(count, np.int64)
    flag = np.full(count, -1, np.int64)
    for k in range(count):
        flag[k] = k
        for p in range(first[k], first[k + 1]):
            i = row[p]
            while flag[i] != k:
                if parent[i] < 0:
                    parent[i] = k
                counts[i] += 1
                flag[i] = k
                i = parent[i]
    return counts


@kernel(
    "boolean(int64[::1], int64[::1], int64[::1], int64[::1], float64[:, :, ::1], "
    "float64[:, :, ::1], int64[::1], float64[:, :, ::1], float64[:, :, ::1])"
)
def _factorize(
    first: Ints,
    row: Ints,
    parent: Ints,
    factor_first: Ints,
    diagonal: Array,
    above: Array,
    rows: Ints,
    blocks: Array,
    inverses: Array,
) -> bool:
    count = first.size - 1
    partial = np.zeros((count, 3, 3))
    pattern = np.empty(count, np.int64)
    path = np.empty(count, np.int64)
    flag = np.full(count, -1, np.int64)
    filled = factor_first.copy()
    pivot = np.empty((3, 3))
    here = np.empty((3, 3))
    for k in range(count):
        top = count
        flag[k] = k
        _copy(diagonal[k], pivot)
        for p in range(first[k], first[k + 1]):
            i = row[p]
            _copy(above[p], partial[i])
            length = 0
            while flag[i] != k:
                path[length] = i
                length += 1
                flag[i] = k
                i = parent[i]
            while length > 0:
                length -= 1
                top -= 1
                pattern[top] = path[length]
        for t in range(top, count):
            i = pattern[t]
            _copy(partial[i], here)
            partial[i] = 0.0
            for p in range(factor_first[i], filled[i]):
                into = partial[rows[p]]
                block = blocks[p]
                for a in range(3):
                    for b in range(3):
                        into[a, b] -= (
                            block[a, 0] * here[0, b]
                            + block[a, 1] * here[1, b]
                            + block[a, 2] * here[2, b]
                        )
            block = blocks[filled[i]]
            inverse = inverses[i]
            for a in range(3):
                for b in range(3):
                    block[a, b] = (
                        here[0, a] * inverse[0, b]
                        + here[1, a] * inverse[1, b]
                        + here[2, a] * inverse[2, b]
                    )
            for a in range(3):
                for b in range(3):
                    pivot[a, b] -= (
                        block[a, 0] * here[0, b]
                        + block[a, 1] * here[1, b]
                        + block[a, 2] * here[2, b]
                    )
            rows[filled[i]] = k
            filled[i] += 1
        a, b, c = pivot[0, 0], pivot[0, 1], pivot[0, 2]
        d, e, f = pivot[1, 1], pivot[1, 2], pivot[2, 2]
        u, v, w = d * f - e * e, c * e - b * f, b * e - c * d
        determinant = a * u + b * v + c * w
        if not (a > 0.0 and a * d - b * b > 0.0 and determinant > 0.0):
            return False
        inverse = inverses[k]
        inverse[0, 0], inverse[0, 1], inverse[0, 2] = u, v, w
        inverse[1, 0], inverse[1, 1], inverse[1, 2] = v, a * f - c * c, b * c - a * e
        inverse[2, 0], inverse[2, 1], inverse[2, 2] = w, b * c - a * e, a * d - b * b
        for i in range(3):
            for j in range(3):
                inverse[i, j] /= determinant
    return True


@kernel("void(float64[:, ::1], float64[:, ::1])")
def _copy(block: Array, to: Array) -> None:
    """A block of 3 x 3: Numba takes a second to compile `to[:] = block`."""
    for a in range(3):
        for b in range(3):
            to[a, b] = block[a, b]


@kernel("void(int64[::1], int64[::1], float64[:, :, ::1], float64[:, :, ::1], float64[:, ::1])")
def _solve(first: Ints, rows: Ints, blocks: Array, inverses: Array, x: Array) -> None:
    count = x.shape[0]
    for i in range(count):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        for p in range(first[i], first[i + 1]):
            block, into = blocks[p], x[rows[p]]
            for a in range(3):
                into[a] -= block[a, 0] * x0 + block[a, 1] * x1 + block[a, 2] * x2
    for i in range(count - 1, -1, -1):
        inverse = inverses[i]
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        for a in range(3):
            x[i, a] = inverse[a, 0] * x0 + inverse[a, 1] * x1 + inverse[a, 2] * x2
        for p in range(first[i], first[i + 1]):
            block, other = blocks[p], x[rows[p]]
            for a in range(3):
                x[i, a] -= block[0, a] * other[0] + block[1, a] * other[1] + block[2, a] * other[2]
