"""A NavigationContext over a unicycle in the house, with real planner, controller and costmap."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.scan import Scan
from mazebot.navigation.behavior.actions import Request, TaskResult
from mazebot.navigation.behavior.bt_navigator import BtNavigator, NavigatorParams
from mazebot.navigation.behavior.context import (
    BatteryCharge,
    ClearRequest,
    Dock,
    FollowRequest,
    MarkerPose,
    PathCheck,
    TrackingFeedback,
)
from mazebot.navigation.behavior.docking.docks import Docks
from mazebot.navigation.behavior.waypoints import WaypointTask
from mazebot.navigation.build import made_drive
from mazebot.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.costmap.layered_costmap import frame_of
from mazebot.navigation.planning.path import PlannedPath
from mazebot.navigation.robot.view import View
from tests.navigation.driving import START, Unicycle, box_segments
from tests.navigation.house_tour import (
    ANGLE_INCREMENT_RAD,
    BASE_FROM_SCAN,
    RANGE_MIN_M,
    as_ranges,
    cast,
    house,
    wall_segments,
)

PERIOD_S = CONTROL_PERIOD_NS * 1e-9
CONFIG = NavigationConfig()
Box = tuple[float, float, float]
NO_ECHOES: Array = np.empty((0, 2))


@dataclass
class SimulatedRobot:
    """The robot, its world and what a NavigationContext offers of them."""

    robot: Unicycle = field(default_factory=lambda: Unicycle(START))
    boxes: list[Box] = field(default_factory=list)
    """x, y and side of what stands in the house and not on the map."""
    localized: bool = True
    wanted: Velocity | None = None
    chosen: dict[str, str] = field(default_factory=dict)
    goal_update: SE2 | None = None
    docks: Docks = field(default_factory=Docks)
    sighting: MarkerPose | None = None
    charge: BatteryCharge | None = None
    clock_ns: int = 0

    def __post_init__(self) -> None:
        loaded = house()
        frame = frame_of(loaded.world.map_resolution_m, loaded.map_origin, loaded.map_cells)
        made = made_drive(CONFIG, frame, loaded.map_cells, np.random.default_rng(0))
        self.inner = made.robot
        self.costmap = self.inner.costmap
        self.plans = 0
        self.cleared: list[ClearRequest] = []
        self.monitor = True
        self.searches = 0
        self._see(0)

    def _see(self, now_ns: int) -> None:
        pose = self.robot.map_from_base
        self.inner.view = View(
            now_ns, pose if self.localized else None, self.odom_from_base(), self.robot.velocity,
            NO_ECHOES, (), self.wanted,
        )  # fmt: skip
        self.inner.docks = self.docks
        self.inner.local_costmap.move(self.odom_from_base())

    @property
    def command(self) -> Velocity:
        return self.inner.command or STOP

    @command.setter
    def command(self, velocity: Velocity) -> None:
        self.inner.command = velocity

    def look(self) -> None:
        """Let the costmap see walls and boxes from where the robot is."""
        pose = self.robot.map_from_base @ BASE_FROM_SCAN
        segments = np.concatenate([wall_segments(), *(box_segments(*box) for box in self.boxes)])
        ranges = as_ranges(cast(pose, segments), None)
        self.costmap.update(
            pose, Scan(ranges, 0.0, ANGLE_INCREMENT_RAD, RANGE_MIN_M, 3.5, SE2(0.0, 0.0, 0.0))
        )

    def pose(self) -> SE2:
        self._see(0)
        return self.inner.pose()

    def odom_from_base(self) -> SE2:
        return SE2(5.0, -3.0, 1.0) @ self.robot.map_from_base

    def velocity(self) -> Velocity:
        return self.robot.velocity

    def check_goals(self, goals: Sequence[SE2]) -> None:
        self._see(0)
        self.inner.check_goals(goals)

    def compute_path(self, start: SE2 | None, goals: Sequence[SE2], planner_id: str) -> PlannedPath:
        self.plans += 1
        self._see(0)
        return self.inner.compute_path(start, goals, planner_id)

    def collisions(self, path: PlannedPath, check: PathCheck) -> tuple[SE2, ...]:
        return self.inner.collisions(path, check)

    def cost_at(self, pose: SE2, use_footprint: bool) -> int:
        return self.inner.cost_at(pose, use_footprint)

    def follow(self, request: FollowRequest) -> None:
        self._see(0)
        self.inner.follow(request)

    def control(self, now_ns: int) -> TrackingFeedback:
        self._see(now_ns)
        return self.inner.control(now_ns)

    def drive(self, velocity: Velocity) -> None:
        self.inner.drive(velocity)

    def stop(self) -> None:
        self.inner.stop()

    def time_to_collision(self, velocity: Velocity) -> float:
        self._see(0)
        return self.inner.time_to_collision(velocity)

    def obstacle(self, velocity: Velocity, seconds: float) -> str:
        self._see(0)
        return self.inner.obstacle(velocity, seconds)

    def clear_costmap(self, request: ClearRequest) -> None:
        self.cleared.append(request)
        self._see(0)
        self.inner.clear_costmap(request)
        self.look()

    def selected(self, topic_name: str) -> str | None:
        return self.chosen.get(topic_name)

    def begin_goal(self) -> None:
        self.goal_update = None

    def updated_goal(self) -> SE2 | None:
        return self.goal_update

    def battery(self) -> BatteryCharge | None:
        return self.charge

    def teleop(self) -> Velocity | None:
        return self.wanted

    def sightings(self, marker_id: str) -> tuple[MarkerPose, ...]:
        return () if self.sighting is None else (self.sighting,)

    def pose_std(self) -> tuple[float, float]:
        return 0.02, 0.01

    def dock(self, dock_id: str) -> Dock:
        self._see(0)
        return self.inner.dock(dock_id)

    def dock_at(self, map_from_dock: SE2) -> Dock:
        self._see(0)
        return self.inner.dock_at(map_from_dock)

    def time_ns(self) -> int:
        return self.clock_ns

    def is_localized(self) -> bool:
        return self.localized

    def reinitialize_global_localization(self) -> None:
        self.searches += 1

    def toggle_collision_monitor(self, enable: bool) -> None:
        self.monitor = enable


@dataclass
class Drive:
    """A navigator that is stepped with its robot."""

    robot: SimulatedRobot = field(default_factory=SimulatedRobot)
    params: NavigatorParams = field(default_factory=NavigatorParams)
    waypoint_task: WaypointTask | None = None
    now_ns: int = 0
    results: list[TaskResult] = field(default_factory=list)
    commands: list[Velocity] = field(default_factory=list)
    poses: list[SE2] = field(default_factory=list)
    each_period: Callable[[int], None] = lambda _: None

    def __post_init__(self) -> None:
        self.navigator = BtNavigator(self.params, self.robot, self.waypoint_task)

    @property
    def now_s(self) -> float:
        return self.now_ns * 1e-9

    def step(self) -> None:
        """One control period."""
        self.each_period(self.now_ns)
        if self.robot.boxes and self.now_ns % (2 * CONTROL_PERIOD_NS) == 0:
            self.robot.look()
        self.robot.command, self.robot.clock_ns = STOP, self.now_ns
        result = self.navigator.step(self.now_ns)
        if result is not None:
            self.results.append(result)
        self.commands.append(self.robot.command)
        self.poses.append(self.robot.robot.map_from_base)
        self.robot.robot.drive(self.robot.command, PERIOD_S)
        self.now_ns += CONTROL_PERIOD_NS

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            self.step()

    def until_done(
        self, request: Request, limit_s: float = 90.0, each: Callable[[], None] = lambda: None
    ) -> TaskResult:
        """Start a request and step until it ends, with something done after each step."""
        before = self.navigator.start(self.now_ns, request)
        if before is not None:
            self.results.append(before)
        return self.finish(limit_s, each)

    def finish(self, limit_s: float = 90.0, each: Callable[[], None] = lambda: None) -> TaskResult:
        count, end_ns = len(self.results), self.now_ns + int(limit_s * 1e9)
        while self.now_ns < end_ns:
            self.step()
            each()
            if len(self.results) > count:
                return self.results[-1]
        raise AssertionError(f"no result after {limit_s} s at {self.robot.robot.map_from_base}")

    def nearest_m(self, box: Box) -> float:
        """Least distance of the robot's centre to a box."""
        off = [
            math.hypot(max(abs(p.x_m - box[0]) - box[2] / 2, 0.0),
                       max(abs(p.y_m - box[1]) - box[2] / 2, 0.0))
            for p in self.poses
        ]  # fmt: skip
        return min(off)
