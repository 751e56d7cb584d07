"""A small picture of a run: the plan with the true path, for lists of runs."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.recordings.report.plan import extent_of
from mazebot.common.recordings.series import RunSeries

WIDTH_PX, HEIGHT_PX = 320, 240
_FINE = 3
"""Drawn so many times larger, and averaged: lines get smooth edges."""
_FLOOR = (250, 248, 246)
_SOLID = (102, 84, 74)
_PATH_FROM, _PATH_TO = (232, 178, 116), (176, 70, 18)
"""The path darkens from its start to its end."""
_REACHED, _MISSED, _START = (55, 127, 26), (46, 34, 207), (90, 90, 90)
_CONTACT = (46, 34, 207)


def thumbnail_png(series: RunSeries) -> bytes:
    """A PNG of `WIDTH_PX` x `HEIGHT_PX`: world, path, goals (green: reached, red: not)
    and contacts.
    """
    picture = np.full((HEIGHT_PX * _FINE, WIDTH_PX * _FINE, 3), _FLOOR, np.uint8)
    extent = extent_of(series)
    wide_m, high_m = extent.x_max_m - extent.x_min_m, extent.y_max_m - extent.y_min_m
    scale = min(WIDTH_PX / wide_m, HEIGHT_PX / high_m) * _FINE
    middle_m = (extent.x_min_m + wide_m / 2.0, extent.y_min_m + high_m / 2.0)

    def pixels(points_m: object) -> NDArray[np.int32]:
        points = np.asarray(points_m, float).reshape(-1, 2) - middle_m
        centre = np.array([WIDTH_PX, HEIGHT_PX]) * _FINE / 2.0
        return np.round(points * (scale, -scale) + centre).astype(np.int32)

    if series.solid:
        rings = [pixels(ring) for ring in series.solid]
        # An area inside an even number of rings stays free.
        cv2.fillPoly(picture, rings, _SOLID)
        cv2.polylines(picture, rings, True, _SOLID, _FINE)
    way = pixels(np.column_stack([series.truth.x_m, series.truth.y_m]))
    for row, (one, other) in enumerate(zip(way[:-1].tolist(), way[1:].tolist(), strict=True)):
        share = row / max(len(way) - 2, 1)
        colour = [a + share * (b - a) for a, b in zip(_PATH_FROM, _PATH_TO, strict=True)]
        cv2.line(picture, one, other, colour, 2 * _FINE + 1, cv2.LINE_AA)
    start = pixels((series.start.x_m, series.start.y_m))[0].tolist()
    cv2.circle(picture, start, 5 * _FINE, _START, _FINE + 1, cv2.LINE_AA)
    for goal in series.goals:
        if goal.pose is not None and not goal.canceled:
            at = pixels((goal.pose.x_m, goal.pose.y_m))[0].tolist()
            cv2.circle(picture, at, 6 * _FINE, (255, 255, 255), -1, cv2.LINE_AA)
            cv2.circle(picture, at, 5 * _FINE, _REACHED if goal.reached else _MISSED, -1)
    for event in series.events:
        if event.kind == "contact" and event.x_m is not None:
            at = pixels((event.x_m, event.y_m))[0].tolist()
            cv2.drawMarker(picture, at, _CONTACT, cv2.MARKER_TILTED_CROSS, 9 * _FINE, 2 * _FINE)
    small = cv2.resize(picture, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".png", small, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert done
    return bytes(data)
