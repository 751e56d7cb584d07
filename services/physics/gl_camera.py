"""The camera on OpenGL: a GPU, or Mesa's llvmpipe on a CPU, without a display."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import cv2
import moderngl
import numpy as np
from numpy.typing import NDArray

from services.common.config import ConfigError
from services.common.frames import Array
from services.physics.camera import Intrinsics, optical_from_map
from services.physics.scene import PLAIN, Scene, Texture

_VERTEX_SHADER = """
#version 330
uniform mat4 clip_from_map;
in vec3 position_m;
in vec2 uv;
in vec3 tint;
out vec2 fragment_uv;
flat out vec3 fragment_tint;
void main() {
    gl_Position = clip_from_map * vec4(position_m, 1.0);
    fragment_uv = uv;
    fragment_tint = tint;
}
"""

_TEXTURED_SHADER = """
#version 330
uniform sampler2D picture;
in vec2 fragment_uv;
flat in vec3 fragment_tint;
out vec4 colour;
void main() {
    colour = vec4(texture(picture, fragment_uv).rgb * fragment_tint, 1.0);
}
"""

_PLAIN_SHADER = """
#version 330
flat in vec3 fragment_tint;
out vec4 colour;
void main() {
    colour = vec4(fragment_tint, 1.0);
}
"""

_INDICES_OF_QUAD = np.array([0, 1, 2, 0, 2, 3], np.int32)


class _Shown:
    """A scene's OpenGL objects."""

    def __init__(
        self, scene: Scene, vertices: Any, indices: Any, textured: Any, plain: Any
    ) -> None:
        self.scene = scene
        self.vertices = vertices
        self.indices = indices
        self.textured = textured
        self.plain = plain
        corners = scene.corners_m
        self._normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
        self._landmarks_m = np.concatenate((corners, corners.mean(1, keepdims=True)), axis=1)

    def drawing_order(self, eye_m: Array) -> NDArray[np.int64]:
        """The quads that turn their front to the eye: textured ones first, near before far.

        So few pixels are shaded twice. The picture does not depend on the order.
        """
        from_eye = self._landmarks_m - eye_m
        distance = np.einsum("ijk,ijk->ij", from_eye, from_eye).min(1)
        distance[self.scene.texture_of_quad == PLAIN] = np.inf
        in_front: NDArray[np.bool_] = np.einsum("ij,ij->i", from_eye[:, 0], self._normals) < 0.0
        order: NDArray[np.int64] = np.argsort(distance, kind="stable")
        return order[in_front[order]]


class GlCamera:
    """A renderer with an OpenGL context of its own, used from the thread that made it."""

    def __init__(self, intrinsics: Intrinsics) -> None:
        """Raises ConfigError where no context can be made."""
        self._context: Any = _make_context()
        self._clip_from_optical = intrinsics.clip_from_optical()
        size = intrinsics.width, intrinsics.height
        self._rgba = np.zeros((intrinsics.height, intrinsics.width, 4), np.uint8)
        self._textures: dict[str, Any] = {}
        self._shown: _Shown | None = None
        with self._context as context:
            self.name = f"moderngl ({context.info['GL_RENDERER']})"
            self._textured: Any = context.program(_VERTEX_SHADER, _TEXTURED_SHADER)
            # The floor fills half of most pictures: sampling a white texture for it would cost a
            # CPU a millisecond.
            self._plain: Any = context.program(_VERTEX_SHADER, _PLAIN_SHADER)
            self._colour: Any = context.renderbuffer(size)
            self._depth: Any = context.depth_renderbuffer(size)
            self._framebuffer: Any = context.framebuffer(self._colour, self._depth)

    def set_scene(self, scene: Scene) -> None:
        """Upload a scene; textures that the last one had as well stay where they are."""
        with self._context as context:
            self._release_shown()
            wanted = {texture.sha256: texture for texture in scene.textures}
            for sha256 in [sha256 for sha256 in self._textures if sha256 not in wanted]:
                self._textures.pop(sha256).release()
            for sha256, texture in wanted.items():
                if sha256 not in self._textures:
                    self._textures[sha256] = self._upload(texture)
            vertices = context.buffer(_vertices(scene).tobytes())
            indices = context.buffer(reserve=_INDICES_OF_QUAD.nbytes * len(scene.corners_m))
            self._shown = _Shown(
                scene,
                vertices,
                indices,
                context.vertex_array(
                    self._textured,
                    [(vertices, "3f 2f 3f", "position_m", "uv", "tint")],
                    index_buffer=indices,
                ),
                context.vertex_array(
                    self._plain,
                    [(vertices, "3f 8x 3f", "position_m", "tint")],
                    index_buffer=indices,
                ),
            )

    def render(self, map_from_optical: Array) -> NDArray[np.uint8]:
        """See Renderer."""
        clip_from_map = self._clip_from_optical @ optical_from_map(map_from_optical)
        # OpenGL takes matrices column by column.
        matrix = clip_from_map.T.astype(np.float32).tobytes()
        with self._context as context:
            self._framebuffer.use()
            context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
            # The projection turns the picture over, and with it the sense of every face.
            context.front_face = "cw"
            sky = self._shown.scene.sky.tolist() if self._shown else (0.0, 0.0, 0.0)
            self._framebuffer.clear(*sky, 1.0, depth=1.0)
            self._textured["clip_from_map"].write(matrix)
            self._plain["clip_from_map"].write(matrix)
            if self._shown:
                self._draw(self._shown, map_from_optical[:3, 3])
            # Four components are read as they lie; three would be converted by the driver, slowly.
            self._framebuffer.read_into(self._rgba, components=4, alignment=1)
        rgb = np.empty((*self._rgba.shape[:2], 3), np.uint8)
        cv2.cvtColor(self._rgba, cv2.COLOR_RGBA2RGB, dst=rgb)
        return rgb

    def _draw(self, shown: _Shown, eye_m: Array) -> None:
        quads = shown.drawing_order(eye_m)
        indices = 4 * quads[:, None].astype(np.int32) + _INDICES_OF_QUAD
        shown.indices.write(indices.tobytes())
        textures = shown.scene.texture_of_quad[quads]
        firsts = [0, *(np.flatnonzero(np.diff(textures)) + 1).tolist(), len(quads)]
        for first, end in pairwise(firsts):
            array = shown.plain
            if textures[first] != PLAIN:
                array = shown.textured
                self._textures[shown.scene.textures[textures[first]].sha256].use(0)
            array.render(moderngl.TRIANGLES, vertices=6 * (end - first), first=6 * first)

    def close(self) -> None:
        """See Renderer."""
        if self._context is None:
            return
        with self._context:
            self._release_shown()
            for texture in self._textures.values():
                texture.release()
            for thing in (
                self._framebuffer,
                self._colour,
                self._depth,
                self._textured,
                self._plain,
            ):
                thing.release()
        self._textures.clear()
        self._context.release()
        self._context = None

    def _release_shown(self) -> None:
        if self._shown:
            for thing in (
                self._shown.textured,
                self._shown.plain,
                self._shown.vertices,
                self._shown.indices,
            ):
                thing.release()
        self._shown = None

    def _upload(self, texture: Texture) -> Any:
        # A row of RGBA is aligned whatever the width.
        rgba = cv2.cvtColor(texture.pixels, cv2.COLOR_RGB2RGBA)
        height, width = rgba.shape[:2]
        uploaded = self._context.texture((width, height), 4, rgba.tobytes())
        uploaded.build_mipmaps()
        # Anisotropic filtering would cost a CPU four times a whole frame, and shows markers no
        # better from less than 75 degrees aside.
        uploaded.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        return uploaded


def _make_context() -> Any:
    try:
        # libEGL finds every OpenGL function itself: libGL, and the X11 libraries behind it, are
        # not needed. The names with a version are there without the development packages.
        options: dict[str, Any] = {
            "require": 330,
            "backend": "egl",
            "libegl": "libEGL.so.1",
            "libgl": "libEGL.so.1",
        }
        return moderngl.create_context(standalone=True, **options)
    except Exception as error:  # moderngl raises no narrower type
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(
            f"renderer: gl: no OpenGL context could be made ({reason}); "
            "install libegl1 and libgl1-mesa-dri, or use --renderer auto"
        ) from error


def _vertices(scene: Scene) -> NDArray[np.float32]:
    """(4 n, 8): position, uv and tint of each quad's corners."""
    tints = np.broadcast_to(scene.tints[:, None, :], scene.corners_m.shape)
    corners = np.concatenate((scene.corners_m, scene.uvs, tints), axis=2)
    return corners.reshape(-1, 8).astype(np.float32)
