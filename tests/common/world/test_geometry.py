"""Shapes as triangles: closed, outwards, of the right volume; meshes as bytes; slices."""

from __future__ import annotations

import io
import math
import zipfile
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from mazebot.common.maths.frames import Array, rotation_from_rpy, transform_matrix
from mazebot.common.messages.documents import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Geometry,
    Mesh,
    Plane,
    Polyline,
    Sphere,
)
from mazebot.common.world.geometry import (
    TriangleMesh,
    clipped,
    joined,
    mesh_from_bytes,
    mesh_to_bytes,
    triangles_of,
)

SQUARE = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0))
HOLE = ((0.5, 0.5), (0.5, 1.0), (1.0, 1.0), (1.0, 0.5))
BEND = ((0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (1.0, 1.0), (1.0, 3.0), (0.0, 3.0))

SOLIDS: list[tuple[Geometry, float, tuple[float, float, float]]] = [
    (Box(size_m=(1.0, 2.0, 3.0)), 6.0, (1.0, 2.0, 3.0)),
    (Cylinder(radius_m=0.5, length_m=2.0), math.pi * 0.5, (1.0, 1.0, 2.0)),
    (Cone(radius_m=0.5, length_m=2.0), math.pi * 0.5 / 3.0, (1.0, 1.0, 2.0)),
    (Capsule(radius_m=0.5, length_m=1.0), math.pi * (0.25 + 0.5 / 3.0), (1.0, 1.0, 2.0)),
    (Sphere(radius_m=0.5), math.pi / 6.0, (1.0, 1.0, 1.0)),
    (Ellipsoid(radii_m=(1.0, 0.5, 0.25)), math.pi / 6.0, (2.0, 1.0, 0.5)),
    (Polyline(polygons_m=(SQUARE, HOLE), height_m=2.0), 7.5, (2.0, 2.0, 2.0)),
    (Polyline(polygons_m=(BEND[::-1],), height_m=0.5), 2.5, (3.0, 3.0, 0.5)),
]


def volume(mesh: TriangleMesh) -> float:
    """By the divergence theorem: right only where triangles look outwards."""
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def face_normals(mesh: TriangleMesh) -> Array:
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def is_closed(mesh: TriangleMesh) -> bool:
    """Every edge is met by its opposite."""
    _, index = np.unique(mesh.vertices_m, axis=0, return_inverse=True)
    corners = index.ravel()[mesh.triangles]
    edges = np.concatenate([corners[:, [k, (k + 1) % 3]] for k in range(3)])
    forth = edges[np.lexsort(edges.T)]
    back = edges[:, ::-1]
    return bool((forth == back[np.lexsort(back.T)]).all())


@pytest.mark.parametrize(("geometry", "expected_m3", "size_m"), SOLIDS)
def test_solids_are_closed_and_as_large_as_they_should_be(
    geometry: Geometry, expected_m3: float, size_m: tuple[float, float, float]
) -> None:
    mesh = triangles_of(geometry, {})
    assert is_closed(mesh)
    # A round body's triangles lie within it.
    assert 0.97 * expected_m3 < volume(mesh) < 1.0001 * expected_m3
    assert np.ptp(mesh.vertices_m, axis=0) == pytest.approx(size_m)
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("geometry", [solid for solid, _, _ in SOLIDS] + [Plane(size_m=(2, 1))])
@pytest.mark.parametrize("tile_side_m", [0.0, 0.3])
def test_normals_look_outwards_and_uvs_are_not_negative(
    geometry: Geometry, tile_side_m: float
) -> None:
    mesh = triangles_of(geometry, {}, tile_side_m)
    flat = face_normals(mesh)
    assert (np.linalg.norm(flat, axis=1) > 0.0).all()
    for corner in range(3):
        assert (np.einsum("ij,ij->i", flat, mesh.normals[mesh.triangles[:, corner]]) > 0.0).all()
    assert mesh.uvs.min() >= 0.0
    if tile_side_m == 0.0:
        assert mesh.uvs.max() <= 1.0 + 1e-12
    # A texture is never turned over: as one looks at a face, v runs down where u runs right.
    a, b, c = (mesh.uvs[mesh.triangles[:, k]] for k in range(3))
    turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (turn < 1e-12).all()


def uv_area(mesh: TriangleMesh) -> Array:
    a, b, c = (mesh.uvs[mesh.triangles[:, k]] for k in range(3))
    area: Array = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2.0
    return area


@pytest.mark.parametrize(
    "geometry",
    [SOLIDS[0][0], Cylinder(radius_m=0.5, length_m=2.0), SOLIDS[6][0], Plane(size_m=(2, 1))],
)
def test_textures_are_in_metres(geometry: Geometry) -> None:
    mesh = triangles_of(geometry, {}, tile_side_m=0.25)
    area_m2 = np.linalg.norm(face_normals(mesh), axis=1) / 2.0
    assert uv_area(mesh) * 0.25**2 == pytest.approx(area_m2, rel=0.01)


def test_a_box_is_textured_upright_from_each_faces_bottom_left() -> None:
    mesh = triangles_of(Box(size_m=(2.0, 4.0, 1.5)), {}, tile_side_m=1.0)
    ahead = mesh.normals[:, 0] > 0.5
    # Seen from +x, +y is to the right.
    expected = {(-2.0, -0.75): (0.0, 2.0), (2.0, -0.75): (4.0, 2.0), (2.0, 0.75): (4.0, 0.5)}
    for (y, z), uv in expected.items():
        (corner,) = np.flatnonzero(ahead & (mesh.vertices_m[:, 1:] == (y, z)).all(1))
        assert mesh.uvs[corner] == pytest.approx(uv)


def test_a_texture_without_a_side_is_stretched_once_over_each_face() -> None:
    mesh = triangles_of(Box(size_m=(2.0, 4.0, 1.5)), {}, tile_side_m=0.0)
    for first in range(0, 24, 4):
        assert mesh.uvs[first : first + 4].tolist() == [[0, 1], [1, 1], [1, 0], [0, 0]]


@pytest.mark.parametrize(("radius_m", "sides"), [(0.05, 32), (1.0, 48), (100.0, 128)])
def test_the_larger_what_is_round_the_more_sides_it_has(radius_m: float, sides: int) -> None:
    mesh = triangles_of(Cylinder(radius_m=radius_m, length_m=1.0), {})
    assert len(mesh.triangles) == pytest.approx(4 * sides, rel=0.1)


def test_a_plane_is_seen_from_above_only() -> None:
    mesh = triangles_of(Plane(size_m=(2.0, 1.0)), {})
    assert (face_normals(mesh)[:, 2] > 0.0).all()
    assert len(mesh.triangles) == 2


def test_polylines_know_islands_in_holes_and_ignore_what_has_no_area() -> None:
    ring = tuple((3.0 * x, 3.0 * y) for x, y in SQUARE)
    island = ((2.0, 2.0), (2.5, 2.0), (2.5, 2.5), (2.0, 2.5))
    hole = ((1.0, 1.0), (5.0, 1.0), (5.0, 5.0), (1.0, 5.0))
    line = ((0.0, 0.0), (1.0, 0.0), (2.0, 0.0))
    mesh = triangles_of(Polyline(polygons_m=(island, ring, hole, line), height_m=1.0), {})
    assert volume(mesh) == pytest.approx(36.0 - 16.0 + 0.25)
    nothing = triangles_of(Polyline(polygons_m=(line,), height_m=1.0), {})
    assert nothing.triangles.shape == (0, 3)


def test_a_polygon_that_crosses_itself_without_end_is_refused() -> None:
    bow = ((0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0))
    assert volume(triangles_of(Polyline(polygons_m=(bow,), height_m=1.0), {})) == pytest.approx(0.5)
    places = np.random.default_rng(1).uniform(0.0, 1.0, (5000, 2)).tolist()
    wild = tuple((x, y) for x, y in places)
    with pytest.raises(ValueError, match="a polygon of 5000 corners crosses itself"):
        triangles_of(Polyline(polygons_m=(wild,), height_m=1.0), {})


def test_meshes_are_scaled_and_mirrored() -> None:
    box = triangles_of(Box(size_m=(1.0, 1.0, 1.0)), {})
    scaled = triangles_of(Mesh(sha256="a", scale=(-2.0, 1.0, 3.0)), {"a": box})
    assert volume(scaled) == pytest.approx(6.0)
    slanted = box.moved(transform_matrix(rotation_from_rpy(0.3, 0.2, 0.1), (0.0, 0.0, 0.0)))
    scaled = triangles_of(Mesh(sha256="a", scale=(-2.0, 1.0, 3.0)), {"a": slanted})
    flat = face_normals(scaled)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert np.abs(flat - scaled.normals[scaled.triangles[:, 0]]).max() < 1e-9
    with pytest.raises(KeyError):
        triangles_of(Mesh(sha256="b"), {"a": box})


def test_moved_takes_points_and_normals_along() -> None:
    mesh = triangles_of(Box(size_m=(1.0, 2.0, 3.0)), {})
    a_from_b = transform_matrix(rotation_from_rpy(0.0, 0.0, math.pi / 2), (1.0, 0.0, 0.0))
    moved = mesh.moved(a_from_b)
    assert moved.vertices_m[0] == pytest.approx(a_from_b[:3, :3] @ mesh.vertices_m[0] + (1, 0, 0))
    assert np.abs(moved.normals[0] - (0.0, 1.0, 0.0)).max() < 1e-12
    assert not moved.vertices_m.flags.writeable


def test_bytes_hold_a_mesh_and_are_the_same_each_time() -> None:
    mesh = joined(triangles_of(solid, {}) for solid, _, _ in SOLIDS)
    data = mesh_to_bytes(mesh)
    again = mesh_from_bytes(data)
    assert np.abs(again.vertices_m - mesh.vertices_m).max() < 1e-6
    assert np.abs(again.uvs - mesh.uvs).max() < 1e-5
    assert (again.triangles == mesh.triangles).all()
    assert mesh_to_bytes(mesh) == data
    assert mesh_to_bytes(again) == data
    empty = mesh_from_bytes(mesh_to_bytes(joined(())))
    assert empty.triangles.shape == (0, 3)


def _changed(**changes: Any) -> bytes:
    box = triangles_of(Box(size_m=(1.0, 1.0, 1.0)), {})
    arrays = {
        "vertices_m": box.vertices_m.astype("<f4"),
        "normals": box.normals.astype("<f4"),
        "uvs": box.uvs.astype("<f4"),
        "triangles": box.triangles,
    }
    buffer = io.BytesIO()
    np.savez(buffer, **{**arrays, **changes})
    return buffer.getvalue()


def _claiming(rows: int) -> bytes:
    """A file whose header claims more than it holds."""
    header = io.BytesIO()
    claim = {"descr": "<f4", "fortran_order": False, "shape": (rows, 3)}
    np.lib.format.write_array_header_1_0(header, claim)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("vertices_m.npy", header.getvalue())
    return buffer.getvalue()


def _nested() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        text = b"(" * 9_000
        head = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little")
        archive.writestr("vertices_m.npy", head + text)
    return buffer.getvalue()


def _compressed() -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, vertices_m=np.zeros((100_000, 3), "<f4"))
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is not a mesh file"),
        (b"PK\x03\x04 nothing", "is not a mesh file"),
        (_changed()[:-40], "is not a mesh file"),
        (_nested(), "is not a mesh file"),
        (_compressed(), "is compressed"),
        (_claiming(10**12), "vertices_m: is truncated"),
        (_changed(vertices_m=np.zeros((24, 2), "<f4")), r"is not \(n, 3\) of <f4"),
        (_changed(vertices_m=np.zeros((24, 3), "<f8")), r"is not \(n, 3\) of <f4"),
        (_changed(vertices_m=np.array([["a", "b", "c"]], object)), r"is not \(n, 3\) of <f4"),
        (_changed(uvs=np.zeros((23, 2), "<f4")), "has different numbers of vertices, normals"),
        (_changed(vertices_m=np.full((24, 3), np.nan, "<f4")), "non-finite"),
        (_changed(triangles=np.full((1, 3), 24, "<i4")), "a nonexistent vertex"),
        (_changed(triangles=np.full((1, 3), -1, "<i4")), "a nonexistent vertex"),
        (_changed(triangles=np.zeros((2_000_001, 3), "<i4")), "has 2000001 triangles"),
    ],  # Of the bytes: they hold the time of day.
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_no_mesh_is_refused_in_a_phrase(data: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words) as caught:
        mesh_from_bytes(data)
    assert "\n" not in str(caught.value)


def area_m2(mesh: TriangleMesh) -> float:
    return float(np.linalg.norm(face_normals(mesh), axis=1).sum() / 2.0)


def test_a_slice_is_what_lies_between_two_heights() -> None:
    box = triangles_of(Box(size_m=(1.0, 2.0, 3.0)), {})
    middle = clipped(box, -0.5, 0.25)
    assert area_m2(middle) == pytest.approx(6.0 * 0.75)
    assert np.allclose([middle.vertices_m[:, 2].min(), middle.vertices_m[:, 2].max()], [-0.5, 0.25])
    flat = face_normals(middle)
    assert (np.einsum("ij,ij->i", flat, middle.normals[middle.triangles[:, 0]]) > 0.0).all()
    # The texture stays where it was.
    up_on = (middle.normals[:, 0] > 0.5) & (np.abs(middle.vertices_m[:, 2] - 0.25) < 1e-12)
    assert np.allclose(middle.uvs[up_on][:, 1], 3.0 - 1.75)
    assert clipped(box, -2.0, 2.0) is box
    assert len(clipped(box, 2.0, 3.0).triangles) == 0
    assert len(clipped(box, 1.5, 3.0).triangles) == 2


def test_slices_make_up_the_whole() -> None:
    ball = triangles_of(Sphere(radius_m=1.0), {})
    cuts = [-1.0, -0.71, -0.2, 0.113, 0.6, 1.0]
    parts = [clipped(ball, low, high) for low, high in pairwise(cuts)]
    assert sum(map(area_m2, parts)) == pytest.approx(area_m2(ball))
    assert volume(joined(parts)) == pytest.approx(volume(ball))
    assert all(np.linalg.norm(part.normals, axis=1) == pytest.approx(1.0) for part in parts)
