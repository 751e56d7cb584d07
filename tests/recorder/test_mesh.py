"""The triangles of walls and robot against their measures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from services.common.config import ROOT
from services.common.documents import Wall
from services.recorder.mesh import Mesh, panel, robot_from_urdf, wall_sides, wall_tops
from tests.recorder.synthetic import marker_on_the_east_wall


def wall(height_m: float = 3.0, yaw_rad: float = 0.0) -> Wall:
    return Wall(
        name="w", length_m=4.0, thickness_m=0.2, height_m=height_m, x_m=1.0, y_m=2.0,
        yaw_rad=yaw_rad, material="m",
    )  # fmt: skip


def sides(*walls: Wall, bottom_m: float, top_m: float, tile_m: float) -> Mesh:
    mesh = wall_sides(walls, bottom_m, top_m, tile_m)
    assert mesh is not None
    return mesh


def outward(mesh: Mesh) -> NDArray[np.float32]:
    """Of each triangle, how far its turning sense agrees with its normal."""
    a, b, c = (mesh.positions_m[mesh.triangles[:, i]] for i in range(3))
    turned = np.cross(b - a, c - a)
    return np.asarray(np.sum(turned * mesh.normals[mesh.triangles[:, 0]], axis=1), np.float32)


def test_a_wall_stands_where_it_should_and_faces_outwards() -> None:
    mesh = sides(wall(yaw_rad=math.pi / 2), bottom_m=0.0, top_m=1.0, tile_m=1.0)
    assert mesh.positions_m.min(axis=0) == pytest.approx([0.9, 0.0, 0.0], abs=1e-6)
    assert mesh.positions_m.max(axis=0) == pytest.approx([1.1, 4.0, 1.0], abs=1e-6)
    assert (outward(mesh) > 0.0).all()
    from_centre = mesh.positions_m[:, :2] - (1.0, 2.0)
    assert (np.sum(from_centre * mesh.normals[:, :2], axis=1) > 0.0).all()


def test_a_texture_has_one_scale_on_every_side_and_runs_on_over_the_cut() -> None:
    lower = sides(wall(), bottom_m=0.0, top_m=1.0, tile_m=0.8)
    upper = sides(wall(), bottom_m=1.0, top_m=math.inf, tile_m=0.8)
    for mesh in (lower, upper):
        for side in range(4):
            corners = mesh.positions_m[4 * side : 4 * side + 4]
            uvs = mesh.uvs[4 * side : 4 * side + 4]
            width_m = float(np.linalg.norm(corners[1] - corners[0]))
            height_m = float(np.linalg.norm(corners[2] - corners[1]))
            assert uvs[1, 0] - uvs[0, 0] == pytest.approx(width_m / 0.8, abs=1e-5)
            assert uvs[1, 1] - uvs[2, 1] == pytest.approx(height_m / 0.8, abs=1e-5)
        assert (mesh.uvs >= 0.0).all()
    assert lower.uvs[2] == pytest.approx(upper.uvs[1])


def test_a_low_wall_has_no_upper_part() -> None:
    assert wall_sides([wall(1.0)], 1.0, math.inf, 1.0) is None
    assert wall_tops([(wall(1.0), (1, 1, 1, 1))], 1.0, math.inf) is None
    cut = wall_tops([(wall(3.0), (1, 1, 1, 1)), (wall(0.5), (1, 1, 1, 1))], 0.0, 1.0)
    assert cut is not None
    assert sorted(set(cut.positions_m[:, 2].tolist())) == [0.5, 1.0]


def test_a_panel_faces_along_its_z_axis_with_its_picture_upright() -> None:
    mesh = panel(marker_on_the_east_wall())
    assert mesh.normals[0] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-6)
    top_left = mesh.positions_m[np.argmin(mesh.uvs.sum(axis=1))]
    # As one looks east at it, left is north.
    assert top_left == pytest.approx([1.92, 0.2, 0.5], abs=1e-6)


def test_the_robot_has_the_waffle_s_measures() -> None:
    robot = robot_from_urdf((ROOT / "models/turtlebot3_waffle/model.urdf").read_text())
    low, high = robot.body.positions_m.min(axis=0), robot.body.positions_m.max(axis=0)
    assert (high - low)[0] == pytest.approx(0.27, abs=0.02)
    assert high[2] == pytest.approx(0.15, abs=0.02)
    assert low[2] > -0.005
    assert (outward(robot.body) >= -1e-12).all()
    assert {wheel.joint for wheel in robot.wheels} == {"wheel_left_joint", "wheel_right_joint"}
    for wheel in robot.wheels:
        assert abs(wheel.base_from_joint[1, 3]) == pytest.approx(0.144)
        assert wheel.base_from_joint[2, 3] == pytest.approx(0.033)
        assert np.abs(wheel.mesh.positions_m).max(axis=0)[[0, 2]] == pytest.approx(
            [0.033, 0.033], abs=1e-3
        )
        assert wheel.axis == pytest.approx([0.0, 1.0, 0.0])


def test_turned_bodies_face_outwards() -> None:
    shapes = ('<sphere radius="0.5"/>', '<cylinder radius="0.2" length="2"/>')
    visuals = "".join(f"<visual><geometry>{shape}</geometry></visual>" for shape in shapes)
    text = f'<robot name="r"><link name="a">{visuals}</link></robot>'
    mesh = robot_from_urdf(text).body
    assert (outward(mesh) >= -1e-9).all()
    assert mesh.positions_m.max(axis=0) == pytest.approx([0.5, 0.5, 1.0], abs=1e-6)
