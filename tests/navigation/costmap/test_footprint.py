from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from mazebot.common.files.root import ROOT
from mazebot.common.maths import portable
from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, Array
from mazebot.common.world.costmap import clearance_m
from mazebot.navigation.costmap.footprint import (
    WAFFLE,
    Footprint,
    distance_at,
    footprint_clearance_m,
    footprint_in_collision,
    signed_distance_m,
)
from mazebot.physics.bodies.robot_model import Shape, robot_model_from_urdf

RESOLUTION_M = 0.05


def corners_of(shape: Shape) -> Array:
    """(n, 3): enough points of a shape's surface for its extent from above."""
    if shape.kind == "box":
        return np.array(list(itertools.product(*((-s / 2, s / 2) for s in shape.sides_m))))
    angles = np.linspace(0.0, math.tau, 72, endpoint=False)
    circle = shape.radius_m * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    ends = [0.0] if shape.kind == "sphere" else [-shape.length_m / 2, shape.length_m / 2]
    return np.concatenate([circle + np.array([0.0, 0.0, end]) for end in ends])


def test_the_waffle_is_the_hull_of_what_collides_in_the_physics() -> None:
    model = robot_model_from_urdf((ROOT / "models/turtlebot3_waffle/model.urdf").read_text())
    pose_of = {BASE_FOOTPRINT_FRAME: np.eye(4)}
    for joint in model.joints:
        pose_of[joint.child] = pose_of[joint.parent] @ joint.parent_from_child
    points = np.concatenate(
        [
            portable.product(corners_of(shape), pose[:3, :3].T) + pose[:3, 3]
            for name, link in model.links.items()
            for shape in link.shapes
            for pose in [portable.product(pose_of[name], shape.link_from_shape)]
        ]
    )
    hull = Footprint.of(points[:, :2])
    for a, b in ((hull, WAFFLE), (WAFFLE, hull)):
        assert max(signed_distance_m(a.points_m, x, y) for x, y in b.points_m) < 1e-4
    assert pytest.approx(0.0685) == WAFFLE.inscribed_radius_m
    assert pytest.approx(0.237, abs=1e-4) == WAFFLE.circumscribed_radius_m
    assert pytest.approx(0.153) == WAFFLE.half_width_m


def test_padding_moves_each_corner_outwards_as_in_nav2() -> None:
    square = Footprint.parse("[[0.1, 0.1], [0.1, -0.1], [-0.1, -0.1], [-0.1, 0.1]]", 0.01)
    expected = np.array([[-0.11, -0.11], [0.11, -0.11], [0.11, 0.11], [-0.11, 0.11]])
    assert square.points_m == pytest.approx(expected)
    assert square.padded(0.01).half_width_m == pytest.approx(0.12)
    assert Footprint.circle(0.2).circumscribed_radius_m == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("[[0, 0], [1, 1]]", "enclose an area"),
        ("[[1, 0], [2, 0], [2, 1]]", "enclose base_footprint"),
        ("[[1, 0], [2, 0]", "must be"),
        ("5", "must be"),
        ("[[1, 2, 3]]", "must be"),
        ('[["a", 0], [1, 1], [0, 1]]', "must be"),
        ("[[NaN, 0], [1, 1], [0, 1]]", "must be"),
    ],
)
def test_a_footprint_that_is_none_is_refused_in_a_phrase(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why) as error:
        Footprint.parse(text)
    assert "\n" not in str(error.value)


def field(
    lethal: set[tuple[int, int]], size: int = 60
) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    mask = np.zeros((size, size), np.bool_)
    for cell in lethal:
        mask[cell] = True
    return clearance_m(mask, RESOLUTION_M)


def test_the_distance_is_interpolated_between_centres() -> None:
    wall = field({(row, 40) for row in range(60)})
    for column in (10.3, 25.0, 39.9, 40.5):
        assert distance_at(wall, column, 30.2) == pytest.approx(0.05 * (40.5 - column), abs=1e-6)
    assert distance_at(wall, -0.1, 30.0) == 0.0
    assert distance_at(wall, 3.0, 60.0) == 0.0


def clearance_at(
    distance: np.ndarray[tuple[int, int], np.dtype[np.float32]], x: float, y: float, yaw: float
) -> float:
    return footprint_clearance_m(
        distance, RESOLUTION_M, WAFFLE.points_m, WAFFLE.circles,
        x / RESOLUTION_M, y / RESOLUTION_M, math.cos(yaw), math.sin(yaw),
    )  # fmt: skip


def hits(
    distance: np.ndarray[tuple[int, int], np.dtype[np.float32]],
    x: float, y: float, yaw: float, margin: float = 0.0,
) -> bool:  # fmt: skip
    return footprint_in_collision(
        distance, RESOLUTION_M, WAFFLE.points_m, WAFFLE.circles,
        x / RESOLUTION_M, y / RESOLUTION_M, math.cos(yaw), math.sin(yaw), margin,
    )  # fmt: skip


def test_clearance_from_a_wall_is_that_of_the_polygon_in_every_direction() -> None:
    wall = field({(row, column) for row in range(60) for column in range(40, 60)})
    face_m = 40.5 * RESOLUTION_M
    for yaw in np.linspace(-3.0, 3.0, 41):
        reach_m = (WAFFLE.points_m @ [math.cos(yaw), -math.sin(yaw)]).max()
        for gap_m in (0.001, 0.012, 0.04):
            at = face_m - reach_m - gap_m
            assert clearance_at(wall, at, 1.5, yaw) == pytest.approx(gap_m, abs=2e-3)
            assert hits(wall, at, 1.5, yaw, gap_m + 2e-3)
            assert not hits(wall, at, 1.5, yaw, gap_m - 2e-3)
        assert hits(wall, face_m - reach_m + 0.01, 1.5, yaw)
        assert 0.0 < clearance_at(wall, face_m - reach_m - 0.3, 1.5, yaw) <= 0.3


def test_a_single_cell_anywhere_under_the_robot_is_a_collision() -> None:
    lethal = field({(30, 30)})
    at_m = 30.5 * RESOLUTION_M
    random = np.random.default_rng(3)
    for _ in range(3000):
        dx, dy, yaw = random.uniform((-0.3, -0.3, -3.2), (0.3, 0.3, 3.2))
        c, s = math.cos(yaw), math.sin(yaw)
        true_m = signed_distance_m(WAFFLE.points_m, -c * dx - s * dy, s * dx - c * dy)
        found_m = clearance_at(lethal, at_m + dx, at_m + dy, yaw)
        if true_m < -1e-6:
            assert found_m < 0.0
            assert hits(lethal, at_m + dx, at_m + dy, yaw)
        elif true_m < 0.04:
            # Bilinear interpolation rounds the cone around one cell, to the side of more distance.
            assert -0.003 < found_m - true_m < 0.021
        else:
            assert found_m > 0.0
            assert not hits(lethal, at_m + dx, at_m + dy, yaw)


def test_it_fits_through_its_width_and_turns_in_its_diameter() -> None:
    # Faces in the middle of their cells, 0.5 m apart.
    corridor = field({(row, column) for row in (20, 30) for column in range(60)})
    middle_m = 25.5 * RESOLUTION_M
    yaws = np.linspace(0.0, math.tau, 100)
    assert not any(hits(corridor, 1.5, middle_m, yaw, 0.01) for yaw in yaws)
    assert any(hits(corridor, 1.5, middle_m + 0.02, yaw) for yaw in yaws)
    assert not hits(corridor, 1.5, middle_m + 0.09, 0.0)
    assert hits(corridor, 1.5, middle_m + 0.1, 0.0)
