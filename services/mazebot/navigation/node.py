"""The node: pose and sensors in, plan and velocity out. The only file here that uses topics."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import numpy as np
from pydantic import JsonValue

from mazebot.common.config import ConfigError, value_of, with_values
from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    CAMERA_FRAME,
    CAMERA_OPTICAL_FRAME,
    MAP_FRAME,
    ODOM_FRAME,
    SCAN_FRAME,
    SE2,
    Array,
)
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    Entities,
    NavigationResult,
    NavigationStatus,
    SetParametersReply,
    StopCause,
    World,
)
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.scan import Mount, Scan
from mazebot.common.messages.slam_documents import ExplorationStatus
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    AMCL_POSE,
    BATTERY_STATE,
    BEHAVIOR_TREE,
    CAMERA_INFO,
    CANCEL_GOAL,
    CLEAR_COSTMAP,
    CMD_VEL,
    CMD_VEL_TELEOP,
    COLLISION_MONITOR_STATE,
    COMPUTE_PATH,
    CONTROLLER_SELECTOR,
    DEPTH_SCAN,
    DETECTIONS,
    ENTITIES,
    EXPLORATION_STATUS,
    GLOBAL_COSTMAP,
    GLOBAL_COSTMAP_UPDATES,
    GLOBAL_LOCALIZATION_REQUEST,
    GOAL_POSE,
    GOAL_UPDATE,
    INPUT_AT_WAYPOINT,
    KEEPOUT_FILTER_MASK,
    LOCAL_COSTMAP,
    LOCALIZATION_STATUS,
    MAP,
    NAVIGATION_CHECKPOINT,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    ODOM,
    PARAMETER_EVENTS,
    PARAMETERS,
    PAUSE_GOAL,
    PHOTO,
    PHOTO_REQUEST,
    PLAN,
    PLANNER_SELECTOR,
    PUBLISHED_FOOTPRINT,
    SCAN,
    SEND_GOAL,
    SET_PARAMETERS,
    SIMULATION_STATS,
    SMOOTH_PATH,
    SPEED_FILTER_MASK,
    SPEED_LIMIT,
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
from mazebot.common.robot.frozen_scans import FROZEN
from mazebot.common.robot.known_markers import known_markers
from mazebot.common.ros.parameters import parameter_event
from mazebot.common.world.costmap import MAX_MAP_CELLS, Cells, straightened
from mazebot.navigation.behavior.actions import (
    NavigateToPose,
    TaskFeedback,
)
from mazebot.navigation.behavior.bt_navigator import BtNavigator
from mazebot.navigation.behavior.engine.tree import NodeSnapshot
from mazebot.navigation.behavior.engine.tree_log import TreeLog
from mazebot.navigation.behavior.waypoints import WaypointExchange
from mazebot.navigation.build import made_drive, reconfigure
from mazebot.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.mppi.batch_pace import Batched
from mazebot.navigation.control.mppi.mppi import MPPIController
from mazebot.navigation.control.safety.collision_monitor import (
    MonitorState,
)
from mazebot.navigation.costmap.layered_costmap import (
    GridFrame,
    LayeredCostmap,
    frame_of,
)
from mazebot.navigation.costmap.zones import Zones, zones_of
from mazebot.navigation.drive import Drive
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.goals import Goal, Goals, input_at_waypoint
from mazebot.navigation.kernels import check_parts, compile_kernels
from mazebot.navigation.mask_files import masks_of
from mazebot.navigation.messages import (
    battery_charge,
    camera_view,
    costmap_message,
    costmap_update_message,
    feedback_document,
    footprint_message,
    goal_of,
    mask_message,
    monitor_document,
    path_message,
    planar_document,
    trajectories_message,
    tree_document,
    twist_message,
)
from mazebot.navigation.queries import clear_costmap, compute_path, smooth_path
from mazebot.navigation.robot.measurements import Measurements
from mazebot.navigation.robot.robot_context import RobotContext, Told
from mazebot.navigation.robot.stop_level import severest, stop_causes
from mazebot.navigation.robot_limits import DriveLimits, beyond, limits_of, within

_LOG = logging.getLogger("navigation")

_STATUS_PERIOD_NS = 500_000_000
_FEEDBACK_PERIOD_NS = 200_000_000
_COSTMAP_PERIOD_NS = 1_000_000_000
_COSTMAP_UPDATES_PERIOD_NS = 200_000_000
_LOCAL_COSTMAP_PERIOD_NS = 500_000_000
_TREE_PERIOD_NS = 200_000_000
_TRAJECTORIES_PERIOD_NS = 500_000_000
_REJECTED_PERIOD_NS = 1_000_000_000
_LOCALIZATION = "localization to converge"


class _Checkpoint(NamedTuple):
    world_hash: str
    epoch: int | None
    goal: Goal | None
    parameters: Mapping[str, JsonValue]
    speed_limit: act.SpeedLimit


class NavigationNode(Node):
    """Drives the robot to goals in the map."""

    name: ClassVar[str] = "navigation"
    _config: NavigationConfig
    period_ns: ClassVar[int | None] = CONTROL_PERIOD_NS
    live_parameters: ClassVar[tuple[str, ...]] = (
        "controller_server.", "velocity_smoother.", "collision_monitor."
    )  # fmt: skip
    parameter_aliases: ClassVar[Mapping[str, str]] = {
        "max_vel_x": "controller_server.max_linear_vel",
        "max_vel_theta": "controller_server.max_angular_vel",
    }

    def __init__(self, config: NavigationConfig) -> None:
        """Raises ConfigError where a controller, planner or tree that is named cannot be used."""
        self._config = config
        self._limits = DriveLimits()
        self._driven = within(config, self._limits)
        """The configuration within what the robot can do."""
        self._watch = SimulationWatch(config.seed)
        self._world: World | None = None
        self._map: msg.OccupancyGrid | None = None
        self._entities: Entities | None = None
        self._static_frames = FrameTree()
        self._lidar: Mount | None = None
        self._base_from_camera: Array | None = None
        self._depth_camera: Mount | None = None
        self._camera: msg.CameraInfo | None = None
        self._drive: Drive | None = None
        self._measured = Measurements()
        self._now_ns = 0
        self._moving = False
        """Whether the last command published was not a stop."""
        self._was_active = False
        self._status: tuple[bool, str, SE2 | None, int, tuple[StopCause, ...]] | None = None
        """The status last published, without the distance remaining."""
        self._monitor_state: MonitorState | None = None
        self._tree_log = TreeLog()
        self._tree_published: tuple[str, tuple[NodeSnapshot, ...]] | None = None
        """The action and its tree last published."""
        self._schedule = Schedule()
        self._costmap_shown = -1
        self._frame_shown: GridFrame | None = None
        self._masks = masks_of(config)
        self._told = Told(config.collision_monitor.enabled)
        self._zones_shown: Zones | None = None
        self._goals = Goals()
        self._exploration: ExplorationStatus | None = None
        self._kept: act.NavigationCheckpoint | None = None
        """Of the process before, until its goal is known to be of this run."""
        self._resumed = False
        """Whether that has been done, or there was none."""
        self._checkpoint: _Checkpoint | None = None
        """What was last published for a process after this one to go on with."""
        self._changed: dict[str, JsonValue] = {}
        """The parameters that were set, in this process or in those before it in this run."""
        self._photo_requested_ns: int | None = None
        """When the picture was requested that is yet to come."""
        check_parts(config)

    def prepare(self) -> None:
        """See Node."""
        compile_kernels(self._config)

    def waiting_for(self) -> str | None:
        """A phrase for the first missing input that keeps the robot from driving."""
        if self._world is None:
            return "the world"
        if self._drive is None:
            return "the map"
        if self._lidar is None:
            return "static transforms on /tf_static"
        if self._measured.odom is None:
            return "odometry"
        if self._measured.echoes is None:
            return "a scan"
        if self._measured.map_from_odom is None:
            return "the transform from map to odom"
        if not self._localized():
            return _LOCALIZATION
        return None

    def facts(self) -> dict[str, str]:
        """What navigation does, the controller that was used last, and, after control periods were
        missed, how many trajectories it tries.
        """
        drive = self._drive
        if drive is None:
            return {"state": "idle"}
        server, request = drive.robot.controller_server, drive.navigator.request
        names = [name for name, one in server.controllers.items() if one is server.controller]
        facts = {
            "state": "idle" if request is None else drive.state(),
            "controller": ", ".join(names),
        }
        if drive.pace.missed and isinstance(server.controller, Batched):
            facts["trajectories tried"] = str(server.controller.batch_size)
        return facts

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Process sensor messages, run one control period, publish commands and status."""
        stats = inbox.new(SIMULATION_STATS)
        if self._watch.restarted(now_ns, stats):
            _LOG.info("simulation restarted; resetting")
            self._reset(now_ns, "simulation restarted")
        for one in stats:
            self._measured.emergency_stop = one.emergency_stop
            again = self._measured.take_watchdog_stops(one.watchdog_stops)
            if again and self._drive is not None and self._drive.navigator.request is not None:
                _LOG.warning("the robot has stopped: velocity commands do not reach it in time")
        # A query also wakes the node while time is stopped: that is no control period.
        passes = now_ns != self._now_ns
        self._now_ns = now_ns
        self._take_limits(inbox)
        self._take_world(now_ns, inbox)
        self._take_pose(inbox)
        self._take_scans(inbox)
        self._look_for_sources(inbox)
        self._take_depth_scans(inbox)
        self._take_detections(inbox)
        for battery in inbox.new(BATTERY_STATE):
            self._measured.battery = battery_charge(battery)
        for twist in inbox.new(CMD_VEL_TELEOP):
            wanted = Velocity(twist.twist.linear.x, twist.twist.angular.z)
            self._measured.take_teleop(now_ns, wanted)
        self._take_photos(inbox)
        if self._drive is not None and self._measured.odom is not None:
            drive = self._drive
            hidden_m = drive.hidden.from_base(self._measured.odom[1])
            view = self._measured.view(now_ns, self._watch.epoch, drive.tracker, hidden_m)
            drive.robot.begin(view)
        self._resume(now_ns, inbox, outbox)
        poses = inbox.new(GOAL_POSE)
        # After the poses, as it is sent before the goal that it tells of.
        self._hear_exploration(inbox)
        self._goals.take_poses(now_ns, poses, self._ready_drive)
        self._goals.stop_exploring(now_ns, self._drive)
        self._answer(now_ns, inbox)
        if self._drive is not None:
            self._hear_selectors(inbox, self._drive.robot)
            # After the goals, so that what is sent right after a goal counts for it.
            self._hear_goal_updates(now_ns, inbox, self._drive.robot)
        self._hear_speed_limits(inbox)
        self._set_parameters(now_ns, inbox, outbox)
        self._control(now_ns, outbox, passes)
        self._publish(now_ns, outbox)

    def _resume(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Go on with the parameters that were set in the process before, and with its goal, if it
        was in this run.
        """
        kept = self._kept = inbox.latest(NAVIGATION_CHECKPOINT) or self._kept
        if self._resumed:
            # What others keep is of this process itself.
            self._kept = None
            return
        if self._world is None or not inbox.is_handed_over:
            return
        run = self._world.hash, self._watch.epoch
        if kept is not None and (kept.world_hash, kept.epoch) == run:
            self._kept = None
            self._take_parameters(now_ns, kept.parameters, outbox)
            if self._told.speed_limit == act.SpeedLimit():
                self._told.speed_limit = kept.speed_limit
            if kept.goal is not None:
                self._goals.before = Goal(
                    kept.goal_id, kept.goal_stamp_ns, kept.goal, kept.start_ns, kept.resumed,
                    kept.missed, kept.paused, kept.explores,
                )  # fmt: skip
            # Who waits for its result learns that it is not lost, before it may end.
            self._put_checkpoint(outbox, self._checkpoint_of(self._goals.before))
        if self.waiting_for() is None:
            self._kept, self._resumed = None, True
            self._goals.resume(now_ns, self._ready_drive)

    def _hear_exploration(self, inbox: Inbox) -> None:
        status = self._exploration = inbox.latest(EXPLORATION_STATUS) or self._exploration
        # In a run that is repeated, goals have the same stamps again.
        of_this_run = status is not None and status.epoch == (self._watch.epoch or 0)
        self._goals.exploration = status if of_this_run else None

    def _take_parameters(self, now_ns: int, kept: Mapping[str, JsonValue], outbox: Outbox) -> None:
        """Set what was set in the process before, except what was set in this one."""
        values = {name: value for name, value in kept.items() if name not in self._changed}
        if not values:
            return
        try:
            self._change(now_ns, values, outbox)
        except ConfigError as error:
            _LOG.error("parameters that were set before navigation was restarted: %s", error)
            # A process after this one may take them.
            self._changed = {**values, **self._changed}

    def _take_world(self, now_ns: int, inbox: Inbox) -> None:
        """Process latched topics. The same world or map, received again, changes nothing."""
        world = inbox.latest(WORLD)
        if world is not None and (self._world is None or world.hash != self._world.hash):
            self._world = world
            self.world_hash = world.hash
            self._reset(now_ns, f"world changed to {world.name}")
        # The world says what the map is; until then it waits.
        if self._world is not None:
            grows = self._world.slam
            grid = self._watch.latest_of_this_run(MAP, inbox) if grows else inbox.latest(MAP)
            if grid is not None and not msg.same_grid(grid, self._map):
                self._take_map(now_ns, grid, inbox, grows=grows)
        entities = inbox.latest(ENTITIES)
        if entities is not None:
            self._entities = entities
            self._update_docks()
        if self._static_frames.receive(inbox, TF_STATIC):
            scan = self._static_frames.chain(BASE_FOOTPRINT_FRAME, SCAN_FRAME)
            self._lidar = None if scan is None else Mount.of(scan)
            depth = self._static_frames.chain(BASE_FOOTPRINT_FRAME, CAMERA_FRAME)
            self._depth_camera = None if depth is None else Mount.of(depth)
            self._base_from_camera = self._static_frames.chain(
                BASE_FOOTPRINT_FRAME, CAMERA_OPTICAL_FRAME
            )
            self._update_docks()
        for info in inbox.new(CAMERA_INFO):
            self._take_camera(info)

    def _take_map(self, now_ns: int, grid: msg.OccupancyGrid, inbox: Inbox, *, grows: bool) -> None:
        origin = msg.se2_from_pose(grid.info.origin)
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
            inbox.reject(MAP, "invalid map")
            _LOG.error("map: %s", error)
            return
        self._abort(now_ns, "map changed")
        self._map, self._drive = grid, drive
        self._update_docks()
        _LOG.info(
            "Received a %d X %d map @ %.3f m/pix",
            frame.columns, frame.rows, frame.resolution_m,
        )  # fmt: skip

    def _take_camera(self, info: msg.CameraInfo) -> None:
        """Keep the intrinsics, which come with each image and rarely change."""
        old = self._camera
        if old is not None and (old.width, old.height) == (info.width, info.height):
            if np.array_equal(old.k, info.k):
                return
        self._camera = info
        self._update_docks()

    def _update_docks(self) -> None:
        """Each marker that the robot knows is a dock, by its id and by its name."""
        if self._drive is None or self._entities is None or self._world is None:
            return
        docks = self._drive.robot.docks
        if self._entities.world_hash != self._world.hash:
            docks.learn((), None)
            return
        view = None
        if self._camera is not None and self._base_from_camera is not None:
            view = camera_view(self._camera, self._base_from_camera)
        known = known_markers(self._world, self._entities.markers)
        docks.learn(known.known, view, known.unknown)

    def _reset(self, now_ns: int, reason: str) -> None:
        """Abort the task, and drop all measurements and what was made of them."""
        self._abort(now_ns, reason)
        self._goals.give_up_before(max(now_ns, self._now_ns), ErrorCode.WORLD_RESTARTED, reason)
        if self._drive is None:
            return
        if self._world is not None and self._world.slam:
            # The map restarts as well.
            self._drive = self._map = None
            return
        self._drive = self._made_drive(self._drive.robot.costmap.frame, self._drive.cells)
        self._update_docks()

    def _made_drive(self, frame: GridFrame, cells: Cells) -> Drive:
        """Navigation for a map, with the zones of the world and of the masks."""
        random = random_generator(self._watch.seed, "navigation/control")
        drive = made_drive(self._driven, frame, cells, random, self._zones(frame))
        drive.robot.told = self._told
        return drive

    def _zones(self, frame: GridFrame) -> Zones | None:
        world, masks = self._world, self._masks
        return zones_of(
            frame, self._driven.controller_server.max_linear_vel,
            world.keepout_zones if world is not None else (),
            world.speed_limits if world is not None else (), masks.keepout, masks.speed,
        )  # fmt: skip

    def _abort(self, now_ns: int, reason: str) -> None:
        """Abort the task and drop all measurements."""
        self._measured.clear()
        self._photo_requested_ns = None
        self._was_active = False
        self._schedule.clear()
        if self._drive is not None:
            at_ns = max(now_ns, self._now_ns)
            navigator = self._drive.navigator
            self._goals.end(navigator.abort(at_ns, ErrorCode.WORLD_RESTARTED, reason))

    def _take_pose(self, inbox: Inbox) -> None:
        """Read odometry, its correction, and whether that can be trusted."""
        measured = self._measured
        for status, envelope in inbox.arrivals(LOCALIZATION_STATUS)[-1:]:
            measured.sources[LOCALIZATION_STATUS.name] = envelope.source
            if measured.take_localization(status) and self._drive is not None:
                found = measured.map_from_odom
                self._drive.forget_places(None if found is None else found[1])
        for odom, envelope in inbox.arrivals(ODOM):
            measured.sources[ODOM.name] = envelope.source
            stamp_ns = msg.ns_from_time(odom.header.stamp)
            if self._watch.is_of_this_run(stamp_ns, ODOM, inbox):
                twist = odom.twist.twist
                velocity = Velocity(twist.linear.x, twist.angular.z)
                measured.take_odometry(stamp_ns, msg.se2_from_pose(odom.pose.pose), velocity)
        for tree in inbox.new(TF):
            for entry in tree.transforms:
                if (entry.header.frame_id, entry.child_frame_id) != (MAP_FRAME, ODOM_FRAME):
                    continue
                stamp_ns = msg.ns_from_time(entry.header.stamp)
                if self._watch.is_of_this_run(stamp_ns, TF, inbox):
                    map_from_odom = msg.se2_from_transform(entry.transform)
                    jumps = measured.correct(stamp_ns, map_from_odom)
                    if self._drive is None:
                        continue
                    slipped = measured.odom_slipped(self._watch.epoch)
                    if slipped is not None:
                        self._drive.follow_slip(slipped)
                    if jumps:
                        self._drive.forget_places(map_from_odom)
        for claim in inbox.new(AMCL_POSE):
            if self._watch.is_of_this_run(msg.ns_from_time(claim.header.stamp), AMCL_POSE, inbox):
                measured.take_covariance(claim.pose.covariance)

    def _look_for_sources(self, inbox: Inbox) -> None:
        """Notice who sends no more, before it is noticed by the age of what came."""
        measured = self._measured
        lost = tuple(topic for topic, source in measured.sources.items() if inbox.is_gone(source))
        if lost != measured.lost:
            measured.lost = lost
            if lost:
                _LOG.warning("publisher of %s is gone: the robot stands", " and ".join(lost))
            else:
                _LOG.info("the publishers of odometry, pose and scan are there again")

    def _take_scans(self, inbox: Inbox) -> None:
        """Read the scans, oldest first: the costmaps, the moving obstacles and the echoes."""
        measured, lidar = self._measured, self._lidar
        for message, envelope in inbox.arrivals(SCAN):
            measured.sources[SCAN.name] = envelope.source
            stamp_ns = msg.ns_from_time(message.header.stamp)
            if not self._watch.is_of_this_run(stamp_ns, SCAN, inbox):
                continue
            if measured.odom is None or lidar is None:
                continue
            scan = Scan.from_message(message, lidar)
            if measured.is_frozen(scan):
                inbox.reject(SCAN, FROZEN)
                continue
            measured.take_scan(scan)
            if self._drive is not None:
                self._drive.take_scan(scan, measured, self._watch.epoch)

    def _take_depth_scans(self, inbox: Inbox) -> None:
        """Read the scans of depth images."""
        for message in inbox.new(DEPTH_SCAN):
            stamp_ns, measured = msg.ns_from_time(message.header.stamp), self._measured
            if not self._watch.is_of_this_run(stamp_ns, DEPTH_SCAN, inbox):
                continue
            if self._drive is None or measured.odom is None or self._depth_camera is None:
                continue
            scan = Scan.from_message(message, self._depth_camera)
            if measured.is_frozen(scan, is_depth=True):
                inbox.reject(DEPTH_SCAN, FROZEN)
                continue
            if any(self._drive.depth_sources):
                measured.take_depth(stamp_ns)
            self._drive.take_depth_scan(scan, message.intensities, measured, self._watch.epoch)

    def _static_margin_m(self) -> float:
        return self._measured.static_margin_m(
            self._config.global_costmap.obstacle_layer.static_margin
        )

    def _take_detections(self, inbox: Inbox) -> None:
        """Keep the newest sightings of each marker, for docking."""
        for seen in inbox.new(DETECTIONS):
            stamp_ns = msg.ns_from_time(seen.header.stamp)
            camera, drive = self._base_from_camera, self._drive
            if camera is None or drive is None or self._measured.odom is None:
                continue
            if not self._watch.is_of_this_run(stamp_ns, DETECTIONS, inbox):
                continue
            # Where the robot was when the picture was taken.
            odom_from_base = self._measured.odometry.at(stamp_ns) or self._measured.odom[1]
            for _ in range(drive.see_markers(stamp_ns, seen, camera, odom_from_base)):
                inbox.reject(DETECTIONS, "marker id twice in a picture")

    def _take_photos(self, inbox: Inbox) -> None:
        """Count the picture that was requested at a waypoint."""
        for photo in inbox.new(PHOTO):
            stamp_ns = msg.ns_from_time(photo.header.stamp)
            requested_ns = self._photo_requested_ns
            if self._drive is None or requested_ns is None or stamp_ns < requested_ns:
                continue
            if self._watch.is_of_this_run(stamp_ns, PHOTO, inbox):
                self._photo_requested_ns = None
                self._drive.navigator.exchange.photos += 1

    def _hear_selectors(self, inbox: Inbox, robot: RobotContext) -> None:
        """Take the names of the plugins that a behaviour tree is to use; a name that there is none
        of changes nothing.
        """
        for topic, check in (
            (CONTROLLER_SELECTOR, robot.controller_server.check_name),
            (PLANNER_SELECTOR, robot.planner_server.check_name),
        ):
            for name in inbox.new(topic):
                try:
                    check(name.data)
                except NavigationError as error:
                    inbox.reject(topic, "unknown name")
                    _LOG.error("%s: %s", topic.name, error.message)
                else:
                    robot.told.names_heard[topic.name.lstrip("/")] = name.data

    def _hear_speed_limits(self, inbox: Inbox) -> None:
        """Take the highest speed; one that is none changes nothing."""
        for heard in inbox.new(SPEED_LIMIT):
            over = heard.percentage and heard.speed_limit > 100.0
            if heard.speed_limit < 0.0 or over:
                inbox.reject(SPEED_LIMIT, "out of range")
                asked = "must be 0 to 100 percent" if heard.percentage else "must be 0 m/s or more"
                _LOG.error("%s: speed_limit %g: %s", SPEED_LIMIT.name, heard.speed_limit, asked)
                continue
            limit = act.SpeedLimit(percentage=heard.percentage, speed_limit=heard.speed_limit)
            # Some send it again and again.
            if limit != self._told.speed_limit:
                self._told.speed_limit = limit
                _LOG.info("Speed limit: %s", limit)

    def _hear_goal_updates(self, now_ns: int, inbox: Inbox, robot: RobotContext) -> None:
        """Take where the goal of the task has moved to."""
        for update in inbox.new(GOAL_UPDATE):
            frame_id, stamp_ns = update.header.frame_id, msg.ns_from_time(update.header.stamp)
            if frame_id not in ("", MAP_FRAME):
                reason = "frame_id is not map"
                problem = f"frame_id {frame_id!r:.40}: must be 'map' or empty"
            elif not robot.hear_goal_update(msg.se2_from_pose(update.pose), stamp_ns):
                reason = "older than the goal"
                problem = f"stamp {stamp_ns * 1e-9:.3f} s: must not be older than the task's goal"
            else:
                continue
            inbox.reject(GOAL_UPDATE, reason)
            # They may come many times a second.
            if self._schedule.is_due(reason, now_ns, _REJECTED_PERIOD_NS):
                _LOG.error("%s: %s", GOAL_UPDATE.name, problem)

    def _localized(self) -> bool:
        """Whether the pose is known and can be trusted."""
        return self._measured.is_localized(self._watch.epoch)

    def _ready_drive(self) -> Drive:
        missing = self.waiting_for()
        if missing == _LOCALIZATION and self._measured.wants_motion(self._watch.epoch):
            # With a goal, a robot that is lost moves until its pose is found.
            missing = None
        if missing is not None or self._drive is None:
            raise NavigationError(
                ErrorCode.GOAL_REJECTED, f"navigation is not active: waiting for {missing}"
            )
        return self._drive

    def _answer(self, now_ns: int, inbox: Inbox) -> None:
        """Reply to the queries."""
        drive, ready = self._drive, self._ready_drive
        for send in inbox.requests(SEND_GOAL):
            send.respond(self._goals.send(now_ns, send.message, ready))
        # Until it is known whether a goal goes on, who cancels it waits.
        if inbox.is_handed_over and (self._kept is None or self._world is not None):
            for cancel in inbox.requests(CANCEL_GOAL):
                cancel.respond(self._goals.cancel(now_ns, drive, cancel.message))
        for pause in inbox.requests(PAUSE_GOAL):
            pause.respond(self._goals.pause(drive, pause.message.pause))
        for given in inbox.requests(INPUT_AT_WAYPOINT):
            given.respond(input_at_waypoint(drive))
        for path in inbox.requests(COMPUTE_PATH):
            path.respond(compute_path(path.message, ready))
        for smooth in inbox.requests(SMOOTH_PATH):
            smooth.respond(smooth_path(smooth.message, ready))
        for clear in inbox.requests(CLEAR_COSTMAP):
            clear.respond(clear_costmap(clear.message, ready))
        for toggle in inbox.requests(TOGGLE_COLLISION_MONITOR):
            self._told.monitor_enabled = toggle.message.enable
            toggle.respond(act.Reply())

    def _set_parameters(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Change parameters, also while the robot drives."""
        for wanted in inbox.requests(SET_PARAMETERS):
            try:
                self._change(now_ns, wanted.message.values, outbox)
            except ConfigError as error:
                wanted.respond(SetParametersReply(error=str(error)))
            else:
                wanted.respond(SetParametersReply())

    def _change(self, now_ns: int, values: Mapping[str, JsonValue], outbox: Outbox) -> None:
        """Raises ConfigError where a value is invalid, or cannot be changed."""
        for name in values:
            if not name.startswith(self.live_parameters):
                raise ConfigError(f"{name}: read only: it is read at the start")
        config = with_values(self._config, values)
        check_parts(config)
        self._drive_by(config)
        if "collision_monitor.enabled" in values:
            # Whatever it was toggled to since.
            self._told.monitor_enabled = config.collision_monitor.enabled
        told = self.parameters()
        changed = {name: value_of(told.values, name) for name in values}
        self._changed = {**self._changed, **changed}
        outbox.put(PARAMETERS, told)
        outbox.put(PARAMETER_EVENTS, parameter_event(self, now_ns, changed))
        _LOG.info("Set %s", ", ".join(f"{name} to {value}" for name, value in values.items()))

    def _take_limits(self, inbox: Inbox) -> None:
        """Keep to what the robot can do, as physics tells it."""
        for told, envelope in inbox.arrivals(PARAMETERS):
            if told.service != "physics" or inbox.is_gone(envelope.source):
                continue
            limits = limits_of(told.values)
            if limits != self._limits:
                self._limits = limits
                self._drive_by(self._config)

    def _drive_by(self, config: NavigationConfig) -> None:
        """Drive by a configuration, within what the robot can do."""
        driven, told = within(config, self._limits), beyond(config, self._limits)
        if self._drive is not None:
            random = random_generator(self._watch.seed, "navigation/control")
            reconfigure(self._drive, self._driven, driven, random)
        of_m_s = self._driven.controller_server.max_linear_vel
        self._config, self._driven = config, driven
        if self._drive is not None and driven.controller_server.max_linear_vel != of_m_s:
            # Limits in percent are of the highest speed.
            self._drive.robot.planner_server.zones = self._zones(self._drive.robot.costmap.frame)
        if told:
            _LOG.warning("%s", told)

    def _control(self, now_ns: int, outbox: Outbox, passes: bool) -> None:
        """Run one control period; if no time has passed, only publish results of ended goals."""
        command: Velocity | None = None
        drive, measured = self._drive, self._measured
        if passes and drive is not None and measured.odom is not None:
            command, ended = drive.wanted(now_ns, measured, self._watch.epoch)
            self._goals.end(ended)
            drive.keep_pace(now_ns)
            if drive.robot.new_path is not None:
                outbox.put(PLAN, path_message(now_ns, drive.robot.new_path))
            command = drive.smoothed(now_ns, command, measured.velocity)
            self._request_photo(now_ns, outbox, drive.navigator.exchange)
            if command is not None:
                watched = drive.monitored(now_ns, command, measured)
                self._monitor_state = watched.state
                command = watched.velocity if watched.publish else None
        if drive is not None and drive.robot.wants_global_localization:
            drive.robot.wants_global_localization = False
            outbox.put(GLOBAL_LOCALIZATION_REQUEST, act.Empty())
        stands = self._goals.current is None or passes
        if command is None and self._moving and stands:
            command = STOP
            if drive is not None:
                # No ramp follows a stop that was sent while time stood still.
                drive.smoother.reset()
        if command is not None:
            self._moving = command != STOP
            outbox.put(CMD_VEL, twist_message(now_ns, command))
        docks = dict[str, SE2] if drive is None else drive.robot.docks.docked
        for result in self._goals.take_results(docks):
            if isinstance(result, NavigationResult):
                outbox.put(NAVIGATION_RESULT, result)
            else:
                outbox.put(ACTION_RESULT, result)

    def _request_photo(self, now_ns: int, outbox: Outbox, exchange: WaypointExchange) -> None:
        index, exchange.photo_wanted_at = exchange.photo_wanted_at, None
        if index is not None:
            self._photo_requested_ns = now_ns
            outbox.put(PHOTO_REQUEST, act.PhotoRequest(waypoint=index, stamp_ns=now_ns))

    def _publish(self, now_ns: int, outbox: Outbox) -> None:
        """Publish costmaps, feedback and status."""
        drive = self._drive
        if drive is None:
            self._publish_checkpoint(now_ns, outbox, None)
            self._publish_status(now_ns, outbox, None)
            return
        self._publish_zones(now_ns, outbox, drive.robot)
        self._publish_costmap(now_ns, outbox, drive.robot.costmap)
        if self._measured.echoes is not None and self._schedule.is_due(
            "local", now_ns, _LOCAL_COSTMAP_PERIOD_NS
        ):
            local = drive.robot.local_costmap
            outbox.offer(LOCAL_COSTMAP, lambda: costmap_message(now_ns, local, ODOM_FRAME))
            odom = self._measured.odom
            if odom is not None:
                footprint = drive.robot.footprint
                outbox.offer(
                    PUBLISHED_FOOTPRINT, lambda: footprint_message(now_ns, footprint, odom[1])
                )
        state = self._monitor_state
        if state is not None and drive.monitor_published != (state.action, state.polygon_name):
            drive.monitor_published = (state.action, state.polygon_name)
            outbox.put(COLLISION_MONITOR_STATE, monitor_document(state))
        self._publish_tree(now_ns, outbox, drive.navigator)
        self._publish_trajectories(now_ns, outbox, drive.robot)
        feedback = drive.navigator.feedback(now_ns)
        if feedback is not None and self._goals.current is not None:
            if self._schedule.is_due("feedback", now_ns, _FEEDBACK_PERIOD_NS):
                request, paused = drive.navigator.request, drive.navigator.paused
                goal = None if request is None else goal_of(request, drive.robot.docks.docked())
                outbox.put(
                    ACTION_FEEDBACK,
                    feedback_document(
                        self._goals.current.goal_id, feedback, paused, goal, drive.stopped_at
                    ),
                )
        self._publish_checkpoint(now_ns, outbox, feedback)
        self._publish_status(now_ns, outbox, feedback)

    def _publish_checkpoint(
        self, now_ns: int, outbox: Outbox, feedback: TaskFeedback | None
    ) -> None:
        if not outbox.is_read(NAVIGATION_CHECKPOINT):
            return
        if not (self._resumed or self._checkpoint):
            # What others keep may still come, until it was taken up.
            return
        goal = self._goals.remaining(now_ns, feedback)
        if goal is not None and self._drive is not None:
            goal = goal._replace(paused=self._drive.navigator.paused)
        goal = goal or self._goals.before
        now = self._checkpoint_of(goal)
        if now != self._checkpoint:
            self._put_checkpoint(outbox, now)

    def _checkpoint_of(self, goal: Goal | None) -> _Checkpoint:
        run = self.world_hash, self._watch.epoch
        return _Checkpoint(*run, goal, self._changed, self._told.speed_limit)

    def _put_checkpoint(self, outbox: Outbox, now: _Checkpoint) -> None:
        self._checkpoint, goal = now, now.goal
        outbox.put(
            NAVIGATION_CHECKPOINT,
            act.NavigationCheckpoint(
                world_hash=now.world_hash,
                epoch=now.epoch,
                parameters=dict(now.parameters),
                speed_limit=now.speed_limit,
                goal=None if goal is None else goal.asked,
                goal_id="" if goal is None else goal.goal_id,
                goal_stamp_ns=None if goal is None else goal.stamp_ns,
                start_ns=0 if goal is None else goal.start_ns,
                resumed=0 if goal is None else goal.resumed,
                missed=() if goal is None else goal.missed,
                paused=goal is not None and goal.paused,
                explores=goal is not None and goal.explores,
            ),
        )

    def _publish_zones(self, now_ns: int, outbox: Outbox, robot: RobotContext) -> None:
        """Publish masks of the zones; of zones that were removed, an empty one."""
        frame, zones, shown = robot.costmap.frame, robot.zones, self._zones_shown
        if zones is shown:
            return
        self._zones_shown = zones
        if any(each is not None and each.keepout.size for each in (zones, shown)):
            keepout = zones.keepout if zones is not None and zones.keepout.size else None
            outbox.put(KEEPOUT_FILTER_MASK, mask_message(now_ns, frame, keepout))
        if any(each is not None and each.limits_m_s.size for each in (zones, shown)):
            highest_m_s = self._driven.controller_server.max_linear_vel
            speeds = zones.speed_values(highest_m_s) if zones is not None else None
            outbox.put(SPEED_FILTER_MASK, mask_message(now_ns, frame, speeds))

    def _publish_costmap(self, now_ns: int, outbox: Outbox, costmap: LayeredCostmap) -> None:
        if costmap.revision == self._costmap_shown:
            return
        if self._schedule.is_due("costmap", now_ns, _COSTMAP_PERIOD_NS):
            self._costmap_shown = costmap.revision
            self._frame_shown = costmap.frame
            costmap.take_changed()
            outbox.offer(GLOBAL_COSTMAP, lambda: costmap_message(now_ns, costmap, MAP_FRAME))
        elif costmap.frame is self._frame_shown and outbox.is_read(GLOBAL_COSTMAP_UPDATES):
            self._publish_costmap_update(now_ns, outbox, costmap)

    def _publish_costmap_update(self, now_ns: int, outbox: Outbox, costmap: LayeredCostmap) -> None:
        if not self._schedule.is_due("costmap updates", now_ns, _COSTMAP_UPDATES_PERIOD_NS):
            return
        changed = costmap.take_changed()
        if changed is not None:
            update = costmap_update_message(now_ns, costmap, changed, MAP_FRAME)
            outbox.put(GLOBAL_COSTMAP_UPDATES, update)

    def _publish_tree(self, now_ns: int, outbox: Outbox, navigator: BtNavigator) -> None:
        if not outbox.is_read(BEHAVIOR_TREE):
            return
        self._tree_log.add(navigator.running_tree())
        if not self._schedule.is_due("tree", now_ns, _TREE_PERIOD_NS):
            return
        action = navigator.request.action if navigator.request is not None else ""
        tree = action, self._tree_log.take()
        if tree != self._tree_published:
            self._tree_published = tree
            outbox.put(BEHAVIOR_TREE, tree_document(*tree))

    def _publish_trajectories(self, now_ns: int, outbox: Outbox, robot: RobotContext) -> None:
        controller = robot.controller_server.controller
        if not robot.controlled or not isinstance(controller, MPPIController):
            return
        if not outbox.is_read(TRAJECTORIES):
            return
        if self._schedule.is_due("trajectories", now_ns, _TRAJECTORIES_PERIOD_NS):
            drawn = controller.trajectories()
            if drawn is not None:
                outbox.put(TRAJECTORIES, trajectories_message(now_ns, drawn))

    def _stop_causes(self, now_ns: int) -> tuple[StopCause, ...]:
        """Why the robot does not drive as it could; what is new of it is said."""
        timeout_s = self._config.controller_server.sensor_timeout
        causes = stop_causes(self._measured, now_ns, timeout_s, self.waiting_for())
        before = () if self._status is None else self._status[-1]
        for cause in causes if causes != before else ():
            # What stops the robot for a moment is said where it is noticed.
            if cause.level != "stop" and cause not in before:
                _LOG.warning("%s: %s; cleared by %s", cause.level, cause.cause, cause.cleared_by)
        return causes

    def _publish_status(self, now_ns: int, outbox: Outbox, feedback: TaskFeedback | None) -> None:
        drive = self._drive
        request = drive.navigator.request if drive is not None else None
        goal = request.pose if isinstance(request, NavigateToPose) else None
        before = self._goals.before.asked if self._goals.before is not None else None
        if self._kept is not None:
            before = self._kept.goal
        if isinstance(before, act.NavigateToPose):
            # It is not lost: nobody need send it again.
            goal = before.pose.se2()
        localized = self._localized() and drive is not None
        state = "idle"
        if drive is not None and request is not None:
            state = drive.state()
        elif (waits := self._kept or self._goals.before) is not None and waits.paused:
            state = "held"
        remaining_m = feedback.distance_remaining_m if feedback is not None else None
        recoveries = feedback.number_of_recoveries if feedback is not None else 0
        causes = self._stop_causes(now_ns)
        status = (localized, state, goal, recoveries, causes)
        # Called on every step, so that the period counts from the last status published.
        due = self._schedule.is_due("status", now_ns, _STATUS_PERIOD_NS)
        if due or status != self._status:
            document = NavigationStatus(
                localization_active=localized,
                navigation_active=localized,
                state=state,
                goal=None if goal is None else planar_document(goal),
                distance_remaining_m=remaining_m or 0.0,
                number_of_recoveries=recoveries,
                stop_level=severest(causes),
                stop_causes=causes,
            )
            outbox.put(NAVIGATION_STATUS, document)
        if localized != self._was_active:
            self._was_active = localized
            _LOG.info(
                "navigation is active" if localized else "navigation is inactive: not localized"
            )
        self._status = status
