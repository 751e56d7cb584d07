"""Worlds without an outer wall, and furnished ones, generated for the benchmark of SLAM."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

Rectangle = tuple[float, float, float, float]
"""Least x and y, greatest x and y, in metres."""

_WALL_M: Final = 0.15
_FIELD_M: Final = (2.2, 2.4)
_APART_M: Final = 0.62
"""Between two pieces of furniture, so that the robot fits through."""
_PIECES_M: Final = ((1.6, 0.8), (0.45, 0.45), (1.2, 0.5), (0.6, 0.6), (0.08, 0.08), (2.0, 0.9))
_SOURCE: Final = {
    "materials": {"plain": {"ambient": [0.6, 0.6, 0.6, 1.0], "diffuse": [0.7, 0.7, 0.7, 1.0]}},
    "wall_materials": ["plain"],
    "wall_height_m": 1.0,
}


def _recipe(
    name: str, start: tuple[float, float, float], solids: list[tuple[Rectangle, float]]
) -> dict[str, Any]:
    """A recipe of upright boxes, each turned about its middle (rad)."""
    boxes = [
        {
            "name": f"solid{number}",
            "size_m": [right - left, back - front, 1.0],
            "x_m": (left + right) / 2.0,
            "y_m": (front + back) / 2.0,
            "yaw_rad": yaw_rad,
            "material": "plain",
        }
        for number, ((left, front, right, back), yaw_rad) in enumerate(solids)
    ]
    pose = dict(zip(("x_m", "y_m", "yaw_rad"), start, strict=True))
    return {"name": name, "start": pose, "boxes": boxes, **_SOURCE}


def _outer_walls(width_m: float, depth_m: float) -> list[Rectangle]:
    x, y, t = width_m / 2.0, depth_m / 2.0, _WALL_M
    return [(-x, y - t, x, y), (-x, t - y, t - x, y - t), (x - t, t - y, x, y - t)]


def yard(seed: int) -> dict[str, Any]:
    """A house of 8 by 6 m with four rooms in a yard without a fence; the robot is at its door."""
    random = np.random.default_rng(seed)
    t = _WALL_M
    door_m, cross_m = random.uniform(-2.0, 0.5), random.uniform(0.6, 1.4)
    walls = [
        *_outer_walls(8.0, 6.0),
        (-4.0, -3.0, door_m - 0.5, t - 3.0), (door_m + 0.5, -3.0, 4.0, t - 3.0),
        (t - 4.0, 0.0, -2.6, t), (-1.6, 0.0, 1.4, t), (2.4, 0.0, 4.0 - t, t),
        (-0.1, t, 0.05, 3.0 - t), (cross_m, t - 3.0, cross_m + t, -1.2),
        (2.4, 1.2, 3.4, 2.0), (-2.6, 1.5, -1.4, 2.2),
    ]  # fmt: skip
    return _recipe("yard", (door_m, -4.0, 1.5708), [(wall, 0.0) for wall in walls])


def field(seed: int) -> dict[str, Any]:
    """45 thin posts on 4.4 by 4.8 m of open floor, as in BARN's worlds; the robot is before it."""
    random = np.random.default_rng(seed)
    places: list[tuple[float, float]] = []
    while len(places) < 45:
        place = random.uniform(-_FIELD_M[0], _FIELD_M[0]), random.uniform(-_FIELD_M[1], _FIELD_M[1])
        if all(math.dist(place, other) > 0.3 for other in places):
            places.append(place)
    posts = [
        ((x - 0.07, y - 0.07, x + 0.07, y + 0.07), float(random.uniform(0.0, 1.5)))
        for x, y in places
    ]
    return _recipe("field", (0.0, -3.6, 1.5708), posts)


def open_floor(seed: int) -> dict[str, Any]:
    """One box on a floor without an edge."""
    random = np.random.default_rng(seed)
    side_m, away_m = random.uniform(0.3, 1.0), random.uniform(1.5, 3.0)
    box = (away_m, -side_m / 2.0, away_m + side_m, side_m / 2.0)
    return _recipe("open_floor", (0.0, 0.0, float(random.uniform(-3.1, 3.1))), [(box, 0.0)])


def furnished(seed: int) -> dict[str, Any]:
    """Two rooms of 4.5 by 7 m with tables, cupboards, chairs and lamps."""
    random = np.random.default_rng(seed)
    width_m, depth_m, t = 9.0, 7.0, _WALL_M
    half_m = depth_m / 2.0
    walls = [
        *_outer_walls(width_m, depth_m), (-width_m / 2.0, -half_m, width_m / 2.0, t - half_m),
        (0.0, t - half_m, t, -0.6), (0.0, 0.5, t, half_m - t),
    ]  # fmt: skip
    start = (-3.0, -2.0)
    pieces: list[Rectangle] = []
    for _ in range(400):
        across_m, along_m = _PIECES_M[int(random.integers(len(_PIECES_M)))]
        x = random.uniform(
            -width_m / 2.0 + across_m / 2.0 + 0.2, width_m / 2.0 - across_m / 2.0 - 0.2
        )
        y = random.uniform(-half_m + along_m / 2.0 + 0.2, half_m - along_m / 2.0 - 0.2)
        in_the_door = abs(x) < across_m / 2.0 + 0.7 and abs(y) < 1.3
        if in_the_door or math.dist((x, y), start) < 1.5 or len(pieces) == 12:
            continue
        piece = (x - across_m / 2.0, y - along_m / 2.0, x + across_m / 2.0, y + along_m / 2.0)
        if all(_are_apart(piece, other) for other in pieces):
            pieces.append(piece)
    return _recipe("furnished", (*start, 0.0), [(solid, 0.0) for solid in (*walls, *pieces)])


def _are_apart(one: Rectangle, other: Rectangle) -> bool:
    return (
        one[0] - _APART_M > other[2]
        or other[0] - _APART_M > one[2]
        or one[1] - _APART_M > other[3]
        or other[1] - _APART_M > one[3]
    )


GENERATED: Final[dict[str, Callable[[int], dict[str, Any]]]] = {
    "yard": yard,
    "field": field,
    "open_floor": open_floor,
    "furnished": furnished,
}
"""By the name in the tables."""
WITHOUT_EDGE: Final = ("yard", "field", "open_floor")


def written(world: str, seed: int, folder: Path) -> Path:
    """A recipe's file with one of GENERATED."""
    file = folder / f"{world}.yaml"
    recipe = yaml.safe_dump(_plain(GENERATED[world](seed)))
    file.write_text(recipe, encoding="utf-8")
    return file


def _plain(value: Any) -> Any:
    """The same without NumPy's numbers, rounded to a millimetre."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return round(float(value), 3) if isinstance(value, float) else value
