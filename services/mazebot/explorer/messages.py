"""The frontiers as messages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mazebot.common.maths.frames import MAP_FRAME, Array
from mazebot.common.messages import messages as msg
from mazebot.explorer.exploration import Aim, Survey
from mazebot.explorer.floor import Floor
from mazebot.explorer.frontiers import Frontier

_MOST_POINTS = 1000
_WIDTH_M, _CHOSEN_WIDTH_M = 0.05, 0.15
_Z_M = 0.03
_GREEN, _RED, _BLUE = (0.2, 0.8, 0.3, 1.0), (0.9, 0.2, 0.2, 1.0), (0.2, 0.4, 1.0, 1.0)


def frontiers_message(now_ns: int, seen: Survey, aim: Aim | None) -> msg.MarkerArray:
    """Cells to be seen: green those that the robot will go to, red the others; and in blue the
    goal. At most 1000 points of each colour.
    """
    red = {*seen.unseen, *seen.aside, *seen.open, *seen.far}
    green = [one for i, one in enumerate(seen.frontiers) if i not in red]
    others = [seen.frontiers[i] for i in sorted(red)]
    chosen = np.empty((0, 2)) if aim is None else np.array([aim.pose[:2]])
    return msg.marker_array(
        [
            _points(now_ns, "reachable", _places(seen.floor, green), _WIDTH_M, _GREEN),
            _points(now_ns, "set_aside", _places(seen.floor, others), _WIDTH_M, _RED),
            _points(now_ns, "chosen", chosen, _CHOSEN_WIDTH_M, _BLUE),
        ]
    )


def _places(floor: Floor, frontiers: list[Frontier]) -> Array:
    """(n, 2) centres of their cells in the map."""
    if not frontiers:
        return np.empty((0, 2))
    cells = np.concatenate([one.cells for one in frontiers])
    cells = cells[:: -(-len(cells) // _MOST_POINTS)]
    origin = np.array([floor.origin_x_m, floor.origin_y_m])
    return np.asarray((cells[:, ::-1] + 0.5) * floor.resolution_m + origin)


def _points(
    now_ns: int, name: str, places_m: Array, width_m: float,
    color: tuple[float, float, float, float],
) -> msg.Marker:  # fmt: skip
    points_m = np.column_stack([places_m, np.full(len(places_m), _Z_M)])
    line = msg.line_strip(now_ns, MAP_FRAME, name, 0, points_m, width_m, color)
    return replace(line, type=msg.Marker.POINTS, scale=msg.Vector3(width_m, width_m, 0.0))
