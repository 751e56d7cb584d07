"""The waffle's URDF, and what is refused as a URDF."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import LINK_FROM_OPTICAL
from mazebot.physics.bodies.robot_model import ModelError, RobotModel, robot_model_from_urdf
from mazebot.physics.config import PhysicsConfig


@pytest.fixture
def waffle() -> RobotModel:
    return robot_model_from_urdf(PhysicsConfig().robot_urdf())


def test_weighs_what_the_reference_weighs(waffle: RobotModel) -> None:
    assert sum(link.mass_kg for link in waffle.links.values()) == pytest.approx(1.362)


def test_has_one_camera_pose(waffle: RobotModel) -> None:
    base_from_camera = waffle.transform("base_link", "camera_link")
    assert base_from_camera[:3, 3].tolist() == [0.069, -0.047, 0.107]
    assert (base_from_camera[:3, :3] == np.eye(3)).all()
    camera_from_optical = waffle.transform("camera_link", "camera_rgb_optical_frame")
    assert (camera_from_optical == LINK_FROM_OPTICAL).all()


def test_stands_on_wheels_and_casters(waffle: RobotModel) -> None:
    footprint_from_base = waffle.transform("base_footprint", "base_link")
    for joint in waffle.separate_links("base_link"):
        radius_m = max(shape.radius_m for shape in waffle.links[joint.child].shapes)
        z_m = (footprint_from_base @ joint.parent_from_child)[2, 3]
        assert z_m == pytest.approx(radius_m)


def test_wheels_are_where_the_reference_has_them(waffle: RobotModel) -> None:
    for side, sign in (("left", 1.0), ("right", -1.0)):
        joint = waffle.joint(f"wheel_{side}_joint")
        assert joint.parent_from_child[:3, 3].tolist() == [0.0, sign * 0.144, 0.023]
        shapes = waffle.links[joint.child].shapes
        assert max(shape.radius_m for shape in shapes) == 0.033
        assert max(shape.length_m for shape in shapes) == 0.018


def test_the_base_is_all_that_is_fixed_to_it(waffle: RobotModel) -> None:
    base = waffle.body("base_link")
    assert base.mass_kg == pytest.approx(1.0 + 0.125 + 0.035)
    x_m, _, z_m = base.centre_of_mass_m
    expected_x_m = (-0.064 - 0.125 * 0.052 + 0.035 * 0.061) / 1.16
    assert x_m == pytest.approx(expected_x_m)
    assert 0.048 < z_m < 0.06
    assert {shape.kind for shape in base.shapes} == {"box", "cylinder"}
    # Two point-like masses away from the centre add to the base's own inertia about z.
    assert 1.06e-2 < base.inertia_diagonal_kg_m2[2] < 1.3e-2


def test_inertia_follows_the_parallel_axis_theorem() -> None:
    sphere = '<inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/>'
    model = robot_model_from_urdf(
        f'<robot name="dumbbell"><link name="a"><inertial><mass value="2"/>{sphere}</inertial>'
        f'</link><link name="b"><inertial><mass value="2"/>{sphere}</inertial></link>'
        '<joint name="j" type="fixed"><parent link="a"/><child link="b"/>'
        '<origin xyz="1 0 0" rpy="0 0 1"/></joint></robot>'
    )
    body = model.body("a")
    assert body.centre_of_mass_m == pytest.approx((0.5, 0.0, 0.0))
    assert body.inertia_diagonal_kg_m2 == pytest.approx((0.0, 1.0, 1.0), abs=1e-6)


LINK = '<link name="a"/><link name="b"/>'


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("<robot", "not XML"),
        ("<sdf/>", "not a URDF"),
        (f"<robot>{LINK}</robot>", "not one tree"),
        (
            f'<robot>{LINK}<joint name="j" type="ball"><parent link="a"/><child link="b"/></joint>'
            "</robot>",
            "'ball'",
        ),
        (
            f'<robot>{LINK}<joint name="j" type="fixed"><parent link="a"/><child link="c"/></joint>'
            "</robot>",
            "no such link: 'c'",
        ),
        (
            '<robot><link name="a"><collision><geometry><box size="1 nan 1"/></geometry>'
            "</collision></link></robot>",
            "'1 nan 1'",
        ),
        (
            '<robot><link name="a"><collision><geometry><mesh/></geometry></collision></link>'
            "</robot>",
            "must be a box",
        ),
        (
            '<robot><link name="a"><inertial><mass value="1"/></inertial></link></robot>',
            "<inertia>",
        ),
    ],
)
def test_what_is_no_usable_urdf_is_refused_in_one_line(text: str, reason: str) -> None:
    with pytest.raises(ModelError, match=reason) as caught:
        robot_model_from_urdf(text)
    assert "\n" not in str(caught.value)


def test_frames_that_no_fixed_joint_links_are_refused(waffle: RobotModel) -> None:
    with pytest.raises(ModelError, match="wheel_left_link"):
        waffle.transform("base_link", "wheel_left_link")
    assert math.isfinite(waffle.body("wheel_left_link").mass_kg)
