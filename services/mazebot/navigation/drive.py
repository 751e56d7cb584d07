"""Everything that drives the robot in one map, and its control period: the command that is wanted,
smoothed, and checked for collisions.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.scan import Scan
from mazebot.common.world.costmap import Cells, Clearance
from mazebot.common.world.grids import distance_cells
from mazebot.navigation.behavior.actions import TaskResult
from mazebot.navigation.behavior.bt_navigator import BtNavigator
from mazebot.navigation.behavior.context import MarkerPose, planar_marker
from mazebot.navigation.behavior.motions.search_motion import SearchMotion, SearchMotionParams
from mazebot.navigation.config import CONTROL_PERIOD_NS
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.mppi.batch_pace import BatchPace
from mazebot.navigation.control.safety.collision_monitor import (
    NOTHING_MOVES,
    Action,
    CollisionMonitor,
    SourcePoints,
    Watched,
    moved_points,
    moving_in_base,
)
from mazebot.navigation.control.safety.velocity_smoother import VelocitySmoother
from mazebot.navigation.control.tracking import ObstacleTracker
from mazebot.navigation.costmap.layered_costmap import GridFrame
from mazebot.navigation.costmap.zones import Zones
from mazebot.navigation.robot.measurements import Measurements
from mazebot.navigation.robot.robot_context import RobotContext

State = Literal["planning", "controlling", "recovering"]
_NOWHERE = SE2(0.0, 0.0, 0.0)


@dataclass
class Drive:
    """Everything that drives in one map."""

    robot: RobotContext
    navigator: BtNavigator
    tracker: ObstacleTracker
    smoother: VelocitySmoother
    monitor: CollisionMonitor
    search: SearchMotionParams
    cells: Cells
    sensor_timeout_s: float
    """The robot stops if odometry or the scan is older than this."""
    static_margin_m: float
    """An echo this near to a wall of the map is the wall's; less where the pose is known well."""
    pace: BatchPace = field(default_factory=lambda: BatchPace(CONTROL_PERIOD_NS))
    known_m: Clearance | None = None
    """(rows, columns) distance from walls and from unknown cells of a map that grows; None: it does
    not.
    """
    monitor_published: tuple[Action, str] = (Action.DO_NOTHING, "")
    """Action and polygon of the monitor's state last published."""
    _search: SearchMotion | None = None
    _smoothed_ns: int = 0
    """When the velocity smoother was asked last."""

    def state(self) -> State:
        """What the task does in this step."""
        if self.robot.controlled:
            return "controlling"
        return "planning" if self.robot.command is None else "recovering"

    def take_map(
        self, frame: GridFrame, cells: Cells, margin_m: float, zones: Zones | None
    ) -> None:
        """Drive on in a map that has grown or changed."""
        self.robot.take_map(frame, cells, margin_m, zones)
        self.cells = cells
        # What stands where the map shows nothing yet is no obstacle that moves.
        unknown_m = distance_cells(np.asarray(cells < 0)) * frame.resolution_m
        static = self.robot.costmap.static
        self.known_m = np.minimum(static.distance_m, unknown_m).astype(np.float32)

    def forget_places(self) -> None:
        """Forget what was seen in the map with a wrong pose: it is elsewhere. What is there is
        marked again when it is seen.
        """
        self.tracker.clear()
        self.robot.costmap.clear()

    def see_markers(
        self, stamp_ns: int, seen: msg.Detection3DArray, base_from_camera: Array, odom: SE2
    ) -> None:
        """Keep sightings of markers, by id; the likelier of two solutions."""
        for detection in seen.detections:
            if not detection.results:
                continue
            best = max(detection.results, key=lambda result: float(result.hypothesis.score))
            name = best.hypothesis.class_id
            camera_from_marker = msg.matrix_from_pose(best.pose.pose)
            base_from_marker = portable.product(base_from_camera, camera_from_marker)
            with suppress(ValueError):
                # One that lies flat is no dock.
                sighting = planar_marker(base_from_marker)
                self.robot.markers[name] = MarkerPose(stamp_ns, sighting, odom)

    def take_scan(self, scan: Scan, measured: Measurements, epoch: int | None) -> None:
        """Update the costmaps and the moving obstacles by a scan, of which the measurements have
        the echoes.
        """
        assert measured.odom is not None
        assert measured.echoes is not None
        odom_from_base = measured.odom[1]
        self.robot.local_costmap.move(odom_from_base)
        self.robot.local_costmap.update(
            odom_from_base @ scan.base_from_scan, scan, map_from_base=odom_from_base
        )
        if not measured.is_localized(epoch):
            self.tracker.clear()
            return
        map_from_base = measured.map_from_base()
        static = self.robot.costmap.static
        margin_m = measured.static_margin_m(self.static_margin_m)
        time_s = scan.stamp_ns * 1e-9
        self.tracker.update(
            time_s, moved_points(measured.echoes.base_points_m, map_from_base, _NOWHERE),
            static.distance_m if self.known_m is None else self.known_m, static.frame, margin_m,
        )  # fmt: skip
        moving = [(t.x_m, t.y_m, t.radius_m) for t in self.tracker.moving(time_s)]
        self.robot.costmap.update(
            map_from_base @ scan.base_from_scan, scan, map_from_base=map_from_base,
            moving_m=np.array(moving, np.float64).reshape(-1, 3), static_margin_m=margin_m,
        )  # fmt: skip

    def wanted(
        self, now_ns: int, measured: Measurements, epoch: int | None
    ) -> tuple[Velocity | None, TaskResult | None]:
        """What behaviors or teleoperation want in this period, None for nothing; and how the task
        ended, where it did.
        """
        assert measured.odom is not None
        robot, navigator = self.robot, self.navigator
        assert robot.view is not None
        searching = measured.wants_motion(epoch)
        if navigator.request is None and not (searching and measured.is_searching()):
            self._search = None
            return robot.view.teleop, None
        if now_ns - measured.oldest_ns(now_ns) > self.sensor_timeout_s * 1e9:
            # What it would meet on the way of a ramp is not known.
            self.smoother.reset()
            return STOP, None
        ended = navigator.step(now_ns)
        if searching and robot.view.map_from_base is None and navigator.hold != "paused":
            if self._search is None:
                self._search = SearchMotion(self.search, look_around=bool(robot.docks))
            command = self._search.step(
                measured.odom[1], robot.view.echoes_m, robot.time_to_collision
            )
            return command, ended
        self._search = None
        return robot.command, ended

    def keep_pace(self, now_ns: int) -> None:
        """Let the controller compute less after control periods were missed."""
        if self.robot.controlled:
            self.pace.step(now_ns, self.robot.controller_server.controller)
        else:
            self.pace.rest()

    def smoothed(
        self, now_ns: int, command: Velocity | None, measured: Velocity
    ) -> Velocity | None:
        """What the velocity smoother makes of a command; where there is none, a ramp to a stop."""
        if command is None and self.smoother.last == STOP:
            return None
        elapsed_s = (now_ns - self._smoothed_ns) * 1e-9
        # A late step is followed by one in time: less than a period after it.
        if not 0.0 < elapsed_s < CONTROL_PERIOD_NS * 1e-9:
            elapsed_s = CONTROL_PERIOD_NS * 1e-9
        self._smoothed_ns = now_ns
        self.smoother.take(now_ns, STOP if command is None else command)
        return self.smoother.step(now_ns, elapsed_s, measured)

    def monitored(self, now_ns: int, command: Velocity, measured: Measurements) -> Watched:
        """The command that may be sent, by the collision monitor."""
        view = self.robot.view
        assert view is not None
        sources = {}
        if measured.echoes is not None:
            sources["scan"] = SourcePoints(measured.echoes.stamp_ns, view.echoes_m)
        self.monitor.enabled = self.robot.monitor_enabled
        pose = view.map_from_base
        # Without a pose, tracks in the map cannot be told from where the robot is.
        moving = NOTHING_MOVES if pose is None else moving_in_base(view.tracks, pose)
        return self.monitor.step(now_ns, command, measured.velocity, sources, moving)
