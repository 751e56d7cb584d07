"""Smooths a path that was planned elsewhere (Nav2's SmoothPath)."""

from __future__ import annotations

import numpy as np

from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.grid.search_grid import NO_PRICE, SOLID, search_grid
from mazebot.navigation.planning.grid.smoothing import densified, rounded
from mazebot.navigation.planning.path import PlannedPath, path_through

_NAMES = ("simple_smoother", "SmoothPath")
"""In Nav2's parameters and trees; all stand for the one smoother that there is."""
_GIVE_CELLS = 0.5
"""By so much a point may come nearer to an obstacle than it was."""


def check_smoother(smoother_id: str) -> None:
    """Raise NavigationError with INVALID_SMOOTHER where no smoother has this name."""
    if smoother_id and smoother_id not in _NAMES:
        raise NavigationError(
            ErrorCode.INVALID_SMOOTHER,
            f"smoother_id: {smoother_id!r:.60}: must be empty or one of {', '.join(_NAMES)}",
        )


def smoothed(
    costmap: Costmap, path: PlannedPath, spacing_m: float, safe_m: float, passes: int
) -> PlannedPath:
    """The path with points at even distances and round corners; its ends stay.

    Args:
        costmap: what is where.
        path: of two points or more.
        spacing_m: longest distance of its points.
        safe_m: no point comes nearer to an obstacle, unless it was.
        passes: most of the relaxation; 0 makes the distances even and no more.

    Raises NavigationError with FAILED_TO_SMOOTH_PATH where a point is outside the map.
    """
    grid = search_grid(costmap, 0.0, allow_unknown=True)
    for x_m, y_m in path.points_m.tolist():
        if grid.cell(x_m, y_m) is None:
            raise NavigationError(
                ErrorCode.FAILED_TO_SMOOTH_PATH,
                f"path: ({x_m:.2f}, {y_m:.2f}) is outside the map",
                (x_m, y_m),
            )
    resolution_m = grid.frame.resolution_m
    points = np.array([grid.at(x_m, y_m) for x_m, y_m in path.points_m.tolist()])
    dense = densified(points, max(spacing_m / resolution_m, 0.5))
    smooth = rounded(
        grid.cells, SOLID, NO_PRICE, costmap.clearance_m, safe_m, _GIVE_CELLS * resolution_m,
        dense, passes,
    )  # fmt: skip
    return path_through(grid.in_map(smooth), float(path.yaws_rad[-1]))
