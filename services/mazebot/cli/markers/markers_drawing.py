"""Draws the markers found in a picture: outline, first corner, id and axes."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.perception.photo import PhotoMarker
from mazebot.perception.pose import Camera

Picture = NDArray[np.uint8]

_GREEN, _YELLOW, _BLACK = (60, 220, 60), (0, 230, 255), (0, 0, 0)
_AXES = ((60, 60, 255), (60, 220, 60), (255, 110, 60))
"""Blue, green, red of x, y and z: red, green and blue."""
_SHIFT = 4
"""Bits of a pixel's fraction in OpenCV's drawing."""


def draw_markers(
    picture: Picture, markers: Iterable[PhotoMarker], camera: Camera | None, side_m: float
) -> Picture:
    """A copy of a (height, width, 3) BGR picture with the markers drawn in.

    The first corner has a small square. With a camera, the axes of the better pose are half a
    marker long: x red to its right, y green up, z blue out of its face.
    """
    drawn = picture.copy()
    for marker in markers:
        side_px = float(np.ptp(marker.corners, axis=0).max())
        width_px = max(1, round(side_px / 60.0))
        outline = np.round((marker.corners) * (1 << _SHIFT)).astype(np.int32)
        cv2.polylines(drawn, [outline], True, _GREEN, width_px, cv2.LINE_AA, _SHIFT)
        if camera is not None and marker.solutions:
            _draw_axes(drawn, marker, camera, side_m, width_px)
        first = marker.corners[0]
        half = max(2.0, side_px / 30.0)
        cv2.rectangle(drawn, _point(first - half), _point(first + half), _YELLOW, -1)
        _draw_id(drawn, marker, side_px)
    return drawn


def _draw_axes(
    drawn: Picture, marker: PhotoMarker, camera: Camera, side_m: float, width_px: int
) -> None:
    pose = marker.solutions[0].camera_from_marker
    ends = np.concatenate([np.zeros((1, 3)), side_m / 2.0 * np.eye(3)])
    turn, _ = cv2.Rodrigues(pose[:3, :3])
    pixels = cv2.projectPoints(ends, turn, pose[:3, 3], camera.matrix, camera.distortion)[0]
    origin, *tips = np.asarray(pixels, np.float64)[:, 0]
    for tip, colour in zip(tips, _AXES, strict=True):
        cv2.arrowedLine(
            drawn, _point(origin), _point(tip), colour, 1 + width_px, cv2.LINE_AA, tipLength=0.15
        )


def _draw_id(drawn: Picture, marker: PhotoMarker, side_px: float) -> None:
    """The id below the marker, light on dark."""
    scale = min(max(side_px / 120.0, 0.4), 4.0)
    thick = max(1, round(2 * scale))
    text = f"{marker.marker_id}"
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, thick)
    middle, low = marker.corners[:, 0].mean(), marker.corners[:, 1].max() + 0.08 * side_px + height
    limit = np.array(drawn.shape[1::-1]) - (width + 2, 4)
    at = np.clip(np.array([middle - width / 2.0, low]), (2, height + 2), np.maximum(limit, 2))
    font = cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(drawn, text, _point(at), font, scale, _BLACK, 3 * thick, cv2.LINE_AA)
    cv2.putText(drawn, text, _point(at), font, scale, _YELLOW, thick, cv2.LINE_AA)


def _point(place: NDArray[np.float64]) -> tuple[int, int]:
    x, y = np.clip(np.nan_to_num(place), -1e6, 1e6).round().astype(int).tolist()
    return x, y
