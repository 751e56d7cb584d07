"""Markers of the world in what the camera sees, for the pose and for docks."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mazebot.common.maths.frames import (
    SE2,
    quaternion_from_rotation,
)
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import DockRobot, SendGoal
from mazebot.common.messages.documents import (
    Entities,
    MappedMarker,
    MarkerEntity,
)
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import (
    ACTION_RESULT,
    CAMERA_INFO,
    DETECTIONS,
    ENTITIES,
    SEND_GOAL,
)
from mazebot.navigation.errors import NavigationError
from tests.common.samples import SAMPLES
from tests.navigation.driving import (
    NodeDriver,
    estimate_error_m,
    fixed_frames,
)
from tests.navigation.house_tour import house


def marker_entity(name: str, marker_id: int, x_m: float, y_m: float) -> MarkerEntity:
    """A marker that faces +x."""
    # Its columns are right, up and out of the wall, as one looks at it.
    rotation = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return MarkerEntity(
        name=name,
        position_m=(x_m, y_m, 0.3),
        orientation_xyzw=quaternion_from_rotation(rotation),
        panel_side_m=0.4,
        texture_sha256="",
        marker_id=marker_id,
        marker_size_m=0.3,
        dictionary="DICT_4X4_100",
    )


def sighting(stamp_ns: int, marker_id: int, camera_from_marker: np.ndarray) -> msg.Detection3DArray:
    header = msg.header(stamp_ns, "camera_rgb_optical_frame")
    pose = msg.pose_from_matrix(camera_from_marker)
    covariance = np.diag([1e-4] * 3 + [1e-3] * 3).reshape(36)
    result = msg.ObjectHypothesisWithPose(
        hypothesis=msg.ObjectHypothesis(class_id=str(marker_id), score=1.0),
        pose=msg.PoseWithCovariance(pose=pose, covariance=covariance),
    )
    box = msg.BoundingBox3D(center=pose, size=msg.Vector3(0.3, 0.3, 0.0))
    detection = msg.Detection3D(header=header, results=[result], bbox=box, id=str(marker_id))
    return msg.Detection3DArray(header=header, detections=[detection])


def test_a_marker_of_the_world_is_used_and_others_are_counted() -> None:
    entities = Entities(
        world_hash=house().world.hash,
        entities=(marker_entity("marker_80", 80, -1.8, 0.427),),
    )
    driver = NodeDriver(start=SE2(-0.8, 0.427, math.pi))
    driver.learn(entities=entities)
    driver.blind = True
    driver.run(0.2)
    driver.blind = False
    frames = fixed_frames().transforms
    base_from_camera = msg.chain_transforms(frames, "base_footprint", "camera_rgb_optical_frame")
    assert base_from_camera is not None
    rotation = msg.matrix_from_pose(
        msg.Pose(
            position=msg.Point(-1.8, 0.427, 0.3),
            orientation=msg.Quaternion(*entities.entities[0].orientation_xyzw),
        )
    )
    camera_from_map = np.linalg.inv(driver.robot.map_from_base.matrix() @ base_from_camera)
    for _ in range(40):
        seen = camera_from_map @ rotation
        driver.deliver(DETECTIONS, sighting(driver.now_ns, 80, seen))
        driver.deliver(DETECTIONS, sighting(driver.now_ns, 81, seen))
        driver.step()
    rejected = driver.rejected(DETECTIONS)
    assert rejected["unknown marker"] == 40
    assert estimate_error_m(driver) < 0.1


def test_a_marker_that_hangs_twice_is_not_used() -> None:
    entities = Entities(
        world_hash=house().world.hash,
        entities=(marker_entity("a", 80, -1.8, 0.427), marker_entity("b", 80, 1.5, 2.1)),
    )
    driver = NodeDriver()
    driver.learn(entities=entities)
    driver.run(0.3)
    driver.deliver(DETECTIONS, sighting(driver.now_ns, 80, np.eye(4)))
    driver.step()
    assert driver.rejected(DETECTIONS)["unknown marker"] == 1
    assert estimate_error_m(driver) < 0.05


def test_markers_of_another_world_are_not_used() -> None:
    entities = Entities(
        world_hash="0123456789abcdef", entities=(marker_entity("a", 80, -1.8, 0.427),)
    )
    driver = NodeDriver()
    driver.learn(entities=entities)
    driver.run(0.3)
    driver.deliver(DETECTIONS, sighting(driver.now_ns, 80, np.eye(4)))
    driver.step()
    assert driver.rejected(DETECTIONS)["unknown marker"] == 1
    driver.deliver(ENTITIES, entities.model_copy(update={"world_hash": house().world.hash}))
    driver.step()
    driver.deliver(DETECTIONS, sighting(driver.now_ns, 80, np.eye(4)))
    driver.step()
    assert driver.rejected(DETECTIONS)["unknown marker"] == 1


def with_a_marker() -> NodeDriver:
    entities = Entities(
        world_hash=house().world.hash, entities=(marker_entity("a", 80, -1.8, 0.427),)
    )
    driver = NodeDriver()
    driver.learn(entities=entities)
    driver.run(0.3)
    return driver


def camera_info(focal_px: float = 554.4) -> msg.CameraInfo:
    matrix = np.array([[focal_px, 0.0, 320.0], [0.0, focal_px, 240.0], [0.0, 0.0, 1.0]])
    info: msg.CameraInfo = SAMPLES[CAMERA_INFO]
    return replace(info, width=640, height=480, k=matrix.reshape(9))


def test_docks_are_where_the_newest_camera_sees_the_marker() -> None:
    driver = with_a_marker()
    goal = SendGoal(goal_id="dock", goal=DockRobot(dock_id="80"))
    driver.inbox.ask(SEND_GOAL, goal, lambda _: None)
    driver.step()
    driver.step()
    (blind,) = driver.of(ACTION_RESULT)
    assert (blind.error_code, blind.action) == (902, "dock_robot")
    assert "dock '80': docking needs the camera" in blind.error_msg
    asked = []
    for focal_px in (554.4, 277.2):
        driver.deliver(CAMERA_INFO, camera_info(focal_px))
        driver.step()
        drive = driver.node._drive
        assert drive is not None
        asked.append(drive.robot.dock("80").marker_from_dock.x_m)
    # The camera is 0.07 m ahead; the panel reaches 0.39 m, the free picture 230.4 px above it.
    assert asked == pytest.approx([1.01, 0.54])


def mapped(entity: MarkerEntity) -> MappedMarker:
    return MappedMarker.model_validate(entity.model_dump(include=set(MappedMarker.model_fields)))


def test_docks_are_those_of_the_robots_map_where_that_has_them() -> None:
    hanging = (marker_entity("a", 80, -1.8, 0.427), marker_entity("b", 60, 1.5, 2.1))
    entities = Entities(world_hash=house().world.hash, entities=hanging)
    on_map = mapped(marker_entity("", 80, -0.8, 0.927))
    gone = mapped(marker_entity("", 7, 0.0, 0.0))
    unknown = {"b": "marker 60 of DICT_4X4_100 is not among the markers of the robot's map"}
    for world, places, reasons in (
        ({}, {"80": (-1.8, 0.427), "60": (1.5, 2.1)}, {"7": "must be one of 60, 80, a, b"}),
        (
            {"mapped_markers": (on_map, gone)},
            {"80": (-0.8, 0.927), "a": (-0.8, 0.927)},
            unknown | {"7": "which the robot's map has, is not in the world; must be one of 80, a"},
        ),
        ({"mapped_markers": ()}, {}, unknown | {"80": "there is no marker that the robot knows"}),
        (
            {"mapped_markers": (on_map, on_map)},
            {},
            {"a": "is in 2 places among the markers of the robot's map"},
        ),
        ({"slam": True}, {}, {"60": "with slam, the robot does not know where"}),
    ):
        driver = NodeDriver()
        driver.learn(world=house().world.model_copy(update=world), entities=entities)
        driver.deliver(CAMERA_INFO, camera_info())
        driver.run(0.1)
        drive = driver.node._drive
        assert drive is not None
        for name, place in places.items():
            assert drive.robot.dock(name).map_from_marker[:2] == pytest.approx(place)
            assert drive.robot.dock(name).side_m == pytest.approx(0.4)
        for name, reason in reasons.items():
            with pytest.raises(NavigationError, match=reason) as caught:
                drive.robot.dock(name)
            assert caught.value.code is ErrorCode.DOCK_NOT_IN_DB


def test_a_marker_that_is_twice_in_a_picture_is_kept_twice_and_counted() -> None:
    driver = with_a_marker()
    upright = np.diag([1.0, -1.0, -1.0, 1.0])
    near, far = upright.copy(), upright.copy()
    near[2, 3], far[2, 3] = 1.0, 1.5
    seen = sighting(driver.now_ns, 80, near)
    seen.detections.extend(sighting(driver.now_ns, 80, far).detections)
    driver.deliver(DETECTIONS, seen)
    driver.step()
    assert driver.inbox.counts[DETECTIONS.name].rejected == {"marker id twice in a picture": 1}
    drive = driver.node._drive
    assert drive is not None
    away_m = [one.base_from_marker.x_m for one in drive.robot.sightings("80")]
    assert away_m[1] - away_m[0] == pytest.approx(0.5, abs=0.01)
