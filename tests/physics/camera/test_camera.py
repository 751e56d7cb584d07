"""The camera's pictures: where things show, in which colours, and that all renderers agree."""

from __future__ import annotations

import hashlib
import math
import os
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.bench.memory import resident_mb
from mazebot.common.config import ConfigError
from mazebot.common.files import png as png_file
from mazebot.common.files.root import ROOT
from mazebot.common.maths.frames import (
    LINK_FROM_OPTICAL,
    SE2,
    Array,
    inverse_matrix,
    quaternion_from_rotation,
    rotation_from_rpy,
    transform_matrix,
)
from mazebot.common.maths.opencv import without_ipp
from mazebot.common.messages.documents import (
    Body,
    Box,
    Ceiling,
    Geometry,
    MarkerEntity,
    Material,
    Mesh,
    Planar,
    PointLight,
    Rgba,
    Shape,
    Sphere,
    Wall,
    World,
)
from mazebot.common.world.geometry import mesh_to_bytes, triangles_of
from mazebot.physics.camera import renderers
from mazebot.physics.camera.camera import DepthRange, Intrinsics, Renderer
from mazebot.physics.camera.cpu_camera import CpuCamera
from mazebot.physics.camera.renderers import RendererKind, make_renderer
from mazebot.physics.camera.scene import PANEL_BACK, PLAIN, Scene, build_scene
from tests.physics.own_process import figures

Picture = NDArray[np.uint8]

INTRINSICS = Intrinsics.from_horizontal_fov(320, 240, 1.047)
SKY = 0.7, 0.7, 0.7, 1.0


KINDS: tuple[RendererKind, ...] = ("cpu", "gl", "tiny")


def new_renderer(
    kind: RendererKind, intrinsics: Intrinsics = INTRINSICS, range_m: DepthRange | None = None
) -> Renderer:
    try:
        renderer = make_renderer(kind, intrinsics, range_m)
    except ConfigError as error:
        if "CI" in os.environ:
            raise
        pytest.skip(str(error))
    assert renderer is not None
    return renderer


@pytest.fixture(params=KINDS)
def renderer(request: pytest.FixtureRequest) -> Iterator[Renderer]:
    made = new_renderer(request.param)
    yield made
    made.close()


@pytest.fixture(params=["cpu", "gl"])
def shader(request: pytest.FixtureRequest) -> Iterator[Renderer]:
    """A renderer that shades each pixel by itself."""
    made = new_renderer(request.param)
    yield made
    made.close()


def world(
    walls: tuple[Wall, ...] = (),
    materials: tuple[Material, ...] = (),
    floor: Rgba = (0.0, 0.0, 0.3, 1.0),
    **changes: Any,
) -> World:
    return World(
        name="test",
        recipe="test.yaml",
        hash="",
        walls=walls,
        materials=(*materials, Material(name="floor", ambient=floor, diffuse=floor)),
        start=Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0),
        **{"sky": SKY, "floor_material": "floor", **changes},
    )


def wall(name: str = "wall", material: str = "plain", **changes: float) -> Wall:
    """A wall 2 m ahead of the map's origin, across the view: its near face is at x = 2."""
    shape = {"length_m": 1.0, "thickness_m": 0.15, "height_m": 1.0}
    pose = {"x_m": 2.075, "y_m": 0.0, "yaw_rad": math.pi / 2}
    return Wall(name=name, material=material, **{**shape, **pose, **changes})


def png(rgb: Picture) -> tuple[str, bytes]:
    data = cv2.imencode(".png", np.ascontiguousarray(rgb[:, :, ::-1]))[1].tobytes()
    return hashlib.sha256(data).hexdigest(), data


def flat(rgb: tuple[int, int, int], side_px: int = 4) -> Picture:
    return np.full((side_px, side_px, 3), rgb, np.uint8)


def marker_picture(marker_id: int, module_px: int = 24) -> Picture:
    """A marker with a quiet zone of one module: eight modules a side."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    black_square = cv2.aruco.generateImageMarker(dictionary, marker_id, 6 * module_px)
    grey = np.pad(np.asarray(black_square, np.uint8), module_px, constant_values=255)
    return np.repeat(grey[:, :, None], 3, axis=2)


def panel(sha256: str, map_from_panel: Array, side_m: float = 0.4) -> MarkerEntity:
    x, y, z = (float(value) for value in map_from_panel[:3, 3])
    return MarkerEntity(
        name="panel",
        position_m=(x, y, z),
        orientation_xyzw=quaternion_from_rotation(map_from_panel[:3, :3]),
        panel_side_m=side_m,
        texture_sha256=sha256,
        marker_id=0,
        marker_size_m=side_m * 6 / 8,
        dictionary="DICT_4X4_100",
    )


def facing_back(x_m: float, y_m: float = 0.0, z_m: float = 0.25, yaw_rad: float = 0.0) -> Array:
    """Pose of an upright panel that looks along -x, turned by yaw."""
    upright = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return transform_matrix(rotation_from_rpy(0.0, 0.0, yaw_rad) @ upright, (x_m, y_m, z_m))


def view(x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.117, yaw_rad: float = 0.0) -> Array:
    """map_from_optical of a level camera."""
    return SE2(x_m, y_m, yaw_rad).matrix(z_m) @ LINK_FROM_OPTICAL


TILTED_VIEW = (
    transform_matrix(rotation_from_rpy(0.15, -0.1, 0.12), (0.1, -0.2, 0.3)) @ LINK_FROM_OPTICAL
)


def projected(
    points_m: Array, map_from_optical: Array, intrinsics: Intrinsics = INTRINSICS
) -> Array:
    """(n, 2) pixel coordinates by OpenCV's camera model."""
    optical_from_map = inverse_matrix(map_from_optical)
    rotation, _ = cv2.Rodrigues(optical_from_map[:3, :3])
    pixels, _ = cv2.projectPoints(
        np.ascontiguousarray(points_m),
        rotation,
        optical_from_map[:3, 3],
        camera_matrix(intrinsics),
        None,
    )
    return np.asarray(pixels, np.float64).reshape(-1, 2)


def camera_matrix(intrinsics: Intrinsics = INTRINSICS) -> Array:
    i = intrinsics
    return np.array([[i.fx, 0.0, i.cx], [0.0, i.fy, i.cy], [0.0, 0.0, 1.0]])


def colour_at(picture: Picture, point_m: tuple[float, float, float], pose: Array) -> Picture:
    u, v = projected(np.array([point_m]), pose)[0]
    colour: Picture = picture[round(v), round(u)]
    return colour


def depth_inside(outline: Array) -> Array:
    """(height, width): how far inside a convex outline each pixel's centre is; negative outside."""
    hull = cv2.convexHull(outline.astype(np.float32), clockwise=False)[:, 0].astype(np.float64)
    edges = np.roll(hull, -1, axis=0) - hull
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    v, u = np.mgrid[: INTRINSICS.height, : INTRINSICS.width]
    depths = [
        edge[0] * (v - corner[1]) - edge[1] * (u - corner[0])
        for corner, edge in zip(hull, edges, strict=True)
    ]
    return np.asarray(np.min(depths, axis=0), np.float64)


def assert_fills(mask: NDArray[np.bool_], outline: Array, tolerance_px: float) -> None:
    """The mask's edges lie where the outline's do."""
    inside = depth_inside(outline)
    assert (inside > tolerance_px).sum() > 200
    assert mask[inside > tolerance_px].all()
    assert not mask[inside < -tolerance_px].any()


@pytest.mark.parametrize("pose", [view(), TILTED_VIEW], ids=["level", "tilted"])
def test_panel_shows_where_opencv_projects_it(renderer: Renderer, pose: Array) -> None:
    sha256, data = png(flat((255, 255, 255)))
    map_from_panel = facing_back(1.3, 0.1, 0.3, yaw_rad=0.4)
    renderer.set_scene(build_scene(world(), {sha256: data}, [panel(sha256, map_from_panel)]))
    corners = np.array([[-0.2, -0.2, 0], [0.2, -0.2, 0], [0.2, 0.2, 0], [-0.2, 0.2, 0]])
    corners_m = corners @ map_from_panel[:3, :3].T + map_from_panel[:3, 3]
    white = (renderer.render(pose).rgb == 255).all(axis=2)
    assert_fills(white, projected(corners_m, pose), tolerance_px=0.05)


@pytest.mark.parametrize("pose", [view(), TILTED_VIEW], ids=["level", "tilted"])
def test_wall_shows_where_opencv_projects_it(renderer: Renderer, pose: Array) -> None:
    plain = Material(name="plain", ambient=(1, 0, 0, 1), diffuse=(1, 0, 0, 1))
    there = wall(x_m=2.4, y_m=0.2, yaw_rad=1.2, height_m=0.6)
    renderer.set_scene(build_scene(world((there,), (plain,)), {}))
    corners_m = [
        there.map_from_wall().matrix() @ (sx * 0.5, sy * 0.075, z, 1.0)
        for sx in (-1, 1)
        for sy in (-1, 1)
        for z in (0.0, 0.6)
    ]
    picture = renderer.render(pose).rgb.astype(int)
    red = (picture[:, :, 0] > 60) & (picture[:, :, 1] == 0)
    assert_fills(red, projected(np.array(corners_m)[:, :3], pose), tolerance_px=0.05)


@pytest.mark.parametrize("distance_m", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("kind", KINDS)
def test_marker_is_read_with_its_pose(kind: RendererKind, distance_m: float) -> None:
    intrinsics = Intrinsics.from_horizontal_fov(640, 480, 1.047)
    renderer = new_renderer(kind, intrinsics)
    sha256, data = png(marker_picture(60))
    map_from_panel = facing_back(distance_m, 0.1, yaw_rad=0.5)
    side_m = 0.3
    renderer.set_scene(
        build_scene(world(), {sha256: data}, [panel(sha256, map_from_panel, side_m=side_m * 8 / 6)])
    )
    picture = renderer.render(view()).rgb
    renderer.close()

    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(picture)
    assert ids is not None
    assert ids.ravel().tolist() == [60]
    half = side_m / 2
    square_m = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    _, _, places, _ = cv2.solvePnPGeneric(
        square_m, corners[0], camera_matrix(intrinsics), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    optical_from_panel = inverse_matrix(view()) @ map_from_panel
    error_m = np.linalg.norm(places[0].ravel() - optical_from_panel[:3, 3])
    assert error_m < 0.01 * distance_m
    expected = projected(
        square_m @ map_from_panel[:3, :3].T + map_from_panel[:3, 3], view(), intrinsics
    )
    # TinyRenderer's edges are stairs of whole pixels.
    assert np.abs(corners[0][0] - expected).max() < (0.8 if kind == "tiny" else 0.5)


def test_texture_repeats_by_the_metre_from_the_bottom_left(renderer: Renderer) -> None:
    tile = np.zeros((64, 64, 3), np.uint8)
    tile[:32, :32], tile[:32, 32:] = (200, 0, 0), (0, 200, 0)
    tile[32:, :32], tile[32:, 32:] = (0, 0, 200), (200, 200, 0)
    sha256, data = png(tile)
    material = Material(name="plain", texture_sha256=sha256, texture_side_m=0.4)
    renderer.set_scene(
        build_scene(world((wall(),), (material,), light_diffuse=0.0), {sha256: data})
    )
    picture = renderer.render(view(z_m=0.3)).rgb
    # As one looks along +x, the face's left end is at y = 0.5.
    for column in range(5):
        for row in range(4):
            y_m, z_m = 0.5 - 0.1 - 0.2 * column, 0.1 + 0.2 * row
            across, up = column % 2, row % 2
            expected = tile[16 if up else 48, 48 if across else 16]
            seen = colour_at(picture, (2.0, y_m, z_m), view(z_m=0.3))
            assert np.abs(seen.astype(int) - expected).max() <= 1, (column, row)


def test_plain_wall_has_its_colour_under_the_light(renderer: Renderer) -> None:
    plain = Material(name="plain", ambient=(0.2, 0.4, 0.6, 1), diffuse=(0.8, 0.4, 0.2, 1))
    lit_by: dict[str, Any] = {
        "light_ambient": 0.5,
        "light_diffuse": 0.5,
        "light_direction": (0.6, 0.0, -0.8),
    }
    renderer.set_scene(build_scene(world((wall(),), (plain,), **lit_by), {}))
    seen = colour_at(renderer.render(view()).rgb, (2.0, 0.0, 0.3), view()).astype(int)
    # The light falls on the near face at a cosine of 0.6, as much as on any upright face.
    expected = [
        255 * (0.5 * a + 0.5 * 0.6 * d) / 0.8 for a, d in ((0.2, 0.8), (0.4, 0.4), (0.6, 0.2))
    ]
    assert np.abs(seen - expected).max() <= 1
    behind = view(4.0, yaw_rad=math.pi)
    seen = colour_at(renderer.render(behind).rgb, (2.15, 0.0, 0.3), behind).astype(int)
    assert np.abs(seen - [255 * 0.5 * a / 0.8 for a in (0.2, 0.4, 0.6)]).max() <= 1


def test_sky_and_floor_have_the_colours_of_the_world(renderer: Renderer) -> None:
    floor = (0.1, 0.5, 0.3, 1.0)
    plains = world(light_diffuse=0.0, floor=floor, sky=(0.2, 0.4, 0.8, 1.0))
    renderer.set_scene(build_scene(plains, {}))
    picture = renderer.render(view()).rgb
    assert (picture[:118] == (51, 102, 204)).all()
    assert np.abs(picture[130:].astype(int) - (25.5, 127.5, 76.5)).max() <= 1


def test_panel_is_not_lit_and_has_a_plain_back(renderer: Renderer) -> None:
    half_black = flat((255, 255, 255), 64)
    half_black[:, :32] = 0
    sha256, data = png(half_black)
    dim = world(light_ambient=0.1, light_diffuse=0.0)
    renderer.set_scene(build_scene(dim, {sha256: data}, [panel(sha256, facing_back(1.0))]))
    picture = renderer.render(view()).rgb
    # The picture's left is the viewer's left, at +y.
    assert colour_at(picture, (1.0, 0.1, 0.25), view()).tolist() == [0, 0, 0]
    assert colour_at(picture, (1.0, -0.1, 0.25), view()).tolist() == [255, 255, 255]
    behind = view(2.0, yaw_rad=math.pi)
    back = colour_at(renderer.render(behind).rgb, (1.0, 0.1, 0.25), behind).astype(int)
    assert np.abs(back - 255 * np.array(PANEL_BACK[:3])).max() <= 1


def test_faces_in_one_plane_show_the_first_wall_only(renderer: Renderer) -> None:
    red = Material(name="red", ambient=(1, 0, 0, 1), diffuse=(1, 0, 0, 1))
    green = Material(name="green", ambient=(0, 1, 0, 1), diffuse=(0, 1, 0, 1))
    walls = (
        wall("first", "red"),
        wall("second", "green", y_m=0.4, x_m=2.075 + 1e-5, yaw_rad=-1.5708),
    )
    renderer.set_scene(build_scene(world(walls, (red, green)), {}))
    picture = renderer.render(view()).rgb
    row = round(projected(np.array([[2.0, 0.0, 0.3]]), view())[0, 1])
    u_of = {y: projected(np.array([[2.0, y, 0.3]]), view())[0, 0] for y in (0.9, 0.5, -0.5)}
    second = picture[row, math.ceil(u_of[0.9]) : math.floor(u_of[0.5])]
    first = picture[row, math.ceil(u_of[0.5]) : math.floor(u_of[-0.5])]
    assert (second[:, 0] == 0).all()
    assert (second[:, 1] > 100).all()
    assert (first[:, 0] > 100).all()
    assert (first[:, 1] == 0).all()


def thing(geometry: Geometry, material: str = "plain", **changes: Any) -> Body:
    """A body a metre and a half ahead."""
    shape = Shape(name="shape", geometry=geometry, material=material)
    values = {"name": "thing", "position_m": (1.5, 0.0, 0.2), "shapes": (shape,)}
    return Body.model_validate({**values, **changes})


GREY = Material(name="plain", ambient=(0.5, 0.5, 0.5, 1), diffuse=(0.5, 0.5, 0.5, 1))
RED = Material(name="red", ambient=(0.9, 0, 0, 1), diffuse=(0.9, 0, 0, 1))


@pytest.mark.parametrize("mass_kg", [0.0, 1.0], ids=["static", "moving"])
def test_bodies_show_where_opencv_projects_them(renderer: Renderer, mass_kg: float) -> None:
    turn = rotation_from_rpy(0.4, 0.3, 0.7)
    box = thing(
        Box(size_m=(0.3, 0.4, 0.5)), "red", mass_kg=mass_kg,
        orientation_xyzw=quaternion_from_rotation(turn), position_m=(1.5, 0.1, 0.4),
    )  # fmt: skip
    renderer.set_scene(build_scene(world(materials=(RED,), bodies=(box,)), {}))
    places = [(1.5, 0.1, 0.4), (2.0, -0.3, 0.6)] if mass_kg else [(1.5, 0.1, 0.4)]
    for place in places:
        poses = np.array([transform_matrix(turn, place)]) if mass_kg else None
        picture = renderer.render(view(), poses).rgb.astype(int)
        corners = triangles_of(Box(size_m=(0.3, 0.4, 0.5)), {}).vertices_m @ turn.T + place
        red = (picture[:, :, 0] > 40) & (picture[:, :, 1] == 0)
        assert_fills(red, projected(corners, view()), tolerance_px=0.05)


def test_a_body_that_has_turned_is_lit_where_it_stands(shader: Renderer) -> None:
    turn = rotation_from_rpy(0.5, -0.4, 2.0)
    still = thing(Sphere(radius_m=0.3), orientation_xyzw=quaternion_from_rotation(turn))
    pictures = []
    for body, poses in (
        (still, None),
        (
            thing(Sphere(radius_m=0.3), mass_kg=1.0, position_m=(9, 9, 9)),
            np.array([transform_matrix(turn, (1.5, 0.0, 0.2))]),
        ),
    ):
        shader.set_scene(build_scene(world(materials=(GREY,), bodies=(body,)), {}))
        pictures.append(shader.render(view(), poses).rgb.astype(int))
    assert np.abs(pictures[0] - pictures[1]).max() <= 1


def test_what_is_round_is_shaded_evenly_and_lighter_towards_the_sun(shader: Renderer) -> None:
    lit_by: dict[str, Any] = {"light_direction": (0.0, 0.0, -1.0), "light_ambient": 0.4}
    ball = thing(Sphere(radius_m=0.3))
    shader.set_scene(build_scene(world(materials=(GREY,), bodies=(ball,), **lit_by), {}))
    picture = shader.render(view(z_m=0.2)).rgb.astype(int)
    middle = picture[80:160, 160, 0]
    assert middle[5] > middle[40] + 40
    # Flat facets would make steps.
    assert np.abs(np.diff(picture[85:120, 160, 0])).max() < 12


def test_poses_of_movers_must_be_finite_and_as_many(renderer: Renderer) -> None:
    ball = thing(Sphere(radius_m=0.3), mass_kg=1.0)
    renderer.set_scene(build_scene(world(materials=(GREY,), bodies=(ball,)), {}))
    for poses in (np.full((1, 4, 4), math.nan), np.eye(4)[None].repeat(2, 0)):
        with pytest.raises(ValueError, match="map_from_movers: must be finite"):
            renderer.render(view(), poses)


def lamps(*places_m: tuple[float, float, float], **changes: Any) -> dict[str, Any]:
    lights = tuple(
        PointLight(name=f"lamp{n}", position_m=place, **changes) for n, place in enumerate(places_m)
    )
    return {"lights": lights, "light_ambient": 0.1, "light_diffuse": 0.0}


def test_a_lamp_lights_what_is_near_after_lambert(shader: Renderer) -> None:
    of = world((wall(length_m=4.0),), (GREY,), **lamps((1.0, 0.5, 0.5), quadratic=1.0))
    shader.set_scene(build_scene(of, {}))
    pose = view(z_m=0.4)
    picture = shader.render(pose).rgb
    for y in (0.5, 0.0, -0.6):
        distance = math.hypot(1.0, y - 0.5, 0.0)
        light = 0.1 + (1.0 / distance) / (1.0 + distance**2)
        seen = float(colour_at(picture, (2.0, y, 0.5), pose)[0])
        assert seen == pytest.approx(255 * 0.5 * light, abs=1.5)


def test_a_lamp_does_not_reach_beyond_its_range_or_behind_a_face(renderer: Renderer) -> None:
    dark = 255 * 0.5 * 0.1
    for place, changes in (((0.0, 0.0, 0.4), {"range_m": 1.5}), ((3.0, 0.0, 0.4), {})):
        of = world((wall(),), (GREY,), **lamps(place, **changes))
        renderer.set_scene(build_scene(of, {}))
        seen = colour_at(renderer.render(view()).rgb, (2.0, 0.1, 0.3), view())
        assert float(seen[0]) == pytest.approx(dark, abs=9.0)


def test_lamps_change_with_the_scene(shader: Renderer) -> None:
    seen = []
    for places in ([(1.0, 0.5, 0.5)], [(1.0, -0.5, 0.5)], [(1.0, 0.5, 0.5), (1.0, -0.5, 0.5)]):
        of = world((wall(length_m=4.0),), (GREY,), **lamps(*places, quadratic=4.0))
        shader.set_scene(build_scene(of, {}))
        picture = shader.render(view(z_m=0.4)).rgb
        seen.append([int(colour_at(picture, (2.0, y, 0.5), view(z_m=0.4))[0]) for y in (0.5, -0.5)])
    (near, far), (far_again, near_again), (left, right) = seen
    assert near > far + 10
    assert (near_again, far_again) == pytest.approx((near, far), abs=1)
    assert min(left, right) > near


def test_a_lamp_beyond_single_precision_gives_a_picture(shader: Renderer) -> None:
    of = world((wall(),), (GREY,), **lamps((1e300, -1e300, 1e-300), range_m=1e308, quadratic=1e308))
    shader.set_scene(build_scene(of, {}))
    seen = colour_at(shader.render(view()).rgb, (2.0, 0.1, 0.3), view())
    assert float(seen[0]) == pytest.approx(255 * 0.5 * 0.1, abs=2.0)


def test_lamps_do_not_light_markers(shader: Renderer) -> None:
    sha256, data = png(flat((0, 100, 200)))
    of = world((wall(),), (GREY,), **lamps((0.5, 0.0, 0.3)))
    shader.set_scene(build_scene(of, {sha256: data}, [panel(sha256, facing_back(1.9))]))
    seen = colour_at(shader.render(view()).rgb, (1.9, 0.05, 0.25), view())
    assert seen.tolist() == [0, 100, 200]


def test_floor_and_ceiling_have_their_textures(renderer: Renderer) -> None:
    quarters = flat((200, 0, 0), 64)
    quarters[:32, :32] = 0, 200, 0
    sha256, data = png(quarters)
    of = world(
        (wall("a", x_m=3.0, length_m=6.0), wall("b", x_m=-3.0, length_m=6.0)),
        (Material(name="plain"), Material(name="tiles", texture_sha256=sha256)),
        floor_material="tiles",
        ceiling=Ceiling(height_m=0.8, material="tiles"),
        light_diffuse=0.0,
    )
    renderer.set_scene(build_scene(of, {sha256: data}))
    pose = view(x_m=-1.0, z_m=0.4)
    picture = renderer.render(pose).rgb
    # A tile lies from the map's origin on, its first quarter towards -x and +y as seen from above;
    # the ceiling's towards -x and -y.
    for x, y in ((0.25, 0.25), (0.75, 0.25), (0.25, -0.25), (0.75, -0.25)):
        below = colour_at(picture, (x, y, 0.0), pose).tolist()
        above = colour_at(picture, (x, y, 0.8), pose).tolist()
        green, red = [0, 200, 0], [200, 0, 0]
        assert below == (green if (x, y) == (0.25, -0.25) else red)
        assert above == (green if (x, y) == (0.25, 0.25) else red)


def test_a_mesh_is_shown_and_one_that_is_missing_is_named(shader: Renderer) -> None:
    data = mesh_to_bytes(triangles_of(Box(size_m=(0.4, 0.4, 0.4)), {}))
    sha256 = hashlib.sha256(data).hexdigest()
    of = world(materials=(RED,), bodies=(thing(Mesh(sha256=sha256), "red"),))
    shader.set_scene(build_scene(of, {sha256: data}))
    assert (shader.render(view()).rgb[:, :, 0] > 100).sum() > 1000
    assert build_scene(of, {}).problems == (
        f"body thing: mesh {sha256[:12]} is missing; not shown",
    )


def textured_room() -> Scene:
    """Three walls with a pattern as fine as a real one's, and a marker."""
    grain = np.random.default_rng(1).integers(90, 160, (32, 32, 3), np.uint8)
    without_ipp()
    bricks = cv2.resize(grain, (512, 512), interpolation=cv2.INTER_CUBIC)
    bricks[::64] = bricks[:, ::128] = 220
    sha256, data = png(np.asarray(bricks, np.uint8))
    marker_sha256, marker_data = png(marker_picture(80))
    material = Material(name="bricks", texture_sha256=sha256)
    walls = (
        wall("ahead", "bricks", length_m=3.0),
        wall("left", "bricks", length_m=3.0, x_m=1.0, y_m=1.2, yaw_rad=0.2),
        wall("right", "bricks", length_m=3.0, x_m=1.0, y_m=-1.0, yaw_rad=0.0),
    )
    assets = {sha256: data, marker_sha256: marker_data}
    return build_scene(world(walls, (material,)), assets, [panel(marker_sha256, facing_back(1.99))])


def test_renderers_agree() -> None:
    pictures = []
    for kind in KINDS:
        renderer = new_renderer(kind)
        renderer.set_scene(textured_room())
        pictures.append(renderer.render(TILTED_VIEW).rgb.astype(int))
        renderer.close()
    cpu, gl, tiny = pictures
    # Mesa blends two levels of a texture less than in full; a pixel on an edge is on either side.
    apart = np.abs(cpu - gl).max(axis=2)
    assert apart.mean() < 0.6
    assert (apart > 8).mean() < 0.005
    # TinyRenderer rounds down, and shows one pixel of a texture where OpenGL mixes several.
    assert np.abs(gl.mean(axis=(0, 1)) - tiny.mean(axis=(0, 1))).max() < 2.0
    assert np.abs(gl - tiny).mean() < 4.0
    blurred = [cv2.blur(picture.astype(np.float32), (7, 7)) for picture in pictures]
    assert np.abs(blurred[0] - blurred[1]).max() < 40.0


def test_pictures_are_the_callers_own(renderer: Renderer) -> None:
    renderer.set_scene(textured_room())
    first = renderer.render(view()).rgb
    assert first.shape == (240, 320, 3)
    assert first.dtype == np.uint8
    assert first.flags.c_contiguous
    copy = first.copy()
    second = renderer.render(view(yaw_rad=0.5)).rgb
    assert (first == copy).all()
    assert (second != first).any()
    assert (renderer.render(view()).rgb == first).all()


def test_there_is_nothing_to_see_before_the_first_scene(renderer: Renderer) -> None:
    assert not renderer.render(view()).rgb.any()


def test_a_new_scene_takes_the_place_of_the_old(renderer: Renderer) -> None:
    renderer.set_scene(build_scene(world(), {}))
    empty = renderer.render(view()).rgb
    renderer.set_scene(textured_room())
    room = renderer.render(view()).rgb
    renderer.set_scene(build_scene(world(), {}))
    assert (renderer.render(view()).rgb == empty).all()
    renderer.set_scene(textured_room())
    assert (renderer.render(view()).rgb == room).all()


def kind_of(renderer: Renderer) -> RendererKind:
    kinds: dict[str, RendererKind] = {"cpu_rasterizer": "cpu", "tiny_renderer": "tiny"}
    return kinds.get(renderer.name, "gl")


def test_two_cameras_of_one_process_do_not_mix(renderer: Renderer) -> None:
    other = new_renderer(kind_of(renderer))
    renderer.set_scene(textured_room())
    alone = renderer.render(view()).rgb
    other.set_scene(build_scene(world(), {}))
    empty = other.render(view()).rgb
    assert (renderer.render(view()).rgb == alone).all()
    assert (other.render(view()).rgb == empty).all()
    other.close()
    other.close()
    assert (renderer.render(view()).rgb == alone).all()


def shown_again_mb(kind: RendererKind) -> tuple[float, float]:
    """Memory of this process after two scenes were shown in turns, and after they were again."""
    renderer = new_renderer(kind)
    scenes = []
    for shade in (100, 200):
        sha256, data = png(flat((shade, 0, 0), 1024))
        material = Material(name="plain", texture_sha256=sha256)
        scenes.append(build_scene(world((wall(),), (material,)), {sha256: data}))
    resident = []
    for _ in range(17):
        for scene in scenes:
            renderer.set_scene(scene)
            renderer.render(view())
        resident.append(resident_mb())
    renderer.close()
    # Not until the second turn is the old scene's memory free while the new one's is made.
    return resident[1], resident[-1]


def test_scenes_do_not_pile_up(renderer: Renderer) -> None:
    kind = kind_of(renderer)
    before_mb, after_mb = figures(__name__, f"shown_again_mb({kind!r})", timeout_s=120)
    # Kept, 30 textures would be 160 MB, and 12 MB in TinyRenderer, which gets small ones.
    # Mesa frees one some frames after it was let go.
    assert after_mb - before_mb < (25.0 if kind == "gl" else 4.0)


def with_value(value: float) -> Array:
    pose = view()
    pose[0, 3] = value
    return pose


@pytest.mark.parametrize(
    "pose", [with_value(math.nan), with_value(math.inf), view()[:3], view().ravel(), np.eye(5)]
)
def test_a_pose_that_is_none_is_refused(renderer: Renderer, pose: Array) -> None:
    with pytest.raises(ValueError, match=r"map_from_optical: must be a finite \(4, 4\) matrix"):
        renderer.render(pose)


def run_python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def picture_hash(kind: RendererKind) -> str:
    renderer = new_renderer(kind)
    renderer.set_scene(textured_room())
    digest = hashlib.sha256()
    for yaw_rad in (-0.6, 0.0, 0.6):
        digest.update(renderer.render(view(yaw_rad=yaw_rad)).rgb.tobytes())
    renderer.close()
    return digest.hexdigest()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_pixels_are_the_same_in_every_process(kind: RendererKind) -> None:
    # Drawn with as many threads as there are told to be, or with none beside: that must not show.
    code = f"""
from mazebot.physics.camera import cpu_camera, gl_camera
gl_camera._THREADS_PER_PROCESSOR = 0
cpu_camera._processors = lambda: 1
from tests.physics.camera.test_camera import picture_hash
print(picture_hash({kind!r}))
"""
    expected = picture_hash(kind)
    other = run_python(code)
    assert other.stdout.split()[-1:] == [expected], other.stderr


@pytest.mark.slow
def test_the_cpus_pixels_are_the_same_on_another_processor(tmp_path: Path) -> None:
    code = "from tests.physics.camera.test_camera import picture_hash; print(picture_hash('cpu'))"
    # The oldest that there is: no vectors but of four numbers, nothing fused.
    plain = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    other = run_python(code, NUMBA_CACHE_DIR=str(tmp_path), **plain)
    assert other.stdout.split() == [picture_hash("cpu")], other.stderr
    assert list(tmp_path.rglob("rasterizer.draw_strip*.nbc"))


@pytest.mark.parametrize("threads", [1, 2, 3, 7])
def test_the_cpus_pixels_do_not_depend_on_its_threads(threads: int) -> None:
    scene, odd = textured_room(), Intrinsics.from_horizontal_fov(317, 235, 1.2)
    pictures = []
    for count in (2, threads):
        drawn = CpuCamera(odd, (0.1, 5.0), count)
        drawn.set_scene(scene)
        pictures.append(drawn.render(TILTED_VIEW))
        drawn.close()
    first, second = pictures
    assert first.depth_m is not None
    assert second.depth_m is not None
    assert (first.rgb == second.rgb).all()
    assert np.array_equal(first.depth_m, second.depth_m, equal_nan=True)


@pytest.mark.slow
def test_no_kernel_of_the_cpus_is_left_to_compile() -> None:
    code = """
import numpy as np
from mazebot.physics.camera import cpu_camera, rasterizer
cpu_camera.compile_kernels()
from mazebot.physics.camera.camera import Intrinsics
from tests.physics.camera.test_camera import TILTED_VIEW, textured_room
camera = cpu_camera.CpuCamera(Intrinsics.from_horizontal_fov(64, 48, 1.2), (0.1, 5.0))
camera.set_scene(textured_room())
read_only = TILTED_VIEW.copy(order="F")
read_only.flags.writeable = False
camera.render(read_only)
kernels = rasterizer.triangles_of_parts, rasterizer.project, rasterizer.draw_strips
print(*(len(kernel.signatures) for kernel in kernels))
"""
    done = run_python(code)
    assert done.stdout.split() == ["1", "1", "1"], done.stderr


CHOOSE = """
import logging
logging.basicConfig(format="%(levelname)s %(message)s", level="INFO")
from mazebot.common.config import ConfigError
from mazebot.physics.camera import renderers
from mazebot.physics.camera.camera import Intrinsics
from mazebot.physics.camera.renderers import make_renderer
intrinsics = Intrinsics.from_horizontal_fov(32, 24, 1.0)
"""


def test_without_opengl_gl_says_so_and_auto_takes_the_cpu(tmp_path: Path) -> None:
    code = f"""{CHOOSE}
try:
    make_renderer("gl", intrinsics)
except ConfigError as error:
    print(error)
renderers._GPU_DEVICES = ("null",)
print(make_renderer("auto", intrinsics).name)
"""
    # No driver is registered in an empty folder.
    result = run_python(code, __EGL_VENDOR_LIBRARY_DIRS=str(tmp_path))
    lines = [line for line in result.stdout.splitlines() if "build time" not in line]
    assert len(lines) == 2, result.stderr
    assert lines[0].startswith("renderer: gl: no OpenGL context could be made (")
    assert lines[0].endswith("install libegl1 and libgl1-mesa-dri, or use --renderer cpu")
    assert lines[1] == "cpu_rasterizer"
    assert f"WARNING {lines[0]}; rendering on the CPU" in result.stderr
    assert "INFO Rendering with cpu_rasterizer" in result.stderr


@pytest.mark.slow
def test_auto_asks_opengl_only_where_there_is_a_gpu_and_takes_no_other_cpu_for_one() -> None:
    for devices, loaded in (("nothing*", "False"), ("null", "True")):
        code = f"""{CHOOSE}
import sys
renderers._GPU_DEVICES = ({devices!r},)
renderers._SOFTWARE_DRIVERS = ("moderngl",)
print(make_renderer("auto", intrinsics).name, "moderngl" in sys.modules)
"""
        result = run_python(code)
        assert result.stdout.split() == ["cpu_rasterizer", loaded], result.stderr
        assert ("no GPU; rendering on the CPU" in result.stderr) == (loaded == "True")


def test_auto_takes_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(renderers, "_GPU_DEVICES", ("null",))
    monkeypatch.setattr(renderers, "_SOFTWARE_DRIVERS", ())
    new_renderer("gl").close()
    assert kind_of(new_renderer("auto")) == "gl"


def test_none_renders_nothing() -> None:
    assert make_renderer("none", INTRINSICS) is None


def test_intrinsics_are_those_of_the_reference_camera() -> None:
    assert math.isclose(INTRINSICS.fx, 277.13, abs_tol=0.1)
    assert INTRINSICS.fx == INTRINSICS.fy
    assert (INTRINSICS.cx, INTRINSICS.cy) == (160.0, 120.0)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"width": 0}, "width"),
        ({"height": -5}, "height"),
        ({"width": 20_000}, "width"),
        ({"fx": math.nan}, "fx"),
        ({"fy": 0.0}, "fy"),
        ({"cx": math.inf}, "cx"),
    ],
)
def test_impossible_intrinsics_are_refused(changes: dict[str, Any], field: str) -> None:
    good = {"width": 32, "height": 24, "fx": 30.0, "fy": 30.0, "cx": 16.0, "cy": 12.0}
    with pytest.raises(ValueError, match=f"^{field}: must be "):
        Intrinsics(**{**good, **changes})


def header_of(width: int) -> bytes:
    """A whole PNG that claims a width."""
    _, data = png(flat((1, 2, 3)))
    body = b"IHDR" + width.to_bytes(4, "big") + data[20:29]
    return data[:12] + body + checksum(body) + data[33:]


def checksum(body: bytes) -> bytes:
    return zlib.crc32(body).to_bytes(4, "big")


def damaged_pngs() -> list[tuple[bytes, str]]:
    _, whole = png(flat((10, 20, 30), 64))
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    return [
        (b"", "is not an image, must be a PNG"),
        (b"\xff\xd8\xff\xe0 a JPEG", "is a JPEG, must be a PNG"),
        (whole[:-20], "is corrupt or truncated, must be a complete PNG"),
        (whole[:8], "is corrupt or truncated, must be a complete PNG"),
        (bytes(flipped), "is corrupt or truncated, must be a complete PNG"),
        (header_of(4096), "is 4096 x 4 pixels, must be at most 2048 a side"),
    ]


@pytest.mark.parametrize(("data", "reason"), damaged_pngs())
def test_a_damaged_texture_gives_the_plain_colour_and_a_reason(data: bytes, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        png_file.decode(data)
    sha256 = hashlib.sha256(data).hexdigest()
    plain = Material(name="plain", texture_sha256=sha256, ambient=(0.25, 0.5, 0.75, 1.0))
    scene = build_scene(world((wall(),), (plain,), light_diffuse=0.0), {sha256: data})
    assert scene.problems == (
        f"material plain: texture {sha256[:12]} {reason}; shown as a plain colour",
    )
    assert scene.textures == ()
    assert (scene.parts.texture == PLAIN).all()
    assert np.allclose(scene.tints[0], (0.25, 0.5, 0.75))


def test_a_texture_that_is_not_there_or_not_itself_is_named() -> None:
    sha256, data = png(flat((10, 20, 30)))
    plain = Material(name="plain", texture_sha256="f" * 64)
    scene = build_scene(
        world((wall(), wall(material="marble")), (plain,)),
        {"f" * 64: data},
        [panel("0" * 64, facing_back(1.0)), panel(sha256, facing_back(1.5))],
    )
    assert scene.problems == (
        "material plain: texture ffffffffffff does not match its sha256; shown as a plain colour",
        "wall wall: material 'marble' is not in the world",
        "entity panel: texture 000000000000 is missing; shown as a plain colour",
        f"entity panel: texture {sha256[:12]} is missing; shown as a plain colour",
    )
