"""The node: sensors in, pose, plan and velocity out. The only file here that uses topics."""

from __future__ import annotations

import logging
from typing import ClassVar, NamedTuple

import numpy as np

from services.common import portable, portable_kernels
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
)
from services.common.node import messages as msg
from services.common.node.documents import (
    CancelGoalReply,
    Entities,
    NavigationStatus,
    World,
)
from services.common.node.frame_tree import FrameTree
from services.common.node.node import Inbox, Node, Outbox, random_generator
from services.common.node.topics import (
    AMCL_POSE,
    CANCEL_GOAL,
    CMD_VEL,
    DETECTIONS,
    ENTITIES,
    GLOBAL_COSTMAP,
    GOAL_POSE,
    INITIAL_POSE,
    MAP,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    ODOM,
    PARTICLE_CLOUD,
    PLAN,
    SCAN,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    WORLD,
)
from services.common.world.costmap import straightened
from services.navigation.collision import STOP, Surroundings, Velocity
from services.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from services.navigation.costmap import LayeredCostmap, frame_of, scan_points
from services.navigation.errors import NavigationError
from services.navigation.kernels import compile_kernels
from services.navigation.localization import Localization
from services.navigation.messages import (
    cloud_message,
    costmap_message,
    path_message,
    planar_document,
    result_message,
    twist_message,
)
from services.navigation.navigator import Goal, GoalResult, Navigator

_LOG = logging.getLogger("navigation")

_AMCL_POSE_PERIOD_NS = 100_000_000
_STATUS_PERIOD_NS = 500_000_000
_PARTICLES_PERIOD_NS = 500_000_000
_COSTMAP_PERIOD_NS = 1_000_000_000
MAX_CELLS = 4_000_000
"""Of a map, e.g. 100 m by 100 m in cells of 5 cm: costmap and localisation take some 100 bytes for
each.
"""
_MOST_GOALS_TRIED = 4
"""Of goals that arrive together: planning a path to each takes milliseconds."""
_ECHOES_WITHIN_M = 1.5
"""Echoes farther away cannot be reached within the controller's horizon."""


class _Echoes(NamedTuple):
    """The newest scan's echoes, with the odometry at that scan."""

    stamp_ns: int
    odom_from_base: SE2
    base_points_m: Array


class NavigationNode(Node):
    """Localises the robot in the map and drives it to goals."""

    name: ClassVar[str] = "navigation"
    _config: NavigationConfig
    period_ns: ClassVar[int | None] = CONTROL_PERIOD_NS

    def __init__(self, config: NavigationConfig) -> None:
        self._config = config
        self._world: World | None = None
        self._map: msg.OccupancyGrid | None = None
        self._entities: Entities | None = None
        self._markers: dict[tuple[str, int], Array] = {}
        self._static_frames = FrameTree()
        self._base_from: dict[str, Array] = {}
        self._costmap: LayeredCostmap | None = None
        self._navigator: Navigator | None = None
        self._localization: Localization | None = None
        self._started = False
        """Whether localisation was given the start pose."""
        self._odom: tuple[int, SE2] | None = None
        self._echoes: _Echoes | None = None
        self._now_ns = 0
        self._moving = False
        """Whether the last command published was not a stop."""
        self._was_active = False
        self._status: tuple[bool, bool, str, SE2 | None, int] | None = None
        """The status last published, without the distance remaining."""
        self._due_ns: dict[str, int] = {}
        self._costmap_shown = -1
        self._results: list[GoalResult] = []
        self._epoch: int | None = None
        self._begun_ns = 0
        """When the epoch began: earlier measurements belong to another one."""
        self._seed = config.seed
        """The simulation's seed, as soon as it is known."""
        compile_kernels(config)

    def waiting_for(self) -> str | None:
        """A phrase for the first missing input that keeps the robot from driving."""
        if self._world is None:
            return "the world"
        if self._costmap is None:
            return "the map"
        if SCAN_FRAME not in self._base_from:
            return "the robot's fixed frames"
        if self._odom is None:
            return "odometry"
        if self._echoes is None:
            return "a scan"
        if not self._localized():
            return "localisation to converge"
        return None

    def nominal_rates_hz(self) -> dict[str, float]:
        """See Node."""
        if self._localization is None or not self._started:
            return {}
        return {TF.name: 1e9 / CONTROL_PERIOD_NS, AMCL_POSE.name: 1e9 / _AMCL_POSE_PERIOD_NS}

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Process sensor messages, run one control period, publish pose and status."""
        if self._simulation_began_anew(now_ns, inbox):
            _LOG.info("the simulation began anew: so does navigation")
            self._begin_anew(now_ns, ErrorCode.WORLD_RESTARTED, "the simulation began anew")
        # A query also wakes the node while time is stopped: that is no control period.
        passes = now_ns != self._now_ns
        self._now_ns = now_ns
        self._learn_world(now_ns, inbox)
        self._localize(now_ns, inbox)
        self._take_goals(now_ns, inbox)
        self._cancel_goals(now_ns, inbox)
        self._drive(now_ns, outbox, passes)
        self._tell(now_ns, outbox)

    def _simulation_began_anew(self, now_ns: int, inbox: Inbox) -> bool:
        """Whether the simulation was reset or its seed changed: time went back, or its statistics
        have another epoch or seed.
        """
        anew = now_ns < self._now_ns
        if anew:
            self._begun_ns = 0
        for stats in inbox.new(SIMULATION_STATS):
            if self._epoch is not None and stats.epoch != self._epoch:
                anew = True
                self._begun_ns = round(stats.sim_time_s * 1e9)
            anew = anew or stats.seed != self._seed
            self._epoch, self._seed = stats.epoch, stats.seed
        return anew

    def _learn_world(self, now_ns: int, inbox: Inbox) -> None:
        """Process latched topics. The same world or map, received again, changes nothing."""
        world = inbox.latest(WORLD)
        if world is not None and (self._world is None or world.hash != self._world.hash):
            self._world = world
            self.world_hash = world.hash
            self._begin_anew(now_ns, ErrorCode.WORLD_RESTARTED, f"the world is now {world.name}")
            self._register_markers()
        grid = inbox.latest(MAP)
        if grid is not None and not _same_map(grid, self._map):
            self._take_map(now_ns, grid, inbox)
        entities = inbox.latest(ENTITIES)
        if entities is not None:
            self._entities = entities
            self._register_markers()
        for tree in inbox.new(TF_STATIC):
            problem = self._static_frames.add(tree)
            if problem:
                inbox.reject(TF_STATIC, problem)
                continue
            self._base_from = {}
            for frame in (SCAN_FRAME, CAMERA_OPTICAL_FRAME):
                matrix = self._static_frames.chain(BASE_FOOTPRINT_FRAME, frame)
                if matrix is not None:
                    self._base_from[frame] = matrix

    def _take_map(self, now_ns: int, grid: msg.OccupancyGrid, inbox: Inbox) -> None:
        origin = msg.se2_from_pose(grid.info.origin)
        try:
            if len(grid.data) > MAX_CELLS:
                raise ValueError(f"{len(grid.data)} cells: must be at most {MAX_CELLS}")
            cells = np.array(msg.cells_from_grid(grid), np.int8)
            # Localisation takes a rotated map; planning needs its rows along the map's axes.
            origin, cells = straightened(grid.info.resolution, origin, cells)
            frame = frame_of(grid.info.resolution, origin, cells)
            self._costmap = LayeredCostmap(
                frame, cells, self._config.inflation(), self._config.obstacle()
            )
        except ValueError as error:
            inbox.reject(MAP, "not a map to drive in")
            _LOG.error("map: %s", error)
            return
        self._map = grid
        self._begin_anew(now_ns, ErrorCode.WORLD_RESTARTED, "the map is another one")
        _LOG.info(
            "Received a %d X %d map @ %.3f m/pix",
            frame.columns, frame.rows, frame.resolution_m,
        )  # fmt: skip

    def _register_markers(self) -> None:
        """Store the pose of each known marker. Two of one id cannot be distinguished: neither is
        used.
        """
        self._markers = {}
        if self._entities is None or self._world is None:
            return
        if self._entities.world_hash != self._world.hash:
            return
        doubled = set()
        for entity in self._entities.markers:
            key = (entity.dictionary, entity.marker_id)
            if key in self._markers:
                doubled.add(key)
            self._markers[key] = pose_matrix(entity)
        for key in sorted(doubled):
            _LOG.warning("marker %d of %s hangs in two places: not used", key[1], key[0])
            del self._markers[key]

    def _begin_anew(self, now_ns: int, code: ErrorCode, why: str) -> None:
        """Abort the goal and drop all measurements; localisation restarts at the start pose."""
        if self._navigator is not None:
            aborted = self._navigator.abort(max(now_ns, self._now_ns), code, why)
            if aborted is not None:
                self._results.append(aborted)
        self._odom = None
        self._echoes = None
        self._started = False
        self._was_active = False
        self._due_ns.clear()
        self._localization = None
        self._navigator = None
        if self._costmap is None or self._map is None or self._world is None:
            return
        self._costmap.clear()
        self._navigator = Navigator(
            self._config.navigator(self._costmap.frame.resolution_m), self._costmap
        )
        try:
            self._localization = Localization(
                self._config.localization,
                np.array(msg.cells_from_grid(self._map), np.int8),
                self._costmap.frame.resolution_m,
                msg.se2_from_pose(self._map.info.origin),
                random_generator(self._seed, "navigation/localization"),
            )
        except ValueError as error:
            _LOG.error("map: %s", error)

    def _localize(self, now_ns: int, inbox: Inbox) -> None:
        """Update the pose: odometry first, then scans and detections, oldest first."""
        localization = self._localization
        odometry, scans = inbox.new(ODOM), inbox.new(SCAN)
        sightings, poses = inbox.new(DETECTIONS), inbox.new(INITIAL_POSE)
        if localization is None:
            return
        for odom in odometry:
            stamp_ns = msg.ns_from_time(odom.header.stamp)
            if stamp_ns > now_ns:
                # From a simulation that has ended since.
                inbox.reject(ODOM, "later than now")
                continue
            if stamp_ns < self._begun_ns:
                inbox.reject(ODOM, "of an earlier epoch")
                continue
            odom_from_base = msg.se2_from_pose(odom.pose.pose)
            localization.odometry(stamp_ns, odom_from_base)
            self._odom = (stamp_ns, odom_from_base)
        if self._odom is None or SCAN_FRAME not in self._base_from:
            return
        if not self._started:
            self._start_at(localization, self._odom[1])
        for initial in poses:
            self._take_initial_pose(localization, initial, inbox)
        seen: list[tuple[int, int, msg.LaserScan | msg.Detection3DArray]] = []
        seen += [(msg.ns_from_time(s.header.stamp), 0, s) for s in scans]
        seen += [(msg.ns_from_time(s.header.stamp), 1, s) for s in sightings]
        for stamp_ns, _, message in sorted(seen, key=lambda item: item[:2]):
            if stamp_ns > now_ns:
                if isinstance(message, msg.LaserScan):
                    inbox.reject(SCAN, "later than now")
                else:
                    inbox.reject(DETECTIONS, "later than now")
            elif stamp_ns < self._begun_ns:
                if isinstance(message, msg.LaserScan):
                    inbox.reject(SCAN, "of an earlier epoch")
                else:
                    inbox.reject(DETECTIONS, "of an earlier epoch")
            elif isinstance(message, msg.LaserScan):
                self._take_scan(localization, stamp_ns, message)
            else:
                self._take_detections(localization, stamp_ns, message, inbox)

    def _start_at(self, localization: Localization, odom_from_base: SE2) -> None:
        """Set the initial pose from the world's start and odometry, which begins at zero there.

        This holds at the start, and for a process that is started while the robot is driving.
        """
        assert self._world is not None
        self._started = True
        config, origin = self._config, SE2(0.0, 0.0, 0.0)
        pose = self._world.start.se2() @ odom_from_base
        drift = config.odometry_drift_ratio * odom_from_base.distance_m(origin)
        variances = [
            portable.square(config.initial_pose_std_m + drift),
            portable.square(config.initial_pose_std_m + drift),
            portable.square(config.initial_pose_std_rad + drift),
        ]
        localization.initialize(pose, np.diag(variances))
        _LOG.info("Setting pose: %.3f %.3f %.3f", *pose)

    def _take_initial_pose(
        self, localization: Localization, initial: msg.PoseWithCovarianceStamped, inbox: Inbox
    ) -> None:
        pose = msg.se2_from_pose(initial.pose.pose)
        assert self._costmap is not None
        if initial.header.frame_id not in ("", MAP_FRAME):
            inbox.reject(INITIAL_POSE, "frame is not map")
        elif self._costmap.frame.cell(pose.x_m, pose.y_m) is None:
            inbox.reject(INITIAL_POSE, "outside the map")
        else:
            index = np.ix_([0, 1, 5], [0, 1, 5])
            covariance = np.array(initial.pose.covariance, np.float64).reshape(6, 6)[index]
            floor = np.diag(
                [
                    portable.square(self._config.initial_pose_std_m),
                    portable.square(self._config.initial_pose_std_m),
                    portable.square(self._config.initial_pose_std_rad),
                ]
            )
            try:
                localization.initialize(pose, covariance + floor)
            except ValueError:
                inbox.reject(INITIAL_POSE, "not a covariance")
                return
            _LOG.info("Setting pose: %.3f %.3f %.3f", *pose)

    def _take_scan(self, localization: Localization, stamp_ns: int, scan: msg.LaserScan) -> None:
        assert self._odom is not None
        base_from_scan = _planar(self._base_from[SCAN_FRAME])
        localization.scan(
            stamp_ns, scan.ranges, scan.angle_min, scan.angle_increment,
            scan.range_min, scan.range_max, base_from_scan,
        )  # fmt: skip
        points_m = scan_points(
            base_from_scan, scan.ranges, scan.angle_min, scan.angle_increment,
            scan.range_min, min(scan.range_max, _ECHOES_WITHIN_M),
        )  # fmt: skip
        self._echoes = _Echoes(stamp_ns, self._odom[1], points_m)
        if self._costmap is not None and self._localized():
            pose = localization.map_from_base()
            self._costmap.update(
                pose @ base_from_scan, scan.ranges, scan.angle_min, scan.angle_increment,
                scan.range_min,
            )  # fmt: skip

    def _take_detections(
        self, localization: Localization, stamp_ns: int, seen: msg.Detection3DArray, inbox: Inbox
    ) -> None:
        camera = self._base_from.get(CAMERA_OPTICAL_FRAME)
        if camera is None:
            return
        for detection in seen.detections:
            entry = self._marker_of(detection)
            if entry is None:
                inbox.reject(DETECTIONS, "unknown marker")
                continue
            candidates = [
                (
                    msg.matrix_from_pose(result.pose.pose),
                    np.array(result.pose.covariance, np.float64).reshape(6, 6),
                    float(result.hypothesis.score),
                )
                for result in detection.results
            ]
            localization.marker(stamp_ns, entry, candidates, camera)

    def _marker_of(self, detection: msg.Detection3D) -> Array | None:
        """map_from_marker of a detection; None if it is not one of the world's markers."""
        if not detection.results:
            return None
        try:
            marker_id = int(detection.results[0].hypothesis.class_id)
        except ValueError:
            return None
        found = [matrix for (_, known_id), matrix in self._markers.items() if known_id == marker_id]
        return found[0] if len(found) == 1 else None

    def _localized(self) -> bool:
        localization = self._localization
        return (
            localization is not None
            and self._started
            and self._echoes is not None
            and localization.converged
            and localization.scan_match >= self._config.min_scan_match
        )

    def _take_goals(self, now_ns: int, inbox: Inbox) -> None:
        """Accept the newest valid goal; those before it would be preempted at once."""
        tries, taken = _MOST_GOALS_TRIED, False
        results: list[GoalResult] = []
        for message in reversed(inbox.new(GOAL_POSE)):
            pose = msg.se2_from_pose(message.pose)
            goal = Goal(pose, msg.ns_from_time(message.header.stamp))
            if taken or not tries:
                code, why = ErrorCode.PREEMPTED, "preempted by a new goal"
                results.append(GoalResult(goal, code, why, now_ns, now_ns, 0))
                continue
            tries -= 1
            try:
                ended = self._accept(now_ns, goal, message.header.frame_id)
            except NavigationError as error:
                _LOG.error("Goal rejected with error %d: %s", error.code, error.message)
                ended = GoalResult(goal, error.code, error.message, now_ns, now_ns, 0)
            else:
                taken = True
            if ended is not None:
                results.append(ended)
        self._results += reversed(results)

    def _accept(self, now_ns: int, goal: Goal, frame_id: str) -> GoalResult | None:
        if frame_id not in ("", MAP_FRAME):
            raise NavigationError(
                ErrorCode.TF_ERROR, f"frame_id {frame_id!r:.40}: must be 'map' or empty"
            )
        missing = self.waiting_for()
        if missing is not None or self._navigator is None or self._localization is None:
            raise NavigationError(
                ErrorCode.GOAL_REJECTED, f"navigation is not active: it waits for {missing}"
            )
        pose = self._localization.map_from_base()
        return self._navigator.accept(now_ns, goal, pose)

    def _cancel_goals(self, now_ns: int, inbox: Inbox) -> None:
        for request in inbox.requests(CANCEL_GOAL):
            request.respond(self._cancel(now_ns, request.message.goal_stamp_ns))

    def _cancel(self, now_ns: int, stamp_ns: int | None) -> CancelGoalReply:
        """Cancel the goal with this stamp; None: any goal."""
        navigator = self._navigator
        goal = navigator.goal if navigator is not None else None
        if navigator is None or goal is None or stamp_ns not in (None, goal.stamp_ns):
            said = "no goal" if stamp_ns is None else f"goal_stamp_ns: {stamp_ns}: no such goal"
            return CancelGoalReply(error=f"{said} is being driven to", return_code=2)
        ended = navigator.abort(now_ns, ErrorCode.CANCELED, "canceled")
        if ended is not None:
            self._results.append(ended)
        return CancelGoalReply(goal=planar_document(goal.pose), goal_stamp_ns=goal.stamp_ns)

    def _drive(self, now_ns: int, outbox: Outbox, passes: bool) -> None:
        """Run one control period; if no time has passed, only publish results of ended goals."""
        navigator, localization, costmap = self._navigator, self._localization, self._costmap
        command: Velocity | None = None
        if (
            passes
            and navigator is not None
            and navigator.goal is not None
            and localization is not None
            and costmap is not None
            and self._odom is not None
            and self._echoes is not None
        ):
            oldest_ns = min(self._odom[0], self._echoes.stamp_ns)
            if now_ns - oldest_ns > self._config.sensor_timeout * 1e9:
                command = STOP
            else:
                pose = localization.map_from_base()
                around = Surroundings(pose, costmap.master, self._echoes_now(self._echoes))
                outcome = navigator.step(now_ns, around, self._localized())
                command = outcome.command
                if outcome.new_path is not None:
                    outbox.put(PLAN, path_message(now_ns, outcome.new_path))
                if outcome.result is not None:
                    self._results.append(outcome.result)
        stands = navigator is None or navigator.goal is None or passes
        if command is None and self._moving and stands:
            command = STOP
        if command is not None:
            self._moving = command != STOP
            outbox.put(CMD_VEL, twist_message(now_ns, command))
        for result in self._results:
            outbox.put(NAVIGATION_RESULT, result_message(result))
        self._results.clear()

    def _echoes_now(self, echoes: _Echoes) -> Array:
        """(n, 2) the newest echoes in the current base frame."""
        assert self._odom is not None
        now_from_then = self._odom[1].inverse() @ echoes.odom_from_base
        c, s = portable_kernels.cos_sin(now_from_then.yaw_rad)
        turned = portable.product(echoes.base_points_m, np.array([[c, s], [-s, c]]))
        return np.ascontiguousarray(turned + np.array([now_from_then.x_m, now_from_then.y_m]))

    def _tell(self, now_ns: int, outbox: Outbox) -> None:
        """Publish the pose, the particles, the costmap and the status."""
        localization = self._localization
        if localization is not None and self._started:
            outbox.put(
                TF,
                msg.TFMessage(
                    transforms=[
                        msg.planar_transform_stamped(
                            now_ns, MAP_FRAME, ODOM_FRAME, localization.map_from_odom()
                        )
                    ]
                ),
            )
            if self._is_due("amcl_pose", now_ns, _AMCL_POSE_PERIOD_NS):
                outbox.put(AMCL_POSE, self._pose_message(localization))
            if self._is_due("particles", now_ns, _PARTICLES_PERIOD_NS):
                outbox.put(PARTICLE_CLOUD, cloud_message(now_ns, localization.particles()))
        if self._costmap is not None and self._costmap.revision != self._costmap_shown:
            if self._is_due("costmap", now_ns, _COSTMAP_PERIOD_NS):
                self._costmap_shown = self._costmap.revision
                outbox.put(GLOBAL_COSTMAP, costmap_message(now_ns, self._costmap))
        self._tell_status(now_ns, outbox)

    def _tell_status(self, now_ns: int, outbox: Outbox) -> None:
        navigator = self._navigator
        goal = navigator.goal if navigator is not None else None
        localized = self._localized() and self._costmap is not None
        active = localized and navigator is not None
        state = navigator.state if navigator is not None else "idle"
        recoveries = navigator.number_of_recoveries if navigator is not None and goal else 0
        status = (localized, active, state, None if goal is None else goal.pose, recoveries)
        # Called on every step, so that the period counts from the last status published.
        due = self._is_due("status", now_ns, _STATUS_PERIOD_NS)
        if due or status != self._status:
            said = NavigationStatus(
                localization_active=localized,
                navigation_active=active,
                state=state,
                goal=None if goal is None else planar_document(goal.pose),
                distance_remaining_m=0.0 if navigator is None else navigator.distance_remaining_m,
                number_of_recoveries=recoveries,
            )
            outbox.put(NAVIGATION_STATUS, said)
        if active != self._was_active:
            self._was_active = active
            _LOG.info("localised" if active else "the pose is no longer trusted")
        self._status = status

    def _is_due(self, what: str, now_ns: int, period_ns: int) -> bool:
        if now_ns < self._due_ns.get(what, 0):
            return False
        self._due_ns[what] = (now_ns // period_ns + 1) * period_ns
        return True

    def _pose_message(self, localization: Localization) -> msg.PoseWithCovarianceStamped:
        pose, covariance = localization.pose()
        assert self._odom is not None
        return msg.PoseWithCovarianceStamped(
            header=msg.header(self._odom[0], MAP_FRAME),
            pose=msg.PoseWithCovariance(
                pose=msg.pose_from_se2(pose), covariance=msg.planar_covariance(covariance)
            ),
        )


def _same_map(one: msg.OccupancyGrid, other: msg.OccupancyGrid | None) -> bool:
    return (
        other is not None
        and one.info.resolution == other.info.resolution
        and one.info.width == other.info.width
        and msg.se2_from_pose(one.info.origin) == msg.se2_from_pose(other.info.origin)
        and np.array_equal(one.data, other.data)
    )


def _planar(matrix: Array) -> SE2:
    """The planar part of a fixed frame's pose on the robot."""
    return SE2(
        float(matrix[0, 3]),
        float(matrix[1, 3]),
        portable_kernels.atan2(float(matrix[1, 0]), float(matrix[0, 0])),
    )
