"""A robot without physics: a unicycle with the waffle's limits, exact walls, and the node driven
through its boxes.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.documents import (
    CancelGoal,
    CancelGoalReply,
    Entities,
    NavigationResult,
    SimulationStats,
    World,
)
from mazebot.common.messages.topics import (
    AMCL_POSE,
    CANCEL_GOAL,
    CMD_VEL,
    DETECTIONS,
    ENTITIES,
    GOAL_POSE,
    INITIAL_POSE,
    MAP,
    NAVIGATION_RESULT,
    ODOM,
    SCAN,
    TF_STATIC,
    WORLD,
    Topic,
)
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox
from mazebot.localization.config import LocalizationConfig
from mazebot.localization.node import LocalizationNode
from mazebot.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.costmap.layered_costmap import LayeredCostmap, frame_of
from mazebot.navigation.node import NavigationNode
from tests.navigation.house_tour import (
    ANGLE_INCREMENT_RAD,
    BASE_FROM_SCAN,
    RANGE_MAX_M,
    RANGE_MIN_M,
    as_ranges,
    cast,
    house,
    wall_segments,
)

M = TypeVar("M")

MAX_ACCEL_M_S2, MAX_ANGULAR_ACCEL_RAD_S2 = 1.0, 2.0
MAX_VEL_M_S, MAX_ANGULAR_VEL_RAD_S = 0.46, 1.9
_SUBSTEPS = 6
IDENTITY = SE2(0.0, 0.0, 0.0)
NO_ECHOES: Array = np.empty((0, 2))

LOCATIONS = {place.name: place.se2() for place in house().world.locations}
START = house().world.start.se2()
TOUR = [LOCATIONS[f"location{i}"] for i in (1, 2, 3, 4)] + [START]


def wall_distance_m(points_m: Array) -> Array:
    """(n,) exact distances of (n, 2) points outside the walls to the nearest of their faces."""
    a, b = wall_segments()[:, :2], wall_segments()[:, 2:]
    along = b - a
    ratio = np.einsum("nsi,si->ns", points_m[:, None] - a, along) / (along**2).sum(1)
    feet = a + ratio.clip(0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(points_m[:, None] - feet, axis=2).min(1))


def house_costmap(config: NavigationConfig) -> LayeredCostmap:
    """The costmap of the house."""
    cells, origin = house().map_cells, house().map_origin
    frame = frame_of(house().world.map_resolution_m, origin, cells)
    params = config.global_costmap
    return LayeredCostmap(frame, cells, params.inflation_layer, params.obstacle_layer)


def box_segments(x_m: float, y_m: float, side_m: float) -> Array:
    """(4, 4) faces of an upright box."""
    h = side_m / 2.0
    corners = [(x_m - h, y_m - h), (x_m + h, y_m - h), (x_m + h, y_m + h), (x_m - h, y_m + h)]
    return np.array([(*p, *q) for p, q in zip(corners, corners[1:] + corners[:1], strict=True)])


@dataclass
class Unicycle:
    """A differential drive that follows commands within its limits of acceleration."""

    map_from_base: SE2
    velocity: Velocity = STOP
    stuck: bool = False
    """Its wheels turn on air: neither pose nor odometry move."""

    def drive(self, command: Velocity, seconds: float) -> None:
        """Advance while one command holds."""
        dt = seconds / _SUBSTEPS
        for _ in range(_SUBSTEPS):
            v, w = self.velocity
            dv, dw = MAX_ACCEL_M_S2 * dt, MAX_ANGULAR_ACCEL_RAD_S2 * dt
            v = min(max(command.linear_m_s, v - dv), v + dv)
            w = min(max(command.angular_rad_s, w - dw), w + dw)
            self.velocity = Velocity(v, w)
            if not self.stuck:
                half = w * dt / 2.0
                step = SE2(v * dt * math.cos(half), v * dt * math.sin(half), w * dt)
                self.map_from_base = self.map_from_base @ step


@dataclass
class Log:
    """What happened, one entry a control period."""

    poses: list[SE2] = field(default_factory=list)
    commands: list[Velocity] = field(default_factory=list)

    def points_m(self) -> Array:
        """(n, 2) true places."""
        return np.array([pose[:2] for pose in self.poses])

    def length_m(self) -> float:
        """Length of the way driven."""
        return float(np.linalg.norm(np.diff(self.points_m(), axis=0), axis=1).sum())


class NodeDriver:
    """Localisation and navigation with a robot about them: odometry, scans and commands go through
    their boxes.
    """

    def __init__(
        self,
        config: NavigationConfig | None = None,
        start: SE2 = START,
        odom_from_base: SE2 = IDENTITY,
        slip: float = 0.01,
        localization: LocalizationConfig | None = None,
    ) -> None:
        self.node = NavigationNode(config or NavigationConfig())
        self.localization = LocalizationNode(localization or LocalizationConfig())
        self.sent: list[tuple[str, object]] = []
        self.inbox, self.outbox = self._boxes(self.node)
        self.localization_inbox, self.localization_outbox = self._boxes(self.localization)
        self.robot = Unicycle(start)
        self.odom_from_base = odom_from_base
        self.now_ns = 0
        self.log = Log()
        self.extra_segments: Array = np.empty((0, 4))
        self.blind = False
        """No scans come."""
        self.frozen = False
        """The lidar's last ranges come again and again, with new stamps."""
        self.deaf = False
        """The robot hears no commands, and stands."""
        self._slip = 1.0 + slip
        self._rng = np.random.default_rng(1)
        self._sequence: dict[str, int] = {}
        self._command = STOP
        self._ranges_m: NDArray[np.float32] = np.empty(0, np.float32)
        self._odometry: deque[int] = deque()

    def deliver(self, topic: Topic[M], message: M | bytes) -> None:
        """Put a message, or its bytes, into the inbox of each node that reads the topic."""
        number = self._sequence.get(topic.name, 0)
        self._sequence[topic.name] = number + 1
        envelope = Envelope(f"of {topic.name}", number, self.now_ns, house().world.hash)
        for node, inbox in (
            (self.localization, self.localization_inbox),
            (self.node, self.inbox),
        ):
            if node.name in topic.readers:
                inbox.deliver(topic, message, envelope)

    def rejected(self, topic: Topic[M]) -> Counter[str]:
        """What localisation rejected of its topics, by reason; else navigation."""
        of_localization = topic.name in (DETECTIONS.name, INITIAL_POSE.name)
        inbox = self.localization_inbox if of_localization else self.inbox
        return inbox.counts[topic.name].rejected

    def of(self, topic: Topic[M]) -> list[M]:
        """What the node has put out on a topic."""
        return [message for name, message in self.sent if name == topic.name]  # type: ignore[misc]

    def results(self) -> list[NavigationResult]:
        """How goals have ended."""
        return self.of(NAVIGATION_RESULT)

    def learn(self, world: World | None = None, entities: Entities | None = None) -> None:
        """Give the node what is latched."""
        loaded = house()
        self.deliver(WORLD, world or loaded.world)
        self.deliver(
            MAP,
            msg.occupancy_grid(
                0, loaded.world.map_resolution_m, loaded.map_origin, loaded.map_cells
            ),
        )
        self.deliver(ENTITIES, entities or Entities(world_hash=loaded.world.hash))
        self.deliver(TF_STATIC, fixed_frames())

    def goal(self, goal: SE2, frame_id: str = "map") -> None:
        """Ask for a goal."""
        header = msg.header(self.now_ns, frame_id)
        message = msg.PoseStamped(header=header, pose=msg.pose_from_se2(goal))
        self.deliver(GOAL_POSE, wire.encode(GOAL_POSE, message))

    def step(self) -> None:
        """One control period: the robot drives, the sensors see, the node steps."""
        before = self.robot.map_from_base
        self.robot.drive(STOP if self.deaf else self._command, CONTROL_PERIOD_NS * 1e-9)
        moved = before.inverse() @ self.robot.map_from_base
        self.odom_from_base = self.odom_from_base @ SE2(
            moved.x_m * self._slip, moved.y_m * self._slip, moved.yaw_rad * self._slip
        )
        self.now_ns += CONTROL_PERIOD_NS
        self.deliver(ODOM, odometry(self.now_ns, self.odom_from_base, self.robot.velocity))
        if not self.blind and self.now_ns % 100_000_000 == 0:
            if not self.frozen:
                segments = np.concatenate([wall_segments(), self.extra_segments])
                exact_m = cast(self.robot.map_from_base @ BASE_FROM_SCAN, segments)
                self._ranges_m = as_ranges(exact_m, self._rng)
            self.deliver(SCAN, scan(self.now_ns, self._ranges_m))
        self.localization.step(self.now_ns, self.localization_inbox, self.localization_outbox)
        self.node.step(self.now_ns, self.inbox, self.outbox)
        self.log.poses.append(self.robot.map_from_base)
        self.log.commands.append(self._command)

    def run(self, seconds: float) -> None:
        """Several control periods."""
        for _ in range(round(seconds * 1e9 / CONTROL_PERIOD_NS)):
            self.step()

    def drive_to(self, goal: SE2, limit_s: float = 60.0) -> NavigationResult:
        """Ask for a goal and step until it has ended."""
        count = len(self.results())
        self.goal(goal)
        for _ in range(int(limit_s * 20)):
            self.step()
            if len(self.results()) > count:
                return self.results()[-1]
        raise AssertionError(f"no result after {limit_s} s, robot at {self.robot.map_from_base}")

    def _boxes(self, node: Node) -> tuple[Inbox, Outbox]:
        return Inbox(node), Outbox(node, lambda topic, message, _: self._keep(topic, message))

    def _keep(self, topic: Topic[object], message: object) -> None:
        self.sent.append((topic.name, message))
        if not {"navigation", "localization"}.isdisjoint(topic.readers):
            self.deliver(topic, message)
        if topic.name == CMD_VEL.name:
            assert isinstance(message, msg.TwistStamped)
            self._command = Velocity(message.twist.linear.x, message.twist.angular.z)


def odometry(stamp_ns: int, odom_from_base: SE2, velocity: Velocity) -> msg.Odometry:
    """Message of odometry."""
    return msg.Odometry(
        header=msg.header(stamp_ns, "odom"),
        child_frame_id="base_footprint",
        pose=msg.PoseWithCovariance(
            pose=msg.pose_from_se2(odom_from_base), covariance=np.zeros(36)
        ),
        twist=msg.TwistWithCovariance(
            twist=msg.Twist(
                linear=msg.Vector3(velocity.linear_m_s, 0.0, 0.0),
                angular=msg.Vector3(0.0, 0.0, velocity.angular_rad_s),
            ),
            covariance=np.zeros(36),
        ),
    )


def scan(stamp_ns: int, ranges_m: NDArray[np.float32]) -> msg.LaserScan:
    """Message of a scan."""
    return msg.LaserScan(
        header=msg.header(stamp_ns, "base_scan"),
        angle_min=0.0,
        angle_max=msg.float32(ANGLE_INCREMENT_RAD * (len(ranges_m) - 1)),
        angle_increment=msg.float32(ANGLE_INCREMENT_RAD),
        time_increment=0.0,
        scan_time=msg.float32(0.1),
        range_min=msg.float32(RANGE_MIN_M),
        range_max=msg.float32(RANGE_MAX_M),
        ranges=ranges_m,
        intensities=np.empty(0, np.float32),
    )


def fixed_frames() -> msg.TFMessage:
    """The robot's fixed frames: base_link on the wheels' axis, the lidar and the camera on it."""
    optical = np.array(
        [[0.0, 0.0, 1.0, 0.07], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.1], [0.0, 0.0, 0.0, 1.0]]
    )
    return msg.TFMessage(
        transforms=[
            msg.transform_stamped(0, "base_footprint", "base_link", IDENTITY.matrix(0.01)),
            msg.transform_stamped(0, "base_link", "base_scan", BASE_FROM_SCAN.matrix(0.14)),
            msg.transform_stamped(0, "base_link", "camera_rgb_optical_frame", optical),
        ]
    )


def estimate_error_m(driver: NodeDriver) -> float:
    """How far the pose is off that localisation has told last."""
    pose = msg.se2_from_pose(driver.of(AMCL_POSE)[-1].pose.pose)
    return pose.distance_m(driver.robot.map_from_base)


def ready(**options: object) -> NodeDriver:
    driver = NodeDriver(**options)  # type: ignore[arg-type]
    driver.learn()
    driver.run(0.5)
    assert driver.node.waiting_for() is None
    return driver


def stats(epoch: int, seed: int = 7, sim_time_s: float = 0.0) -> SimulationStats:
    return SimulationStats(
        world_hash=house().world.hash, sim_time_s=sim_time_s, iterations=0, step_size_s=1 / 240,
        seed=seed, epoch=epoch, renderer="none", state_hash="",
    )  # fmt: skip


def cancelled(driver: NodeDriver, stamp_ns: int | None = None) -> CancelGoalReply:
    """The answer to a request to cancel, in a step in which no time passes."""
    answers: list[CancelGoalReply] = []
    driver.inbox.ask(CANCEL_GOAL, CancelGoal(goal_stamp_ns=stamp_ns), answers.append)
    driver.node.step(driver.now_ns, driver.inbox, driver.outbox)
    (answer,) = answers
    return answer


def asked(driver: NodeDriver, query: Any, message: Any) -> Any:
    """The answer to a query."""
    answers: list[Any] = []
    driver.inbox.ask(query, message, answers.append)
    driver.node.step(driver.now_ns, driver.inbox, driver.outbox)
    (answer,) = answers
    return answer
