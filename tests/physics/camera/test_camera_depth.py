"""Depth beside colour: against ray casting by hand, for every profile, and by all renderers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.maths.frames import (
    Array,
    inverse_matrix,
    pose_matrix,
    quaternion_from_rotation,
    rotation_from_rpy,
    transform_matrix,
)
from mazebot.common.messages.documents import Body, Box, MarkerEntity, Material, World
from mazebot.perception.config import PerceptionConfig
from mazebot.perception.detect import Detector, grey_from_rgb
from mazebot.physics.camera import visibility
from mazebot.physics.camera.camera import Intrinsics, Picture
from mazebot.physics.camera.camera_messages import camera_info
from mazebot.physics.camera.renderers import RendererKind
from mazebot.physics.camera.scene import Scene, build_scene
from mazebot.physics.config import PhysicsConfig
from mazebot.physics.sensors import occlusion
from tests.physics.camera.test_camera import (
    KINDS,
    TILTED_VIEW,
    facing_back,
    flat,
    marker_picture,
    new_renderer,
    panel,
    png,
    thing,
    view,
    wall,
    world,
)

RED = Material(name="red", ambient=(0.9, 0.1, 0.1, 1), diffuse=(0.9, 0.1, 0.1, 1))
GREEN = Material(name="green", ambient=(0.1, 0.8, 0.1, 1), diffuse=(0.1, 0.8, 0.1, 1))
SIZES = {"d435i": (640, 480), "waffle": (1920, 1080), "small": (320, 240)}

TURNED = rotation_from_rpy(0.4, 0.3, 0.7)
BOX = thing(
    Box(size_m=(0.3, 0.4, 0.5)),
    "green",
    orientation_xyzw=quaternion_from_rotation(TURNED),
    position_m=(1.5, 0.1, 0.45),
)
WALLS = (wall("a", "red", x_m=3.0, length_m=2.0), wall("b", "red", x_m=2.2, y_m=-0.9, yaw_rad=0.3))
PLACES = world(WALLS, (RED, GREEN), bodies=(BOX,))


def cast(
    of: World, map_from_optical: Array, intrinsics: Intrinsics, shift_px: tuple[float, float]
) -> Array:
    """Depth of the first box or floor on the rays of the SAMPLED pixels, by slabs; inf: nothing."""
    i = intrinsics
    v, u = np.mgrid[: i.height, : i.width][:, *sampled(i)].astype(np.float64)
    u, v = u + shift_px[0], v + shift_px[1]
    rays = np.stack([(u - i.cx) / i.fx, (v - i.cy) / i.fy, np.ones_like(u)], axis=-1)
    solids = [
        (
            inverse_matrix(w.map_from_wall().matrix(w.height_m / 2.0)),
            np.array([w.length_m, w.thickness_m, w.height_m]) / 2.0,
        )
        for w in of.walls
    ] + [(inverse_matrix(pose_matrix(body)), np.array(size_of(body)) / 2.0) for body in of.bodies]
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = -map_from_optical[2, 3] / (rays @ map_from_optical[2, :3])
        least = np.where(floor > 0.0, floor, np.inf)
        for from_map, half in solids:
            eye = from_map @ map_from_optical[:, 3]
            along = rays @ (from_map[:3, :3] @ map_from_optical[:3, :3]).T
            ends = np.stack([(-half - eye[:3]) / along, (half - eye[:3]) / along])
            enters, leaves = ends.min(0).max(-1), ends.max(0).min(-1)
            least = np.where((enters <= leaves) & (enters > 0.0), np.fmin(least, enters), least)
    return np.asarray(least)


def sampled(intrinsics: Intrinsics) -> tuple[slice, slice]:
    """Rows and columns of some twenty thousand pixels."""
    step = max(1, round(intrinsics.width / 160))
    return slice(None, None, step), slice(None, None, step)


def size_of(body: Body) -> tuple[float, float, float]:
    geometry = body.shapes[0].geometry
    assert isinstance(geometry, Box)
    return geometry.size_m


def seen(
    kind: RendererKind,
    scene: Scene,
    pose: Array,
    intrinsics: Intrinsics,
    range_m: tuple[float, float] | None = (0.05, 6.0),
) -> Picture:
    renderer = new_renderer(kind, intrinsics, range_m)
    renderer.set_scene(scene)
    picture = renderer.render(pose)
    renderer.close()
    return picture


def depth_of(picture: Picture) -> NDArray[np.float64]:
    assert picture.depth_m is not None
    assert picture.depth_m.dtype == np.float32
    assert picture.depth_m.flags.c_contiguous
    return picture.depth_m.astype(np.float64)


def without_nan(depth_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """With 0 where nothing is in range, to be compared."""
    return np.nan_to_num(depth_m, nan=0.0)


def intrinsics_of(profile: str) -> Intrinsics:
    config = PhysicsConfig.model_validate({"camera_profile": profile})
    size = config.camera_width_px, config.camera_height_px
    assert size == SIZES[profile]
    return Intrinsics.from_horizontal_fov(*size, config.camera_horizontal_fov_rad)


@pytest.mark.parametrize("pose", [view(), TILTED_VIEW], ids=["level", "tilted"])
@pytest.mark.parametrize(
    ("kind", "profile"),
    [(kind, profile) for kind in ("cpu", "gl") for profile in SIZES] + [("tiny", "small")],
)
def test_depth_is_that_of_rays_cast_by_hand(kind: RendererKind, profile: str, pose: Array) -> None:
    intrinsics = intrinsics_of(profile)
    # What camera_info says is all that a reader knows.
    k = camera_info(0, intrinsics).k
    told = Intrinsics(intrinsics.width, intrinsics.height, k[0], k[4], k[2], k[5])
    picture = seen(kind, build_scene(PLACES, {}), pose, intrinsics)
    depth_m = depth_of(picture)
    assert depth_m.shape == (told.height, told.width)
    depth_m, rgb = depth_m[sampled(told)], picture.rgb[sampled(told)]
    exact = cast(PLACES, pose, told, (0.0, 0.0))
    around = [
        cast(PLACES, pose, told, (dx, dy)) for dx in (-0.5, 0.0, 0.5) for dy in (-0.5, 0.0, 0.5)
    ]
    nearest, farthest = np.min(around, axis=0), np.max(around, axis=0)
    shown = (farthest <= 5.9) & (nearest >= 0.06)
    assert shown.mean() > 0.4
    # No edge is off by more than half a pixel.
    assert (depth_m[shown] >= nearest[shown] - 1e-3).all()
    assert (depth_m[shown] <= farthest[shown] + 1e-3).all()
    # And where there is none the depth is right to a millimetre.
    within = shown & (farthest < 1.02 * nearest)
    assert within.mean() > 0.2
    assert np.abs(depth_m - exact)[within].max() < 1e-3
    # Nothing in range: sky, and the far floor.
    assert np.isnan(depth_m[nearest > 6.01]).all()
    # Colour and depth are of one render: what is green is where the box is.
    box = cast(world(bodies=(BOX,)), pose, told, (0.0, 0.0))
    green = rgb[:, :, 1] > 1.5 * np.max(rgb[:, :, (0, 2)], axis=2)
    assert green.sum() > 200
    assert np.abs(depth_m - box)[green & within].max() < 1e-3


def test_depth_is_no_number_out_of_range_and_in_the_sky() -> None:
    scene = build_scene(world((wall(x_m=3.075, length_m=6.0, height_m=3.0),)), {})
    intrinsics = intrinsics_of("small")
    row, column = 100, 160
    for kind in KINDS:
        for range_m, expected in (
            ((0.1, 5.0), 3.0),
            ((3.1, 5.0), math.nan),
            ((0.1, 2.9), math.nan),
        ):
            depth_m = depth_of(seen(kind, scene, view(), intrinsics, range_m))
            assert depth_m[row, column] == pytest.approx(expected, abs=1e-4, nan_ok=True)
            assert (np.isnan(depth_m) | (depth_m >= range_m[0])).all()
            assert (np.isnan(depth_m) | (depth_m <= range_m[1])).all()
        sky = depth_of(seen(kind, scene, view(yaw_rad=math.pi), intrinsics))
        assert np.isnan(sky[:118]).all()


@pytest.mark.parametrize("kind", KINDS)
def test_before_the_first_scene_there_is_no_depth(kind: RendererKind) -> None:
    renderer = new_renderer(kind, intrinsics_of("small"), (0.1, 5.0))
    assert np.isnan(depth_of(renderer.render(view()))).all()
    renderer.close()


@pytest.mark.parametrize("kind", KINDS)
def test_depth_comes_only_where_it_is_asked_for(kind: RendererKind) -> None:
    scene, intrinsics = build_scene(PLACES, {}), intrinsics_of("small")
    without = seen(kind, scene, TILTED_VIEW, intrinsics, None)
    assert without.depth_m is None
    assert (seen(kind, scene, TILTED_VIEW, intrinsics).rgb == without.rgb).all()


def test_a_moving_thing_has_its_depth_where_it_stands() -> None:
    ball = thing(Box(size_m=(0.2, 0.4, 0.4)), "green", mass_kg=1.0)
    scene = build_scene(world(materials=(GREEN,), bodies=(ball,)), {})
    for kind in KINDS:
        renderer = new_renderer(kind, intrinsics_of("small"), (0.1, 5.0))
        renderer.set_scene(scene)
        for x_m in (1.5, 2.5):
            pose = transform_matrix(np.eye(3), (x_m, 0.0, 0.2))[None]
            depth_m = depth_of(renderer.render(view(), pose))
            assert depth_m[115, 160] == pytest.approx(x_m - 0.1, abs=1e-3)
        renderer.close()


def neighbours(values: NDArray[Any]) -> NDArray[Any]:
    """(9, h - 2, w - 2): each inner pixel's and those of the eight about it."""
    height, width = values.shape[:2]
    return np.stack(
        [values[dv : height - 2 + dv, du : width - 2 + du] for dv in range(3) for du in range(3)]
    )


@pytest.mark.parametrize("pose", [view(), TILTED_VIEW], ids=["level", "tilted"])
def test_renderers_agree_to_a_pixel_at_edges_and_to_a_shade_elsewhere(pose: Array) -> None:
    scene, intrinsics = build_scene(PLACES, {}), intrinsics_of("d435i")
    cpu, gl, tiny = (seen(kind, scene, pose, intrinsics) for kind in KINDS)
    # The first two sample a pixel in its middle: only what lies on an edge may differ.
    assert (np.abs(cpu.rgb.astype(int) - gl.rgb).max(-1) > 1).mean() < 1e-4
    assert (np.abs(without_nan(depth_of(cpu)) - without_nan(depth_of(gl))) > 1e-4).mean() < 1e-4
    colours = neighbours(gl.rgb.astype(int))
    apart = np.abs(colours - tiny.rgb[1:-1, 1:-1].astype(int)).max(-1)
    # TinyRenderer rounds down.
    assert apart.min(0).max() <= 2
    assert (apart[4] > 2).mean() < 0.002
    depths, tiny_m = (without_nan(depth_of(each)) for each in (gl, tiny))
    depths, tiny_m = neighbours(depths), tiny_m[1:-1, 1:-1]
    assert (tiny_m >= 0.99 * depths.min(0)).all()
    assert (tiny_m <= 1.01 * depths.max(0)).all()
    assert np.median(np.abs(depths[4] - tiny_m)) < 1e-4


def many_walls() -> tuple[Scene, dict[str, bytes]]:
    """Sixty walls at random, which stand through one another, and panels on a few."""
    random = np.random.default_rng(3)
    sha256, data = png(flat((250, 250, 250), 16))
    names = ("red", "green")
    walls = tuple(
        wall(
            f"w{n}",
            names[n % 2],
            x_m=float(random.uniform(-6, 6)),
            y_m=float(random.uniform(-6, 6)),
            yaw_rad=float(random.uniform(-3, 3)),
            length_m=float(random.uniform(0.5, 4)),
            height_m=float(random.uniform(0.3, 2.5)),
        )
        for n in range(60)
    )
    panels: list[MarkerEntity] = []
    for n, there in enumerate(walls[:20]):
        pose = there.map_from_wall().matrix(0.2)
        upright = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
        at = transform_matrix(upright, (0.0, -0.075 - 0.002, 0.0))
        panels.append(panel(sha256, pose @ at, side_m=0.2).model_copy(update={"name": f"panel{n}"}))
    assets = {sha256: data}
    return build_scene(world(walls, (RED, GREEN)), assets, panels), assets


@pytest.mark.parametrize("kind", ["cpu", "gl"])
def test_what_is_left_out_does_not_show(
    kind: RendererKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, _ = many_walls()
    renderer = new_renderer(kind, Intrinsics.from_horizontal_fov(317, 235, 1.2), (0.02, 40.0))
    renderer.set_scene(scene)
    random = np.random.default_rng(4)
    drawn: list[int] = []

    def counted(corners_m: Array, *rest: Any) -> NDArray[np.int64]:
        quads = occlusion.visible_quads(corners_m, *rest)
        drawn.append(len(quads))
        return quads

    def every(corners_m: Array, *rest: Any) -> NDArray[np.int64]:
        # The others come last: of two in one plane the first shows.
        quads = occlusion.visible_quads(corners_m, *rest)
        return np.concatenate([quads, np.setdiff1d(np.arange(len(corners_m)), quads)])

    for _ in range(60):
        # Some of these eyes are inside a wall, or nearer to one than the near plane.
        roll, pitch, yaw = (random.uniform(-1, 1, 3) * (0.3, 0.3, 3.0)).tolist()
        x_m, y_m = random.uniform(-6, 6, 2).tolist()
        place = x_m, y_m, float(random.uniform(0.1, 0.4))
        pose = transform_matrix(rotation_from_rpy(roll, pitch, yaw), place) @ view(z_m=0.0)
        monkeypatch.setattr(visibility, "visible_quads", counted)
        picture = renderer.render(pose)
        monkeypatch.setattr(visibility, "visible_quads", every)
        whole = renderer.render(pose)
        assert (picture.rgb == whole.rgb).all()
        assert np.array_equal(depth_of(picture), depth_of(whole), equal_nan=True)
    renderer.close()
    # A third of all sides would turn their front to the eye and be in view.
    assert np.mean(drawn) < 0.1 * scene.parts.quad.sum()


def test_cpu_and_opengl_draw_the_same_from_anywhere() -> None:
    scene, _ = many_walls()
    intrinsics, range_m = Intrinsics.from_horizontal_fov(317, 235, 1.2), (0.02, 40.0)
    renderers = [new_renderer(kind, intrinsics, range_m) for kind in ("cpu", "gl")]
    for renderer in renderers:
        renderer.set_scene(scene)
    random = np.random.default_rng(6)
    for _ in range(40):
        roll, pitch, yaw = (random.uniform(-1, 1, 3) * (3.0, 0.5, 3.0)).tolist()
        x_m, y_m = random.uniform(-6, 6, 2).tolist()
        place = x_m, y_m, float(random.uniform(0.1, 1.0))
        pose = transform_matrix(rotation_from_rpy(roll, pitch, yaw), place) @ view(z_m=0.0)
        cpu, gl = (renderer.render(pose) for renderer in renderers)
        # Where two walls stand through one another, the depth buffer's steps show.
        assert (np.abs(cpu.rgb.astype(int) - gl.rgb).max(-1) > 1).mean() < 2e-3
        depths, cpu_m = (without_nan(depth_of(each)) for each in (gl, cpu))
        depths, cpu_m = neighbours(depths), cpu_m[1:-1, 1:-1]
        assert (np.abs(depths - cpu_m) <= 1e-4 + 1e-3 * cpu_m).any(0).mean() > 0.9995
    for renderer in renderers:
        renderer.close()


def test_balls_are_found_near_to_far_and_none_that_shows_is_missed() -> None:
    random = np.random.default_rng(5)
    clip_from_optical = Intrinsics.from_horizontal_fov(317, 235, 1.2).clip_from_optical()
    found, shown = 0, 0
    for _ in range(40):
        roll, pitch, yaw = random.uniform(-3, 3, 3).tolist()
        x_m, y_m, z_m = random.uniform(-2, 2, 3).tolist()
        pose = transform_matrix(rotation_from_rpy(roll, pitch, yaw), (x_m, y_m, z_m))
        mover = transform_matrix(rotation_from_rpy(yaw, roll, pitch), (z_m, x_m, y_m))
        optical_from_map = inverse_matrix(pose)
        clip_from_map = clip_from_optical @ optical_from_map
        centres_m, radii_m = random.uniform(-6, 6, (50, 3)), random.uniform(0.01, 1.0, 50)
        movers = random.integers(-1, 1, 50)
        balls = occlusion.balls_in_view(
            centres_m, radii_m, movers, mover[None], optical_from_map, clip_from_map
        )
        moved = centres_m @ mover[:3, :3].T + mover[:3, 3]
        in_map_m = np.where(movers[:, None] == 0, moved, centres_m)
        distances_m = np.linalg.norm(in_map_m - pose[:3, 3], axis=1) - radii_m
        assert (np.diff(distances_m[balls]) >= 0.0).all()
        directions = random.normal(size=(50, 300, 3))
        directions /= np.linalg.norm(directions, axis=2, keepdims=True)
        surface_m = in_map_m[:, None] + radii_m[:, None, None] * directions
        clip = surface_m @ clip_from_map[:, :3].T + clip_from_map[:, 3]
        within = np.abs(clip[:, :, :3]) <= clip[:, :, 3:]
        inside = np.any(np.all(within, axis=2), axis=1)
        assert set(np.flatnonzero(inside)) <= set(balls.tolist())
        found, shown = found + len(balls), shown + int(inside.sum())
    # Beside an edge of the view a ball may be found that does not show.
    assert shown > 100
    assert found < 1.5 * shown


@pytest.mark.parametrize("turn_rad", [0.0, 0.6])
@pytest.mark.parametrize("kind", ["cpu", "gl"])
def test_a_panel_of_30_cm_is_read_at_5_m(kind: RendererKind, turn_rad: float) -> None:
    sha256, data = png(marker_picture(60))
    at = panel(sha256, facing_back(5.0, 0.2, yaw_rad=turn_rad), side_m=0.3)
    bricks = wall("back", "red", x_m=6.0, length_m=8.0, height_m=3.0)
    scene = build_scene(world((bricks,), (RED,)), {sha256: data}, [at])
    picture = seen(kind, scene, view(), intrinsics_of("d435i"))
    config = PerceptionConfig()
    detector = Detector("DICT_4X4_100", config.threshold_window_px, config.threshold_contrast)
    height, width, _ = picture.rgb.shape
    grey = grey_from_rgb(picture.rgb.reshape(-1), height, width, 3 * width)
    found = detector.detect(grey, 40.0)
    assert [sighting.marker_id for sighting in found] == [60]
