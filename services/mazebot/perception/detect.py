"""Detects the markers in a picture, and their corners."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.opencv import without_ipp
from mazebot.perception.code_check import CodeCheck
from mazebot.perception.corners import MODULES, Corners, corners_of_black

_MIN_MODULE_PX = 2.0
"""Markers with smaller modules cannot be read."""

_MIN_CANDIDATES_APART = 0.05
"""Of the marker's perimeter: OpenCV's 0.125 takes a panel's edge and the black square in it for one
candidate, and keeps the panel's edge where that is cut off by the picture's."""

MIN_CLARITY = 6.0
"""See CodeCheck.clarity."""


@dataclass(frozen=True)
class Sighting:
    """A marker in a picture.

    `corners` is (4, 2) in pixels, a pixel's coordinates being those of its centre: top left, top
    right, bottom right, bottom left of the upright marker.
    """

    marker_id: int
    corners: Corners


@dataclass(frozen=True)
class Threshold:
    """An adaptive threshold: black is darker than the mean of a window by some grey levels."""

    window_px: int
    contrast: float


def dictionary_names() -> tuple[str, ...]:
    """Names of OpenCV's predefined dictionaries, sorted, e.g. `DICT_4X4_100`."""
    return tuple(sorted(name for name in dir(cv2.aruco) if dictionary_exists(name)))


def dictionary_exists(name: str) -> bool:
    """Whether OpenCV has a predefined dictionary of this name."""
    return name.startswith("DICT_") and isinstance(getattr(cv2.aruco, name, None), int)


def smallest_perimeter_px(
    side_m: float, focal_px: float, range_m: float, angle_rad: float, modules: int = MODULES
) -> float:
    """Perimeter in pixels of a marker at the greatest range, seen at an angle to its normal."""
    side_px = max(side_m * focal_px / range_m, _MIN_MODULE_PX * modules)
    return 2.0 * side_px * (1.0 + portable.cos(angle_rad))


class Detector:
    """Finds the markers of one dictionary.

    The first pass uses one threshold window instead of OpenCV's three, no contour shorter than a
    marker's can be, and a threshold above the contrast of wall textures: on brick walls, nearly all
    of the time is spent on contours that are no markers. The second pass, with a wider window and
    less contrast, is for pictures in which the first finds none of the wanted markers: dim, shaded
    or blurred ones.
    """

    def __init__(
        self,
        dictionary: str | cv2.aruco.Dictionary,
        window_px: int,
        min_contrast: float,
        second: Threshold | None = None,
        min_clarity: float = MIN_CLARITY,
    ) -> None:
        """Set up for a dictionary, or the name of one of OpenCV's.

        Args:
            dictionary: where it is a name, OpenCV's.
            window_px: side of the first pass's threshold window, odd.
            min_contrast: its contrast in grey levels.
            second: threshold of the second pass; None: there is none.
            min_clarity: least CodeCheck.clarity of a marker; 0: not checked.

        Raises:
            ValueError: OpenCV has no dictionary of this name.
        """
        if isinstance(dictionary, str):
            if not dictionary_exists(dictionary):
                raise ValueError(f"dictionary: {dictionary!r}: unknown to OpenCV")
            dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
        # The order of work, and so the result, must not depend on the machine's processors.
        cv2.setNumThreads(1)
        self.modules = int(dictionary.markerSize) + 2
        self._check = CodeCheck(dictionary)
        self._min_clarity = min_clarity
        self._first = _Pass(dictionary, Threshold(window_px, min_contrast))
        self._second = _Pass(dictionary, second) if second is not None else None

    def detect(
        self,
        grey: NDArray[np.uint8],
        min_perimeter_px: float,
        wanted: Collection[int] | None = None,
        expected: Collection[int] = (),
        twice: bool = True,
    ) -> list[Sighting]:
        """The markers in a (height, width) picture, by id and then from left to right.

        The second pass runs if the first finds no marker whose id is `wanted` (None: any is), or
        not all that are `expected`; and if `twice`.
        """
        found = self._sightings(self._first, grey, min_perimeter_px)
        ids = {one.marker_id for one in found}
        enough = bool(ids if wanted is None else ids.intersection(wanted)) and ids.issuperset(
            expected
        )
        if self._second is not None and twice and not enough:
            more = self._sightings(self._second, grey, min_perimeter_px)
            found += [one for one in more if not any(same_place(one, other) for other in found)]
        return sorted(found, key=lambda s: (s.marker_id, float(s.corners[0, 0])))

    def _sightings(
        self, step: _Pass, grey: NDArray[np.uint8], min_perimeter_px: float
    ) -> list[Sighting]:
        found: list[Sighting] = []
        for marker_id, rough in step.candidates(grey, min_perimeter_px):
            corners = corners_of_black(grey, rough, self.modules)
            if self._min_clarity > 0.0:
                if self._check.clarity(grey, corners, marker_id) < self._min_clarity:
                    continue
            one = Sighting(marker_id, corners)
            if not any(same_place(one, other) for other in found):
                found.append(one)
        return found


class _Pass:
    """OpenCV's detector with one threshold."""

    def __init__(self, book: cv2.aruco.Dictionary, threshold: Threshold) -> None:
        self._parameters = cv2.aruco.DetectorParameters()
        self._parameters.adaptiveThreshWinSizeMin = threshold.window_px
        self._parameters.adaptiveThreshWinSizeMax = threshold.window_px
        self._parameters.adaptiveThreshConstant = threshold.contrast
        self._parameters.minMarkerDistanceRate = _MIN_CANDIDATES_APART
        self._parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._detector = cv2.aruco.ArucoDetector(book, self._parameters)
        self._perimeter_rate = 0.0

    def candidates(
        self, grey: NDArray[np.uint8], min_perimeter_px: float
    ) -> list[tuple[int, Corners]]:
        """Ids and rough corners."""
        rate = min_perimeter_px / max(grey.shape)
        if rate != self._perimeter_rate:
            self._perimeter_rate = self._parameters.minMarkerPerimeterRate = rate
            self._detector.setDetectorParameters(self._parameters)
        without_ipp()
        corners, ids, _ = self._detector.detectMarkers(grey)
        if ids is None:
            return []
        return [
            (int(marker_id), np.asarray(quad[0], np.float64))
            for quad, marker_id in zip(corners, ids.ravel(), strict=True)
        ]


def same_place(one: Sighting, other: Sighting) -> bool:
    """Whether two sightings are of one marker: its inner and its outer contour, or two passes."""
    if one.marker_id != other.marker_id:
        return False
    apart_px = np.abs(one.corners.mean(axis=0) - other.corners.mean(axis=0)).max()
    return bool(apart_px < 0.25 * np.ptp(other.corners, axis=0).max())


def grey_from_rgb(data: NDArray[np.uint8], height: int, width: int, step: int) -> NDArray[np.uint8]:
    """(height, width) grey picture of the bytes of an rgb8 image with rows of `step` bytes."""
    rows = data.reshape(height, step)[:, : 3 * width].reshape(height, width, 3)
    return np.asarray(cv2.cvtColor(rows, cv2.COLOR_RGB2GRAY), np.uint8)
