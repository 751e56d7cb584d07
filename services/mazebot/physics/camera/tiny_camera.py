"""The camera on PyBullet's TinyRenderer, for comparison: some fifty times slower than the others.

Each triangle has one constant shade, that of its centre: a moving body is shaded as at its start
pose.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array, position_and_quaternion
from mazebot.common.maths.opencv import without_ipp
from mazebot.physics.bodies.bullet import lent, pybullet
from mazebot.physics.camera.camera import (
    DepthRange,
    Intrinsics,
    Picture,
    mover_poses,
    optical_from_map,
)
from mazebot.physics.camera.scene import PLAIN, STATIC, Scene, Texture, lamp_light
from mazebot.physics.sensor_profiles import FAR_M, NEAR_M

MAX_TEXTURE_SIDE_PX = 256
"""Larger textures are shrunk: they are sampled without filtering, and alias from afar."""

_PIXEL_CENTRE = (0.0, 1.0)
"""Where TinyRenderer samples a pixel; v is 1 because it counts rows from the bottom."""

_GL_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0, 1.0])
"""PyBullet expects a view with y up, along -z."""

_SHADES = 16.0
_MAX_TRIANGLES = 40_000
"""Of a shape: PyBullet takes no more than 131,072 vertices."""


class TinyCamera:
    """A renderer with its own physics client: visual shapes in a world that is never stepped."""

    name = "tiny_renderer"
    any_thread = False

    def __init__(self, intrinsics: Intrinsics, depth_range_m: DepthRange | None = None) -> None:
        self._depth_range_m = depth_range_m
        self._size = intrinsics.width, intrinsics.height
        clip_from_gl = (
            np.diag([1.0, -1.0, 1.0, 1.0])
            @ intrinsics.clip_from_optical(_PIXEL_CENTRE)
            @ _GL_FROM_OPTICAL
        )
        self._projection = _column_major(clip_from_gl)
        self._sky = np.zeros(3, np.uint8)
        self._scene: Scene | None = None
        self._bodies_of_mover: list[list[int]] = []
        self._client: int | None = pybullet.connect(pybullet.DIRECT)

    def set_scene(self, scene: Scene) -> None:
        """Load a scene after a reset, without which PyBullet does not release textures."""
        client = self._client
        pybullet.resetSimulation(physicsClientId=client)
        self._sky = np.round(255.0 * scene.sky).astype(np.uint8)
        with tempfile.TemporaryDirectory(prefix="mazebot-textures-") as folder:
            textures = [self._load(texture, Path(folder)) for texture in scene.textures]
        self._scene = scene
        self._bodies_of_mover = [[] for _ in scene.movers]
        for mover, texture, tint, triangles in _looks(scene):
            for some in np.array_split(triangles, -(-len(triangles) // _MAX_TRIANGLES)):
                body = self._add(scene, some, tint)
                if texture != PLAIN:
                    pybullet.changeVisualShape(
                        body, -1, textureUniqueId=textures[texture], physicsClientId=client
                    )
                if mover != STATIC:
                    self._bodies_of_mover[mover].append(body)

    def render(
        self, map_from_optical: Array, map_from_movers: Array | None = None, spare: int = 0
    ) -> Picture:
        """See Renderer."""
        if self._scene is not None:
            self._move(mover_poses(self._scene, map_from_movers))
        gl_from_map = _GL_FROM_OPTICAL @ optical_from_map(map_from_optical)
        width, height = self._size
        _, _, rgba, buffer, bodies = pybullet.getCameraImage(
            width,
            height,
            viewMatrix=_column_major(gl_from_map),
            projectionMatrix=self._projection,
            # The light is already in the scene's tints.
            lightAmbientCoeff=1.0,
            lightDiffuseCoeff=0.0,
            lightSpecularCoeff=0.0,
            lightColor=[1.0, 1.0, 1.0],
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        picture = np.asarray(rgba, np.uint8).reshape(height, width, 4)
        rgb = cv2.cvtColor(picture, cv2.COLOR_RGBA2RGB)
        nothing = np.asarray(bodies).reshape(height, width) < 0
        rgb[nothing] = self._sky
        depth_m = None
        if self._depth_range_m is not None:
            depth_m = _depth_from_buffer(np.asarray(buffer).reshape(height, width))
            nearest_m, farthest_m = self._depth_range_m
            depth_m[nothing | (depth_m < nearest_m) | (depth_m > farthest_m)] = np.nan
        return Picture(np.asarray(rgb, np.uint8), depth_m)

    def prepare(self) -> None:
        """See Renderer."""

    def close(self) -> None:
        """See Renderer."""
        if self._client is not None:
            pybullet.disconnect(self._client)
        self._client = None

    def _load(self, texture: Texture, folder: Path) -> int:
        height, width = texture.pixels.shape[:2]
        shrink = min(1.0, MAX_TEXTURE_SIDE_PX / max(width, height))
        size = max(1, round(width * shrink)), max(1, round(height * shrink))
        without_ipp()
        pixels = cv2.resize(texture.pixels, size, interpolation=cv2.INTER_AREA)
        path = folder / f"{texture.sha256}.png"
        path.write_bytes(cv2.imencode(".png", pixels[:, :, ::-1])[1].tobytes())
        return int(pybullet.loadTexture(str(path), physicsClientId=self._client))

    def _move(self, map_from_movers: Array) -> None:
        for pose, bodies in zip(map_from_movers, self._bodies_of_mover, strict=True):
            position, turn = position_and_quaternion(pose)
            for body in bodies:
                pybullet.resetBasePositionAndOrientation(
                    body, position, turn, physicsClientId=self._client
                )

    def _add(self, scene: Scene, triangles: NDArray[np.int64], tint: Array) -> int:
        """Add one body of triangles with the same texture and tint."""
        used, corners = np.unique(scene.triangles[triangles], return_inverse=True)
        # TinyRenderer counts v from a texture's bottom, and supports no negative one.
        uvs = scene.uvs[used] * (1.0, -1.0)
        uvs -= np.floor(uvs.min(0))
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=lent("vertices", scene.vertices_m[used]),
            indices=lent("indices", corners.ravel()),
            uvs=lent("uvs", uvs),
            normals=lent("normals", scene.normals[used]),
            rgbaColor=[*tint.tolist(), 1.0],
            physicsClientId=self._client,
        )
        return int(
            pybullet.createMultiBody(baseVisualShapeIndex=shape, physicsClientId=self._client)
        )


def _looks(scene: Scene) -> Iterator[tuple[int, int, Array, NDArray[np.int64]]]:
    """Triangles by mover, texture and tint: a shape has one texture and one colour."""
    parts = scene.parts
    order = np.concatenate(
        [
            np.arange(first, first + count)
            for first, count in zip(parts.first, parts.count, strict=True)
        ]
    )
    part = np.repeat(np.arange(len(parts.first)), parts.count)
    tints = _tints(scene, scene.triangles[order], parts.mover[part], parts.smooth[part])
    rows = np.column_stack((parts.mover[part], parts.texture[part], tints))
    looks, index = np.unique(rows, axis=0, return_inverse=True)
    by_look = np.argsort(index.ravel(), kind="stable")
    ends = np.cumsum(np.bincount(index.ravel(), minlength=len(looks)))
    for look, members in zip(looks, np.split(by_look, ends[:-1]), strict=True):
        yield int(look[0]), int(look[1]), look[2:], order[members]


def _tints(
    scene: Scene,
    triangles: NDArray[np.int32],
    movers: NDArray[np.int64],
    smooth: NDArray[np.bool_],
) -> Array:
    """(m, 3), of each triangle's centre."""
    normals, albedos = scene.normals[triangles].mean(1), scene.albedos[triangles].mean(1)
    middles = scene.vertices_m[triangles].mean(1)
    tints = scene.tints[triangles].mean(1)
    moving = movers != STATIC
    if moving.any():
        poses = scene.map_from_movers[movers[moving]]
        normals[moving] = (poses[:, :3, :3] @ normals[moving][:, :, None])[:, :, 0]
        middles[moving] = (poses[:, :3, :3] @ middles[moving][:, :, None])[:, :, 0] + poses[
            :, :3, 3
        ]
        facing = np.maximum(normals[moving] @ scene.sun, 0.0)
        tints[moving] += albedos[moving] * facing[:, None]
    tints += albedos * lamp_light(scene, middles, normals)
    tints = np.clip(tints, 0.0, 1.0)
    # Few shades, so that a round or lamp-lit surface does not need one body for each triangle.
    many = smooth | bool(scene.lamps)
    tints[many] = np.round(tints[many] * _SHADES) / _SHADES
    tints[~many] = np.round(tints[~many], 9)
    return np.asarray(tints)


def _depth_from_buffer(buffer: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    """Metres along the optical axis from OpenGL's depth, which grows from 0 to 1."""
    depth_m = FAR_M * NEAR_M / (FAR_M - (FAR_M - NEAR_M) * buffer.astype(np.float64))
    return np.asarray(depth_m, np.float32)


def _column_major(matrix: Array) -> list[float]:
    return [float(value) for value in matrix.T.ravel()]
