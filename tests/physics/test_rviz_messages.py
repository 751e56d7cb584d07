"""What ROS tools draw the robot and the entities from."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from mazebot.common.maths import portable
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import ENTITY_MARKERS, ROBOT_DESCRIPTION, TF
from mazebot.embedded.session import Session
from mazebot.physics.bodies.robot_model import robot_model_from_urdf
from mazebot.physics.config import PhysicsConfig
from mazebot.physics.rviz_messages import MOST_TRIANGLES, EntityMarkers, WheelFrames


def _matrix(entry: msg.TransformStamped) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return msg.matrix_from_transform(entry.transform)


@pytest.mark.parametrize("angle_rad", [0.0, 0.4, -2.0, 100.0])
def test_a_wheel_turns_about_its_axis_as_its_joint_says(angle_rad: float) -> None:
    model = robot_model_from_urdf(PhysicsConfig().robot_urdf())
    left, right = WheelFrames.of(model).transforms((angle_rad, -angle_rad), 5)
    for entry, side, turn_rad in ((left, "left", angle_rad), (right, "right", -angle_rad)):
        joint = model.joint(f"wheel_{side}_joint")
        assert (entry.header.frame_id, entry.child_frame_id) == (joint.parent, joint.child)
        # About the axis by an angle, by Rodrigues' formula.
        x, y, z = joint.axis
        k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turned = np.eye(4)
        turned[:3, :3] += math.sin(turn_rad) * k
        turned[:3, :3] += (1.0 - math.cos(turn_rad)) * portable.product(k, k)
        expected = portable.product(joint.parent_from_child, turned)
        np.testing.assert_allclose(_matrix(entry), expected, atol=1e-9)


def _body(name: str, geometry: doc.Geometry, mass_kg: float = 0.0) -> doc.BodyEntity:
    shape = doc.Shape(name="shape", geometry=geometry, material="red")
    red = doc.Material(name="red", diffuse=(1.0, 0.0, 0.0, 1.0))
    return doc.BodyEntity(
        name=name, position_m=(1.0, 2.0, 0.5), mass_kg=mass_kg, shapes=(shape,), materials=(red,)
    )


def test_entities_are_triangles_and_markers_are_panels_with_their_numbers() -> None:
    panel = doc.MarkerEntity(
        name="aruco_60", position_m=(0.0, 1.0, 0.3), orientation_xyzw=(0.0, 0.0, 0.0, 1.0),
        panel_side_m=0.4, texture_sha256="ab", marker_id=60, marker_size_m=0.3,
        dictionary="DICT_4X4_100",
    )  # fmt: skip
    box = _body("box", doc.Box(size_m=(0.2, 0.4, 0.6)))
    ball = _body("ball", doc.Sphere(radius_m=0.1), mass_kg=1.0)
    world = doc.World(
        name="w", recipe="", hash="", walls=(), materials=(),
        start=doc.Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0),
    )  # fmt: skip
    entities = doc.Entities(world_hash="", entities=(panel, box, ball))
    array = EntityMarkers().array(entities, world, {}, {"ball"}, 7)
    wire.validate(ENTITY_MARKERS, array)
    first, *rest = array.markers
    assert first.action == msg.Marker.DELETEALL
    names = [(one.ns, one.id) for one in rest]
    assert names == [("aruco_60", 0), ("aruco_60", 1), ("box", 0), ("ball", 0)]
    square, text, cuboid, sphere = rest
    assert (square.type, square.scale.x, square.scale.y) == (msg.Marker.CUBE, 0.4, 0.4)
    assert (text.type, text.text) == (msg.Marker.TEXT_VIEW_FACING, "60")
    corners = np.array([[one.x, one.y, one.z] for one in cuboid.points])
    assert len(corners) == 36
    np.testing.assert_allclose(corners.min(axis=0), (0.9, 1.8, 0.2))
    np.testing.assert_allclose(corners.max(axis=0), (1.1, 2.2, 0.8))
    assert (cuboid.color.r, cuboid.color.g) == (1.0, 0.0)
    assert (cuboid.header.frame_id, cuboid.frame_locked) == ("map", False)
    # What moves is drawn about its own frame.
    corners = np.array([[one.x, one.y, one.z] for one in sphere.points])
    assert abs(corners.mean(axis=0)).max() < 1e-3
    assert (sphere.header.frame_id, sphere.frame_locked) == ("ball", True)


def test_what_is_kept_from_before_is_drawn_as_if_made_anew() -> None:
    start = doc.Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0)
    world = doc.World(name="w", recipe="", hash="", walls=(), materials=(), start=start)
    blue = doc.Material(name="blue", diffuse=(0.0, 0.0, 1.0, 1.0))
    box, ball = _body("box", doc.Box(size_m=(1.0, 1.0, 1.0))), _body("ball", doc.Sphere(radius_m=1))
    of_world = ball.model_copy(update={"name": "blue", "materials": ()})
    of_world = of_world.model_copy(
        update={"shapes": (ball.shapes[0].model_copy(update={"material": "blue"}),)}
    )
    away = box.model_copy(update={"position_m": (3.0, 0.0, 0.5)})
    drawn = EntityMarkers()
    for entities, where, movers in (
        ((box, ball, of_world), world, set()),
        ((away, of_world), world, set()),
        ((of_world, ball, box), world.model_copy(update={"materials": (blue,)}), set()),
        ((of_world, ball), world, {"ball"}),
    ):
        told = doc.Entities(world_hash="", entities=entities)
        array = drawn.array(told, where, {}, movers, 7)
        assert array == EntityMarkers().array(told, where, {}, movers, 7)


def test_what_has_very_many_triangles_is_a_box() -> None:
    many = 120
    angles = np.linspace(0.0, math.tau, many, endpoint=False)
    ring = tuple((math.cos(a), math.sin(a)) for a in angles)
    shape = doc.Polyline(polygons_m=(ring,), height_m=2.0)
    shapes = tuple(
        doc.Shape(name=f"s{number}", geometry=shape, material="red") for number in range(60)
    )
    body = _body("many", shape).model_copy(update={"shapes": shapes})
    world = doc.World(
        name="w", recipe="", hash="", walls=(), materials=(),
        start=doc.Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0),
    )  # fmt: skip
    assert 60 * 4 * (many - 1) > MOST_TRIANGLES
    array = EntityMarkers().array(doc.Entities(world_hash="", entities=(body,)), world, {}, (), 0)
    corners = np.array([[one.x, one.y, one.z] for one in array.markers[1].points])
    assert len(corners) == 36
    np.testing.assert_allclose(corners.min(axis=0), (0.0, 1.0, 0.5), atol=1e-2)
    np.testing.assert_allclose(corners.max(axis=0), (2.0, 3.0, 2.5), atol=1e-2)


def test_every_link_of_the_description_has_a_frame() -> None:
    heard: list[tuple[str, object]] = []
    with Session("original", camera=False) as session:
        topics = (ROBOT_DESCRIPTION, ENTITY_MARKERS, TF)
        session.watch(topics, lambda topic, message, _: heard.append((topic.name, message)))
        session.spawn(_body("crate", doc.Box(size_m=(0.2, 0.2, 0.2)), mass_kg=1.0))
        session.step(120)
        session.remove("crate")
        session.step(24)
    (text,) = [one.data for name, one in heard if name == ROBOT_DESCRIPTION.name]  # type: ignore[attr-defined]
    links = {link.get("name") for link in ET.fromstring(text).findall("link")}
    model = robot_model_from_urdf(text)
    moving = {
        entry.child_frame_id
        for name, tree in heard
        if name == TF.name
        for entry in tree.transforms  # type: ignore[attr-defined]
    }
    fixed = {joint.child for joint in model.fixed_joints()}
    assert links <= moving | fixed
    drawn = [
        {marker.ns for marker in array.markers}  # type: ignore[attr-defined]
        for name, array in heard
        if name == ENTITY_MARKERS.name
    ]
    assert [("crate" in names) for names in drawn[-2:]] == [True, False]
