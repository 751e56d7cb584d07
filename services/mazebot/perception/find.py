"""Finds the registered markers in a picture, with every pose that their corners allow."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.perception.config import PerceptionConfig
from mazebot.perception.detect import Detector, Threshold, smallest_perimeter_px
from mazebot.perception.pose import Camera, Solution, solve


@dataclass(frozen=True)
class Found:
    """A registered marker in a picture, with its poses, best first."""

    dictionary: str
    marker_id: int
    side_m: float
    solutions: list[Solution]


Name = tuple[str, int]
"""Dictionary and id."""


@dataclass(frozen=True)
class Findings:
    """What a picture shows: registered markers at their height and tilt, and names of others."""

    found: list[Found]
    unknown: list[Name]
    """Not registered."""
    misplaced: list[Name]
    """Registered, but elsewhere than the robot could see it from the floor."""


@dataclass(frozen=True)
class _Registered:
    side_m: float
    map_from_marker: Array | None


MAX_TILT_RAD = math.radians(15.0)
MAX_HEIGHT_ERROR_M = 0.05
MAX_HEIGHT_ERROR_SHARE = 0.02
_SIGMAS = 3.0


class MarkerFinder:
    """Finds markers by a register of dictionaries, ids and sizes; others are only reported.

    It remembers what the picture before showed: what is missing now is looked for once more. Where
    a second pass has found nothing either, the next pictures are spared one.

    The robot stands level on the floor, so that a marker's height and tilt are known wherever the
    robot is: a detection at another height or tilt is not the registered marker.
    """

    def __init__(self, config: PerceptionConfig) -> None:
        self._config = config
        self._registered: dict[str, dict[int, _Registered]] = {}
        self._detectors: dict[str, Detector] = {}
        self._books: dict[str, cv2.aruco.Dictionary | None] = {}
        self._before: dict[str, frozenset[int]] = {}
        self._spared: dict[str, int] = {}
        """Pictures left without a second pass, by dictionary"""

    @property
    def registered(self) -> bool:
        """Whether there is any marker to look for."""
        return bool(self._registered)

    def clear(self) -> None:
        """Forget all registered markers."""
        self._registered = {}
        self.forget_picture()

    def forget_picture(self) -> None:
        """Expect nothing of the next picture, which does not follow the one before."""
        self._before, self._spared = {}, {}

    def register(
        self,
        dictionary: str,
        marker_id: int,
        side_m: float,
        map_from_marker: Array | None = None,
        book: cv2.aruco.Dictionary | None = None,
    ) -> None:
        """Look for a marker whose black square has this side.

        `map_from_marker`, (4, 4), is its pose, x to its right and z out of its face, of which
        height and tilt are checked; None: they are not. `book` is the dictionary, if it is not one
        of OpenCV's.

        Raises ValueError if OpenCV has no dictionary of this name.
        """
        config = self._config
        if dictionary not in self._detectors or self._books.get(dictionary) is not book:
            second = Threshold(config.second_window_px, config.second_contrast)
            self._books[dictionary] = book
            self._detectors[dictionary] = Detector(
                dictionary if book is None else book,
                config.threshold_window_px,
                config.threshold_contrast,
                second if config.second_pass else None,
                config.min_clarity,
            )
        by_id = self._registered.setdefault(dictionary, {})
        by_id[marker_id] = _Registered(side_m, map_from_marker)

    def find(
        self, grey: NDArray[np.uint8], camera: Camera, floor_from_camera: Array | None = None
    ) -> Findings:
        """The markers in a (height, width) picture.

        `floor_from_camera`, (4, 4), is the camera's pose in a frame on the floor with z up; without
        it heights and tilts are not checked.
        """
        config = self._config
        findings = Findings([], [], [])
        for dictionary, by_id in self._registered.items():
            detector = self._detectors[dictionary]
            min_perimeter_px = smallest_perimeter_px(
                min(one.side_m for one in by_id.values()),
                float(min(camera.matrix[0, 0], camera.matrix[1, 1])),
                config.max_range_m,
                config.max_view_angle_rad,
                detector.modules,
            )
            expected, spared = self._before.get(dictionary, ()), self._spared.get(dictionary, 0)
            twice = bool(expected) or spared == 0
            sightings = detector.detect(grey, min_perimeter_px, by_id, expected, twice)
            now = frozenset(one.marker_id for one in sightings if one.marker_id in by_id)
            self._before[dictionary] = now
            self._spared[dictionary] = (
                0 if now else config.second_pass_every - 1 if twice else spared - 1
            )
            for sighting in sightings:
                registered = by_id.get(sighting.marker_id)
                if registered is None:
                    findings.unknown.append((dictionary, sighting.marker_id))
                    continue
                solutions = solve(
                    sighting.corners,
                    registered.side_m,
                    camera,
                    config.corner_sigma_px,
                    config.min_ambiguous_score,
                )
                if not solutions:
                    continue
                if any(_fits(one, registered, floor_from_camera) for one in solutions):
                    found = Found(dictionary, sighting.marker_id, registered.side_m, solutions)
                    findings.found.append(found)
                else:
                    findings.misplaced.append((dictionary, sighting.marker_id))
        return findings


def _fits(solution: Solution, registered: _Registered, floor_from_camera: Array | None) -> bool:
    """Whether a pose has the height and the tilt of the registered one, within its covariance."""
    if registered.map_from_marker is None or floor_from_camera is None:
        return True
    expected = registered.map_from_marker
    seen = portable.product(floor_from_camera, solution.camera_from_marker)
    # The vertical in the marker's own axes: it does not depend on the heading.
    cosine = float(portable.product(seen[2, :3], expected[2, :3]))
    tilt_rad = portable.acos(min(max(cosine, -1.0), 1.0))
    variances = np.diagonal(solution.covariance)
    sigma_m = math.sqrt(float(variances[:3].max()))
    sigma_rad = math.sqrt(float(variances[3:].max()))
    range_m = float(portable.lengths(solution.camera_from_marker[:3, 3]))
    slack_m = MAX_HEIGHT_ERROR_M + MAX_HEIGHT_ERROR_SHARE * range_m + _SIGMAS * sigma_m
    height_error_m = abs(float(seen[2, 3] - expected[2, 3]))
    return tilt_rad <= MAX_TILT_RAD + _SIGMAS * sigma_rad and height_error_m <= slack_m
