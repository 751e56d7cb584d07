"""Finds the markers of one dictionary in a single picture of any size, as thoroughly as it can."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.opencv import without_ipp
from mazebot.perception.code_check import CodeCheck
from mazebot.perception.config import PerceptionConfig
from mazebot.perception.corners import HALF_WIDTH_PX, Corners, corners_of_black
from mazebot.perception.detect import Detector, Sighting, Threshold, same_place
from mazebot.perception.pose import Camera, Solution, solve

_SMALLEST_SHARE = 0.01
"""Of a picture's longer side: no marker's perimeter is shorter. Else texture takes all the time."""
_MODULE_PX = 2
_LARGE_PX = 1200
"""A longer side is halved until it is not: an edge may be blurred over more than a window."""
_BLUR_SHARE = 0.006
"""Of a picture's longer side: how far a large picture's edges may be blurred."""


_MOST_TIMES, _MAGNIFIED_PX = 3, 1280
"""A small picture is looked at magnified as well, up to so many times and to this longer side."""


@dataclass(frozen=True)
class PhotoMarker:
    """A marker in a picture.

    `corners` is (4, 2) in pixels as in Sighting. `clarity` is CodeCheck's. `solutions` are both
    poses that explain the corners, the better one first; empty without a camera.
    """

    marker_id: int
    corners: Corners
    clarity: float
    solutions: tuple[Solution, ...]

    @property
    def ambiguity(self) -> float | None:
        """Reprojection error of the worse pose over that of the better one; near 1 either may be
        true. None: there is one pose only.
        """
        if len(self.solutions) < 2:
            return None
        better, worse = (one.reprojection_error_px for one in self.solutions[:2])
        return worse / max(better, 1e-9)


def markers_in_photo(
    grey: NDArray[np.uint8],
    book: cv2.aruco.Dictionary,
    camera: Camera | None = None,
    side_m: float = 0.0,
    corner_sigma_px: float = 0.3,
    magnify: bool = True,
) -> list[PhotoMarker]:
    """The markers in a picture, by id and then from left to right.

    Both thresholds of perception are used on the picture and, if it is large, on ever smaller
    copies of it, of which corners and codes are judged in the picture itself; if it is small, on a
    magnified copy as well. The white around a marker may be thin.

    Args:
        grey: (height, width) picture.
        book: the dictionary.
        camera: intrinsics for the poses; None: without poses.
        side_m: side of the black square.
        corner_sigma_px: least standard deviation of a corner's coordinate, for the covariances.
        magnify: whether the smallest markers count, at several times the time.
    """
    found = _clear(grey, book)
    times = min(_MOST_TIMES, _MAGNIFIED_PX // max(grey.shape)) if magnify else 1
    if times > 1:
        # Small markers are read better between the pixels.
        size = times * grey.shape[1], times * grey.shape[0]
        without_ipp()
        magnified = cv2.resize(grey, size, interpolation=cv2.INTER_CUBIC)
        for one, clarity in _clear(np.asarray(magnified, np.uint8), book):
            in_grey = Sighting(one.marker_id, (one.corners + 0.5) / times - 0.5)
            if not any(same_place(in_grey, other) for other, _ in found):
                found.append((in_grey, clarity))
    found.sort(key=lambda pair: (pair[0].marker_id, float(pair[0].corners[0, 0])))
    return [
        PhotoMarker(
            one.marker_id,
            one.corners,
            clarity,
            tuple(solve(one.corners, side_m, camera, corner_sigma_px, 0.0)) if camera else (),
        )
        for one, clarity in found
    ]


def unreadable_in_photo(
    grey: NDArray[np.uint8], book: cv2.aruco.Dictionary, readable: Iterable[PhotoMarker] = ()
) -> dict[str, list[int]]:
    """Ids of markers that no detector may read, by what is wrong with them: `mirrored`, `inverted`
    (white on black), or both. Where one is `readable`, there is no other.
    """
    inverse = np.asarray(255 - grey, np.uint8)
    ways = {
        "mirrored": (grey, True),
        "inverted": (inverse, False),
        "mirrored and inverted": (inverse, True),
    }
    taken = [one.corners for one in readable]
    found: dict[str, list[int]] = {}
    for way, (picture, is_mirrored) in ways.items():
        seen = np.ascontiguousarray(picture[:, ::-1]) if is_mirrored else picture
        for one, _ in _clear(seen, book):
            corners = one.corners.copy()
            if is_mirrored:
                corners[:, 0] = grey.shape[1] - 1 - corners[:, 0]
            if not any(_holds(other, corners.mean(axis=0)) for other in taken):
                taken.append(corners)
                found.setdefault(way, []).append(one.marker_id)
    return found


def _holds(corners: Corners, place: Corners) -> bool:
    x, y = place.tolist()
    quad = np.asarray(corners, np.float32)
    return cv2.pointPolygonTest(quad, (x, y), measureDist=False) >= 0.0


def _clear(grey: NDArray[np.uint8], book: cv2.aruco.Dictionary) -> list[tuple[Sighting, float]]:
    """The markers in a picture that are clearly black and white, each with its clarity."""
    config = PerceptionConfig()
    modules, check = int(book.markerSize) + 2, CodeCheck(book)
    blur_px = max(HALF_WIDTH_PX, _BLUR_SHARE * max(grey.shape))
    found: list[tuple[Sighting, float]] = []
    for rough in _sightings_at_all_sizes(grey, book, config):
        one = Sighting(rough.marker_id, corners_of_black(grey, rough.corners, modules, blur_px))
        clarity = max(
            check.clarity(grey, one.corners, one.marker_id, thin) for thin in (False, True)
        )
        if clarity >= config.min_clarity and not any(same_place(one, other) for other, _ in found):
            found.append((one, clarity))
    return found


def _sightings_at_all_sizes(
    grey: NDArray[np.uint8], book: cv2.aruco.Dictionary, config: PerceptionConfig
) -> list[Sighting]:
    """What each threshold finds at each size, with corners in the original's pixels."""
    thresholds = (
        Threshold(config.threshold_window_px, config.threshold_contrast),
        Threshold(config.second_window_px, config.second_contrast),
    )
    detectors = [Detector(book, one.window_px, one.contrast, min_clarity=0.0) for one in thresholds]
    least_px = 4.0 * _MODULE_PX * (int(book.markerSize) + 2)
    sightings: list[Sighting] = []
    without_ipp()
    size, shrunk = grey, 1
    while True:
        longer_px = max(size.shape)
        for detector in detectors:
            for one in detector.detect(size, max(least_px, _SMALLEST_SHARE * longer_px)):
                # The centre of a pixel of the copy is the centre of its block of the original.
                corners = shrunk * (one.corners + 0.5) - 0.5
                sightings.append(Sighting(one.marker_id, corners))
        if longer_px <= _LARGE_PX:
            return sightings
        halved = size.shape[1] // 2, size.shape[0] // 2
        even = size[: 2 * halved[1], : 2 * halved[0]]
        size = np.asarray(cv2.resize(even, halved, interpolation=cv2.INTER_AREA), np.uint8)
        shrunk *= 2
