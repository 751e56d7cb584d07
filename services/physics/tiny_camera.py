"""The camera on PyBullet's TinyRenderer: needs no OpenGL, and is some thirty times slower."""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from services.common.frames import Array
from services.physics.bullet import pybullet
from services.physics.camera import Intrinsics, optical_from_map
from services.physics.scene import PLAIN, Scene, Texture

MAX_TEXTURE_SIDE_PX = 256
"""Larger textures are shrunk: one of their pixels is shown, unfiltered, and glitters from afar."""

_PIXEL_CENTRE = (0.0, 1.0)
"""Where TinyRenderer samples a pixel; the one in v comes of counting rows from the bottom."""

_GL_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0, 1.0])
"""PyBullet wants a view with y up, that looks along -z."""

_TRIANGLES_OF_QUAD = np.array([0, 1, 2, 0, 2, 3])


class TinyCamera:
    """A renderer with a physics client of its own: visual shapes in a world that never steps."""

    name = "tiny_renderer"

    def __init__(self, intrinsics: Intrinsics) -> None:
        self._size = intrinsics.width, intrinsics.height
        clip_from_gl = (
            np.diag([1.0, -1.0, 1.0, 1.0])
            @ intrinsics.clip_from_optical(_PIXEL_CENTRE)
            @ _GL_FROM_OPTICAL
        )
        self._projection = _column_major(clip_from_gl)
        self._sky = np.zeros(3, np.uint8)
        self._client: int | None = pybullet.connect(pybullet.DIRECT)

    def set_scene(self, scene: Scene) -> None:
        """Load a scene anew: only a reset makes PyBullet release textures."""
        client = self._client
        pybullet.resetSimulation(physicsClientId=client)
        self._sky = np.round(255.0 * scene.sky).astype(np.uint8)
        with tempfile.TemporaryDirectory(prefix="mazebot-textures-") as folder:
            textures = [self._load(texture, Path(folder)) for texture in scene.textures]
        # A shape has one texture and one colour.
        looks = np.column_stack((scene.texture_of_quad, scene.tints))
        for look in np.unique(looks, axis=0):
            quads = (looks == look).all(axis=1)
            body = self._add(scene.corners_m[quads], scene.uvs[quads], look[1:])
            if look[0] != PLAIN:
                pybullet.changeVisualShape(
                    body, -1, textureUniqueId=textures[int(look[0])], physicsClientId=client
                )

    def render(self, map_from_optical: Array) -> NDArray[np.uint8]:
        """See Renderer."""
        gl_from_map = _GL_FROM_OPTICAL @ optical_from_map(map_from_optical)
        width, height = self._size
        _, _, rgba, _, bodies = pybullet.getCameraImage(
            width,
            height,
            viewMatrix=_column_major(gl_from_map),
            projectionMatrix=self._projection,
            # The scene's tints hold the light.
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
        rgb[np.asarray(bodies).reshape(height, width) < 0] = self._sky
        return np.asarray(rgb, np.uint8)

    def close(self) -> None:
        """See Renderer."""
        if self._client is not None:
            pybullet.disconnect(self._client)
        self._client = None

    def _load(self, texture: Texture, folder: Path) -> int:
        height, width = texture.pixels.shape[:2]
        shrink = min(1.0, MAX_TEXTURE_SIDE_PX / max(width, height))
        size = max(1, round(width * shrink)), max(1, round(height * shrink))
        pixels = cv2.resize(texture.pixels, size, interpolation=cv2.INTER_AREA)
        path = folder / f"{texture.sha256}.png"
        path.write_bytes(cv2.imencode(".png", pixels[:, :, ::-1])[1].tobytes())
        return int(pybullet.loadTexture(str(path), physicsClientId=self._client))

    def _add(self, corners_m: Array, uvs: Array, tint: Array) -> int:
        """One static body of quads (n, 4, 3) with one look."""
        normals = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 3] - corners_m[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        indices = 4 * np.arange(len(corners_m))[:, None] + _TRIANGLES_OF_QUAD
        # TinyRenderer counts v from a texture's bottom, and knows no negative one.
        bottom = np.ceil(uvs[:, :, 1].max())
        uvs_from_bottom = np.stack((uvs[:, :, 0], bottom - uvs[:, :, 1]), axis=2)
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=corners_m.reshape(-1, 3).tolist(),
            indices=indices.ravel().tolist(),
            uvs=uvs_from_bottom.reshape(-1, 2).tolist(),
            normals=np.repeat(normals, 4, axis=0).tolist(),
            rgbaColor=[*tint.tolist(), 1.0],
            physicsClientId=self._client,
        )
        return int(
            pybullet.createMultiBody(baseVisualShapeIndex=shape, physicsClientId=self._client)
        )


def _column_major(matrix: Array) -> list[float]:
    return [float(value) for value in matrix.T.ravel()]
