"""The node: pose and sensors in, plan and velocity out. The only file here that uses topics."""

from __future__ import annotations

import logging
from typing import ClassVar, NamedTuple

import numpy as np

from services.common.config import ConfigError
from services.common.error_codes import ErrorCode
from services.common.frames import (
    BASE_FOOTPRINT_FRAME,
    CAMERA_OPTICAL_FRAME,
    MAP_FRAME,
    ODOM_FRAME,
    SCAN_FRAME,
    SE2,
    Array,
    pose_matrix,
    se2_from_matrix,
)
from services.common.node import action_documents as act
from services.common.node import messages as msg
from services.common.node.documents import (
    CancelGoalReply,
    Entities,
    LocalizationStatus,
    NavigationStatus,
    World,
)
from services.common.node.frame_tree import FrameTree
from services.common.node.node import Inbox, Node, Outbox, random_generator
from services.common.node.simulation_watch import SimulationWatch
from services.common.node.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    CANCEL_GOAL,
    CLEAR_COSTMAP,
    CMD_VEL,
    CMD_VEL_TELEOP,
    COLLISION_MONITOR_STATE,
    COMPUTE_PATH,
    DETECTIONS,
    ENTITIES,
    GLOBAL_COSTMAP,
    GOAL_POSE,
    LOCAL_COSTMAP,
    LOCALIZATION_STATUS,
    MAP,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    ODOM,
    PAUSE_GOAL,
    PLAN,
    SCAN,
    SEND_GOAL,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    TOGGLE_COLLISION_MONITOR,
    WORLD,
)
from services.common.world.costmap import MAX_MAP_CELLS, straightened
from services.navigation.behavior.actions import NavigateToPose, TaskFeedback, TaskResult
from services.navigation.behavior.bt_navigator import BtNavigator
from services.navigation.behavior.search_motion import SearchMotion
from services.navigation.build import Drive, made_drive
from services.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from services.navigation.control.collision import STOP, Velocity
from services.navigation.control.collision_monitor import MonitorState, SourcePoints, moved_points
from services.navigation.costmap.layered_costmap import LayeredCostmap, frame_of, scan_points
from services.navigation.costmap.obstacle_layer import denoised_ranges
from services.navigation.errors import NavigationError
from services.navigation.kernels import compile_kernels
from services.navigation.messages import (
    clear_requests,
    costmap_message,
    feedback_document,
    goal_result,
    marker_pose,
    monitor_document,
    path_message,
    path_poses,
    planar_document,
    request_of,
    result_action,
    result_document,
    twist_message,
)
from services.navigation.robot import View

_LOG = logging.getLogger("navigation")

_STATUS_PERIOD_NS = 500_000_000
_FEEDBACK_PERIOD_NS = 200_000_000
_COSTMAP_PERIOD_NS = 1_000_000_000
_LOCAL_COSTMAP_PERIOD_NS = 500_000_000
_TELEOP_NS = 300_000_000
"""A command of a person counts for this long."""
_MOST_GOALS_TRIED = 4
"""Of goals that arrive together: planning a path to each takes milliseconds."""
_NOWHERE = SE2(0.0, 0.0, 0.0)


class _Echoes(NamedTuple):
    """The newest scan's echoes, with the odometry at that scan."""

    stamp_ns: int
    odom_from_base: SE2
    base_points_m: Array


class _Current(NamedTuple):
    """The goal of the task that runs."""

    goal_id: str
    stamp_ns: int | None
    """Of its message on /goal_pose; None: it came as an action."""


class NavigationNode(Node):
    """Drives the robot to goals in the map."""

    name: ClassVar[str] = "navigation"
    _config: NavigationConfig
    period_ns: ClassVar[int | None] = CONTROL_PERIOD_NS

    def __init__(self, config: NavigationConfig) -> None:
        """Raises ConfigError where a controller, planner or tree that is named cannot be used."""
        self._config = config
        self._watch = SimulationWatch(config.seed)
        self._world: World | None = None
        self._map: msg.OccupancyGrid | None = None
        self._entities: Entities | None = None
        self._static_frames = FrameTree()
        self._base_from_scan: SE2 | None = None
        self._base_from_camera: Array | None = None
        self._drive: Drive | None = None
        self._localization: LocalizationStatus | None = None
        self._map_from_odom: tuple[int, SE2] | None = None
        """The newest correction of odometry, with its stamp."""
        self._odom: tuple[int, SE2] | None = None
        self._velocity = STOP
        self._echoes: _Echoes | None = None
        self._teleop: tuple[int, Velocity] | None = None
        self._search: SearchMotion | None = None
        self._now_ns = 0
        self._moving = False
        """Whether the last command published was not a stop."""
        self._was_active = False
        self._status: tuple[bool, bool, str, SE2 | None, int] | None = None
        """The status last published, without the distance remaining."""
        self._monitor_state: MonitorState | None = None
        self._due_ns: dict[str, int] = {}
        self._costmap_shown = -1
        self._current: _Current | None = None
        self._results: list[tuple[_Current, TaskResult]] = []
        compile_kernels(config)

    def waiting_for(self) -> str | None:
        """A phrase for the first missing input that keeps the robot from driving."""
        if self._world is None:
            return "the world"
        if self._drive is None:
            return "the map"
        if self._base_from_scan is None:
            return "the robot's fixed frames"
        if self._odom is None:
            return "odometry"
        if self._echoes is None:
            return "a scan"
        if self._map_from_odom is None:
            return "the transform from map to odom"
        if not self._localized():
            return "localisation to converge"
        return None

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Process sensor messages, run one control period, publish commands and status."""
        if self._watch.restarted(now_ns, inbox.new(SIMULATION_STATS)):
            _LOG.info("the simulation began anew: so does navigation")
            self._begin_anew(now_ns, ErrorCode.WORLD_RESTARTED, "the simulation began anew")
        # A query also wakes the node while time is stopped: that is no control period.
        passes = now_ns != self._now_ns
        self._now_ns = now_ns
        self._learn_world(now_ns, inbox)
        self._take_pose(inbox)
        self._take_scans(inbox)
        self._take_detections(inbox)
        for twist in inbox.new(CMD_VEL_TELEOP):
            wanted = Velocity(twist.twist.linear.x, twist.twist.angular.z)
            self._teleop = (now_ns, wanted)
        self._look(now_ns)
        self._take_goals(now_ns, inbox)
        self._answer(now_ns, inbox)
        self._control(now_ns, outbox, passes)
        self._tell(now_ns, outbox)

    def _learn_world(self, now_ns: int, inbox: Inbox) -> None:
        """Process latched topics. The same world or map, received again, changes nothing."""
        world = inbox.latest(WORLD)
        if world is not None and (self._world is None or world.hash != self._world.hash):
            self._world = world
            self.world_hash = world.hash
            self._begin_anew(now_ns, ErrorCode.WORLD_RESTARTED, f"the world is now {world.name}")
        grid = inbox.latest(MAP)
        if grid is not None and not msg.same_grid(grid, self._map):
            self._take_map(now_ns, grid, inbox)
        entities = inbox.latest(ENTITIES)
        if entities is not None:
            self._entities = entities
            self._know_docks()
        for tree in inbox.new(TF_STATIC):
            problem = self._static_frames.add(tree)
            if problem:
                inbox.reject(TF_STATIC, problem)
                continue
            scan = self._static_frames.chain(BASE_FOOTPRINT_FRAME, SCAN_FRAME)
            self._base_from_scan = None if scan is None else se2_from_matrix(scan)
            self._base_from_camera = self._static_frames.chain(
                BASE_FOOTPRINT_FRAME, CAMERA_OPTICAL_FRAME
            )

    def _take_map(self, now_ns: int, grid: msg.OccupancyGrid, inbox: Inbox) -> None:
        origin = msg.se2_from_pose(grid.info.origin)
        try:
            if len(grid.data) > MAX_MAP_CELLS:
                raise ValueError(f"{len(grid.data)} cells: must be at most {MAX_MAP_CELLS}")
            cells = np.array(msg.cells_from_grid(grid), np.int8)
            # Planning needs the rows along the axes of the map's frame.
            origin, cells = straightened(grid.info.resolution, origin, cells)
            frame = frame_of(grid.info.resolution, origin, cells)
            drive = made_drive(
                self._config, frame, cells, random_generator(self._watch.seed, "navigation/control")
            )
        except (ValueError, ConfigError) as error:
            inbox.reject(MAP, "not a map to drive in")
            _LOG.error("map: %s", error)
            return
        self._abort(now_ns, ErrorCode.WORLD_RESTARTED, "the map is another one")
        self._map, self._drive = grid, drive
        self._know_docks()
        _LOG.info(
            "Received a %d X %d map @ %.3f m/pix",
            frame.columns, frame.rows, frame.resolution_m,
        )  # fmt: skip

    def _know_docks(self) -> None:
        """Each marker of the world is a dock, by its id and by its name."""
        if self._drive is None or self._entities is None or self._world is None:
            return
        docks = self._drive.robot.docks
        docks.clear()
        if self._entities.world_hash != self._world.hash:
            return
        marker_from_dock = self._drive.docking.marker_from_dock
        for entity in self._entities.markers:
            docked = marker_pose(pose_matrix(entity)) @ marker_from_dock
            docks[entity.name] = docks[str(entity.marker_id)] = docked

    def _begin_anew(self, now_ns: int, code: ErrorCode, why: str) -> None:
        """Abort the task, and drop all measurements and what was made of them."""
        self._abort(now_ns, code, why)
        if self._drive is None:
            return
        cells, frame = self._drive.cells, self._drive.robot.costmap.frame
        random = random_generator(self._watch.seed, "navigation/control")
        self._drive = made_drive(self._config, frame, cells, random)
        self._know_docks()

    def _abort(self, now_ns: int, code: ErrorCode, why: str) -> None:
        """Abort the task and drop all measurements."""
        self._odom = self._echoes = self._map_from_odom = None
        self._teleop = self._search = None
        self._velocity = STOP
        self._was_active = False
        self._due_ns.clear()
        if self._drive is not None:
            self._ended(self._drive.navigator.abort(max(now_ns, self._now_ns), code, why))

    def _take_pose(self, inbox: Inbox) -> None:
        """Read odometry, its correction, and whether that can be trusted."""
        status = inbox.latest(LOCALIZATION_STATUS)
        if status is not None:
            self._localization = status
        for odom in inbox.new(ODOM):
            stamp_ns = msg.ns_from_time(odom.header.stamp)
            if self._watch.is_of_this_run(stamp_ns, ODOM, inbox):
                self._odom = (stamp_ns, msg.se2_from_pose(odom.pose.pose))
                twist = odom.twist.twist
                self._velocity = Velocity(twist.linear.x, twist.angular.z)
        for tree in inbox.new(TF):
            for entry in tree.transforms:
                if (entry.header.frame_id, entry.child_frame_id) != (MAP_FRAME, ODOM_FRAME):
                    continue
                stamp_ns = msg.ns_from_time(entry.header.stamp)
                if self._watch.is_of_this_run(stamp_ns, TF, inbox):
                    matrix = msg.matrix_from_transform(entry.transform)
                    self._map_from_odom = (stamp_ns, se2_from_matrix(matrix))

    def _take_scans(self, inbox: Inbox) -> None:
        """Read the scans, oldest first: the costmaps, the moving obstacles and the echoes."""
        for scan in inbox.new(SCAN):
            stamp_ns = msg.ns_from_time(scan.header.stamp)
            if self._watch.is_of_this_run(stamp_ns, SCAN, inbox):
                self._take_scan(stamp_ns, scan)

    def _take_scan(self, stamp_ns: int, scan: msg.LaserScan) -> None:
        base_from_scan = self._base_from_scan
        if self._odom is None or base_from_scan is None:
            return
        odom_from_base = self._odom[1]
        points_m = scan_points(
            base_from_scan, denoised_ranges(scan.ranges), scan.angle_min, scan.angle_increment,
            scan.range_min, scan.range_max,
        )  # fmt: skip
        self._echoes = _Echoes(stamp_ns, odom_from_base, points_m)
        drive = self._drive
        if drive is None:
            return
        drive.robot.local_costmap.move(odom_from_base)
        drive.robot.local_costmap.update(
            odom_from_base @ base_from_scan, scan.ranges, scan.angle_min, scan.angle_increment,
            scan.range_min, now_ns=stamp_ns, map_from_base=odom_from_base,
        )  # fmt: skip
        if not self._localized():
            return
        map_from_base = self._map_from_base()
        static = drive.robot.costmap.static
        drive.tracker.update(
            stamp_ns * 1e-9, moved_points(points_m, map_from_base, _NOWHERE),
            static.distance_m, static.frame,
        )  # fmt: skip
        moving = [(t.x_m, t.y_m, t.radius_m) for t in drive.tracker.moving(stamp_ns * 1e-9)]
        drive.robot.costmap.update(
            map_from_base @ base_from_scan, scan.ranges, scan.angle_min, scan.angle_increment,
            scan.range_min, now_ns=stamp_ns, map_from_base=map_from_base,
            moving_m=np.array(moving, np.float64).reshape(-1, 3),
        )  # fmt: skip

    def _take_detections(self, inbox: Inbox) -> None:
        """Keep the newest sighting of each marker, for docking."""
        for seen in inbox.new(DETECTIONS):
            stamp_ns = msg.ns_from_time(seen.header.stamp)
            camera, drive = self._base_from_camera, self._drive
            if camera is None or drive is None or self._odom is None:
                continue
            if not self._watch.is_of_this_run(stamp_ns, DETECTIONS, inbox):
                continue
            drive.see_markers(stamp_ns, seen, camera, self._odom[1])

    def _map_from_base(self) -> SE2:
        """The robot's pose, once odometry and its correction are known."""
        assert self._map_from_odom is not None
        assert self._odom is not None
        return self._map_from_odom[1] @ self._odom[1]

    def _localized(self) -> bool:
        """Whether the pose is known and can be trusted."""
        status = self._localization
        return (
            status is not None
            and status.state == "localized"
            and status.epoch == self._watch.epoch
            and self._map_from_odom is not None
            and self._odom is not None
            and self._echoes is not None
        )

    def _look(self, now_ns: int) -> None:
        """Give the robot its view of this step."""
        if self._drive is None or self._odom is None:
            return
        echoes = self._echoes
        odom_from_base = self._odom[1]
        teleop = self._teleop
        self._drive.robot.begin(
            View(
                now_ns,
                self._map_from_base() if self._localized() else None,
                odom_from_base,
                self._velocity,
                np.empty((0, 2)) if echoes is None else self._echoes_now(echoes),
                self._drive.tracker.moving(now_ns * 1e-9),
                teleop[1] if teleop and now_ns - teleop[0] <= _TELEOP_NS else None,
            )
        )

    def _echoes_now(self, echoes: _Echoes) -> Array:
        """(n, 2) the newest echoes in the current base frame."""
        assert self._odom is not None
        return moved_points(echoes.base_points_m, echoes.odom_from_base, self._odom[1])

    def _take_goals(self, now_ns: int, inbox: Inbox) -> None:
        """Accept the newest valid goal; those before it would be preempted at once."""
        tries, taken = _MOST_GOALS_TRIED, False
        refused: list[tuple[_Current, TaskResult]] = []
        for message in reversed(inbox.new(GOAL_POSE)):
            stamp_ns = msg.ns_from_time(message.header.stamp)
            request = NavigateToPose(msg.se2_from_pose(message.pose))
            current = _Current("", stamp_ns)
            if taken or not tries:
                preempted = (ErrorCode.PREEMPTED, "preempted by a new goal")
                refused.append((current, goal_result(request, now_ns, *preempted)))
                continue
            tries -= 1
            try:
                if message.header.frame_id not in ("", MAP_FRAME):
                    raise NavigationError(
                        ErrorCode.TF_ERROR,
                        f"frame_id {message.header.frame_id!r:.40}: must be 'map' or empty",
                    )
                self._start(now_ns, request, current)
            except NavigationError as error:
                _LOG.error("Goal rejected with error %d: %s", error.code, error.message)
                refused.append((current, goal_result(request, now_ns, error.code, error.message)))
            else:
                taken = True
        self._results += reversed(refused)

    def _start(self, now_ns: int, request: object, current: _Current) -> None:
        """Start a task. Raises NavigationError where it is refused; the one before goes on."""
        drive = self._ready_drive()
        before = self._current
        ended = drive.navigator.start(now_ns, request)  # type: ignore[arg-type]
        if ended is not None and before is not None:
            self._results.append((before, ended))
        self._current = current

    def _ready_drive(self) -> Drive:
        missing = self.waiting_for()
        if missing is not None or self._drive is None:
            raise NavigationError(
                ErrorCode.GOAL_REJECTED, f"navigation is not active: it waits for {missing}"
            )
        return self._drive

    def _ended(self, result: TaskResult | None) -> None:
        if result is not None and self._current is not None:
            self._results.append((self._current, result))
            self._current = None

    def _answer(self, now_ns: int, inbox: Inbox) -> None:
        """Answer the queries."""
        for send in inbox.requests(SEND_GOAL):
            send.respond(self._send_goal(now_ns, send.message))
        for cancel in inbox.requests(CANCEL_GOAL):
            ask = cancel.message
            cancel.respond(self._cancel(now_ns, ask.goal_stamp_ns, ask.goal_id))
        for pause in inbox.requests(PAUSE_GOAL):
            pause.respond(self._pause(pause.message.pause))
        for path in inbox.requests(COMPUTE_PATH):
            path.respond(self._compute_path(path.message))
        for clear in inbox.requests(CLEAR_COSTMAP):
            clear.respond(self._clear_costmap(clear.message))
        for toggle in inbox.requests(TOGGLE_COLLISION_MONITOR):
            if self._drive is not None:
                self._drive.robot.toggle_collision_monitor(toggle.message.enable)
            missing = "" if self._drive is not None else "navigation waits for the map"
            toggle.respond(act.Reply(error=missing))

    def _send_goal(self, now_ns: int, send: act.SendGoal) -> act.SendGoalReply:
        try:
            self._start(now_ns, request_of(send.goal), _Current(send.goal_id, None))
        except NavigationError as error:
            _LOG.error("Goal rejected with error %d: %s", error.code, error.message)
            near = error.nearest_free
            return act.SendGoalReply(
                accepted=False,
                error_code=int(error.code),
                error_msg=error.message,
                nearest_free=None if near is None else planar_document(near),
            )
        return act.SendGoalReply(accepted=True)

    def _cancel(self, now_ns: int, stamp_ns: int | None, goal_id: str | None) -> CancelGoalReply:
        """Cancel the goal with this stamp or id; None: any goal."""
        drive, current = self._drive, self._current
        request = drive.navigator.request if drive is not None else None
        if (
            drive is None
            or current is None
            or request is None
            or stamp_ns not in (None, current.stamp_ns)
            or goal_id not in (None, current.goal_id)
        ):
            said = "no goal"
            if stamp_ns is not None:
                said = f"goal_stamp_ns: {stamp_ns}: no such goal"
            elif goal_id is not None:
                said = f"goal_id: {goal_id}: no such goal"
            return CancelGoalReply(error=f"{said} is being driven to", return_code=2)
        self._ended(drive.navigator.cancel(now_ns))
        pose = request.pose if isinstance(request, NavigateToPose) else None
        return CancelGoalReply(
            goal=None if pose is None else planar_document(pose),
            goal_stamp_ns=current.stamp_ns or 0,
        )

    def _pause(self, pause: bool) -> act.Reply:
        if self._drive is None or self._drive.navigator.request is None:
            return act.Reply(error="no action is running")
        if pause:
            self._drive.navigator.pause()
        else:
            self._drive.navigator.resume()
        return act.Reply()

    def _compute_path(self, ask: act.ComputePath) -> act.ComputePathReply:
        try:
            drive = self._ready_drive()
            start = drive.robot.pose() if ask.start is None else ask.start.se2()
            path = drive.robot.compute_path(
                start, [goal.se2() for goal in ask.goals], ask.planner_id
            )
        except NavigationError as error:
            near = error.nearest_free
            return act.ComputePathReply(
                error_code=int(error.code),
                error_msg=error.message,
                nearest_free=None if near is None else planar_document(near),
            )
        return act.ComputePathReply(path=path_poses(path), length_m=path.length_m)

    def _clear_costmap(self, ask: act.ClearCostmap) -> act.Reply:
        try:
            drive = self._ready_drive()
            for request in clear_requests(ask):
                drive.robot.clear_costmap(request)
        except NavigationError as error:
            return act.Reply(error=error.message)
        return act.Reply()

    def _control(self, now_ns: int, outbox: Outbox, passes: bool) -> None:
        """Run one control period; if no time has passed, only publish results of ended goals."""
        command: Velocity | None = None
        if passes and self._drive is not None and self._odom is not None:
            command = self._wanted(now_ns, self._drive, self._drive.navigator)
            if self._drive.robot.new_path is not None:
                outbox.put(PLAN, path_message(now_ns, self._drive.robot.new_path))
            if command is not None:
                command = self._watched(now_ns, self._drive, command)
        stands = self._current is None or passes
        if command is None and self._moving and stands:
            command = STOP
        if command is not None:
            self._moving = command != STOP
            outbox.put(CMD_VEL, twist_message(now_ns, command))
        for current, result in self._results:
            if current.stamp_ns is not None:
                outbox.put(NAVIGATION_RESULT, result_document(current.stamp_ns, result))
            else:
                outbox.put(ACTION_RESULT, result_action(current.goal_id, result))
        self._results.clear()

    def _wanted(self, now_ns: int, drive: Drive, navigator: BtNavigator) -> Velocity | None:
        """What behaviours or a person want in this period; None: nothing."""
        assert self._odom is not None
        assert drive.robot.view is not None
        searching = self._wants_motion() and self._localization is not None
        if navigator.request is None and not (searching and self._is_searching()):
            self._search = None
            return drive.robot.view.teleop
        # A pose that is not known has no age; an old one stops the robot.
        pose_ns = now_ns if self._map_from_odom is None else self._map_from_odom[0]
        echoes_ns = self._echoes.stamp_ns if self._echoes is not None else self._odom[0]
        if now_ns - min(self._odom[0], echoes_ns, pose_ns) > self._config.sensor_timeout * 1e9:
            return STOP
        self._ended(navigator.step(now_ns))
        if searching and drive.robot.view.map_from_base is None and navigator.hold != "paused":
            if self._search is None:
                self._search = SearchMotion(drive.search, look_around=bool(drive.robot.docks))
            return self._search.step(
                self._odom[1], drive.robot.view.echoes_m, drive.robot.time_to_collision
            )
        self._search = None
        return drive.robot.command

    def _wants_motion(self) -> bool:
        status = self._localization
        return status is not None and status.wants_motion and status.epoch == self._watch.epoch

    def _is_searching(self) -> bool:
        """Whether a person has asked for global localisation: the robot moves without a goal."""
        return self._localization is not None and self._localization.state == "searching"

    def _watched(self, now_ns: int, drive: Drive, command: Velocity) -> Velocity:
        """The command that may be sent: by the velocity smoother and the collision monitor."""
        assert drive.robot.view is not None
        echoes = self._echoes
        sources = {}
        if echoes is not None:
            sources["scan"] = SourcePoints(echoes.stamp_ns, drive.robot.view.echoes_m)
        drive.monitor.enabled = drive.robot.monitor_enabled
        watched = drive.monitor.step(now_ns, command, self._velocity, sources)
        self._monitor_state = watched.state
        return watched.velocity

    def _tell(self, now_ns: int, outbox: Outbox) -> None:
        """Publish costmaps, feedback and status."""
        drive = self._drive
        if drive is None:
            self._tell_status(now_ns, outbox, None)
            return
        self._tell_costmap(now_ns, outbox, drive.robot.costmap)
        if self._echoes is not None and self._is_due("local", now_ns, _LOCAL_COSTMAP_PERIOD_NS):
            local = drive.robot.local_costmap
            outbox.put(LOCAL_COSTMAP, costmap_message(now_ns, local, ODOM_FRAME))
        state = self._monitor_state
        if state is not None and drive.monitor_told != (state.action, state.polygon_name):
            drive.monitor_told = (state.action, state.polygon_name)
            outbox.put(COLLISION_MONITOR_STATE, monitor_document(state))
        feedback = drive.navigator.feedback(now_ns)
        if feedback is not None and self._current is not None:
            if self._is_due("feedback", now_ns, _FEEDBACK_PERIOD_NS):
                paused = drive.navigator.paused
                outbox.put(
                    ACTION_FEEDBACK, feedback_document(self._current.goal_id, feedback, paused)
                )
        self._tell_status(now_ns, outbox, feedback)

    def _tell_costmap(self, now_ns: int, outbox: Outbox, costmap: LayeredCostmap) -> None:
        if costmap.revision == self._costmap_shown:
            return
        if self._is_due("costmap", now_ns, _COSTMAP_PERIOD_NS):
            self._costmap_shown = costmap.revision
            outbox.put(GLOBAL_COSTMAP, costmap_message(now_ns, costmap, MAP_FRAME))

    def _tell_status(self, now_ns: int, outbox: Outbox, feedback: TaskFeedback | None) -> None:
        drive = self._drive
        request = drive.navigator.request if drive is not None else None
        goal = request.pose if isinstance(request, NavigateToPose) else None
        localized = self._localized() and drive is not None
        state = "idle"
        if drive is not None and request is not None:
            state = drive.state()
        recoveries = feedback.number_of_recoveries if feedback is not None else 0
        status = (localized, localized, state, goal, recoveries)
        # Called on every step, so that the period counts from the last status published.
        due = self._is_due("status", now_ns, _STATUS_PERIOD_NS)
        if due or status != self._status:
            said = NavigationStatus(
                localization_active=localized,
                navigation_active=localized,
                state=state,
                goal=None if goal is None else planar_document(goal),
                distance_remaining_m=0.0 if feedback is None else feedback.distance_remaining_m,
                number_of_recoveries=recoveries,
            )
            outbox.put(NAVIGATION_STATUS, said)
        if localized != self._was_active:
            self._was_active = localized
            _LOG.info("navigation is active" if localized else "navigation waits for the pose")
        self._status = status

    def _is_due(self, what: str, now_ns: int, period_ns: int) -> bool:
        if now_ns < self._due_ns.get(what, 0):
            return False
        self._due_ns[what] = (now_ns // period_ns + 1) * period_ns
        return True
