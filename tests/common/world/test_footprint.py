from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from mazebot.common.maths.frames import Array, rotation_from_rpy, transform_matrix
from mazebot.common.messages import documents as doc
from mazebot.common.robot.waffle import FOOT_M, TOP_M
from mazebot.common.world.footprint import Footprint, footprint, footprints
from mazebot.common.world.geometry import TriangleMesh, triangles_of
from mazebot.worldgen.map.occupancy import Grid, grid_around, occupied_cells

MIDDLE_M = (FOOT_M + TOP_M) / 2.0


def pose(
    x_m: float = 0.0, y_m: float = 0.0, z_m: float = MIDDLE_M, roll_rad: float = 0.0,
    pitch_rad: float = 0.0, yaw_rad: float = 0.0,
) -> Array:  # fmt: skip
    return transform_matrix(rotation_from_rpy(roll_rad, pitch_rad, yaw_rad), (x_m, y_m, z_m))


def polygon(taken: Footprint) -> shapely.Polygon:
    (stack,) = taken.polygons_m
    (corners,) = stack
    return shapely.Polygon(corners)


def cells_of(taken: Footprint, resolution_m: float = 0.05) -> tuple[NDArray[np.bool_], Grid]:
    corners = np.concatenate([stack.reshape(-1, 2) for stack in taken.polygons_m])
    grid = grid_around(corners.min(0), corners.max(0), resolution_m, 0.2)
    return occupied_cells([taken], grid), grid


def area_m2(taken: Footprint, resolution_m: float = 0.05) -> float:
    return float(cells_of(taken, resolution_m)[0].sum()) * resolution_m**2


def mesh_of(geometry: doc.Geometry) -> dict[str, TriangleMesh]:
    return {"mesh": triangles_of(geometry, {})}


def sheet(*corners: tuple[float, float, float]) -> dict[str, TriangleMesh]:
    """One rectangle, seen from one side and closed by nothing."""
    vertices = np.array(corners)
    return {
        "mesh": TriangleMesh(
            vertices,
            np.zeros((4, 3)),
            np.zeros((4, 2)),
            np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        )
    }


MESH = doc.Mesh(sha256="mesh")
BOX = doc.Box(size_m=(1.2, 0.4, 0.1))


def test_a_box_is_exact_at_any_turn_about_z() -> None:
    taken = polygon(footprint(BOX, pose(1.0, 2.0, yaw_rad=0.7), {}))
    c, s = math.cos(0.7), math.sin(0.7)
    expected = [(1.0 + c * x - s * y, 2.0 + s * x + c * y)
                for x, y in ((0.6, 0.2), (-0.6, 0.2), (-0.6, -0.2), (0.6, -0.2))]  # fmt: skip
    assert taken.symmetric_difference(shapely.Polygon(expected)).area < 1e-12


def test_a_tilted_box_is_what_lies_between_the_heights() -> None:
    # A plank that leans at 45 degrees from the floor up to two metres: a fifth of a metre of it.
    plank = doc.Box(size_m=(2.0 * math.sqrt(2.0), 0.5, 1e-3))
    low_x, _, high_x, _ = polygon(
        footprint(plank, pose(z_m=1.0, pitch_rad=-math.pi / 4), {})
    ).bounds
    assert low_x == pytest.approx(-1.0 + FOOT_M, abs=1e-3)
    assert high_x == pytest.approx(-1.0 + TOP_M, abs=1e-3)


@pytest.mark.parametrize(
    ("geometry", "z_m", "widest_m"),
    [
        (doc.Cylinder(radius_m=0.5, length_m=1.0), 0.5, 0.5),
        (doc.Sphere(radius_m=0.5), MIDDLE_M, 0.5),
        # Standing on the floor a ball is at most as wide as at the robot's top.
        (doc.Sphere(radius_m=0.5), 0.5, math.sqrt(0.5**2 - (0.5 - TOP_M) ** 2)),
        (doc.Capsule(radius_m=0.3, length_m=1.0), 0.8, math.sqrt(0.3**2 - (0.3 - TOP_M) ** 2)),
        (doc.Capsule(radius_m=0.3, length_m=1.0), 0.5, 0.3),
        (doc.Cone(radius_m=0.5, length_m=1.0), 0.5, 0.5 * (1.0 - FOOT_M)),
        (doc.Ellipsoid(radii_m=(0.4, 0.4, 0.2)), 0.3, 0.4 * math.sqrt(1 - (0.08 / 0.2) ** 2)),
    ],
)
def test_what_is_round_is_drawn_around_and_hardly_wider(
    geometry: doc.Geometry, z_m: float, widest_m: float
) -> None:
    taken = polygon(footprint(geometry, pose(3.0, -2.0, z_m), {}))
    around = np.linspace(0.0, 2.0 * math.pi, 1000)
    circle = np.array([3.0, -2.0]) + widest_m * np.stack([np.cos(around), np.sin(around)], axis=-1)
    assert taken.buffer(1e-9).covers(shapely.Polygon(circle))
    assert taken.area <= math.pi * widest_m**2 * 1.02
    assert np.abs(shapely.get_coordinates(taken) - (3.0, -2.0)).max() <= widest_m * 1.01


@pytest.mark.parametrize(
    "geometry",
    [
        doc.Cylinder(radius_m=0.3, length_m=0.8), doc.Cone(radius_m=0.3, length_m=0.8),
        doc.Capsule(radius_m=0.1, length_m=0.8), doc.Ellipsoid(radii_m=(0.3, 0.2, 0.6)),
        doc.Box(size_m=(0.3, 0.5, 0.7)),
    ],
)  # fmt: skip
@pytest.mark.parametrize("seed", range(4))
def test_a_shape_at_any_tilt_covers_its_triangles_and_hardly_more(
    geometry: doc.Geometry, seed: int
) -> None:
    at = pose(0.0, 0.0, 0.15, *np.random.default_rng(seed).uniform(-3.0, 3.0, 3))
    taken = footprint(geometry, at, {})
    of_mesh = footprint(MESH, at, mesh_of(geometry))
    pieces = [shapely.Polygon(corners) for stack in of_mesh.polygons_m for corners in stack]
    hull = shapely.convex_hull(shapely.multipolygons(pieces))
    assert polygon(taken).buffer(1e-6).covers(hull)
    assert polygon(taken).area <= hull.area * 1.03


def test_what_is_too_low_or_too_high_is_no_obstacle() -> None:
    for z_m in (-0.05, FOOT_M - 0.05, TOP_M + 0.05, 0.5):
        assert footprint(BOX, pose(z_m=z_m), {}).polygons_m == ()
        assert footprint(MESH, pose(z_m=z_m), mesh_of(BOX)).polygons_m == ()
    ground = doc.Plane(size_m=(100.0, 100.0))
    assert footprint(ground, pose(z_m=0.0), {}).polygons_m == ()
    assert footprint(ground, pose(z_m=FOOT_M), {}).polygons_m == ()


def test_of_a_table_the_legs_are_obstacles_and_the_top_is_not() -> None:
    top = doc.Shape(
        name="top", geometry=doc.Box(size_m=(1.2, 0.8, 0.04)), position_m=(0.0, 0.0, 0.72)
    )
    legs = tuple(
        doc.Shape(
            name=f"leg{x}{y}", geometry=doc.Box(size_m=(0.05, 0.05, 0.7)), position_m=(x, y, 0.35)
        )
        for x in (-0.5, 0.5) for y in (-0.3, 0.3)
    )  # fmt: skip
    seen = doc.Shape(
        name="cloth", geometry=doc.Box(size_m=(2.0, 2.0, 2.0)), material="m", solid=False
    )
    # Turned by a quarter about z, and two metres off: the body's pose counts, then the shape's.
    half = math.sqrt(0.5)
    table = doc.Body(
        name="table", position_m=(2.0, 0.0, 0.0), orientation_xyzw=(0.0, 0.0, half, half),
        mass_kg=9.0, shapes=(top, *legs, seen),
    )  # fmt: skip
    world = doc.World(
        name="w", recipe="", hash="", walls=(), materials=(), bodies=(table,),
        start=doc.Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0),
    )  # fmt: skip
    taken = [one for one in footprints(world, {}) if one.polygons_m]
    middles = sorted(tuple(np.round(shapely.centroid(polygon(one)).coords[0], 6)) for one in taken)
    assert middles == [(1.7, -0.5), (1.7, 0.5), (2.3, -0.5), (2.3, 0.5)]


def test_a_polyline_is_solid_but_for_its_holes() -> None:
    ring = doc.Polyline(
        polygons_m=(
            ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)),
            ((0.5, 0.5), (0.5, 1.5), (1.5, 1.5), (1.5, 0.5)),
        ),
        height_m=1.0,
    )
    assert area_m2(footprint(ring, pose(z_m=0.0), {})) == pytest.approx(3.0)
    assert footprint(ring, pose(z_m=0.3), {}).polygons_m == ()


def test_a_closed_mesh_is_solid_inside() -> None:
    tall = doc.Box(size_m=(2.0, 1.0, 3.0))
    taken = footprint(MESH, pose(0.0, 0.0, 1.0), mesh_of(tall))
    assert area_m2(taken) == pytest.approx(2.0)
    # Nothing of its surface but the four sides is on the robot's level.
    assert area_m2(Footprint(taken.polygons_m)) < 0.5
    # A mesh of two bodies, one of which lies partly in the other.
    one = mesh_of(tall)["mesh"]
    both = TriangleMesh(
        np.concatenate([one.vertices_m, one.vertices_m + np.array([1.0, 0.5, 0.1])]),
        np.concatenate([one.normals] * 2),
        np.concatenate([one.uvs] * 2),
        np.concatenate([one.triangles, one.triangles + np.int32(len(one.vertices_m))]),
    )
    assert area_m2(footprint(MESH, pose(0.0, 0.0, 1.0), {"mesh": both})) == pytest.approx(3.5)


def test_a_mesh_inside_out_or_mirrored_is_solid_too() -> None:
    tall = mesh_of(doc.Box(size_m=(2.0, 1.0, 3.0)))["mesh"]
    inverted = TriangleMesh(tall.vertices_m, tall.normals, tall.uvs, tall.triangles[:, ::-1].copy())
    assert area_m2(footprint(MESH, pose(), {"mesh": inverted})) == pytest.approx(2.0)
    mirrored = doc.Mesh(sha256="mesh", scale=(-0.5, 1.0, 1.0))
    assert area_m2(footprint(mirrored, pose(), {"mesh": tall})) == pytest.approx(1.0)


def test_an_open_mesh_is_as_thin_as_it_is_and_never_lost() -> None:
    for y_m in (0.0, 0.025, 0.05, 0.07):
        upright = sheet((0.0, y_m, 0.0), (1.0, y_m, 0.0), (1.0, y_m, 1.0), (0.0, y_m, 1.0))
        occupied, _ = cells_of(footprint(MESH, pose(z_m=0.0), upright))
        assert 20 <= occupied.sum() <= 2 * 22
        assert occupied.any(1).sum() <= 2
    level = sheet((0.0, 0.0, 0.1), (1.0, 0.0, 0.1), (1.0, 0.5, 0.1), (0.0, 0.5, 0.1))
    assert area_m2(footprint(MESH, pose(z_m=0.0), level)) == pytest.approx(0.5)


def test_a_mesh_that_is_not_there_is_named() -> None:
    with pytest.raises(KeyError, match="mesh"):
        footprint(MESH, pose(), {})


def test_a_large_mesh_is_cut_in_one_go() -> None:
    """A wavy ground of 20,000 triangles: what is higher than the foot, and no more."""
    x, y = np.meshgrid(np.linspace(0.0, 4.0, 101), np.linspace(0.0, 4.0, 101))
    z = 0.1 * np.sin(np.pi * x / 2.0) - 0.05
    index = np.arange(101 * 101).reshape(101, 101)
    a, b, c, d = (
        index[i : 100 + i, j : 100 + j].ravel() for i, j in ((0, 0), (0, 1), (1, 1), (1, 0))
    )
    triangles = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    ground = TriangleMesh(
        vertices, np.zeros_like(vertices), np.zeros((len(vertices), 2)), triangles.astype(np.int32)
    )
    taken = footprint(MESH, pose(z_m=0.0), {"mesh": ground})
    low_m = 2.0 / math.pi * math.asin(0.7)
    assert area_m2(taken, 0.02) == pytest.approx((2.0 - 2.0 * low_m) * 4.0, rel=0.05)
    assert not footprint(MESH, pose(z_m=0.0), {"mesh": ground}).outline_m
