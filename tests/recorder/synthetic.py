"""A run made by hand: a robot drives a circle in a walled room, and every topic has messages."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, rotation_from_rpy, transform_matrix
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.common.messages.topics import Topic
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox
from mazebot.physics.battery import Battery
from mazebot.recorder.node import RecorderNode

Said = tuple[int, Topic[Any], Any]

WIDTH, HEIGHT, FOCAL_PX = 320, 240, 277.13
STEP_NS = 33_333_333
ERROR_M = 0.05
"""By how much the estimate is off, in x."""
BATTERY = Battery(1.8, 0.9, 1.0)


def png(pixels: NDArray[np.uint8]) -> tuple[str, msg.CompressedImage]:
    """A texture and its sha256."""
    data = cv2.imencode(".png", pixels)[1]
    sha256 = hashlib.sha256(data.tobytes()).hexdigest()
    return sha256, msg.CompressedImage(msg.header(0, sha256), "png", data)


def checker(first: tuple[int, int, int], second: tuple[int, int, int]) -> NDArray[np.uint8]:
    """A BGR picture of 64 x 64 pixels in two colours."""
    squares = (np.indices((64, 64)) // 16).sum(axis=0) % 2
    return np.asarray(np.array([first, second], np.uint8)[squares], np.uint8)


def marker_picture(marker_id: int) -> NDArray[np.uint8]:
    """A marker with a quiet zone of one module."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    picture = np.asarray(cv2.aruco.generateImageMarker(dictionary, marker_id, 180), np.uint8)
    return np.pad(picture, 30, constant_values=255)


BRICKS, _BRICKS_ASSET = png(checker((40, 60, 200), (60, 90, 230)))
MARKER, _MARKER_ASSET = png(marker_picture(60))


def room(name: str = "room", height_m: float = 3.0) -> doc.World:
    """Four walls around (0, 0), 4 m apart, and one marker on the eastern one."""
    places = ((2.0, 0.0, math.pi / 2), (-2.0, 0.0, math.pi / 2), (0.0, 2.0, 0.0), (0.0, -2.0, 0.0))
    world = doc.World(
        name=name,
        recipe=f"{name}.yaml",
        hash="",
        walls=tuple(
            doc.Wall(
                name=f"Wall_{i}", length_m=4.15, thickness_m=0.15, height_m=height_m,
                x_m=x, y_m=y, yaw_rad=yaw, material="bricks" if i % 2 else "plain",
            )
            for i, (x, y, yaw) in enumerate(places)
        ),
        materials=(
            doc.Material(name="bricks", texture_sha256=BRICKS, texture_name="bricks.png"),
            doc.Material(name="plain", diffuse=(0.7, 0.7, 0.7, 1.0)),
        ),
        locations=(doc.Location(name="corner", x_m=1.0, y_m=1.0, yaw_rad=0.0),),
        start=doc.Planar(x_m=0.0, y_m=0.0, yaw_rad=0.0),
    )  # fmt: skip
    return world.model_copy(update={"hash": world.content_hash()})


def marker_on_the_east_wall() -> doc.MarkerEntity:
    """It faces -x: its own x axis is -y of the map, its y axis is up."""
    return doc.MarkerEntity(
        name="marker_60",
        position_m=(1.92, 0.0, 0.3),
        orientation_xyzw=(0.5, -0.5, -0.5, 0.5),
        panel_side_m=0.4,
        texture_sha256=MARKER,
        marker_id=60,
        marker_size_m=0.3,
        dictionary="DICT_4X4_100",
    )


BASE_FROM_CAMERA = transform_matrix(np.eye(3), (0.069, -0.047, 0.117))


def static_transforms() -> msg.TFMessage:
    """The robot's fixed frames."""
    optical = transform_matrix(rotation_from_rpy(-math.pi / 2, 0.0, -math.pi / 2), (0.0, 0.0, 0.0))
    lidar = transform_matrix(np.eye(3), (-0.064, 0.0, 0.132))
    return msg.TFMessage(
        [
            msg.transform_stamped(0, "base_footprint", "camera_link", BASE_FROM_CAMERA),
            msg.transform_stamped(0, "camera_link", "camera_rgb_optical_frame", optical),
            msg.transform_stamped(0, "base_footprint", "base_scan", lidar),
        ]
    )


def opening(world: doc.World) -> list[Said]:
    """What is said before the simulation starts."""
    request = doc.WorldRequest(world_name=world.name)
    entities = doc.Entities(world_hash=world.hash, entities=(marker_on_the_east_wall(),))
    cells = np.zeros((84, 84), np.int8)
    cells[:3], cells[-3:], cells[:, :3], cells[:, -3:] = 100, 100, 100, 100
    grid = msg.occupancy_grid(0, 0.05, SE2(-2.1, -2.1, 0.0), cells)
    return [
        (0, table.WORLD_REQUEST, request),
        (0, table.WORLD_STATUS, doc.WorldStatus(request=request, world_hash=world.hash)),
        (0, table.ASSETS, _BRICKS_ASSET),
        (0, table.ASSETS, _MARKER_ASSET),
        (0, table.WORLD, world),
        (0, table.MAP, grid),
        (0, table.DESIRED_ENTITIES, entities),
        (0, table.ENTITIES, entities),
        (0, table.TF_STATIC, static_transforms()),
        (0, table.GLOBAL_COSTMAP, grid),
    ]


def true_pose(now_ns: int) -> SE2:
    """A circle of 1 m around the middle at 0.2 rad/s, from (1, 0)."""
    angle = 0.2 * now_ns * 1e-9
    return SE2(math.cos(angle), math.sin(angle), angle + math.pi / 2)


def driving(world: doc.World, seconds: float, start_ns: int = 0) -> Iterator[Said]:
    """Everything said while the robot drives, at about the table's rates; at last a goal ends."""
    goal = doc.Planar(x_m=1.0, y_m=1.0, yaw_rad=0.0)
    pose_message = msg.pose_from_se2(goal.se2())
    yield start_ns, table.GOAL_POSE, msg.PoseStamped(msg.header(start_ns, "map"), pose_message)
    count = round(seconds * 1e9 / STEP_NS)
    for step in range(1, count + 1):
        now_ns = start_ns + step * STEP_NS
        yield from _fast(now_ns)
        if step % 3 == 0:
            yield from _medium(now_ns)
        if step % 30 == 0:
            yield from _slow(world, now_ns, step)
    end_ns = start_ns + count * STEP_NS
    yield end_ns, table.NAVIGATION_RESULT, doc.NavigationResult(
        goal=goal, goal_stamp_ns=start_ns, error_code=105, error_msg="no progress",
        start_time_s=start_ns * 1e-9, end_time_s=end_ns * 1e-9,
    )  # fmt: skip


def _odometry(now_ns: int, pose: SE2, frame: str) -> msg.Odometry:
    twist = msg.Twist(linear=msg.Vector3(0.2, 0.0, 0.0), angular=msg.Vector3(0.0, 0.0, 0.2))
    covariance = np.zeros(36)
    return msg.Odometry(
        msg.header(now_ns, frame),
        "base_footprint",
        msg.PoseWithCovariance(msg.pose_from_se2(pose), covariance),
        msg.TwistWithCovariance(twist, covariance),
    )


def _fast(now_ns: int) -> Iterator[Said]:
    truth = true_pose(now_ns)
    header = msg.header(now_ns, "base_footprint")
    wheel = 6.0 * now_ns * 1e-9
    yield now_ns, table.CLOCK, msg.Clock(msg.time_from_ns(now_ns))
    yield now_ns, table.GROUND_TRUTH_ODOM, _odometry(now_ns, truth, "map")
    yield now_ns, table.ODOM, _odometry(now_ns, truth, "odom")
    map_from_odom = SE2(ERROR_M, 0.0, 0.0)
    yield (
        now_ns,
        table.TF,
        msg.TFMessage(
            [
                msg.transform_stamped(now_ns, "odom", "base_footprint", truth.matrix()),
                msg.transform_stamped(now_ns, "map", "odom", map_from_odom.matrix()),
            ]
        ),
    )
    yield (
        now_ns,
        table.JOINT_STATES,
        msg.JointState(
            header,
            ["wheel_left_joint", "wheel_right_joint"],
            np.array([wheel, wheel]),
            np.array([6.0, 6.0]),
            np.zeros(0),
        ),
    )
    zero = msg.Vector3(0.0, 0.0, 0.2)
    q = msg.Quaternion(0.0, 0.0, 0.0, 1.0)
    covariance = np.zeros(9)
    yield now_ns, table.IMU, msg.Imu(header, q, covariance, zero, covariance, zero, covariance)
    twist = msg.Twist(linear=msg.Vector3(0.2, 0.0, 0.0), angular=zero)
    yield now_ns, table.CMD_VEL, msg.TwistStamped(header, twist)


def _medium(now_ns: int) -> Iterator[Said]:
    truth = true_pose(now_ns)
    estimate = SE2(truth.x_m + ERROR_M, truth.y_m, truth.yaw_rad)
    covariance = msg.planar_covariance(np.diag([0.002, 0.001, 0.001]))
    pose = msg.PoseWithCovariance(msg.pose_from_se2(estimate), covariance)
    yield (
        now_ns,
        table.AMCL_POSE,
        msg.PoseWithCovarianceStamped(msg.header(now_ns, "map"), pose),
    )
    ranges = np.full(360, 1.5, np.float32)
    ranges[::7] = np.inf
    yield now_ns, table.SCAN, msg.LaserScan(
        msg.header(now_ns, "base_scan"), 0.0, msg.float32(2 * math.pi), msg.float32(math.pi / 180),
        0.0, msg.float32(0.1), msg.float32(0.12), 3.5, ranges, np.zeros(0, np.float32),
    )  # fmt: skip
    optical = msg.header(now_ns, "camera_rgb_optical_frame")
    yield now_ns, table.CAMERA_INFO, _camera_info(optical)
    yield now_ns, table.CAMERA_IMAGE, _picture(optical)
    detections = _detections(now_ns, truth)
    yield now_ns, table.DETECTIONS, msg.Detection3DArray(optical, detections)
    yield now_ns, table.MAP_DETECTIONS, msg.Detection3DArray(msg.header(now_ns, "map"), [])


def _slow(world: doc.World, now_ns: int, step: int) -> Iterator[Said]:
    truth = true_pose(now_ns)
    header = msg.header(now_ns, "map")
    cloud = [msg.pose_from_se2(SE2(truth.x_m + 0.01 * i, truth.y_m, 0.1 * i)) for i in range(20)]
    yield now_ns, table.PARTICLE_CLOUD, msg.PoseArray(header, cloud)
    yield now_ns, table.BATTERY_STATE, BATTERY.message(now_ns)
    ahead = [true_pose(now_ns + i * 1_000_000_000) for i in range(5)]
    path = [msg.PoseStamped(header, msg.pose_from_se2(pose)) for pose in ahead]
    yield now_ns, table.PLAN, msg.Path(header, path)
    yield now_ns, table.LOCALIZATION_STATUS, doc.LocalizationStatus(state="localized", quality=0.9)
    yield now_ns, table.NAVIGATION_STATUS, doc.NavigationStatus(
        localization_active=True, navigation_active=True, state="controlling",
        goal=doc.Planar(x_m=1.0, y_m=1.0, yaw_rad=0.0), distance_remaining_m=1.0,
    )  # fmt: skip
    yield now_ns, table.SIMULATION_STATS, doc.SimulationStats(
        world_hash=world.hash, sim_time_s=now_ns * 1e-9, iterations=step, step_size_s=1 / 240,
        renderer="moderngl (hand-made)", state_hash=f"{step:08x}", seed=7, epoch=1,
    )  # fmt: skip
    yield (
        now_ns,
        table.DIAGNOSTICS,
        msg.DiagnosticArray(
            header,
            [
                msg.DiagnosticStatus(
                    0, "navigation", "active", "", [msg.KeyValue("rejected /scan: not finite", "2")]
                )
            ],
        ),
    )
    yield now_ns, table.ROSOUT, msg.Log(header.stamp, 20, "physics", "all well", "a.py", "f", 3)


def _camera_info(header: msg.Header) -> msg.CameraInfo:
    k = np.array([FOCAL_PX, 0, WIDTH / 2, 0, FOCAL_PX, HEIGHT / 2, 0, 0, 1], np.float64)
    p = np.zeros(12)
    p.reshape(3, 4)[:, :3] = k.reshape(3, 3)
    region = msg.RegionOfInterest(0, 0, 0, 0, False)
    r = np.eye(3).reshape(9)
    return msg.CameraInfo(header, HEIGHT, WIDTH, "plumb_bob", np.zeros(5), k, r, p, 0, 0, region)


def _picture(header: msg.Header) -> msg.Image:
    """Blue above, yellow below."""
    pixels = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    pixels[: HEIGHT // 2] = (30, 60, 200)
    pixels[HEIGHT // 2 :] = (230, 200, 20)
    return msg.Image(header, HEIGHT, WIDTH, "rgb8", 0, 3 * WIDTH, pixels.reshape(-1))


def _detections(now_ns: int, truth: SE2) -> list[msg.Detection3D]:
    """The marker 2 m ahead of the camera, facing it, whatever the robot's pose."""
    optical_from_marker = np.diag([1.0, -1.0, -1.0, 1.0])
    optical_from_marker[2, 3] = 2.0
    pose = msg.pose_from_matrix(optical_from_marker)
    covariance = np.zeros(36)
    hypothesis = msg.ObjectHypothesisWithPose(
        msg.ObjectHypothesis("60", 1.0), msg.PoseWithCovariance(pose, covariance)
    )
    box = msg.BoundingBox3D(pose, msg.Vector3(0.3, 0.3, 0.0))
    header = msg.header(now_ns, "camera_rgb_optical_frame")
    return [msg.Detection3D(header, [hypothesis], box, "DICT_4X4_100:60")]


class Bench:
    """A recorder with a wall clock of our own, fed by hand as the executive feeds it."""

    def __init__(self, node: RecorderNode, world_hash: str = "") -> None:
        self.node: Node = node
        self.inbox = Inbox(node)
        self.put: list[tuple[Topic[object], object]] = []
        self.outbox = Outbox(node, lambda topic, message, _: self.put.append((topic, message)))
        self.world_hash = world_hash
        self._sequence: dict[str, int] = {}
        self._next_step_ns = 0

    def say(self, said: list[Said] | Iterator[Said]) -> None:
        """Deliver messages, and let the recorder step every 100 ms and after the last."""
        now_ns = 0
        for now_ns, topic, message in said:
            if now_ns >= self._next_step_ns or now_ns < self._next_step_ns - 1_000_000_000:
                self.step(now_ns)
                self._next_step_ns = now_ns + 100_000_000
            number = self._sequence.get(topic.name, 0)
            self._sequence[topic.name] = number + 1
            self.inbox.deliver(topic, message, Envelope("test", number, now_ns, self.world_hash))
        self.step(now_ns)

    def step(self, now_ns: int) -> None:
        """One step."""
        self.outbox.now_ns = now_ns
        self.node.step(now_ns, self.inbox, self.outbox)


class WallClock:
    """Advances by a little whenever it is read."""

    def __init__(self, tick_s: float = 0.001) -> None:
        self.now_s, self.tick_s = 100.0, tick_s

    def __call__(self) -> float:
        self.now_s += self.tick_s
        return self.now_s
