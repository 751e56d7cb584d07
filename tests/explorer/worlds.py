"""Small floor plans, and a stage on which the explorer's node drives a robot without physics."""

from __future__ import annotations

from typing import Any

import numpy as np

from mazebot.bench.slam.exploration_kernels import reveal
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.common.messages.slam_documents import ExplorationStatus
from mazebot.common.messages.topics import Topic
from mazebot.common.node.node import Envelope, Inbox, Outbox
from mazebot.common.world.costmap import Cells
from mazebot.explorer.config import STEP_PERIOD_NS, ExplorerConfig
from mazebot.explorer.floor import floor_from
from mazebot.explorer.node import ExplorerNode
from mazebot.explorer.paths import search, way
from tests.common.samples import WORLD

RESOLUTION_M = 0.05
STEP_M = 0.1
RANGE_M = 3.5
SLAM_WORLD = WORLD.model_copy(update={"slam": True, "explore": True})
ACTIVE = doc.NavigationStatus(localization_active=True, navigation_active=True)


def plan(*rows: str) -> Cells:
    """Cells of a plan, 0.5 m a character, the first row at the greatest y: # wall, ? unknown."""
    values = {"#": 100, ".": 0, "?": -1}
    small = np.array([[values[one] for one in row] for row in rows[::-1]], np.int8)
    return np.repeat(np.repeat(small, 10, 0), 10, 1)


class Stage:
    """The explorer's node, and the hand that plays navigation, mapping and the robot.

    The map's corner is at (0, 0); the robot begins at `home`.
    """

    def __init__(
        self, truth: Cells, home: SE2, config: ExplorerConfig, world: doc.World = SLAM_WORLD
    ) -> None:
        self.node = ExplorerNode(config)
        self.inbox = Inbox(self.node)
        self.outbox = Outbox(self.node, lambda topic, message, _: self._keep(topic, message))
        self.truth, self.robot = truth, home
        self.known = np.full(truth.shape, -1, np.int8)
        self.goal: tuple[int, SE2] | None = None
        self.goals: list[tuple[int, SE2]] = []
        self.statuses: list[ExplorationStatus] = []
        self.frontiers: list[msg.MarkerArray] = []
        self.now_ns = 0
        self.driven_m = 0.0
        self.refuses: Any = None
        """Called with each goal; an error code of a refused one, else 0."""
        self.stuck = False
        self.range_m = RANGE_M
        """How far the lidar really sees."""
        self.localized = True
        self.navigation: dict[str, Any] = {}
        """Other fields of navigation's status."""
        self._sequence = 0
        start = doc.Planar(x_m=home.x_m, y_m=home.y_m, yaw_rad=home.yaw_rad)
        self.world = world.model_copy(update={"start": start})
        self.say(table.WORLD, self.world)

    @property
    def status(self) -> ExplorationStatus:
        return self.statuses[-1]

    def _keep(self, topic: Topic[Any], message: Any) -> None:
        if topic is table.GOAL_POSE:
            goal = msg.ns_from_time(message.header.stamp), msg.se2_from_pose(message.pose)
            self.goals.append(goal)
            code = self.refuses(goal[1]) if self.refuses is not None else 0
            if code:
                self.end(goal, code)
                return
            if self.goal is not None:
                self.end(self.goal, 4)
            self.goal = goal
        elif topic is table.EXPLORATION_STATUS:
            self.statuses.append(message)
            own = self.goal
            if message.state == "paused" and own and own[0] == message.goal_stamp_ns:
                self.goal = None
                self.end(own, 9012)
        elif topic is table.FRONTIERS:
            self.frontiers.append(message)

    def say(self, topic: Topic[Any], message: object) -> None:
        envelope = Envelope("x", self._sequence, self.now_ns, WORLD.hash)
        self.inbox.deliver(topic, message, envelope)
        self._sequence += 1

    def end(self, goal: tuple[int, SE2], code: int) -> None:
        self.say(
            table.NAVIGATION_RESULT,
            doc.NavigationResult(
                goal=doc.Planar(x_m=goal[1].x_m, y_m=goal[1].y_m, yaw_rad=goal[1].yaw_rad),
                goal_stamp_ns=goal[0], error_code=code, error_msg="no way" if code else "",
                start_time_s=0.0, end_time_s=1.0,
            ),
        )  # fmt: skip

    def step(self) -> None:
        """0.1 s: the lidar sees, the map comes once a second, the robot drives 10 cm."""
        self.now_ns += STEP_PERIOD_NS
        row, column = self.robot.y_m / RESOLUTION_M - 0.5, self.robot.x_m / RESOLUTION_M - 0.5
        reveal(self.truth, row, column, self.range_m / RESOLUTION_M, 360, self.known)
        if self.now_ns % 1_000_000_000 == STEP_PERIOD_NS:
            origin = SE2(0.0, 0.0, 0.0)
            grid = msg.occupancy_grid(self.now_ns, RESOLUTION_M, origin, self.known.copy())
            self.say(table.MAP, grid)
        if self.now_ns % 500_000_000 == 0:
            goal = None
            if self.goal is not None:
                x_m, y_m, yaw_rad = self.goal[1]
                goal = doc.Planar(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)
            changed = {"goal": goal, "navigation_active": self.localized, **self.navigation}
            self.say(table.NAVIGATION_STATUS, ACTIVE.model_copy(update=changed))
        pose = msg.PoseWithCovariance(pose=msg.pose_from_se2(self.robot), covariance=np.zeros(36))
        header = msg.header(self.now_ns, "map")
        self.say(table.AMCL_POSE, msg.PoseWithCovarianceStamped(header=header, pose=pose))
        self._drive()
        self.outbox.now_ns = self.now_ns
        self.node.step(self.now_ns, self.inbox, self.outbox)

    def _drive(self) -> None:
        if self.goal is None or self.stuck:
            return
        origin = SE2(0.0, 0.0, 0.0)
        floor = floor_from(self.known, RESOLUTION_M, origin, self.robot, 0.24, 0.5, 0.153)
        start = floor.coarse_index(self.robot.x_m, self.robot.y_m)
        end = floor.coarse_index(self.goal[1].x_m, self.goal[1].y_m)
        assert start is not None
        assert end is not None
        cells = way(search(floor.prices, start)[1], end)
        if len(cells) == 1:
            goal, self.goal = self.goal, None
            self.end(goal, 0)
            return
        row, column = divmod(cells[1], floor.prices.shape[1])
        x_m, y_m = floor.center(row * floor.factor + 0.5, column * floor.factor + 0.5)
        away_m = self.robot.distance_m(SE2(x_m, y_m, 0.0))
        share = min(STEP_M / away_m, 1.0)
        to = SE2(
            self.robot.x_m + share * (x_m - self.robot.x_m),
            self.robot.y_m + share * (y_m - self.robot.y_m), 0.0,
        )  # fmt: skip
        self.driven_m += to.distance_m(self.robot)
        self.robot = to

    def run(self, most_s: float, *states: str) -> None:
        """Until the exploration is in one of the states."""
        for _ in range(int(most_s * 10)):
            self.step()
            if self.statuses and self.status.state in states:
                return
        raise AssertionError(f"still {self.status if self.statuses else 'silent'}")
