"""The parts of a scene to draw from a camera pose, from near to far."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.physics.camera.camera import Intrinsics
from mazebot.physics.camera.scene import Scene
from mazebot.physics.sensor_profiles import FAR_M, NEAR_M
from mazebot.physics.sensors.occlusion import balls_in_view, visible_quads

Parts = NDArray[np.int64]


class InView(NamedTuple):
    """Indices, near to far each. No part that could be seen in a single pixel is missing."""

    things: Parts
    """Parts that are neither rectangles nor background."""
    quads: Parts
    """Rectangles, as numbers among the rectangles."""
    background: Parts
    """Floor and ceiling parts, drawn last."""


class Visibility:
    """The parts of a scene that a camera can see."""

    def __init__(self, scene: Scene, intrinsics: Intrinsics) -> None:
        parts = scene.parts
        self.quads: Parts = np.flatnonzero(parts.quad)
        """The parts that are rectangles"""
        first = parts.first[self.quads]
        self.quad_vertices = scene.triangles[np.stack((first, first + 1), axis=1)].reshape(-1, 6)
        """(q, 6): of their two triangles"""
        self._corners_m = scene.vertices_m[self.quad_vertices[:, (0, 1, 2, 5)]]
        self._others: Parts = np.flatnonzero(~parts.quad)
        self._background = parts.background[self._others]
        balls = [_ball(scene, part) for part in self._others.tolist()]
        self._centres_m = np.array([centre for centre, _ in balls]).reshape(-1, 3)
        self._radii_m = np.array([radius for _, radius in balls])
        self._movers = parts.mover[self._others].astype(np.int64)
        self._view = (
            np.array([intrinsics.fx, intrinsics.fy]),
            np.array([intrinsics.cx, intrinsics.cy]),
            np.array([intrinsics.width, intrinsics.height]),
            np.array([NEAR_M, FAR_M]),
        )

    def of(self, optical_from_map: Array, clip_from_map: Array, map_from_movers: Array) -> InView:
        """The parts that may be visible from a camera pose."""
        quads = visible_quads(self._corners_m, optical_from_map, *self._view)
        balls = balls_in_view(
            self._centres_m,
            self._radii_m,
            self._movers,
            map_from_movers,
            optical_from_map,
            clip_from_map,
        )
        behind = self._background[balls]
        return InView(self._others[balls[~behind]], quads, self._others[balls[behind]])


def compile_kernels() -> None:
    """Compile the kernels before the first picture."""
    eye, pair, size_px = np.eye(4), np.ones(2), np.ones(2, np.int64)
    visible_quads(np.empty((0, 4, 3)), eye, pair, pair, size_px, pair)
    balls_in_view(
        np.empty((0, 3)), np.empty(0), np.empty(0, np.int64), np.empty((0, 4, 4)), eye, eye
    )


def _ball(scene: Scene, part: int) -> tuple[Array, float]:
    """Centre and radius of a ball around a part, in its own frame."""
    first, count = int(scene.parts.first[part]), int(scene.parts.count[part])
    points = scene.vertices_m[scene.triangles[first : first + count].ravel()]
    centre = (points.min(0) + points.max(0)) / 2.0
    return centre, float(portable.lengths(points - centre).max())
