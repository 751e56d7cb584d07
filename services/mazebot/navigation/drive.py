"""Everything that drives the robot in one map, and its control period: the command that is wanted,
smoothed, and checked for collisions.
"""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.error_codes import ErrorCode
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
from mazebot.navigation.control.ray_evidence import Rays
from mazebot.navigation.control.safety.back_off import BackOff
from mazebot.navigation.control.safety.bumps import Bumps
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
from mazebot.navigation.control.yielding.giving_way import GivingWay, Scene
from mazebot.navigation.control.yielding.newcomers import Newcomers
from mazebot.navigation.costmap.layered_costmap import (
    LETHAL_OBSTACLE,
    GridFrame,
    LayeredCostmap,
)
from mazebot.navigation.costmap.zones import Zones
from mazebot.navigation.robot.hidden import (
    HiddenThings,
    depth_points,
    hidden_from,
    points_behind,
)
from mazebot.navigation.robot.measurements import Measurements
from mazebot.navigation.robot.robot_context import RobotContext

_LOG = logging.getLogger("navigation")

State = Literal["planning", "controlling", "recovering", "held"]
_NOWHERE = SE2(0.0, 0.0, 0.0)
_SEARCH_STANDS_NS = 3_000_000_000
"""A search that found no motion for so long finds none."""
_WEDGED_NS = 20_000_000_000
"""A robot whose wheels slip in one place for so long does not get away from there."""
_WEDGED_M = 0.25
"""What it seems to move meanwhile, until a slip is noticed, is less."""
_SLIPS_AGAIN_NS = 5_000_000_000
"""After longer, a slip is another one."""
_WEDGED = "stuck: the wheels turn, the robot does not move"


class DepthSources(NamedTuple):
    """Which of them have the depth camera's scan as an observation source."""

    local_costmap: bool = True
    global_costmap: bool = True
    collision_monitor: bool = True


class _Wedged(NamedTuple):
    """Slips of the wheels in one place."""

    since_ns: int
    last_ns: int
    map_from_base: SE2


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
    depth_sources: DepthSources
    """What the depth camera's scan is used for."""
    back_off: BackOff
    bumps: Bumps
    giving_way: GivingWay
    newcomers: Newcomers
    """What moves, where the pose in the map is not known."""
    hidden: HiddenThings = field(default_factory=HiddenThings)
    pace: BatchPace = field(default_factory=lambda: BatchPace(CONTROL_PERIOD_NS))
    known_m: Clearance | None = None
    """(rows, columns) distance from walls and from unknown cells of a map that grows; None: it does
    not.
    """
    monitor_published: tuple[Action, str] = (Action.DO_NOTHING, "")
    """Action and polygon of the monitor's state last published."""
    _search: SearchMotion | None = None
    _searched_ns: int = 0
    """When the search last had a motion."""
    _stuck_ns: int = 0
    """When it began to back off,"""
    _bumped: bool = False
    """and whether what has stopped it is seen."""
    stopped_at: list[tuple[float, float]] = field(default_factory=list)
    """Where it could not go on, x and y in the map, in order; without those where it was lost."""
    _slips: bool = False
    _wedged: _Wedged | None = None
    """Where the wheels slip again and again."""
    _commanded: Velocity = STOP
    """What was sent last."""
    _smoothed_ns: int = 0
    """When the velocity smoother was asked last."""

    def state(self) -> State:
        """What the task does in this step."""
        if self.navigator.hold in ("held", "paused"):
            return "held"
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

    def forget_places(self, map_from_odom: SE2 | None) -> None:
        """Forget what was seen in the map with a wrong pose: it is elsewhere. What is there is
        marked again when it is seen; what the camera may not see again, and what was touched, by
        the new pose, which None is where there is none.
        """
        self.tracker.clear()
        self.robot.forget_places()
        self.giving_way.reset()
        self.robot.costmap.clear()
        if map_from_odom is not None:
            self._mark_hidden(self.robot.costmap, map_from_odom)

    def forget_hidden(self) -> None:
        """Forget what the lidar does not show: a person says that it is gone."""
        self.hidden.clear()
        self.stopped_at.clear()
        self.robot.costmap.clear_hidden()
        self.robot.local_costmap.clear_hidden()

    def _forget_touched(self) -> None:
        self.hidden.forget_touched()
        self.stopped_at.clear()
        self.robot.costmap.clear_touched()
        self.robot.local_costmap.clear_touched()

    def follow_slip(self, odom_from_before: SE2) -> None:
        """Move what was seen around the robot along with odometry, whose wheels have slipped. What
        the lidar has marked is marked again by its next scan.
        """
        self.hidden.move(odom_from_before)
        self.robot.local_costmap.clear()
        self._mark_hidden(self.robot.local_costmap, _NOWHERE)

    def _mark_hidden(self, costmap: LayeredCostmap, map_from_odom: SE2) -> None:
        """Mark what the lidar does not show in a costmap of the frame `map`."""
        hidden = self.hidden
        for points_m, mark in (
            (hidden.low_m, costmap.mark_low), (hidden.touched_m, costmap.mark_touched)
        ):  # fmt: skip
            if len(points_m):
                mark(moved_points(points_m, map_from_odom, _NOWHERE))

    def see_markers(
        self, stamp_ns: int, seen: msg.Detection3DArray, base_from_camera: Array, odom: SE2
    ) -> int:
        """Keep the sightings of markers in a picture, by id; the likelier of two solutions.
        Returns how many have the id of another one.
        """
        found: dict[str, list[MarkerPose]] = {}
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
                found.setdefault(name, []).append(MarkerPose(stamp_ns, sighting, odom))
        self.robot.markers.update({name: tuple(same) for name, same in found.items()})
        return sum(len(same) - 1 for same in found.values())

    def take_scan(self, scan: Scan, measured: Measurements, epoch: int | None) -> None:
        """Update the costmaps and the moving obstacles by a scan, of which the measurements have
        the echoes.
        """
        assert measured.odom is not None
        assert measured.echoes is not None
        odom_from_base = measured.odom[1]
        self.robot.local_costmap.follow(odom_from_base, scan)
        time_s = scan.stamp_ns * 1e-9
        if self.giving_way.is_enabled:
            self.newcomers.take_scan(scan, odom_from_base)
        moving = moving_in_base(self.newcomers.moving(time_s), odom_from_base)
        if not measured.is_localized(epoch):
            self.tracker.clear()
            self.bumps.take(scan.stamp_ns, measured.echoes.base_points_m, moving)
            return
        map_from_base = measured.map_from_base()
        static = self.robot.costmap.static
        margin_m = measured.static_margin_m(self.static_margin_m)
        self.tracker.update(
            time_s, moved_points(measured.echoes.base_points_m, map_from_base, _NOWHERE),
            static.distance_m if self.known_m is None else self.known_m, static.frame, margin_m,
            Rays(time_s, map_from_base @ scan.base_from_scan, scan),
        )  # fmt: skip
        tracks = self.tracker.moving(time_s)
        self.robot.costmap.update(
            map_from_base @ scan.base_from_scan, scan, map_from_base=map_from_base,
            moving_m=np.array([(t.x_m, t.y_m, t.radius_m) for t in tracks]).reshape(-1, 3),
            static_margin_m=margin_m,
        )  # fmt: skip
        moving = np.concatenate([moving, moving_in_base(tracks, map_from_base)])
        self.bumps.take(scan.stamp_ns, measured.echoes.base_points_m, moving)
        if not measured.wheels_slip(epoch):
            self.hidden.cross(odom_from_base, self.robot.footprint)

    def take_depth_scan(
        self,
        scan: Scan,
        reaches_m: NDArray[np.float32],
        measured: Measurements,
        epoch: int | None,
    ) -> None:
        """Update the costmaps by what the depth camera sees and the lidar does not; `reaches_m` as
        for `points_behind`.
        """
        assert measured.odom is not None
        use, robot = self.depth_sources, self.robot
        odom_from_base = measured.odometry.at(scan.stamp_ns) or measured.odom[1]
        points_m, echo = depth_points(scan)
        lidar, odom_from_scanning = measured.scan_at(scan.stamp_ns) or (None, odom_from_base)
        marks = echo & hidden_from(points_m, odom_from_base, lidar, odom_from_scanning)
        behind_m = points_behind(scan, reaches_m, marks)
        if use.local_costmap:
            seen_m = np.concatenate([points_m[marks], behind_m])
            if len(seen_m):
                seen_m = moved_points(seen_m, odom_from_base, _NOWHERE)
            robot.local_costmap.update_seen_low(
                odom_from_base @ scan.base_from_scan, scan, marks, seen_m[marks.sum() :]
            )
            self.hidden.see(seen_m, robot.local_costmap)
        if use.global_costmap and measured.is_localized(epoch):
            assert measured.map_from_odom is not None
            map_from_base = measured.map_from_odom[1] @ odom_from_base
            if len(behind_m):
                behind_m = moved_points(behind_m, map_from_base, _NOWHERE)
            robot.costmap.update_seen_low(
                map_from_base @ scan.base_from_scan, scan, marks, behind_m,
                measured.static_margin_m(self.static_margin_m),
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
        navigator.held = bool(measured.emergency_stop)
        if navigator.held:
            # The robot stands: nothing of before is gone on with when it may move again.
            self._search = None
            self.smoother.reset()
            self.back_off.end()
            self.giving_way.reset()
            robot.controller_server.interrupt()
            return None, navigator.step(now_ns)
        request, teleop = navigator.request, robot.view.teleop
        searching = measured.wants_motion(epoch)
        if request is None and (teleop is not None or not (searching and measured.is_searching())):
            self._end_own_motion(measured, epoch)
            if teleop is not None:
                return teleop, None
            return self._out_of_the_way(now_ns, measured), None
        if measured.is_blind(now_ns, self.sensor_timeout_s):
            # What it would meet on the way of a ramp is not known.
            self.smoother.reset()
            return STOP, None
        by_person = (
            request is not None and request.action == "AssistedTeleop" and teleop is not None
        )
        stays = navigator.paused or by_person
        away = None if stays else self._out_of_the_way(now_ns, measured)
        navigator.gives_way = away is not None
        ended = navigator.step(now_ns)
        if by_person:
            self._end_own_motion(measured, epoch)
            return robot.command, ended
        if away is not None and ended is None:
            return away, None
        back = self._backs_off(now_ns, measured, epoch)
        if ended is None and self._is_wedged(now_ns, measured, epoch):
            ended = navigator.abort(now_ns, ErrorCode.FAILED_TO_MAKE_PROGRESS, _WEDGED)
            self._end_own_motion(measured, epoch)
            return None, ended
        if back is not None:
            return back, ended
        # A task that needs no pose has a command of its own.
        if searching and (request is None or navigator.hold == "lost"):
            return self._searches(now_ns, measured.odom[1]), ended
        self._search = None
        return robot.command, ended

    def _searches(self, now_ns: int, odom_from_base: SE2) -> Velocity:
        """The command of a robot that looks for where it is. Where it cannot move, one of the
        places where it could not go on is none.
        """
        robot = self.robot
        assert robot.view is not None
        if self._search is None:
            self._search = SearchMotion(self.search, look_around=bool(robot.docks))
            self._searched_ns = now_ns
        command = self._search.step(odom_from_base, robot.view.echoes_m, robot.time_to_collision)
        if command != STOP:
            self._searched_ns = now_ns
        elif now_ns - self._searched_ns > _SEARCH_STANDS_NS and len(self.hidden.touched_m):
            self._searched_ns = now_ns
            self._forget_touched()
            _LOG.warning(
                "the robot cannot move to find its pose: the places where something that no sensor "
                "shows stopped it are forgotten"
            )
        return command

    def _end_own_motion(self, measured: Measurements, epoch: int | None) -> None:
        """Neither search for the pose nor back off: a person drives, or there is no task."""
        self._search = None
        self._slips = measured.wheels_slip(epoch)
        self._wedged = None
        self.back_off.end()

    def _is_wedged(self, now_ns: int, measured: Measurements, epoch: int | None) -> bool:
        """Whether the wheels have slipped again and again, and the robot has stayed where it is."""
        if not (self._slips and measured.is_localized(epoch)):
            return False
        pose, before = measured.map_from_base(), self._wedged
        if (
            before is None
            or now_ns - before.last_ns > _SLIPS_AGAIN_NS
            or pose.distance_m(before.map_from_base) > _WEDGED_M
        ):
            before = _Wedged(now_ns, now_ns, pose)
        self._wedged = before._replace(last_ns=now_ns)
        return now_ns - before.since_ns > _WEDGED_NS

    def _backs_off(self, now_ns: int, measured: Measurements, epoch: int | None) -> Velocity | None:
        """The command of a robot that could not go on; None: it can."""
        assert measured.odom is not None
        server, before = self.robot.controller_server, self._slips
        self._slips = measured.wheels_slip(epoch)
        stuck_towards, server.stuck_towards = server.stuck_towards, None
        if not self.back_off.is_active:
            slips = self._slips and not before
            if slips:
                stuck_towards = self._commanded
            if stuck_towards is None or not self.back_off.begin(now_ns, stuck_towards, slips):
                return None
            self._stuck_ns, self._bumped = now_ns, False
        server.interrupt()
        command, touched_at = self.back_off.step(
            now_ns, measured.odom[1], measured.velocity, self.robot.time_to_collision
        )
        # As long as the robot stands at it, it is seen there.
        self._bumped = self._bumped or self.bumps.explain(self._stuck_ns, self.back_off.sign)
        if touched_at is not None:
            if self._bumped:
                _LOG.warning("something that the lidar sees has stopped the robot")
            else:
                self._remember_touched(touched_at, measured, epoch)
        self.robot.controlled = False
        return command

    def _remember_touched(
        self, odom_from_base: SE2, measured: Measurements, epoch: int | None
    ) -> None:
        """Mark where the robot could not go on as an obstacle, and tell."""
        local = self.robot.local_costmap

        def is_seen(place_m: Array) -> bool:
            at = odom_from_base @ SE2(float(place_m[0]), float(place_m[1]), 0.0)
            return local.master.cost_at(at.x_m, at.y_m) == LETHAL_OBSTACLE

        touched_m = self.back_off.touched_m(is_seen)
        in_odom_m = moved_points(touched_m, odom_from_base, _NOWHERE)
        self.hidden.touch(in_odom_m)
        local.mark_touched(in_odom_m)
        where = ""
        if measured.is_localized(epoch):
            assert measured.map_from_odom is not None
            map_from_base = measured.map_from_odom[1] @ odom_from_base
            in_map_m = moved_points(touched_m, map_from_base, _NOWHERE)
            self.robot.costmap.mark_touched(in_map_m)
            x_m, y_m = in_map_m[0].tolist()
            self.stopped_at.append((x_m, y_m))
            where = f" at ({x_m:.2f}, {y_m:.2f})"
        _LOG.warning(
            "the robot cannot go on%s: something that no sensor shows is remembered as an obstacle",
            where,
        )

    def _out_of_the_way(self, now_ns: int, measured: Measurements) -> Velocity | None:
        """The velocity that gets the robot out of the way of what comes; None: nothing does."""
        robot, view = self.robot, self.robot.view
        assert view is not None
        if measured.is_blind(now_ns, self.sensor_timeout_s):
            self.giving_way.reset()
            return None
        pose = view.map_from_base
        if pose is None:
            scene = Scene(
                view.odom_from_base, view.velocity, robot.local_costmap.master,
                self.newcomers.moving(now_ns * 1e-9),
            )  # fmt: skip
        else:
            path = robot.controller_server.followed if self.navigator.request else None
            scene = Scene(pose, view.velocity, robot.costmap.master, view.tracks, path)
        return self.giving_way.step(now_ns, scene, in_map=pose is not None)

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
            sources["scan"] = SourcePoints(measured.echoes.stamp_ns, view.scanned_m)
        if view.hidden and self.depth_sources.collision_monitor:
            # They stand where they were seen.
            sources["depth"] = SourcePoints(now_ns, view.hidden_m)
        self.monitor.enabled = self.robot.told.monitor_enabled
        pose = view.map_from_base
        # Without a pose, tracks in the map cannot be told from where the robot is.
        moving = NOTHING_MOVES if pose is None else moving_in_base(view.tracks, pose)
        watched = self.monitor.step(now_ns, command, measured.velocity, sources, moving)
        if self.robot.controlled:
            self.robot.controller_server.take_sent(watched.velocity, _let_through(command, watched))
        if watched.velocity != STOP:
            self._commanded = watched.velocity
        return watched


def _let_through(command: Velocity, watched: Watched) -> float:
    """The share of a command that the monitor's zones for slower driving leave; 1 where they stop
    the robot: then it gets nowhere.
    """
    slows = watched.state.action in (Action.SLOWDOWN, Action.LIMIT)
    if not slows or watched.velocity == STOP:
        return 1.0
    return max(map(abs, watched.velocity)) / max(map(abs, command))
