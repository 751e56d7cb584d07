"""Selects the renderer of the camera's pictures on this machine."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from mazebot.common.config import ConfigError
from mazebot.physics.camera.camera import DepthRange, Intrinsics, Renderer

RendererKind = Literal["auto", "gl", "cpu", "tiny", "none"]

_GPU_DEVICES = ("dri/renderD*", "nvidia[0-9]*", "dxg")
"""Of Mesa's drivers, of NVIDIA's, and of Windows' for Linux."""
_SOFTWARE_DRIVERS = ("llvmpipe", "softpipe", "swrast")
"""Mesa's, without a GPU"""

_log = logging.getLogger("physics")


def make_renderer(
    kind: RendererKind, intrinsics: Intrinsics, depth_range_m: DepthRange | None = None
) -> Renderer | None:
    """The requested renderer; None for `none`. Its pictures have depth if a range is given.

    `auto` takes a GPU if there is one, else the CPU, and logs why a GPU is not used. Raises
    ConfigError, in one line, if `gl` is requested and not available.
    """
    if kind == "none":
        return None
    renderer = _MAKERS[kind](intrinsics, depth_range_m)
    _log.info("Rendering with %s", renderer.name)
    return renderer


# Imported where they are used: a machine may lack the libraries of the others.


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
    """Whether /dev has a GPU driver's device; asking OpenGL would load Mesa's compiler."""
    return any(any(Path("/dev").glob(pattern)) for pattern in _GPU_DEVICES)


def _gl_camera(intrinsics: Intrinsics, depth_range_m: DepthRange | None) -> Renderer:
    from mazebot.physics.camera.gl_camera import GlCamera  # noqa: PLC0415

    return GlCamera(intrinsics, depth_range_m)


def _cpu_camera(intrinsics: Intrinsics, depth_range_m: DepthRange | None) -> Renderer:
    from mazebot.physics.camera.cpu_camera import CpuCamera  # noqa: PLC0415

    return CpuCamera(intrinsics, depth_range_m)


def _tiny_camera(intrinsics: Intrinsics, depth_range_m: DepthRange | None) -> Renderer:
    from mazebot.physics.camera.tiny_camera import TinyCamera  # noqa: PLC0415

    return TinyCamera(intrinsics, depth_range_m)


_MAKERS: dict[str, Callable[[Intrinsics, DepthRange | None], Renderer]] = {
    "auto": _gpu_or_cpu,
    "gl": _gl_camera,
    "cpu": _cpu_camera,
    "tiny": _tiny_camera,
}
