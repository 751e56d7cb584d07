"""The camera on all cores of a CPU: needs no OpenGL, and gives the same pixels everywhere."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.common.messages.documents import Planar, World
from mazebot.common.processors import processors
from mazebot.physics.camera.camera import (
    DepthRange,
    Intrinsics,
    Picture,
    mover_poses,
    optical_from_map,
)
from mazebot.physics.camera.rasterizer import (
    Lamps,
    Scratch,
    Surfaces,
    View,
    draw_strips,
    levels_of,
    project,
    textures_of,
    triangles_of_parts,
)
from mazebot.physics.camera.scene import Scene, build_scene
from mazebot.physics.camera.visibility import Visibility
from mazebot.physics.sensor_profiles import FAR_M, NEAR_M

_FARTHEST = float(np.finfo(np.float32).max)
_STRIP_PX = 32
"""Rows that are drawn at a time: few enough for a core's cache and for an even load."""


class CpuCamera:
    """A renderer that draws with Numba's kernels, strip by strip, in as many threads as there are
    processors.
    """

    name = "cpu_rasterizer"
    any_thread = True

    def __init__(
        self,
        intrinsics: Intrinsics,
        depth_range_m: DepthRange | None = None,
        threads: int | None = None,
    ) -> None:
        self._intrinsics = intrinsics
        self._with_depth = depth_range_m is not None
        least_m, most_m = depth_range_m or (NEAR_M, FAR_M)
        self._view = View(
            np.array([intrinsics.fx, intrinsics.fy]),
            np.array([intrinsics.cx, intrinsics.cy]),
            np.array([intrinsics.width, intrinsics.height], np.int64),
            np.array([NEAR_M, FAR_M, least_m, most_m]),
        )
        self._clip_from_optical = intrinsics.clip_from_optical()
        self._scene: Scene | None = None
        self._textures = textures_of((), {})
        strips = -(-intrinsics.height // _STRIP_PX)
        helpers = min(threads or processors(), strips) - 1
        self._scratches = [
            Scratch.of(intrinsics.width * min(_STRIP_PX, intrinsics.height))
            for _ in range(helpers + 1)
        ]
        self._pool = ThreadPoolExecutor(helpers, "camera") if helpers else None

    def set_scene(self, scene: Scene) -> None:
        """Prepare a scene; textures that the last one had as well are not prepared again."""
        old = self._scene.textures if self._scene else ()
        if [texture.sha256 for texture in old] != [texture.sha256 for texture in scene.textures]:
            known = {
                texture.sha256: levels_of(self._textures, index)
                for index, texture in enumerate(old)
            }
            self._textures = textures_of(scene.textures, known)
        self._surfaces = _surfaces(scene)
        self._visibility = Visibility(scene, self._intrinsics)
        self._first = _plain(scene.parts.first, np.int64)
        self._count = _plain(scene.parts.count, np.int64)
        self._sun = _plain(scene.sun, np.float64)
        lamps = np.array(
            [
                (*lamp.position_m, *lamp.diffuse[:3],
                 lamp.constant, lamp.linear, lamp.quadratic, lamp.range_m)
                for lamp in scene.lamps
            ],
            np.float64,
        ).reshape(-1, 10)  # fmt: skip
        # As on a GPU: a lamp beyond the range of single precision lights nothing.
        self._lamps = np.clip(lamps, -_FARTHEST, _FARTHEST)
        red, green, blue = np.round(255.0 * scene.sky).astype(int).tolist()
        self._sky = red | green << 8 | blue << 16
        self._scene = scene

    def render(
        self, map_from_optical: Array, map_from_movers: Array | None = None, spare: int = 0
    ) -> Picture:
        """See Renderer."""
        from_map = optical_from_map(map_from_optical)
        height, width = self._intrinsics.height, self._intrinsics.width
        # A whole number of words; the last pixels may not fill them.
        words = np.empty(-(-height * width // 4) * 3, np.uint32)
        rgb = words.view(np.uint8)[: 3 * height * width].reshape(height, width, 3)
        depth_m = np.empty((height, width), np.float32) if self._with_depth else None
        depths_m = np.empty(0, np.float32) if depth_m is None else depth_m.ravel()
        scene = self._scene
        if scene is not None:
            poses = mover_poses(scene, map_from_movers)
            in_view = self._visibility.of(
                from_map, portable.product(self._clip_from_optical, from_map), poses
            )
            order = np.concatenate(
                (in_view.things, self._visibility.quads[in_view.quads], in_view.background)
            )
            planes, facts = project(
                triangles_of_parts(order, self._first, self._count),
                self._surfaces,
                self._view,
                from_map,
                _plain(poses, np.float64),
                self._sun,
                len(self._lamps) > 0,
            )
            lamps = Lamps(self._lamps, _plain(map_from_optical, np.float64))
            self._draw(planes, facts, lamps, words, depths_m, spare)
        else:
            words[:], depths_m[:] = 0, np.nan
        return Picture(rgb, depth_m)

    def _draw(
        self,
        planes: Array,
        facts: NDArray[np.int64],
        lamps: Lamps,
        rgb: NDArray[np.uint32],
        depths_m: NDArray[np.float32],
        spare: int,
    ) -> None:
        threads = max(1, len(self._scratches) - spare)

        def draw(number: int) -> None:
            draw_strips(
                number, threads, _STRIP_PX, planes, facts, self._textures, lamps,
                self._view, self._sky, self._scratches[number], rgb, depths_m,
            )  # fmt: skip

        helpers = range(1, threads)
        helping = [self._pool.submit(draw, one) for one in helpers] if self._pool else []
        draw(0)
        for help_ in helping:
            help_.result()

    def prepare(self) -> None:
        """See Renderer."""
        compile_kernels()

    def close(self) -> None:
        """See Renderer."""
        if self._pool is not None:
            self._pool.shutdown()
        self._pool = None
        self._scratches = self._scratches[:1]


def compile_kernels() -> None:
    """Compile the kernels before the first picture."""
    start = Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0)
    camera = CpuCamera(Intrinsics.from_horizontal_fov(8, 8, 1.0), threads=1)
    empty = World(name="", recipe="", hash="", walls=(), materials=(), start=start)
    camera.set_scene(build_scene(empty, {}))
    camera.render(np.eye(4))
    camera.close()


def _plain(array: NDArray[Any], kind: type[Any]) -> NDArray[Any]:
    """A copy in the layout that kernels are compiled for: row by row, and not read-only."""
    return np.array(array, kind, order="C")


def _surfaces(scene: Scene) -> Surfaces:
    parts = scene.parts
    each = np.arange(len(parts.first))
    part = np.empty(len(scene.triangles), np.int64)
    part[triangles_of_parts(each, _plain(parts.first, np.int64), _plain(parts.count, np.int64))] = (
        np.repeat(each, parts.count)
    )
    return Surfaces(
        corners=_plain(scene.triangles, np.int32),
        places_m=_plain(scene.vertices_m, np.float64),
        normals=_plain(scene.normals, np.float64),
        uvs=_plain(scene.uvs, np.float64),
        tints=_plain(scene.tints, np.float64),
        albedos=_plain(scene.albedos, np.float64),
        textures=parts.texture[part],
        movers=parts.mover[part],
        smooth=parts.smooth[part],
    )
