"""Pictures of a map with what happened on it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.config import ConfigError
from mazebot.common.files.folder_writing import write_file
from mazebot.common.maths.frames import SE2

_LONGEST_PX = 1600
_MARGIN_CELLS = 10
Colour = tuple[int, int, int]
"""Blue, green, red."""


class MapPicture:
    """The map's known part in greys, to be drawn on in the map's coordinates."""

    def __init__(self, cells: NDArray[np.int8], resolution_m: float, origin: SE2) -> None:
        """`cells`: (rows, columns) 0 to 100, -1 unknown; `origin`: map_from_grid."""
        known = cells >= 0
        rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        (top, bottom), (left, right) = (
            (max(0, kept[0] - _MARGIN_CELLS), kept[-1] + 1 + _MARGIN_CELLS) if len(kept) else (0, n)
            for kept, n in zip((rows, columns), cells.shape, strict=True)
        )
        cells = cells[top:bottom, left:right]
        self._scale = max(1, min(8, _LONGEST_PX // max(cells.shape)))
        grey = np.full(cells.shape, 255, np.uint8)
        grey[cells < 0] = 205
        grey[cells >= 50] = 60
        large = np.kron(grey[::-1], np.ones((self._scale, self._scale), np.uint8))
        self.image = np.ascontiguousarray(np.repeat(large[:, :, None], 3, axis=2))
        self._per_m = self._scale / resolution_m
        corner = SE2(float(left) * resolution_m, float(top) * resolution_m, 0.0)
        self._grid_from_map = (origin @ corner).inverse()

    def pixel(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Where a point of the map is in the picture."""
        at = self._grid_from_map @ SE2(x_m, y_m, 0.0)
        return round(at.x_m * self._per_m), round(len(self.image) - at.y_m * self._per_m)

    def line(self, points: Sequence[Sequence[float]], colour: Colour, width: int = 1) -> None:
        """A line through points x, y of the map."""
        pixels = np.array([self.pixel(point[0], point[1]) for point in points], np.int32)
        cv2.polylines(self.image, [pixels.reshape(-1, 1, 2)], False, colour, width, cv2.LINE_AA)

    def dot(self, x_m: float, y_m: float, colour: Colour, radius: int = 2) -> None:
        """A filled circle at a point of the map."""
        cv2.circle(self.image, self.pixel(x_m, y_m), radius, colour, -1, cv2.LINE_AA)

    def write(self, path: Path) -> None:
        """Write a PNG.

        Raises ConfigError where it cannot be written.
        """
        done, data = cv2.imencode(".png", self.image)
        try:
            if not done:
                raise OSError(0, "cannot be drawn")
            write_file(path, data.tobytes())
        except OSError as error:
            raise ConfigError(f"--draw: {path}: {error.strerror}") from error
