"""The node: sensors in, pose, plan and velocity out. The only file here that knows topics."""

from __future__ import annotations

import logging
import math
from typing import ClassVar, NamedTuple

import numpy as np

from services.common import messages as msg
from services.common.documents import (
    Entities,
    NavigationResult,
    NavigationStatus,
    Planar,
    World,
)
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
from services.common.node import Inbox, Node, Outbox, random_generator
from services.common.topics import (
    AMCL_POSE,
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
from services.navigation.collision import STOP, Surroundings, Velocity
from services.navigation.config import CONTROL_PERIOD_NS, NavigationConfig
from services.navigation.costmap import LayeredCostmap, frame_of, scan_points, straightened
from services.navigation.errors import NavigationError
from services.navigation.localization import Localization
from services.navigation.navigator import Goal, GoalResult, Navigator
from services.navigation.path import PlannedPath

_LOG = logging.getLogger("navigation")

_AMCL_POSE_PERIOD_NS = 100_000_000
_STATUS_PERIOD_NS = 500_000_000
_PARTICLES_PERIOD_NS = 500_000_000
_COSTMAP_PERIOD_NS = 1_000_000_000
_MAX_PARTICLES_SHOWN = 500
_ECHOES_WITHIN_M = 1.5
"""Echoes further away cannot be reached within the controller's horizon."""


class _Echoes(NamedTuple):
    """The newest scan's echoes, fixed where they were seen."""

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
        self._static_transforms: dict[str, msg.TransformStamped] = {}
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
        """Whether the last command put out was other than a stop."""
        self._was_active = False
        self._status: tuple[bool, bool, str, SE2 | None, int] | None = None
        """The status last told, but for the distance that remains."""
        self._due_ns: dict[str, int] = {}
        self._costmap_shown = -1
        self._results: list[GoalResult] = []
        self._epoch: int | None = None
        self._begun_ns = 0
        """When the epoch began: what was measured before is of another."""
        self._seed = config.seed
        """The simulation's, as soon as that is known."""
        _compile_kernels(config)

    def waiting_for(self) -> str | None:
        """The one thing that keeps the robot from driving, in words."""
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
        """Take in what the sensors saw, drive one control period, tell where the robot is."""
        if self._simulation_began_anew(now_ns, inbox):
            _LOG.info("the simulation began anew: so does navigation")
            self._begin_anew(now_ns, ErrorCode.WORLD_RESTARTED, "the simulation began anew")
        self._now_ns = now_ns
        self._learn_world(now_ns, inbox)
        self._localize(now_ns, inbox)
        self._take_goals(now_ns, inbox)
        self._drive(now_ns, outbox)
        self._tell(now_ns, outbox)

    def _simulation_began_anew(self, now_ns: int, inbox: Inbox) -> bool:
        """Whether the robot is elsewhere than where it was driven to, or has other random streams:
        time went back, or the simulation says that this is another epoch.
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
        """Take in what changes seldom. The same world or map, latched again, changes nothing."""
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
            for entry in tree.transforms:
                self._static_transforms[entry.child_frame_id] = entry
            self._base_from = {}
            for frame in (SCAN_FRAME, CAMERA_OPTICAL_FRAME):
                matrix = msg.chain_transforms(
                    self._static_transforms.values(), BASE_FOOTPRINT_FRAME, frame
                )
                if matrix is not None:
                    self._base_from[frame] = matrix

    def _take_map(self, now_ns: int, grid: msg.OccupancyGrid, inbox: Inbox) -> None:
        origin = msg.se2_from_pose(grid.info.origin)
        cells = np.array(msg.cells_from_grid(grid), np.int8)
        try:
            # Localisation takes a map as it lies; what plans has its rows along the map's axes.
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
        """Where each known marker hangs. Two of one id would be told apart by nothing: neither is
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
        """Forget the goal and everything seen; localisation begins at the start pose again."""
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
        """Bring the pose up to date: odometry first, then what was seen, oldest first."""
        localization = self._localization
        odometry, scans = inbox.new(ODOM), inbox.new(SCAN)
        sightings, poses = inbox.new(DETECTIONS), inbox.new(INITIAL_POSE)
        if localization is None:
            return
        for odom in odometry:
            stamp_ns = msg.ns_from_time(odom.header.stamp)
            if stamp_ns > now_ns:
                # Of a simulation that has ended since.
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
        """Odometry begins at zero with the simulation, so it tells how far from the start the robot
        is.

        That holds at the start, and for a process that comes up while the robot is on its way.
        """
        assert self._world is not None
        self._started = True
        config, origin = self._config, SE2(0.0, 0.0, 0.0)
        pose = self._world.start.se2() @ odom_from_base
        drift = config.odometry_drift_ratio * odom_from_base.distance_m(origin)
        variances = [
            (config.initial_pose_std_m + drift) ** 2,
            (config.initial_pose_std_m + drift) ** 2,
            (config.initial_pose_std_rad + drift) ** 2,
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
                    self._config.initial_pose_std_m**2,
                    self._config.initial_pose_std_m**2,
                    self._config.initial_pose_std_rad**2,
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
        """map_from_marker of a detection; None where it is not one of the world's."""
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
        for message in inbox.new(GOAL_POSE):
            pose = msg.se2_from_pose(message.pose)
            goal = Goal(pose, msg.ns_from_time(message.header.stamp))
            try:
                ended = self._accept(now_ns, goal, message.header.frame_id)
            except NavigationError as error:
                _LOG.error("Goal rejected with error %d: %s", error.code, error.message)
                ended = GoalResult(goal, error.code, error.message, now_ns, now_ns, 0)
            if ended is not None:
                self._results.append(ended)

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

    def _drive(self, now_ns: int, outbox: Outbox) -> None:
        navigator, localization, costmap = self._navigator, self._localization, self._costmap
        command: Velocity | None = None
        if (
            navigator is not None
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
                    outbox.put(PLAN, _path_message(now_ns, outcome.new_path))
                if outcome.result is not None:
                    self._results.append(outcome.result)
        if command is None and self._moving:
            command = STOP
        if command is not None:
            self._moving = command != STOP
            outbox.put(CMD_VEL, _twist(now_ns, command))
        for result in self._results:
            outbox.put(NAVIGATION_RESULT, _result_message(result))
        self._results.clear()

    def _echoes_now(self, echoes: _Echoes) -> Array:
        """(n, 2) the newest echoes in the base's frame as it is now."""
        assert self._odom is not None
        now_from_then = self._odom[1].inverse() @ echoes.odom_from_base
        c, s = math.cos(now_from_then.yaw_rad), math.sin(now_from_then.yaw_rad)
        turned = echoes.base_points_m @ np.array([[c, s], [-s, c]])
        return np.ascontiguousarray(turned + np.array([now_from_then.x_m, now_from_then.y_m]))

    def _tell(self, now_ns: int, outbox: Outbox) -> None:
        """Put out the pose, what is known of it, and what navigation does."""
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
                outbox.put(PARTICLE_CLOUD, _cloud(now_ns, localization.particles()))
        if self._costmap is not None and self._costmap.revision != self._costmap_shown:
            if self._is_due("costmap", now_ns, _COSTMAP_PERIOD_NS):
                self._costmap_shown = self._costmap.revision
                outbox.put(GLOBAL_COSTMAP, _costmap_message(now_ns, self._costmap))
        self._tell_status(now_ns, outbox)

    def _tell_status(self, now_ns: int, outbox: Outbox) -> None:
        navigator = self._navigator
        goal = navigator.goal if navigator is not None else None
        localized = self._localized() and self._costmap is not None
        active = localized and navigator is not None
        state = navigator.state if navigator is not None else "idle"
        recoveries = navigator.number_of_recoveries if navigator is not None and goal else 0
        status = (localized, active, state, None if goal is None else goal.pose, recoveries)
        # Asked on every step, so that the period counts from the last one put out.
        due = self._is_due("status", now_ns, _STATUS_PERIOD_NS)
        if due or status != self._status:
            said = NavigationStatus(
                localization_active=localized,
                navigation_active=active,
                state=state,
                goal=None if goal is None else _planar_document(goal.pose),
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


def _compile_kernels(config: NavigationConfig) -> None:
    """Drive a metre in a small room, so that nothing is left to compile while the robot moves."""
    cells = np.zeros((60, 60), np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = 100
    frame = frame_of(0.05, SE2(0.0, 0.0, 0.0), cells)
    costmap = LayeredCostmap(frame, cells, config.inflation(), config.obstacle())
    localization = Localization(
        config.localization, cells, 0.05, SE2(0.0, 0.0, 0.0), random_generator(0, "navigation/warm")
    )
    start = SE2(1.0, 1.5, 0.0)
    ranges = np.full(360, 1.0, np.float32)
    step = math.tau / 360
    localization.odometry(0, start)
    localization.initialize(start, np.eye(3) * 0.01)
    marker = msg.matrix_from_pose(msg.pose_from_se2(SE2(2.0, 1.5, math.pi), 0.3))
    for i in range(4):
        stamp_ns = (i + 1) * 100_000_000
        localization.odometry(stamp_ns, SE2(1.0 + 0.1 * i, 1.5, 0.0))
        localization.scan(stamp_ns, ranges, 0.0, step, 0.1, 3.5, SE2(0.0, 0.0, 0.0))
        camera_from_marker = np.linalg.inv(start.matrix(0.2)) @ marker
        localization.marker(stamp_ns, marker, [(camera_from_marker, np.eye(6), 1.0)], np.eye(4))
        costmap.update(start, ranges, 0.0, step, 0.1)
    costmap.clear()
    planner_and_controller = Navigator(config.navigator(0.05), costmap)
    points_m = scan_points(SE2(0.0, 0.0, 0.0), ranges, 0.0, step, 0.1, 3.5)
    level = _LOG.level
    _LOG.setLevel(logging.CRITICAL)
    try:
        planner_and_controller.accept(0, Goal(SE2(2.0, 1.5, 0.0), 0), start)
        planner_and_controller.step(0, Surroundings(start, costmap.master, points_m), True)
    except NavigationError:
        # A robot too large for the room has compiled as much as it can.
        pass
    finally:
        _LOG.setLevel(level)


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
        math.atan2(float(matrix[1, 0]), float(matrix[0, 0])),
    )


def _planar_document(pose: SE2) -> Planar:
    return Planar(x_m=pose.x_m, y_m=pose.y_m, yaw_rad=pose.yaw_rad)


def _twist(now_ns: int, velocity: Velocity) -> msg.TwistStamped:
    return msg.TwistStamped(
        header=msg.header(now_ns, BASE_FOOTPRINT_FRAME),
        twist=msg.Twist(
            linear=msg.Vector3(velocity.linear_m_s, 0.0, 0.0),
            angular=msg.Vector3(0.0, 0.0, velocity.angular_rad_s),
        ),
    )


def _path_message(now_ns: int, path: PlannedPath) -> msg.Path:
    header = msg.header(now_ns, MAP_FRAME)
    poses = [
        msg.PoseStamped(header=header, pose=msg.pose_from_se2(SE2(float(x), float(y), float(yaw))))
        for (x, y), yaw in zip(path.points_m, path.yaws_rad, strict=True)
    ]
    return msg.Path(header=header, poses=poses)


def _cloud(now_ns: int, particles: Array) -> msg.PoseArray:
    shown = particles[:: -(-len(particles) // _MAX_PARTICLES_SHOWN)]
    half_yaws = shown[:, 2] / 2.0
    zeros = [0.0] * len(shown)
    points = map(msg.Point, shown[:, 0].tolist(), shown[:, 1].tolist(), zeros)
    turns = map(
        msg.Quaternion, zeros, zeros, np.sin(half_yaws).tolist(), np.cos(half_yaws).tolist()
    )
    return msg.PoseArray(
        header=msg.header(now_ns, MAP_FRAME), poses=list(map(msg.Pose, points, turns))
    )


def _costmap_message(now_ns: int, costmap: LayeredCostmap) -> msg.OccupancyGrid:
    frame = costmap.frame
    return msg.occupancy_grid(
        now_ns,
        frame.resolution_m,
        SE2(frame.origin_x_m, frame.origin_y_m, 0.0),
        costmap.master.occupancy(),
    )


def _result_message(result: GoalResult) -> NavigationResult:
    return NavigationResult(
        goal=_planar_document(result.goal.pose),
        goal_stamp_ns=result.goal.stamp_ns,
        error_code=int(result.error_code),
        error_msg=result.error_msg,
        start_time_s=result.start_ns * 1e-9,
        end_time_s=result.end_ns * 1e-9,
        number_of_recoveries=result.number_of_recoveries,
    )
