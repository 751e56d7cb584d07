"""A mesh's convex parts cover it, and little else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from mazebot.common.maths.frames import Array, rotation_from_rpy, transform_matrix
from mazebot.common.messages.documents import (
    Body,
    Box,
    Ellipsoid,
    Mesh,
    Point2,
    Polyline,
    Shape,
)
from mazebot.common.world.convex.convex_parts import MAX_PARTS, convex_parts, rough_text
from mazebot.common.world.geometry import TriangleMesh, joined, triangles_of
from tests.physics.driver import TABLE, URCHIN

ANGLE = ((0.0, 0.0), (1.0, 0.0), (1.0, 0.1), (0.1, 0.1), (0.1, 1.0), (0.0, 1.0))
SQUARE = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
HOLE = ((0.1, 0.1), (0.9, 0.1), (0.9, 0.9), (0.1, 0.9))
TILT = transform_matrix(rotation_from_rpy(0.4, -0.3, 1.0), (0.0, 0.0, 0.0))


def raised(*rings: tuple[Point2, ...]) -> TriangleMesh:
    return triangles_of(Polyline(polygons_m=rings, height_m=0.5), {})


def volume_m3(parts: tuple[Array, ...]) -> float:
    return float(sum(ConvexHull(part).volume for part in parts))


@pytest.mark.parametrize(
    ("mesh", "true_m3"),
    [
        (TABLE, 1.2 * 1.2 * 0.04 + 4 * 0.06 * 0.06 * 0.66),
        (raised(ANGLE), 0.095),
        (raised(SQUARE, HOLE), 0.18),
        (raised(SQUARE, HOLE).moved(TILT), 0.18),
    ],
    ids=["table", "angle", "ring", "tilted ring"],
)
@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (2.0, -1.0, 0.5)], ids=["plain", "mirrored"])
def test_parts_are_together_what_the_mesh_is(
    mesh: TriangleMesh, true_m3: float, scale: tuple[float, float, float]
) -> None:
    parts = convex_parts(mesh, scale)
    assert 1 < len(parts) <= MAX_PARTS
    assert volume_m3(parts) == pytest.approx(true_m3 * abs(np.prod(scale)), rel=1e-3)
    corners = np.concatenate([part[ConvexHull(part).vertices] for part in parts])
    assert corners.min(0) == pytest.approx((mesh.vertices_m * scale).min(0))
    assert corners.max(0) == pytest.approx((mesh.vertices_m * scale).max(0))
    again = convex_parts.__wrapped__(mesh, scale)
    assert all(np.array_equal(*pair) for pair in zip(parts, again, strict=True))


def test_a_convex_mesh_stays_as_it_is() -> None:
    ball = triangles_of(Ellipsoid(radii_m=(0.2, 0.3, 0.4)), {})
    (part,) = convex_parts(ball)
    assert np.array_equal(part, ball.vertices_m[np.unique(ball.triangles)])


def ring(sides: int) -> TriangleMesh:
    around = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    circle = np.column_stack((np.cos(around), np.sin(around)))
    return raised(*(tuple(map(tuple, radius * circle)) for radius in (1.0, 0.8)))


def test_a_ring_too_fine_to_be_cut_keeps_its_hull_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("mazebot.common.world.convex.convex_parts._MAX_CUT_TRIANGLES", 100)
    parts = convex_parts(ring(48))
    assert len(parts) == 1
    assert parts.excess == pytest.approx(0.64)


def test_a_round_ring_is_covered_by_few_parts() -> None:
    parts = convex_parts(ring(48))
    assert parts.excess < 0.1
    rng = np.random.default_rng(1)
    way, out = rng.uniform(0.0, 2.0 * np.pi, 500), rng.uniform(0.81, 0.99, 500)
    inside = np.column_stack((out * np.cos(way), out * np.sin(way), rng.uniform(0.0, 0.5, 500)))
    covered = np.zeros(500, bool)
    for part in parts:
        planes = ConvexHull(part).equations
        covered |= (inside @ planes[:, :3].T + planes[:, 3] < 1e-6).all(axis=1)
    assert covered.all()


def test_flat_sheets_of_a_mesh_are_thickened_and_a_flat_or_tiny_mesh_is_refused() -> None:
    crate = triangles_of(Box(size_m=(0.4, 0.4, 0.4)), {})
    sheet = TriangleMesh(
        np.array([[1.0, 0, 0], [2.0, 0, 0], [1.0, 1.0, 0]]),
        np.zeros((3, 3)),
        np.zeros((3, 2)),
        np.array([[0, 1, 2]], np.int32),
    )
    assert volume_m3(convex_parts(joined((crate, sheet)))) == pytest.approx(0.064 + 0.0025)
    with pytest.raises(ValueError, match="is flat"):
        convex_parts(sheet)
    with pytest.raises(ValueError, match="is within 1e-05 m: it must have a volume"):
        convex_parts(crate, (1e-6, 1e-6, 1e-6))


def test_a_mesh_that_parts_cannot_follow_is_told_of() -> None:
    shape = Shape(name="mesh", geometry=Mesh(sha256="d" * 64))
    thing = Body(name="thing", shapes=(shape,), mass_kg=1.0, position_m=(0.0, 0.0, 0.0))
    text = rough_text([thing, thing], {"d" * 64: URCHIN})
    assert text.startswith("body 'thing': shape 'mesh' collides as 32 convex parts, ")
    assert text.endswith("(and 1 more)")
    assert rough_text([thing], {"d" * 64: TABLE}) == ""
    assert rough_text([thing.model_copy(update={"mass_kg": 0.0})], {"d" * 64: URCHIN}) == ""
