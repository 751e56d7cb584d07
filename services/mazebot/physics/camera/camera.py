"""A pinhole camera, its pictures, and the renderer interface."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.physics.camera.scene import Scene
from mazebot.physics.sensor_profiles import FAR_M, NEAR_M

MAX_SIDE_PX = 4096


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole without distortion, in pixels.

    As in OpenCV, (u, v) = (0, 0) is the centre of the top left pixel: a point at (x, y, z) in the
    optical frame (x right, y down, z forward) is seen at u = fx x/z + cx, v = fy y/z + cy, and a
    renderer colours the pixel in column u, row v by what that ray hits.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        """Raises ValueError if no picture could be rendered with these values."""
        for name, side in (("width", self.width), ("height", self.height)):
            if not 1 <= side <= MAX_SIDE_PX:
                raise ValueError(f"{name}: must be 1 to {MAX_SIDE_PX} pixels (got {side})")
        for name, focal_length in (("fx", self.fx), ("fy", self.fy)):
            if not (math.isfinite(focal_length) and focal_length > 0.0):
                raise ValueError(f"{name}: must be positive (got {focal_length})")
        for name, centre in (("cx", self.cx), ("cy", self.cy)):
            if not math.isfinite(centre):
                raise ValueError(f"{name}: must be finite (got {centre})")

    @classmethod
    def from_horizontal_fov(cls, width: int, height: int, horizontal_fov_rad: float) -> Intrinsics:
        """Square pixels, principal point at (width/2, height/2), as in Gazebo's camera_info."""
        if not 0.0 < horizontal_fov_rad < math.pi:
            raise ValueError(
                f"horizontal_fov_rad: must be between 0 and pi (got {horizontal_fov_rad})"
            )
        focal_length = width / 2.0 / portable.tan(horizontal_fov_rad / 2.0)
        return cls(width, height, focal_length, focal_length, width / 2.0, height / 2.0)

    def clip_from_optical(self, pixel_centre: tuple[float, float] = (0.5, 0.5)) -> Array:
        """(4, 4) OpenGL projection whose window coordinates are (u, v) plus `pixel_centre`.

        `pixel_centre` is where a rasteriser samples a pixel. Since v runs downwards, a buffer read
        from its bottom row up, as OpenGL's is, holds the picture's top row first, and front faces
        turn clockwise in it.
        """
        across, down = pixel_centre
        depth = FAR_M - NEAR_M
        w, h = self.width, self.height
        return np.array(
            [
                [2.0 * self.fx / w, 0.0, 2.0 * (self.cx + across) / w - 1.0, 0.0],
                [0.0, 2.0 * self.fy / h, 2.0 * (self.cy + down) / h - 1.0, 0.0],
                [0.0, 0.0, (FAR_M + NEAR_M) / depth, -2.0 * FAR_M * NEAR_M / depth],
                [0.0, 0.0, 1.0, 0.0],
            ]
        )


DepthRange = tuple[float, float]
"""Nearest and farthest depth that a camera measures, in metres along the optical axis."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Colour and depth of one render: new arrays, contiguous, top row first."""

    rgb: NDArray[np.uint8]
    """(h, w, 3)"""
    depth_m: NDArray[np.float32] | None
    """(h, w): along the optical axis; NaN where nothing is within range, by REP 118. None: not
    requested.
    """


class Renderer(Protocol):
    """Renders pictures of a scene: a function of the scene and the poses only."""

    @property
    def name(self) -> str:
        """Its name for users."""

    def set_scene(self, scene: Scene) -> None:
        """Render this scene from now on. The last one is released."""

    @property
    def any_thread(self) -> bool:
        """Whether it may render in another thread than that in which it was made."""

    def render(
        self, map_from_optical: Array, map_from_movers: Array | None = None, spare: int = 0
    ) -> Picture:
        """Render the picture from a camera pose; `spare` processors are left to others.

        `map_from_movers`, (k, 4, 4), are poses of the scene's movers; None: as at the start. Before
        the first scene it is black and without depth. Raises ValueError where a pose is not finite.
        """

    def prepare(self) -> None:
        """Load or compile what renders a picture, whatever the scene."""

    def close(self) -> None:
        """Release everything. Calling it again does nothing."""


@kernel()
def optical_from_map(map_from_optical: Array) -> Array:
    """The camera's view matrix. Raises ValueError if the pose is not (4, 4) or not finite."""
    if map_from_optical.shape != (4, 4) or not np.isfinite(map_from_optical).all():
        raise ValueError("map_from_optical: must be a finite (4, 4) matrix")
    # Reshaped for the compiler, which needs the type even where the shape was rejected above.
    pose = np.ascontiguousarray(map_from_optical).reshape((4, 4))
    # As inverse_matrix, which takes four times as long when a picture has just filled the caches.
    from_map = np.zeros((4, 4))
    for row in range(3):
        for column in range(3):
            from_map[row, column] = pose[column, row]
            from_map[row, 3] -= pose[column, row] * pose[column, 3]
    from_map[3, 3] = 1.0
    return from_map


def mover_poses(scene: Scene, map_from_movers: Array | None) -> Array:
    """(k, 4, 4) poses of a scene's movers. Raises ValueError if shape or values are not valid."""
    if map_from_movers is None:
        return scene.map_from_movers
    wanted = scene.map_from_movers.shape
    if map_from_movers.shape != wanted or not np.isfinite(map_from_movers).all():
        raise ValueError(f"map_from_movers: must be finite matrices {wanted}")
    return map_from_movers
