"""The node: pose and sensors in, plan and velocity out. The only file here that uses topics."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from typing import ClassVar, NamedTuple

import numpy as np

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    CAMERA_OPTICAL_FRAME,
    MAP_FRAME,
    ODOM_FRAME,
    SCAN_FRAME,
    SE2,
    Array,
    se2_from_matrix,
    wrap_angle,
)
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    CancelGoalReply,
    Entities,
    LocalizationStatus,
    NavigationStatus,
    World,
)
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.scan import Scan
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    AMCL_POSE,
    BEHAVIOR_TREE,
    CAMERA_INFO,
    CANCEL_GOAL,
    CLEAR_COSTMAP,
    CMD_VEL,
    CMD_VEL_TELEOP,
    COLLISION_MONITOR_STATE,
    COMPUTE_PATH,
    DETECTIONS,
    ENTITIES,
    GLOBAL_COSTMAP,
    GLOBAL_LOCALIZATION_REQUEST,
    GOAL_POSE,
    INPUT_AT_WAYPOINT,
    KEEPOUT_FILTER_MASK,
    LOCAL_COSTMAP,
    LOCALIZATION_STATUS,
    MAP,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    ODOM,
    PAUSE_GOAL,
    PHOTO,
    PHOTO_REQUEST,
    PLAN,
    SCAN,
    SEND_GOAL,
    SIMULATION_STATS,
    SMOOTH_PATH,
    SPEED_FILTER_MASK,
    TF,
    TF_STATIC,
    TOGGLE_COLLISION_MONITOR,
    TRAJECTORIES,
    WORLD,
)
from mazebot.common.node.frame_tree import FrameTree
from mazebot.common.node.node import Inbox, Node, Outbox, random_generator
from mazebot.common.node.schedule import Schedule
from mazebot.common.node.simulation_watch import SimulationWatch
from mazebot.common.world.costmap import MAX_MAP_CELLS, Cells, straightened
from mazebot.navigation.behavior.actions import (
    FollowWaypoints,
    NavigateToPose,
    TaskFeedback,
    TaskResult,
)
from mazebot.navigation.behavior.bt_navigator import BtNavigator
from mazebot.navigation.behavior.engine.tree import NodeSnapshot
from mazebot.navigation.behavior.engine.tree_log import TreeLog
from mazebot.navigation.behavior.motions.search_motion import SearchMotion
from mazebot.navigation.behavior.waypoints import WaypointExchange
from mazebot.navigation.build import Drive, made_drive
from mazebot.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.mppi.batch_pace import Batched
from mazebot.navigation.control.mppi.mppi import MPPIController
from mazebot.navigation.control.safety.collision_monitor import (
    NOTHING_MOVES,
    MonitorState,
    SourcePoints,
    moved_points,
    moving_in_base,
)
from mazebot.navigation.costmap.layered_costmap import (
    GridFrame,
    LayeredCostmap,
    frame_of,
    scan_points,
)
from mazebot.navigation.costmap.obstacle_layer import denoised_ranges
from mazebot.navigation.costmap.zones import Zones, zones_of
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.kernels import compile_kernels
from mazebot.navigation.mask_files import masks_of
from mazebot.navigation.messages import (
    camera_view,
    clear_requests,
    costmap_message,
    feedback_document,
    goal_of,
    goal_result,
    mask_message,
    monitor_document,
    path_message,
    path_poses,
    planar_document,
    planned_path,
    request_of,
    result_action,
    result_document,
    trajectories_message,
    tree_document,
    twist_message,
)
from mazebot.navigation.robot import RobotContext, View

_LOG = logging.getLogger("navigation")

_STATUS_PERIOD_NS = 500_000_000
_FEEDBACK_PERIOD_NS = 200_000_000
_COSTMAP_PERIOD_NS = 1_000_000_000
_LOCAL_COSTMAP_PERIOD_NS = 500_000_000
_TREE_PERIOD_NS = 200_000_000
_TRAJECTORIES_PERIOD_NS = 500_000_000
_TELEOP_NS = 300_000_000
"""A command of a person counts for this long."""
_STATIC_MARGIN_M = 0.05
_SIGMAS = 3.0
"""An echo is a wall's within a cell of it and so many standard deviations of the pose."""
_JUMP_M, _JUMP_RAD = 0.3, 0.3
"""A correction of the pose by more than this is a jump."""
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
        self._camera: msg.CameraInfo | None = None
        self._drive: Drive | None = None
        self._localization: LocalizationStatus | None = None
        self._map_from_odom: tuple[int, SE2] | None = None
        """The newest correction of odometry, with its stamp."""
        self._pose_std_m: float | None = None
        """Of the pose in the map, along the axis of which less is known."""
        self._odom: tuple[int, SE2] | None = None
        self._velocity = STOP
        self._smoothed_ns = 0
        """When the velocity smoother was asked last."""
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
        self._tree_log = TreeLog()
        self._tree_told: tuple[str, tuple[NodeSnapshot, ...]] | None = None
        """The action and its tree last published."""
        self._schedule = Schedule()
        self._costmap_shown = -1
        self._masks = masks_of(config)
        self._zones_shown: Zones | None = None
        self._current: _Current | None = None
        self._results: list[tuple[_Current, TaskResult]] = []
        self._photo_asked_ns: int | None = None
        """When the picture was asked for that is yet to come."""
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

    def facts(self) -> dict[str, str]:
        """What navigation does, the controller that was used last, and, after control periods were
        missed, how many trajectories it tries.
        """
        drive = self._drive
        if drive is None:
            return {"state": "idle"}
        robot, request = drive.robot, drive.navigator.request
        names = [name for name, one in robot.controllers.items() if one is robot.controller]
        said = {
            "state": "idle" if request is None else drive.state(),
            "controller": ", ".join(names),
        }
        if drive.pace.missed and isinstance(robot.controller, Batched):
            said["trajectories tried"] = str(robot.controller.batch_size)
        return said

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
        self._take_photos(inbox)
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
            self._know_docks()
        for info in inbox.new(CAMERA_INFO):
            self._take_camera(info)

    def _take_map(self, now_ns: int, grid: msg.OccupancyGrid, inbox: Inbox) -> None:
        origin = msg.se2_from_pose(grid.info.origin)
        grows = self._world is not None and self._world.slam
        stamp_ns = msg.ns_from_time(grid.header.stamp)
        if grows and not self._watch.is_of_this_run(stamp_ns, MAP, inbox):
            return
        try:
            if len(grid.data) > MAX_MAP_CELLS:
                raise ValueError(f"{len(grid.data)} cells: must be at most {MAX_MAP_CELLS}")
            cells = np.array(msg.cells_from_grid(grid), np.int8)
            # Planning needs the rows along the axes of the map's frame.
            origin, cells = straightened(grid.info.resolution, origin, cells)
            frame = frame_of(grid.info.resolution, origin, cells)
            if grows and self._drive is not None:
                zones, margin_m = self._zones(frame), self._static_margin_m()
                self._drive.take_map(frame, cells, margin_m, zones)
                self._map = grid
                return
            drive = self._made_drive(frame, cells)
            if grows:
                drive.take_map(frame, cells, 0.0, self._zones(frame))
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

    def _take_camera(self, info: msg.CameraInfo) -> None:
        """Keep the intrinsics, which come with each image and hardly ever change."""
        old = self._camera
        if old is not None and (old.width, old.height) == (info.width, info.height):
            if np.array_equal(old.k, info.k):
                return
        self._camera = info
        self._know_docks()

    def _know_docks(self) -> None:
        """Each marker of the world is a dock, by its id and by its name."""
        if self._drive is None or self._entities is None or self._world is None:
            return
        if self._world.slam or self._entities.world_hash != self._world.hash:
            # With slam, nobody has told where they hang.
            self._drive.robot.docks.learn((), None)
            return
        view = None
        if self._camera is not None and self._base_from_camera is not None:
            view = camera_view(self._camera, self._base_from_camera)
        self._drive.robot.docks.learn(self._entities.markers, view)

    def _begin_anew(self, now_ns: int, code: ErrorCode, why: str) -> None:
        """Abort the task, and drop all measurements and what was made of them."""
        self._abort(now_ns, code, why)
        if self._drive is None:
            return
        if self._world is not None and self._world.slam:
            # The map begins anew as well.
            self._drive = self._map = None
            return
        self._drive = self._made_drive(self._drive.robot.costmap.frame, self._drive.cells)
        self._know_docks()

    def _made_drive(self, frame: GridFrame, cells: Cells) -> Drive:
        """Navigation for a map, with the zones of the world and of the masks."""
        random = random_generator(self._watch.seed, "navigation/control")
        return made_drive(self._config, frame, cells, random, self._zones(frame))

    def _zones(self, frame: GridFrame) -> Zones | None:
        world, masks = self._world, self._masks
        return zones_of(
            frame, self._config.desired_linear_vel,
            world.keepout_zones if world is not None else (),
            world.speed_limits if world is not None else (), masks.keepout, masks.speed,
        )  # fmt: skip

    def _abort(self, now_ns: int, code: ErrorCode, why: str) -> None:
        """Abort the task and drop all measurements."""
        self._odom = self._echoes = self._map_from_odom = self._pose_std_m = None
        self._teleop = self._search = self._photo_asked_ns = None
        self._velocity = STOP
        self._was_active = False
        self._schedule.clear()
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
                    self._correct(stamp_ns, se2_from_matrix(matrix))
        for claim in inbox.new(AMCL_POSE):
            if self._watch.is_of_this_run(msg.ns_from_time(claim.header.stamp), AMCL_POSE, inbox):
                variances = claim.pose.covariance[0], claim.pose.covariance[7]
                self._pose_std_m = math.sqrt(max(*variances, 0.0))

    def _correct(self, stamp_ns: int, map_from_odom: SE2) -> None:
        """Take a correction of odometry. After a jump, what is tracked in the map is elsewhere."""
        if self._map_from_odom is not None and self._odom is not None and self._drive is not None:
            before, now = (one @ self._odom[1] for one in (self._map_from_odom[1], map_from_odom))
            turn_rad = abs(wrap_angle(now.yaw_rad - before.yaw_rad))
            if now.distance_m(before) > _JUMP_M or turn_rad > _JUMP_RAD:
                self._drive.tracker.clear()
        self._map_from_odom = (stamp_ns, map_from_odom)

    def _take_scans(self, inbox: Inbox) -> None:
        """Read the scans, oldest first: the costmaps, the moving obstacles and the echoes."""
        for scan in inbox.new(SCAN):
            stamp_ns = msg.ns_from_time(scan.header.stamp)
            if self._watch.is_of_this_run(stamp_ns, SCAN, inbox):
                self._take_scan(stamp_ns, scan)

    def _take_scan(self, stamp_ns: int, message: msg.LaserScan) -> None:
        base_from_scan = self._base_from_scan
        if self._odom is None or base_from_scan is None:
            return
        odom_from_base = self._odom[1]
        scan = Scan.from_message(message, base_from_scan)
        points_m = scan_points(replace(scan, ranges_m=denoised_ranges(scan.ranges_m)))
        self._echoes = _Echoes(stamp_ns, odom_from_base, points_m)
        drive = self._drive
        if drive is None:
            return
        drive.robot.local_costmap.move(odom_from_base)
        drive.robot.local_costmap.update(
            odom_from_base @ base_from_scan, scan, map_from_base=odom_from_base
        )
        if not self._localized():
            drive.tracker.clear()
            return
        map_from_base = self._map_from_base()
        static = drive.robot.costmap.static
        margin_m = self._static_margin_m()
        drive.tracker.update(
            stamp_ns * 1e-9, moved_points(points_m, map_from_base, _NOWHERE),
            static.distance_m if drive.known_m is None else drive.known_m, static.frame, margin_m,
        )  # fmt: skip
        moving = [(t.x_m, t.y_m, t.radius_m) for t in drive.tracker.moving(stamp_ns * 1e-9)]
        drive.robot.costmap.update(
            map_from_base @ base_from_scan, scan, map_from_base=map_from_base,
            moving_m=np.array(moving, np.float64).reshape(-1, 3), static_margin_m=margin_m,
        )  # fmt: skip

    def _static_margin_m(self) -> float:
        """How near to a wall of the map an echo is taken for the wall's: by the pose's error."""
        most_m = self._config.obstacle_static_margin
        if self._pose_std_m is None:
            return most_m
        return min(_STATIC_MARGIN_M + _SIGMAS * self._pose_std_m, most_m)

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

    def _take_photos(self, inbox: Inbox) -> None:
        """Count the picture that was asked for at a waypoint."""
        for photo in inbox.new(PHOTO):
            stamp_ns = msg.ns_from_time(photo.header.stamp)
            asked_ns = self._photo_asked_ns
            if self._drive is None or asked_ns is None or stamp_ns < asked_ns:
                continue
            if self._watch.is_of_this_run(stamp_ns, PHOTO, inbox):
                self._photo_asked_ns = None
                self._drive.navigator.exchange.photos += 1

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
                self._drive.tracker.turning(),
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
        for given in inbox.requests(INPUT_AT_WAYPOINT):
            given.respond(self._input())
        for path in inbox.requests(COMPUTE_PATH):
            path.respond(self._compute_path(path.message))
        for smooth in inbox.requests(SMOOTH_PATH):
            smooth.respond(self._smooth_path(smooth.message))
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

    def _input(self) -> act.Reply:
        """An input for the robot that waits at a waypoint."""
        if self._drive is None or not isinstance(self._drive.navigator.request, FollowWaypoints):
            return act.Reply(error="no waypoints are being followed")
        self._drive.navigator.exchange.inputs += 1
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

    def _smooth_path(self, ask: act.SmoothPath) -> act.SmoothPathReply:
        try:
            path = self._ready_drive().robot.smooth_path(
                planned_path(ask.path, ErrorCode.SMOOTHER_INVALID_PATH),
                ask.smoother_id,
                ask.check_for_collisions,
            )
        except NavigationError as error:
            return act.SmoothPathReply(error_code=int(error.code), error_msg=error.message)
        return act.SmoothPathReply(path=path_poses(path))

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
            if self._drive.robot.controlled:
                self._drive.pace.step(now_ns, self._drive.robot.controller)
            else:
                self._drive.pace.rest()
            if self._drive.robot.new_path is not None:
                outbox.put(PLAN, path_message(now_ns, self._drive.robot.new_path))
            command = self._smoothed(now_ns, self._drive, command)
            self._ask_for_photo(now_ns, outbox, self._drive.navigator.exchange)
            if command is not None:
                command = self._watched(now_ns, self._drive, command)
        if self._drive is not None and self._drive.robot.wants_global_localization:
            self._drive.robot.wants_global_localization = False
            outbox.put(GLOBAL_LOCALIZATION_REQUEST, act.Empty())
        stands = self._current is None or passes
        if command is None and self._moving and stands:
            command = STOP
            if self._drive is not None:
                # No ramp follows a stop that was sent while time stood still.
                self._drive.smoother.reset()
        if command is not None:
            self._moving = command != STOP
            outbox.put(CMD_VEL, twist_message(now_ns, command))
        for current, result in self._results:
            if current.stamp_ns is not None:
                outbox.put(NAVIGATION_RESULT, result_document(current.stamp_ns, result))
            else:
                docks = self._drive.robot.docks.docked() if self._drive is not None else {}
                outbox.put(ACTION_RESULT, result_action(current.goal_id, result, docks))
        self._results.clear()

    def _ask_for_photo(self, now_ns: int, outbox: Outbox, exchange: WaypointExchange) -> None:
        index, exchange.photo_wanted_at = exchange.photo_wanted_at, None
        if index is not None:
            self._photo_asked_ns = now_ns
            outbox.put(PHOTO_REQUEST, act.PhotoRequest(waypoint=index, stamp_ns=now_ns))

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
            # What it would meet on the way of a ramp is not known.
            drive.smoother.reset()
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

    def _smoothed(self, now_ns: int, drive: Drive, command: Velocity | None) -> Velocity | None:
        """What the velocity smoother makes of a command; where there is none, a ramp to a stop."""
        smoother = drive.smoother
        if command is None and smoother.last == STOP:
            return None
        elapsed_s = (now_ns - self._smoothed_ns) * 1e-9
        # A late step is followed by one in time: less than a period after it.
        if not 0.0 < elapsed_s < CONTROL_PERIOD_NS * 1e-9:
            elapsed_s = CONTROL_PERIOD_NS * 1e-9
        self._smoothed_ns = now_ns
        smoother.take(now_ns, STOP if command is None else command)
        return smoother.step(now_ns, elapsed_s, self._velocity)

    def _watched(self, now_ns: int, drive: Drive, command: Velocity) -> Velocity:
        """The command that may be sent, by the collision monitor."""
        assert drive.robot.view is not None
        echoes = self._echoes
        sources = {}
        if echoes is not None:
            sources["scan"] = SourcePoints(echoes.stamp_ns, drive.robot.view.echoes_m)
        drive.monitor.enabled = drive.robot.monitor_enabled
        pose = drive.robot.view.map_from_base
        # Without a pose, tracks in the map cannot be told from where the robot is.
        moving = NOTHING_MOVES if pose is None else moving_in_base(drive.robot.view.tracks, pose)
        watched = drive.monitor.step(now_ns, command, self._velocity, sources, moving)
        self._monitor_state = watched.state
        return watched.velocity

    def _tell(self, now_ns: int, outbox: Outbox) -> None:
        """Publish costmaps, feedback and status."""
        drive = self._drive
        if drive is None:
            self._tell_status(now_ns, outbox, None)
            return
        self._tell_zones(now_ns, outbox, drive.robot)
        self._tell_costmap(now_ns, outbox, drive.robot.costmap)
        if self._echoes is not None and self._schedule.is_due(
            "local", now_ns, _LOCAL_COSTMAP_PERIOD_NS
        ):
            local = drive.robot.local_costmap
            outbox.put(LOCAL_COSTMAP, costmap_message(now_ns, local, ODOM_FRAME))
        state = self._monitor_state
        if state is not None and drive.monitor_told != (state.action, state.polygon_name):
            drive.monitor_told = (state.action, state.polygon_name)
            outbox.put(COLLISION_MONITOR_STATE, monitor_document(state))
        self._tell_tree(now_ns, outbox, drive.navigator)
        self._tell_trajectories(now_ns, outbox, drive.robot)
        feedback = drive.navigator.feedback(now_ns)
        if feedback is not None and self._current is not None:
            if self._schedule.is_due("feedback", now_ns, _FEEDBACK_PERIOD_NS):
                request, paused = drive.navigator.request, drive.navigator.paused
                goal = None if request is None else goal_of(request, drive.robot.docks.docked())
                told = feedback_document(self._current.goal_id, feedback, paused, goal)
                outbox.put(ACTION_FEEDBACK, told)
        self._tell_status(now_ns, outbox, feedback)

    def _tell_zones(self, now_ns: int, outbox: Outbox, robot: RobotContext) -> None:
        """Publish masks of the zones; of zones that are no more, an empty one."""
        frame, zones, shown = robot.costmap.frame, robot.zones, self._zones_shown
        if zones is shown:
            return
        self._zones_shown = zones
        if any(each is not None and each.keepout.size for each in (zones, shown)):
            keepout = zones.keepout if zones is not None and zones.keepout.size else None
            outbox.put(KEEPOUT_FILTER_MASK, mask_message(now_ns, frame, keepout))
        if any(each is not None and each.limits_m_s.size for each in (zones, shown)):
            highest_m_s = self._config.desired_linear_vel
            speeds = zones.speed_values(highest_m_s) if zones is not None else None
            outbox.put(SPEED_FILTER_MASK, mask_message(now_ns, frame, speeds))

    def _tell_costmap(self, now_ns: int, outbox: Outbox, costmap: LayeredCostmap) -> None:
        if costmap.revision == self._costmap_shown:
            return
        if self._schedule.is_due("costmap", now_ns, _COSTMAP_PERIOD_NS):
            self._costmap_shown = costmap.revision
            outbox.put(GLOBAL_COSTMAP, costmap_message(now_ns, costmap, MAP_FRAME))

    def _tell_tree(self, now_ns: int, outbox: Outbox, navigator: BtNavigator) -> None:
        self._tree_log.add(navigator.running_tree())
        if not self._schedule.is_due("tree", now_ns, _TREE_PERIOD_NS):
            return
        action = navigator.request.action if navigator.request is not None else ""
        tree = action, self._tree_log.take()
        if tree != self._tree_told:
            self._tree_told = tree
            outbox.put(BEHAVIOR_TREE, tree_document(*tree))

    def _tell_trajectories(self, now_ns: int, outbox: Outbox, robot: RobotContext) -> None:
        controller = robot.controller
        if not robot.controlled or not isinstance(controller, MPPIController):
            return
        if self._schedule.is_due("trajectories", now_ns, _TRAJECTORIES_PERIOD_NS):
            drawn = controller.trajectories()
            if drawn is not None:
                outbox.put(TRAJECTORIES, trajectories_message(now_ns, drawn))

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
        due = self._schedule.is_due("status", now_ns, _STATUS_PERIOD_NS)
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
