"""Detects the markers in a picture, and their corners."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from services.common import portable
from services.common.opencv import without_ipp
from services.perception.corners import Corners, refine_corners

_MIN_SIDE_PX = 12.0
"""A 4x4 marker smaller than this has modules of less than two pixels and cannot be read."""


@dataclass(frozen=True)
class Sighting:
    """A marker in a picture.

    `corners` is (4, 2) in pixels, a pixel's coordinates being those of its centre: top left, top
    right, bottom right, bottom left of the upright marker.
    """

    marker_id: int
    corners: Corners


def dictionary_exists(name: str) -> bool:
    """Whether OpenCV has a predefined dictionary of this name, e.g. `DICT_4X4_100`."""
    return name.startswith("DICT_") and isinstance(getattr(cv2.aruco, name, None), int)


def smallest_perimeter_px(
    side_m: float, focal_px: float, range_m: float, angle_rad: float
) -> float:
    """Perimeter in pixels of a marker at the greatest range, seen at an angle to its normal."""
    side_px = max(side_m * focal_px / range_m, _MIN_SIDE_PX)
    return 2.0 * side_px * (1.0 + portable.cos(angle_rad))


class Detector:
    """Finds the markers of one dictionary.

    Uses one threshold window instead of OpenCV's three, no contour shorter than a marker's can be,
    and a threshold above the contrast of wall textures: on brick walls, nearly all of the time is
    spent on contours that are no markers.
    """

    def __init__(self, dictionary: str, window_px: int, min_contrast: float) -> None:
        """Set up for a dictionary's name, an odd window, and a contrast in grey levels.

        Raises ValueError if OpenCV has no such dictionary.
        """
        if not dictionary_exists(dictionary):
            raise ValueError(f"dictionary: OpenCV has none named {dictionary!r}")
        # The order of work, and so the result, must not depend on the machine's processors.
        cv2.setNumThreads(1)
        book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
        self.modules = int(book.markerSize) + 2
        self._parameters = cv2.aruco.DetectorParameters()
        self._parameters.adaptiveThreshWinSizeMin = window_px
        self._parameters.adaptiveThreshWinSizeMax = window_px
        self._parameters.adaptiveThreshConstant = min_contrast
        self._parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._detector = cv2.aruco.ArucoDetector(book, self._parameters)
        self._perimeter_rate = 0.0

    def detect(self, grey: NDArray[np.uint8], min_perimeter_px: float) -> list[Sighting]:
        """The markers in a (height, width) picture, by id and then from left to right."""
        rate = min_perimeter_px / max(grey.shape)
        if rate != self._perimeter_rate:
            self._perimeter_rate = self._parameters.minMarkerPerimeterRate = rate
            self._detector.setDetectorParameters(self._parameters)
        without_ipp()
        corners, ids, _ = self._detector.detectMarkers(grey)
        if ids is None:
            return []
        sightings = [
            Sighting(
                int(marker_id),
                refine_corners(grey, np.asarray(quad[0], np.float64), self.modules),
            )
            for quad, marker_id in zip(corners, ids.ravel(), strict=True)
        ]
        return sorted(sightings, key=lambda s: (s.marker_id, float(s.corners[0, 0])))


def grey_from_rgb(data: NDArray[np.uint8], height: int, width: int, step: int) -> NDArray[np.uint8]:
    """(height, width) grey picture of the bytes of an rgb8 image with rows of `step` bytes."""
    rows = data.reshape(height, step)[:, : 3 * width].reshape(height, width, 3)
    return np.asarray(cv2.cvtColor(rows, cv2.COLOR_RGB2GRAY), np.uint8)
