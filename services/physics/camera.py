"""A pinhole camera, what a renderer is, and which one this machine can have."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from services.common.config import ConfigError
from services.common.frames import Array
from services.common.kernels import kernel
from services.physics.scene import Scene

RendererKind = Literal["auto", "gl", "cpu", "tiny", "none"]

NEAR_M = 0.02
FAR_M = 300.0
"""Between them things show: as the camera of ROBOTIS' simulated waffle."""
MAX_SIDE_PX = 4096

_GPU_DEVICES = ("dri/renderD*", "nvidia[0-9]*", "dxg")
"""Of Mesa's drivers, of NVIDIA's, and of Windows' for Linux."""
_SOFTWARE_DRIVERS = ("llvmpipe", "softpipe", "swrast")
"""Mesa's, without a GPU"""

_log = logging.getLogger("physics")


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole without distortion, in pixels.

    As in OpenCV, (u, v) = (0, 0) is the centre of the top left pixel: a point at (x, y, z) in the
    optical frame (x right, y down, z forward) shows at u = fx x/z + cx, v = fy y/z + cy, and a
    renderer colours the pixel in column u, row v by what lies on that ray.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        """Raises ValueError where no picture could be rendered so."""
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
        """Square pixels, principal point at (width/2, height/2), as Gazebo's camera_info has it."""
        if not 0.0 < horizontal_fov_rad < math.pi:
            raise ValueError(
                f"horizontal_fov_rad: must be between 0 and pi (got {horizontal_fov_rad})"
            )
        focal_length = width / 2.0 / math.tan(horizontal_fov_rad / 2.0)
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
    """Colour and depth of one render: arrays of the caller's own, contiguous, top row first."""

    rgb: NDArray[np.uint8]
    """(h, w, 3)"""
    depth_m: NDArray[np.float32] | None
    """(h, w): along the optical axis; 0 where nothing is within range. None: not asked for."""


class Renderer(Protocol):
    """Makes pictures of a scene: a function of the scene and of poses alone."""

    @property
    def name(self) -> str:
        """What it is, for people."""

    def set_scene(self, scene: Scene) -> None:
        """Show this scene from now on. What the last one held is released."""

    def render(self, map_from_optical: Array, map_from_movers: Array | None = None) -> Picture:
        """What is seen from there.

        `map_from_movers`, (k, 4, 4), are poses of the scene's movers; None: as at the start. Before
        the first scene it is black and without depth. Raises ValueError where a pose is not finite.
        """

    def close(self) -> None:
        """Release everything. Calling it again does nothing."""


@kernel()
def optical_from_map(map_from_optical: Array) -> Array:
    """The camera's view. Raises ValueError where the pose is not (4, 4) or not finite."""
    if map_from_optical.shape != (4, 4) or not np.isfinite(map_from_optical).all():
        raise ValueError("map_from_optical: must be a finite (4, 4) matrix")
    # Seen as (4, 4) whatever it is, so that it can be refused: types are settled before shapes.
    pose = np.ascontiguousarray(map_from_optical).reshape((4, 4))
    # As inverse_matrix, which takes four times as long where a picture has just filled the caches.
    from_map = np.zeros((4, 4))
    for row in range(3):
        for column in range(3):
            from_map[row, column] = pose[column, row]
            from_map[row, 3] -= pose[column, row] * pose[column, 3]
    from_map[3, 3] = 1.0
    return from_map


def mover_poses(scene: Scene, map_from_movers: Array | None) -> Array:
    """(k, 4, 4) poses of a scene's movers. Raises ValueError where they are not, or not finite."""
    if map_from_movers is None:
        return scene.map_from_movers
    wanted = scene.map_from_movers.shape
    if map_from_movers.shape != wanted or not np.isfinite(map_from_movers).all():
        raise ValueError(f"map_from_movers: must be finite matrices {wanted}")
    return map_from_movers


def make_renderer(
    kind: RendererKind, intrinsics: Intrinsics, depth_range_m: DepthRange | None = None
) -> Renderer | None:
    """The renderer asked for; None for `none`. Its pictures have depth where a range is given.

    `auto` takes a GPU where one is at hand, else the CPU, and logs why a GPU that is there is not
    used. Raises ConfigError, in one line, where `gl` is asked for and cannot be had.
    """
    if kind == "none":
        return None
    renderer = _MAKERS[kind](intrinsics, depth_range_m)
    _log.info("Rendering with %s", renderer.name)
    return renderer


# Imported where they are used: they know this module, and a machine may lack the other's libraries.


def _gpu_or_cpu(intrinsics: Intrinsics, depth_range_m: DepthRange | None) -> Renderer:
    if _has_gpu():
        try:
            renderer = _gl_camera(intrinsics, depth_range_m)
        except ConfigError as error:
            _log.warning("%s; rendering on the CPU", error)
            return _cpu_camera(intrinsics, depth_range_m)
        if not any(driver in renderer.name for driver in _SOFTWARE_DRIVERS):
            return renderer
        renderer.close()
        _log.warning("OpenGL here is %s, no GPU; rendering on the CPU", renderer.name)
    return _cpu_camera(intrinsics, depth_range_m)


def _has_gpu() -> bool:
    """A GPU's driver shows itself among the devices: OpenGL would load Mesa's compiler to tell."""
    return any(any(Path("/dev").glob(pattern)) for pattern in _GPU_DEVICES)


def _gl_camera(intrinsics: Intrinsics, depth_range_m: DepthRange | None) -> Renderer:
    from services.physics.gl_camera import GlCamera  # noqa: PLC0415

    return GlCamera(intrinsics, depth_range_m)


def _cpu_camera(intrinsics: Intrinsics, depth_range_m: DepthRange | None) -> Renderer:
    from services.physics.cpu_camera import CpuCamera  # noqa: PLC0415

    return CpuCamera(intrinsics, depth_range_m)


def _tiny_camera(intrinsics: Intrinsics, depth_range_m: DepthRange | None) -> Renderer:
    from services.physics.tiny_camera import TinyCamera  # noqa: PLC0415

    return TinyCamera(intrinsics, depth_range_m)


_MAKERS: dict[str, Callable[[Intrinsics, DepthRange | None], Renderer]] = {
    "auto": _gpu_or_cpu,
    "gl": _gl_camera,
    "cpu": _cpu_camera,
    "tiny": _tiny_camera,
}
