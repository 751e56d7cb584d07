"""A picture of a map made of a log: the trajectory, and the loops that were closed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mazebot.cli.map_picture import MapPicture

if TYPE_CHECKING:
    from mazebot.cli.map.build_run import Built

_WAY, _LOOP, _START = (200, 120, 40), (40, 40, 210), (60, 140, 20)


def draw_built(path: Path, built: Built) -> None:
    """Write a PNG: the way blue, loops red, the start a green dot.

    Raises ConfigError where it cannot be written.
    """
    grid = built.slam.grid()
    picture = MapPicture(grid.cells, grid.resolution_m, grid.origin)
    picture.line(built.poses[:, :2].tolist(), _WAY)
    places = {node.id: (node.pose.x_m, node.pose.y_m) for node in built.graph.nodes}
    for edge in built.graph.edges:
        if edge.kind == "loop":
            picture.line([places[edge.source], places[edge.target]], _LOOP)
    x_m, y_m, _ = built.poses[0].tolist()
    picture.dot(x_m, y_m, _START, 4)
    picture.write(path)
