"""The camera on OpenGL, without a display: on a GPU, or with Mesa's llvmpipe on a CPU."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, NamedTuple

import cv2
import moderngl
import numpy as np
from numpy.typing import NDArray

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import Array
from mazebot.common.maths.kernels import kernel
from mazebot.common.messages.documents import PointLight
from mazebot.physics.camera import visibility
from mazebot.physics.camera.camera import (
    DepthRange,
    Intrinsics,
    Picture,
    mover_poses,
    optical_from_map,
)
from mazebot.physics.camera.mipmaps import LevelUpload
from mazebot.physics.camera.scene import PLAIN, STATIC, Scene, Texture
from mazebot.physics.camera.visibility import Visibility

_LIBEGL = "libEGL.so.1"
_VERTEX_SHADER = """
layout(std140) uniform View { mat4 clip_from_map; };
in vec3 position_m;
in vec2 uv;
in vec3 tint;
in vec3 normal;
in vec3 albedo;
out vec2 fragment_uv;
SHADE out vec3 fragment_tint;
#ifdef MOVES
uniform mat4 map_from_mover;
uniform vec3 sun;
#endif
#if LAMPS > 0
out vec3 fragment_place_m;
SHADE out vec3 fragment_normal;
SHADE out vec3 fragment_albedo;
#endif
void main() {
    vec4 place = vec4(position_m, 1.0);
    vec3 shade = tint;
    vec3 facing = normal;
#ifdef MOVES
    place = map_from_mover * place;
    facing = mat3(map_from_mover) * normal;
    shade = min(shade + albedo * max(dot(facing, sun), 0.0), 1.0);
#endif
    gl_Position = clip_from_map * place;
    fragment_uv = uv;
    fragment_tint = shade;
#if LAMPS > 0
    fragment_place_m = place.xyz;
    fragment_normal = facing;
    fragment_albedo = albedo;
#endif
}
"""

_FRAGMENT_SHADER = """
in vec2 fragment_uv;
SHADE in vec3 fragment_tint;
layout(location = 0) out vec4 colour;
#ifdef DEPTH
layout(location = 1) out float depth_m;
#endif
#ifdef TEXTURED
uniform sampler2D picture;
#endif
#if LAMPS > 0
in vec3 fragment_place_m;
SHADE in vec3 fragment_normal;
SHADE in vec3 fragment_albedo;
#endif
void main() {
    vec3 shade = fragment_tint;
#if LAMPS > 0
    vec3 facing = normalize(fragment_normal);
    vec3 light = vec3(0.0);
    for (int i = 0; i < LAMPS; ++i) {
        vec3 to_lamp = lamp_places_m[i] - fragment_place_m;
        float distance_m = length(to_lamp);
        vec4 fade = lamp_fades[i];
        float strength = max(dot(facing, to_lamp), 0.0) / max(distance_m, 1e-6)
            / max(fade.x + fade.y * distance_m + fade.z * distance_m * distance_m, 1e-6);
        light += distance_m > fade.w ? vec3(0.0) : strength * lamp_colours[i];
    }
    shade = min(shade + fragment_albedo * light, 1.0);
#endif
#ifdef TEXTURED
    shade *= texture(picture, fragment_uv).rgb;
#endif
    colour = vec4(shade, 1.0);
#ifdef DEPTH
    // A perspective's w is the depth along the optical axis.
    float along_m = 1.0 / gl_FragCoord.w;
    bool within = along_m >= depth_range_m.x && along_m <= depth_range_m.y;
    // Not a number.
    depth_m = within ? along_m : uintBitsToFloat(0x7fc00000u);
#endif
}
"""

_ALL_COLOURS = True, True, True, True
_NO_COLOURS = False, False, False, False

_THREADS_PER_PROCESSOR = 2
"""For Mesa on a CPU, which would take one: if a thread is delayed, as happens on a virtual machine,
another draws what waits for it. Pictures do not depend on it.
"""

_STRIP_PX = 80
"""Rows that are read at a time."""

_VIEW = 0
"""Binding of the programs' uniform block View."""

_VERTEX_FORMAT = "3f 2f 3f 3f 3f"
_VERTEX_FIELDS = ("position_m", "uv", "tint", "normal", "albedo")


class _Look(NamedTuple):
    """The properties of a part that select the program that draws it."""

    textured: bool
    smooth: bool
    moves: bool


@dataclass(frozen=True)
class _Shading:
    """Features of a program: only those its triangles need, since a CPU pays for each pixel.

    The values that a fragment shader reads are constants in it: llvmpipe loads uniforms one pixel
    at a time.
    """

    look: _Look
    lamps: str
    """GLSL that defines their number and values"""
    depth_range_m: DepthRange | None

    def source(self, shader: str) -> str:
        """GLSL of one stage."""
        flags = [self.lamps]
        flags += ["#define TEXTURED"] if self.look.textured else []
        flags += ["#define MOVES"] if self.look.moves else []
        if self.depth_range_m is not None:
            flags += [
                "#define DEPTH",
                f"const vec2 depth_range_m = {_constant(self.depth_range_m)};",
            ]
        # Flat tints are not interpolated: faster, and the same for each pixel.
        flags += ["#define SHADE smooth" if self.look.smooth else "#define SHADE flat"]
        return "\n".join(("#version 330", *flags, shader))


class _Shown:
    """A scene's OpenGL objects and its visibility."""

    def __init__(self, context: Any, scene: Scene, intrinsics: Intrinsics) -> None:
        self.scene = scene
        self.lamps = _lamp_constants(scene.lamps)
        self.visibility = Visibility(scene, intrinsics)
        self.vertices = context.buffer(_vertices(scene).tobytes())
        self.indices = context.buffer(np.ascontiguousarray(scene.triangles).tobytes())
        # Few are visible at a time: lists give one number, or a few, faster than arrays do.
        self.quad_textures: list[int] = scene.parts.texture[self.visibility.quads].tolist()
        self.quad_indices = context.buffer(reserve=max(self.visibility.quad_vertices.nbytes, 4))
        self.arrays: dict[tuple[_Look, bool], Any] = {}
        """Vertex arrays of the programs, by look and whether for the quads in view."""

    def release(self) -> None:
        """Release all objects."""
        for thing in (*self.arrays.values(), self.vertices, self.indices, self.quad_indices):
            thing.release()


class GlCamera:
    """A renderer with its own OpenGL context, used from the thread that made it."""

    any_thread = False

    def __init__(self, intrinsics: Intrinsics, depth_range_m: DepthRange | None = None) -> None:
        """Raises ConfigError if no context can be created."""
        self._depth_range_m = depth_range_m
        self._context: Any = _make_context()
        self._upload_smaller_levels = LevelUpload(_LIBEGL)
        self._clip_from_optical = intrinsics.clip_from_optical()
        size = intrinsics.width, intrinsics.height
        self._intrinsics = intrinsics
        self._strip = np.empty((_STRIP_PX, intrinsics.width, 4), np.uint8)
        self._textures: dict[str, Any] = {}
        self._shown: _Shown | None = None
        self._programs: dict[_Shading, Any] = {}
        with self._context as context:
            self.name = f"moderngl ({context.info['GL_RENDERER']})"
            self._buffers: list[Any] = [context.renderbuffer(size)]
            if depth_range_m is not None:
                # Depths that the shaders write in metres are read four times as fast as the depth
                # buffer, and need no linearising.
                self._buffers.append(context.renderbuffer(size, 1, dtype="f4"))
            self._z_buffer: Any = context.depth_renderbuffer(size)
            self._framebuffer: Any = context.framebuffer(self._buffers, self._z_buffer)
            self._clip_from_map: Any = context.buffer(reserve=4 * 4 * 4)
            # The same state is used for all pictures, and for nothing else.
            self._framebuffer.use()
            self._clip_from_map.bind_to_uniform_block(_VIEW)
            context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
            # The projection flips the picture, and with it the winding of every face.
            context.front_face = "cw"

    def set_scene(self, scene: Scene) -> None:
        """Upload a scene; textures that the last one had as well are kept."""
        with self._context as context:
            self._release_shown()
            wanted = {texture.sha256: texture for texture in scene.textures}
            for sha256 in [sha256 for sha256 in self._textures if sha256 not in wanted]:
                self._textures.pop(sha256).release()
            for sha256, texture in wanted.items():
                if sha256 not in self._textures:
                    self._textures[sha256] = self._upload(texture)
            self._shown = _Shown(context, scene, self._intrinsics)
            for shading in [key for key in self._programs if key.lamps != self._shown.lamps]:
                self._programs.pop(shading).release()

    def render(
        self, map_from_optical: Array, map_from_movers: Array | None = None, spare: int = 0
    ) -> Picture:
        """See Renderer."""
        from_map, clip_from_map, for_gl = _views(map_from_optical, self._clip_from_optical)
        shown = self._shown
        with self._context:
            self._clear(shown.scene.sky.tolist() if shown else (0.0, 0.0, 0.0))
            if shown:
                poses = mover_poses(shown.scene, map_from_movers)
                self._clip_from_map.write(for_gl)
                self._draw(shown, from_map, clip_from_map, poses)
            rgb = self._read_rgb()
            depth_m = None
            if self._depth_range_m is not None:
                depth_m = np.empty(rgb.shape[:2], np.float32)
                self._framebuffer.read_into(depth_m, components=1, attachment=1, dtype="f4")
        return Picture(rgb, depth_m)

    def _read_rgb(self) -> NDArray[np.uint8]:
        # Four components are read without conversion; the driver would convert three slowly.
        # A strip is still in the processor's cache when it is converted.
        width, height = self._framebuffer.size
        rgb = np.empty((height, width, 3), np.uint8)
        for top in range(0, height, len(self._strip)):
            strip = self._strip[: height - top]
            viewport = 0, top, width, len(strip)
            self._framebuffer.read_into(strip, viewport, components=4, alignment=1)
            cv2.cvtColor(strip, cv2.COLOR_RGBA2RGB, dst=rgb[top : top + len(strip)])
        return rgb

    def _clear(self, sky: Sequence[float]) -> None:
        buffer = self._framebuffer
        if self._depth_range_m is None:
            buffer.clear(*sky, 1.0, depth=1.0)
            return
        # A clear writes the same value to all buffers that are not masked.
        buffer.color_mask = _ALL_COLOURS, _NO_COLOURS
        buffer.clear(*sky, 1.0, depth=1.0)
        buffer.color_mask = _NO_COLOURS, _ALL_COLOURS
        buffer.clear(math.nan, math.nan, math.nan, math.nan, depth=1.0)
        buffer.color_mask = _ALL_COLOURS, _ALL_COLOURS

    def _draw(
        self, shown: _Shown, from_map: Array, clip_from_map: Array, map_from_movers: Array
    ) -> None:
        in_view = shown.visibility.of(from_map, clip_from_map, map_from_movers)
        for part in in_view.things.tolist():
            self._draw_part(shown, part, map_from_movers)
        self._draw_quads(shown, in_view.quads)
        for part in in_view.background.tolist():
            self._draw_part(shown, part, map_from_movers)

    def _draw_part(self, shown: _Shown, part: int, map_from_movers: Array) -> None:
        parts = shown.scene.parts
        texture, mover = int(parts.texture[part]), int(parts.mover[part])
        look = _Look(texture != PLAIN, bool(parts.smooth[part]), mover != STATIC)
        array = self._array(shown, look, False)
        if look.moves:
            array.program["map_from_mover"].write(_for_gl(map_from_movers[mover]))
        self._use(shown, texture)
        first, count = int(parts.first[part]), int(parts.count[part])
        array.render(moderngl.TRIANGLES, vertices=3 * count, first=3 * first)

    def _draw_quads(self, shown: _Shown, quads: NDArray[np.int64]) -> None:
        if not len(quads):
            return
        shown.quad_indices.write(shown.visibility.quad_vertices[quads])
        first = 0
        for texture, alike in groupby(map(shown.quad_textures.__getitem__, quads.tolist())):
            count = sum(1 for _ in alike)
            array = self._array(shown, _Look(texture != PLAIN, False, False), True)
            self._use(shown, texture)
            array.render(moderngl.TRIANGLES, vertices=6 * count, first=6 * first)
            first += count

    def _use(self, shown: _Shown, texture: int) -> None:
        if texture != PLAIN:
            self._textures[shown.scene.textures[texture].sha256].use(0)

    def _array(self, shown: _Shown, look: _Look, of_quads: bool) -> Any:
        """See _Shown.arrays; created when it is first needed."""
        array = shown.arrays.get((look, of_quads))
        if array is None:
            program = self._program(_Shading(look, shown.lamps, self._depth_range_m))
            if look.moves:
                program["sun"].write(shown.scene.sun.astype(np.float32).tobytes())
            array = self._context.vertex_array(
                program,
                [(shown.vertices, _VERTEX_FORMAT, *_VERTEX_FIELDS)],
                index_buffer=shown.quad_indices if of_quads else shown.indices,
                skip_errors=True,
            )
            shown.arrays[look, of_quads] = array
        return array

    def _program(self, shading: _Shading) -> Any:
        if shading not in self._programs:
            program = self._context.program(
                shading.source(_VERTEX_SHADER), shading.source(_FRAGMENT_SHADER)
            )
            program["View"].binding = _VIEW
            self._programs[shading] = program
        return self._programs[shading]

    def prepare(self) -> None:
        """See Renderer."""
        compile_kernels()

    def close(self) -> None:
        """See Renderer."""
        if self._context is None:
            return
        with self._context:
            self._release_shown()
            for texture in self._textures.values():
                texture.release()
            for thing in (
                *self._programs.values(),
                self._clip_from_map,
                self._framebuffer,
                *self._buffers,
                self._z_buffer,
            ):
                thing.release()
        self._textures.clear()
        self._programs.clear()
        self._context.release()
        self._context = None

    def _release_shown(self) -> None:
        if self._shown:
            self._shown.release()
        self._shown = None

    def _upload(self, texture: Texture) -> Any:
        # A row of RGBA is aligned whatever the width.
        rgba = np.asarray(cv2.cvtColor(texture.pixels, cv2.COLOR_RGB2RGBA), np.uint8)
        height, width = rgba.shape[:2]
        uploaded = self._context.texture((width, height), 4, rgba.tobytes())
        self._upload_smaller_levels(uploaded, rgba)
        # Anisotropic filtering would cost a CPU four times a whole frame, and improves markers
        # only from 75 degrees aside.
        uploaded.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        return uploaded


def compile_kernels() -> None:
    """Compile the kernels before the first picture."""
    visibility.compile_kernels()
    _for_gl(_views(np.eye(4), np.eye(4))[0])


def _make_context() -> Any:
    # Mesa on a CPU, unlike a GPU, blends two mipmap levels even where one has nearly all the
    # weight, and takes square roots to choose them: a sixth of a picture's cost, for a thousandth
    # of its colours' scale. Set here, so that pictures do not depend on the environment. A GPU's
    # driver ignores it.
    os.putenv("GALLIVM_PERF", "brilinear,rho_approx")
    os.putenv("LP_NUM_THREADS", str(_THREADS_PER_PROCESSOR * (os.cpu_count() or 1)))
    try:
        # libEGL finds every OpenGL function itself: libGL, and the X11 libraries behind it, are
        # not needed. The versioned names exist without the development packages.
        options: dict[str, Any] = {
            "require": 330,
            "backend": "egl",
            "libegl": _LIBEGL,
            "libgl": _LIBEGL,
        }
        return moderngl.create_context(standalone=True, **options)
    except Exception as error:  # moderngl raises no narrower type
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(
            f"renderer: gl: no OpenGL context could be made ({reason}); "
            "install libegl1 and libgl1-mesa-dri, or use --renderer cpu"
        ) from error


def _vertices(scene: Scene) -> NDArray[np.float32]:
    """(n, 14): position, uv, tint, normal and albedo."""
    columns = (scene.vertices_m, scene.uvs, scene.tints, scene.normals, scene.albedos)
    return np.concatenate(columns, axis=1, dtype=np.float32, casting="same_kind")


def _lamp_constants(lamps: Sequence[PointLight]) -> str:
    lines = [f"#define LAMPS {len(lamps)}"]
    for name, rows in (
        ("lamp_places_m", [lamp.position_m for lamp in lamps]),
        ("lamp_colours", [lamp.diffuse[:3] for lamp in lamps]),
        ("lamp_fades", [(lp.constant, lp.linear, lp.quadratic, lp.range_m) for lp in lamps]),
    ):
        if rows:
            kind = f"vec{len(rows[0])}"
            values = ", ".join(map(_constant, rows))
            lines.append(f"const {kind} {name}[LAMPS] = {kind}[]({values});")
    return "\n".join(lines)


def _constant(numbers: Sequence[float]) -> str:
    """A vector in GLSL, exactly the nearest values in single precision."""
    most = float(np.finfo(np.float32).max)
    exact = [float(np.float32(min(max(number, -most), most))) for number in numbers]
    return f"vec{len(exact)}({', '.join(map(repr, exact))})"


@kernel()
def _for_gl(matrix: Array) -> NDArray[np.float32]:
    """A matrix column by column, as OpenGL takes it."""
    columns = np.empty((4, 4), np.float32)
    for row in range(4):
        for column in range(4):
            columns[column, row] = matrix[row, column]
    return columns


@kernel()
def _views(
    map_from_optical: Array, clip_from_optical: Array
) -> tuple[Array, Array, NDArray[np.float32]]:
    """`optical_from_map`, `clip_from_map`, and the latter for OpenGL. Raises as the former does."""
    from_map = optical_from_map(map_from_optical)
    # A kernel's `@` would need SciPy's linear algebra, which is not loaded.
    clip_from_map = np.zeros((4, 4))
    for row in range(4):
        for column in range(4):
            for inner in range(4):
                step = clip_from_optical[row, inner] * from_map[inner, column]
                clip_from_map[row, column] += step
    return from_map, clip_from_map, _for_gl(clip_from_map)
