"""A world's triangles: each part of a wall seen once, coverings, floors of rooms, bodies."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mazebot.common.maths.frames import Array
from mazebot.common.messages.documents import (
    Body,
    Box,
    Ceiling,
    Covering,
    Material,
    Mesh,
    Planar,
    Room,
    Shape,
    Sphere,
    Wall,
    World,
)
from mazebot.common.world.geometry import TriangleMesh, joined, triangles_of
from mazebot.common.world.surfaces import Surface, surfaces, wall_corners

SQUARE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))


def world(walls: tuple[Wall, ...] = (), **changes: Any) -> World:
    materials = tuple(Material(name=name) for name in ("plain", "brick", "tiles"))
    start = Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0)
    return World(
        name="test", recipe="", hash="", walls=walls, start=start,
        **{"materials": materials, **changes},
    )  # fmt: skip


def wall(name: str = "wall", **changes: Any) -> Wall:
    values = {"length_m": 2.0, "thickness_m": 0.2, "height_m": 1.0, "x_m": 0.0, "y_m": 0.0}
    return Wall.model_validate(
        {"name": name, "yaw_rad": 0.0, "material": "plain", **values, **changes}
    )


def faces(mesh: TriangleMesh, normal: tuple[float, float, float]) -> Array:
    """(m, 3, 3) corners of the triangles that look along a normal."""
    corners = mesh.vertices_m[mesh.triangles]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    return corners[flat @ normal > 0.999]


def spans(parts: list[Surface], normal: tuple[float, float, float]) -> list[tuple[float, ...]]:
    """Left, right and top of the faces that look along a normal, along x."""
    found = set()
    for part in parts:
        for quad in faces(part.mesh, normal).reshape(-1, 6, 3):
            ends = quad[:, 0].min(), quad[:, 0].max(), quad[:, 2].max()
            found.add(tuple(round(float(end), 6) for end in ends))
    return sorted(found)


def upright(of: World) -> list[Surface]:
    return [part for part in surfaces(of, {}) if part.kind == "wall" and part.textured]


def area_m2(mesh: TriangleMesh) -> float:
    corners = mesh.vertices_m[mesh.triangles]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(flat, axis=1).sum() / 2.0)


def test_a_wall_has_four_sides_and_a_plain_top() -> None:
    sides, top, _ = surfaces(world((wall(yaw_rad=0.7, x_m=3.0),)), {})
    assert (sides.name, sides.material, sides.textured, sides.moves) == (
        "wall", "plain", True, False,
    )  # fmt: skip
    assert area_m2(sides.mesh) == pytest.approx(2 * 2.0 + 2 * 0.2)
    assert (top.name, top.textured) == ("wall", False)
    assert area_m2(top.mesh) == pytest.approx(0.4)
    assert np.allclose(top.mesh.vertices_m[:, 2], 1.0)
    for part in (sides, top):
        corners = part.mesh.vertices_m[part.mesh.triangles]
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing = np.einsum("ij,ij->i", flat, part.mesh.normals[part.mesh.triangles[:, 0]])
        assert (facing > 0.0).all()
        outwards = corners.mean(1) - (3.0, 0.0, 0.5)
        assert (np.einsum("ij,ij->i", flat, outwards) > 0.0).all()


def test_corners_run_counter_clockwise() -> None:
    ((a, b, c, d),) = wall_corners([wall(yaw_rad=math.pi / 2)])
    expected = [(-0.1, 1.0), (-0.1, -1.0), (0.1, -1.0), (0.1, 1.0)]
    assert np.abs(np.array([a, b, c, d]) - expected).max() < 1e-12


def test_the_first_of_two_equal_faces_in_one_plane_is_seen() -> None:
    walls = wall("a"), wall("b", x_m=1.5, yaw_rad=-3.14159), wall("c", x_m=1.0)
    parts = upright(world(walls))
    by_name = {part.name: spans([part], (0.0, 1.0, 0.0)) for part in parts}
    assert by_name["a"] == [(-1.0, 1.0, 1.0)]
    (rest,) = by_name["b"]
    assert rest == pytest.approx((1.0, 2.5, 1.0), abs=1e-5)
    assert by_name["c"] == []


def test_the_higher_face_is_seen_whole() -> None:
    walls = wall("low"), wall("high", x_m=0.5, length_m=1.0, height_m=2.0)
    parts = upright(world(walls))
    assert spans([parts[0]], (0.0, 1.0, 0.0)) == [(-1.0, 0.0, 1.0)]
    assert spans([parts[1]], (0.0, 1.0, 0.0)) == [(0.0, 1.0, 2.0)]


def test_a_face_is_seen_left_and_right_of_a_higher_one() -> None:
    walls = wall("low", length_m=4.0), wall("high", length_m=1.0, height_m=2.0)
    assert spans(upright(world(walls))[:1], (0.0, -1.0, 0.0)) == [
        (-2.0, -0.5, 1.0),
        (0.5, 2.0, 1.0),
    ]


@pytest.mark.parametrize("apart_m", [0.0005, 0.002])
def test_faces_in_planes_apart_do_not_hide_each_other(apart_m: float) -> None:
    walls = wall("a"), wall("b", y_m=apart_m)
    parts = upright(world(walls))
    left = [spans([part], (0.0, 1.0, 0.0)) for part in parts]
    assert bool(left[1:] and left[1]) == (apart_m > 0.001)


def test_opposite_faces_do_not_hide_each_other() -> None:
    parts = upright(world((wall("a"), wall("b", y_m=0.2))))
    assert [len(spans([part], (0.0, 1.0, 0.0))) for part in parts] == [1, 1]


def test_a_covering_takes_its_stretch_of_its_side() -> None:
    coverings = (
        Covering(side="left", from_m=0.25, to_m=9.0, material="brick"),
        Covering(side="right", from_m=-0.5, to_m=0.25, material="tiles"),
    )
    parts = upright(world((wall(coverings=coverings),)))
    by_material = {part.material: part for part in parts}
    assert set(by_material) == {"plain", "brick", "tiles"}
    left, right = (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)
    assert spans([by_material["brick"]], left) == [(0.25, 1.0, 1.0)]
    assert spans([by_material["brick"]], right) == []
    assert spans([by_material["tiles"]], right) == [(-0.5, 0.25, 1.0)]
    assert spans([by_material["plain"]], left) == [(-1.0, 0.25, 1.0)]
    assert spans([by_material["plain"]], right) == [(-1.0, -0.5, 1.0), (0.25, 1.0, 1.0)]
    assert sum(area_m2(part.mesh) for part in parts) == pytest.approx(4.4)


def test_a_covering_under_a_higher_wall_is_not_seen() -> None:
    covering = Covering(side="left", from_m=-1.0, to_m=0.5, material="brick")
    walls = wall("low", coverings=(covering,)), wall("high", length_m=1.0, height_m=2.0)
    parts = {(part.name, part.material): part for part in upright(world(walls))}
    seen = spans([parts["low", "brick"]], (0.0, 1.0, 0.0))
    assert seen == [(-1.0, -0.5, 1.0)]
    assert spans([parts["low", "plain"]], (0.0, 1.0, 0.0)) == [(0.5, 1.0, 1.0)]


def uv_at(part: Surface, point_m: tuple[float, float, float], normal: int, sign: float) -> Array:
    mesh = part.mesh
    near = (np.abs(mesh.vertices_m - point_m) < 1e-9).all(1) & (
        sign * mesh.normals[:, normal] > 0.9
    )
    uv: Array = mesh.uvs[np.flatnonzero(near)[0]]
    return uv


def test_textures_of_walls_run_in_metres_from_the_bottom_left() -> None:
    covering = Covering(side="right", from_m=0.0, to_m=0.5, material="brick")
    materials = (
        Material(name="plain", texture_side_m=0.4),
        Material(name="brick", texture_side_m=0.0),
    )
    own, brick = upright(world((wall(coverings=(covering,)),), materials=materials))
    # Seen from -y, +x is to the right.
    assert uv_at(own, (-1.0, -0.1, 0.0), 1, -1.0) == pytest.approx((0.0, 3.0))
    assert uv_at(own, (1.0, -0.1, 1.0), 1, -1.0) == pytest.approx((5.0, 0.5))
    # A texture without a side is stretched once over what it covers.
    assert uv_at(brick, (0.0, -0.1, 0.0), 1, -1.0) == pytest.approx((0.0, 1.0))
    assert uv_at(brick, (0.5, -0.1, 1.0), 1, -1.0) == pytest.approx((1.0, 0.0))


def floors(of: World) -> dict[str, Surface]:
    return {part.name: part for part in surfaces(of, {}) if part.kind == "floor"}


def test_the_floor_reaches_fifty_metres_and_beyond_the_walls() -> None:
    (floor,) = floors(world()).values()
    assert area_m2(floor.mesh) == pytest.approx(100.0**2)
    (floor,) = floors(world((wall(x_m=500.0),))).values()
    assert floor.mesh.vertices_m[:, 0].max() > 510.0


def test_rooms_with_floors_of_their_own_are_cut_out() -> None:
    rooms = (
        Room(name="hall", polygon_m=SQUARE, floor_material="tiles"),
        Room(name="yard", polygon_m=tuple((x + 5.0, y) for x, y in SQUARE)),
    )
    made = floors(world(rooms=rooms, floor_material="brick"))
    assert set(made) == {"hall", ""}
    assert made["hall"].material == "tiles"
    assert made[""].material == "brick"
    assert area_m2(made["hall"].mesh) == pytest.approx(4.0)
    assert area_m2(made[""].mesh) == pytest.approx(100.0**2 - 4.0)
    for part in made.values():
        assert (part.mesh.normals == (0.0, 0.0, 1.0)).all()
        corners = part.mesh.vertices_m[part.mesh.triangles]
        assert (
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0
        ).all()


@pytest.mark.parametrize("polygon_m", [SQUARE, tuple((x - 7.3, y + 4.1) for x, y in SQUARE)])
def test_tiles_of_a_floor_lie_from_the_maps_origin(
    polygon_m: tuple[tuple[float, float], ...],
) -> None:
    rooms = (Room(name="hall", polygon_m=polygon_m, floor_material="tiles"),)
    materials = (Material(name="tiles", texture_side_m=0.5),)
    mesh = floors(world(rooms=rooms, materials=materials))["hall"].mesh
    assert mesh.uvs.min() >= 0.0
    assert mesh.uvs.max() < 6.0
    whole = mesh.uvs - mesh.vertices_m[:, :2] * (2.0, -2.0)
    assert np.abs(whole - np.round(whole)).max() < 1e-9


def test_a_ceiling_hangs_over_all_walls_and_is_seen_from_below() -> None:
    walls = wall("a", x_m=-2.0), wall("b", y_m=3.0)
    of = world(walls, ceiling=Ceiling(height_m=2.5, material="tiles"))
    (ceiling,) = (part for part in surfaces(of, {}) if part.kind == "ceiling")
    assert ceiling.mesh.vertices_m.min(0) == pytest.approx((-3.0, -0.1, 2.5))
    assert ceiling.mesh.vertices_m.max(0) == pytest.approx((1.0, 3.1, 2.5))
    assert len(faces(ceiling.mesh, (0.0, 0.0, -1.0))) == len(ceiling.mesh.triangles)
    assert ceiling.mesh.uvs.min() >= 0.0


def test_static_bodies_are_in_the_map_and_moving_ones_in_their_own_frame() -> None:
    half_turn = (0.0, 0.0, 1.0, 0.0)
    shapes = (
        Shape(name="a", geometry=Box(size_m=(1, 1, 1)), position_m=(1, 0, 0), material="brick"),
        Shape(name="b", geometry=Sphere(radius_m=0.5), material="plain"),
        Shape(name="c", geometry=Box(size_m=(1, 1, 1)), position_m=(3, 0, 0), material="brick"),
        Shape(name="unseen", geometry=Box(size_m=(9, 9, 9))),
    )
    bodies = (
        Body(name="table", position_m=(10, 0, 2), orientation_xyzw=half_turn, shapes=shapes),
        Body(name="crate", position_m=(10, 0, 2), mass_kg=2.0, shapes=shapes[:1]),
    )
    brick, plain, crate = (
        part for part in surfaces(world(bodies=bodies), {}) if part.kind == "body"
    )
    assert [(p.name, p.material, p.moves) for p in (brick, plain, crate)] == [
        ("table", "brick", False),
        ("table", "plain", False),
        ("crate", "brick", True),
    ]
    assert brick.mesh.vertices_m.min(0) == pytest.approx((6.5, -0.5, 1.5))
    assert brick.mesh.vertices_m.max(0) == pytest.approx((9.5, 0.5, 2.5))
    assert crate.mesh.vertices_m.min(0) == pytest.approx((0.5, -0.5, -0.5))


def test_meshes_come_from_their_assets() -> None:
    shape = Shape(name="a", geometry=Mesh(sha256="f" * 64, scale=(2, 2, 2)), material="plain")
    of = world(bodies=(Body(name="rock", position_m=(0, 0, 1), shapes=(shape,)),))
    box = triangles_of(Box(size_m=(1, 1, 1)), {})
    (rock,) = (part for part in surfaces(of, {"f" * 64: box}) if part.kind == "body")
    assert rock.mesh.vertices_m.max(0) == pytest.approx((1.0, 1.0, 2.0))
    with pytest.raises(KeyError):
        surfaces(of, {})


def test_thousands_of_walls_in_one_plane_are_no_burden() -> None:
    row = [wall(f"w{n}", x_m=0.1 * n, length_m=0.05) for n in range(2000)]
    row += [wall(f"v{n}", x_m=0.01 * n, length_m=9.0, height_m=1 + n % 7 / 10) for n in range(2000)]
    whole = joined(part.mesh for part in upright(world(tuple(row))))
    highest = whole.vertices_m[:, 2].max()
    assert highest == pytest.approx(1.6)
    ahead = faces(whole, (0.0, 1.0, 0.0)).reshape(-1, 6, 3)
    ends = np.sort(np.stack((ahead[:, :, 0].min(1), ahead[:, :, 0].max(1)), axis=1), axis=0)
    assert (ends[1:, 0] > ends[:-1, 1] - 1e-5).all()
