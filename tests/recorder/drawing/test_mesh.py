"""The triangles of panels and robot against their measures."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.files.root import ROOT
from mazebot.common.maths.frames import pose_matrix
from mazebot.recorder.drawing.mesh import Mesh, panel, robot_from_urdf
from tests.recorder.synthetic import marker_on_the_east_wall


def outward(mesh: Mesh) -> NDArray[np.float32]:
    """Of each triangle, how far its turning sense agrees with its normal."""
    a, b, c = (mesh.positions_m[mesh.triangles[:, i]] for i in range(3))
    turned = np.cross(b - a, c - a)
    return np.asarray(np.sum(turned * mesh.normals[mesh.triangles[:, 0]], axis=1), np.float32)


def test_a_panel_faces_along_its_z_axis_with_its_picture_upright() -> None:
    entity = marker_on_the_east_wall()
    mesh, map_from_panel = panel(entity.panel_side_m), pose_matrix(entity)
    normal = map_from_panel[:3, :3] @ mesh.normals[0]
    assert normal == pytest.approx([-1.0, 0.0, 0.0], abs=1e-6)
    top_left = mesh.positions_m[np.argmin(mesh.uvs.sum(axis=1))]
    # As one looks east at it, left is north.
    top_left_m = (map_from_panel @ (*top_left, 1.0))[:3]
    assert top_left_m == pytest.approx([1.92, 0.2, 0.5], abs=1e-6)


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


def test_the_outline_goes_around_the_robot_with_its_wheels() -> None:
    robot = robot_from_urdf((ROOT / "models/turtlebot3_waffle/model.urdf").read_text())
    corners = np.concatenate(robot.outline())
    assert np.ptp(corners, axis=0) == pytest.approx([0.267, 0.307, 0.15], abs=0.02)
    assert len(robot.outline()) < 20
