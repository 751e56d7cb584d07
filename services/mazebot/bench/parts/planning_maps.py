"""Maps to plan on: four kinds made by seed, and the files of the MovingAI benchmarks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.config import ConfigError

Solid = NDArray[np.bool_]

_PASSABLE = frozenset(".GS")
"""Terrain of MovingAI maps for ground units: floor, grass and shallow water."""
_FIELDS_OF_PROBLEM = 9


class Problem(NamedTuple):
    """One line of a .scen file."""

    start: tuple[int, int]
    """(row, column), row 0 at the top of the file."""
    goal: tuple[int, int]
    optimum: float
    """Length of the shortest 8-connected path that cuts no corners, in cells."""


def read_movingai_map(path: Path) -> Solid:
    """(rows, columns) obstacles of a .map file (Sturtevant, 2012).

    Raises ConfigError, in one line.
    """
    lines = _lines(path)
    header = dict(line.split(None, 1) for line in lines[:4] if len(line.split(None, 1)) == 2)
    try:
        rows, columns = int(header["height"]), int(header["width"])
    except (KeyError, ValueError):
        raise ConfigError(f"{path}: must begin with type, height, width and map") from None
    grid = lines[4 : 4 + rows]
    if rows < 1 or len(grid) < rows or any(len(line) != columns for line in grid):
        raise ConfigError(f"{path}: map: must be {rows} lines of {columns} characters")
    return np.array([[one not in _PASSABLE for one in line] for line in grid], np.bool_)


def read_movingai_scen(path: Path) -> list[Problem]:
    """The problems of a .scen file. Raises ConfigError, in one line."""
    problems = []
    for number, line in enumerate(_lines(path), 1):
        if line.startswith("version") or not line.strip():
            continue
        fields = line.split()
        try:
            if len(fields) != _FIELDS_OF_PROBLEM:
                raise ValueError
            x0, y0, x1, y1 = (int(field) for field in fields[4:8])
            problems.append(Problem((y0, x0), (y1, x1), float(fields[8])))
        except ValueError:
            raise ConfigError(
                f"{path}:{number}: must be bucket, map, width, height, start x and y, "
                "goal x and y, optimal length"
            ) from None
    return problems


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "must be text"
        raise ConfigError(f"{path}: cannot be read: {reason}") from error


def random_obstacles(side: int, random: np.random.Generator, share: float = 0.2) -> Solid:
    """Single cells, each occupied by the same chance."""
    return np.asarray(random.random((side, side)) < share)


def rooms(side: int, random: np.random.Generator, room: int = 16) -> Solid:
    """Square rooms with a door to most of their neighbours."""
    solid = np.zeros((side, side), np.bool_)
    for at in range(0, side, room):
        solid[at] = solid[:, at] = True
    for top in range(0, side, room):
        for left in range(0, side, room):
            across, along = random.integers(2, room - 2, 2)
            if random.random() < 0.8:
                solid[top : top + 1, left + across : left + across + 2] = False
            if random.random() < 0.8:
                solid[top + along : top + along + 2, left : left + 1] = False
    solid[0] = solid[:, 0] = solid[-1] = solid[:, -1] = True
    return solid


def maze(side: int, random: np.random.Generator, width: int = 6) -> Solid:
    """A perfect maze with a few loops, by randomised depth-first search."""
    pitch = width + 1
    count = (side - 1) // pitch
    solid = np.ones((side, side), np.bool_)
    seen = np.zeros((count, count), np.bool_)
    stack = [(0, 0)]
    seen[0, 0] = True
    for row in range(count):
        for column in range(count):
            top, left = row * pitch + 1, column * pitch + 1
            solid[top : top + width, left : left + width] = False
    while stack:
        row, column = stack[-1]
        beside = [(row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)]
        unseen = [(r, c) for r, c in beside if 0 <= r < count and 0 <= c < count and not seen[r, c]]
        if not unseen:
            stack.pop()
            continue
        to = unseen[int(random.integers(len(unseen)))]
        _open(solid, (row, column), to, pitch, width)
        seen[to] = True
        stack.append(to)
    for _ in range(count * count // 20):
        row, column = (int(one) for one in random.integers(0, count - 1, 2))
        to = (row + 1, column) if random.random() < 0.5 else (row, column + 1)
        _open(solid, (row, column), to, pitch, width)
    return solid


def _open(solid: Solid, one: tuple[int, int], other: tuple[int, int], pitch: int, w: int) -> None:
    top, left = (min(a, b) * pitch + 1 for a, b in zip(one, other, strict=True))
    if one[0] != other[0]:
        solid[top + w, left : left + w] = False
    else:
        solid[top : top + w, left + w] = False


def streets(side: int, random: np.random.Generator) -> Solid:
    """Houses at all angles, as on the benchmark's city maps."""
    solid = np.zeros((side, side), np.bool_)
    y, x = np.mgrid[:side, :side]
    for _ in range(60):
        at_x, at_y = random.random(2) * side
        half_x, half_y = (0.015 + 0.05 * random.random(2)) * side
        angle = float(random.random()) * np.pi
        c, s = np.cos(angle), np.sin(angle)
        along, across = c * (x - at_x) + s * (y - at_y), c * (y - at_y) - s * (x - at_x)
        solid |= (np.abs(along) < half_x) & (np.abs(across) < half_y)
    return solid


KINDS: dict[str, Callable[[int, np.random.Generator], Solid]] = {
    "random obstacles": random_obstacles,
    "rooms": rooms,
    "maze": maze,
    "streets": streets,
}
