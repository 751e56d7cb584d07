"""The node: odometry, scans and markers in, the robot's pose in the map out. The only file here
that uses topics.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    CAMERA_OPTICAL_FRAME,
    MAP_FRAME,
    SCAN_FRAME,
    SE2,
    Array,
    PlanarCovariance,
    pose_matrix,
)
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import Reply
from mazebot.common.messages.documents import (
    Entities,
    LocalizationCheckpoint,
    LocalizationStatus,
    MappedMarker,
    MarkerEntity,
    Planar,
    World,
)
from mazebot.common.messages.scan import Mount, Scan
from mazebot.common.messages.topics import (
    AMCL_POSE,
    DETECTIONS,
    ENTITIES,
    GLOBAL_LOCALIZATION_REQUEST,
    INITIAL_POSE,
    LOCALIZATION_CHECKPOINT,
    LOCALIZATION_STATUS,
    MAP,
    ODOM,
    PARTICLE_CLOUD,
    REINITIALIZE_GLOBAL_LOCALIZATION,
    SCAN,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    WORLD,
)
from mazebot.common.node.frame_tree import FrameTree
from mazebot.common.node.node import Inbox, Node, Outbox, random_generator
from mazebot.common.node.pose_estimate import (
    by_stamp,
    marker_candidates,
    pose_message,
    transform_message,
)
from mazebot.common.node.pose_measurements import PoseMeasurements, StatusReports
from mazebot.common.node.schedule import Schedule
from mazebot.common.node.simulation_watch import SimulationWatch
from mazebot.common.world.costmap import MAX_MAP_CELLS
from mazebot.localization.config import STEP_PERIOD_NS, LocalizationConfig
from mazebot.localization.kernels import compile_kernels
from mazebot.localization.markers.marker_trust import marker_key
from mazebot.localization.messages import cloud_message, unseen_cells
from mazebot.localization.monte_carlo import Localization, LocalizationState

_LOG = logging.getLogger("localization")

_AMCL_POSE_PERIOD_NS = 100_000_000
_PARTICLES_PERIOD_NS = 500_000_000
_CHECKPOINT_PERIOD_NS = 500_000_000

State = LocalizationState


class LocalizationNode(Node):
    """Localises the robot in the map: owns `map -> odom`."""

    name: ClassVar[str] = "localization"
    _config: LocalizationConfig
    period_ns: ClassVar[int | None] = STEP_PERIOD_NS

    def __init__(self, config: LocalizationConfig) -> None:
        self._config = config
        self._watch = SimulationWatch(config.seed)
        self._world: World | None = None
        self._map: msg.OccupancyGrid | None = None
        self._entities: Entities | None = None
        self._markers: dict[int, Array] = {}
        self._doubled: set[int] = set()
        """Ids that are in two places."""
        self._misplaced: set[int] = set()
        """Ids of those that the scans contradict."""
        self._static_frames = FrameTree()
        self._base_from: dict[str, Array] = {}
        self._localization: Localization | None = None
        self._started = False
        """Whether the filter was given the start pose."""
        self._measured = PoseMeasurements()
        self._schedule = Schedule()
        self._reports = StatusReports(_LOG)
        self._kept: LocalizationCheckpoint | None = None
        """Of the process before, until its pose is used."""
        self._resumed = False
        """Whether this process has begun where the one before was, or anew."""

    def prepare(self) -> None:
        """See Node."""
        compile_kernels(self._config)

    def waiting_for(self) -> str | None:
        """A phrase for the first missing input that keeps the pose from being known."""
        if self._world is None:
            return "the world"
        if self._world.slam:
            # Mapping localises the robot.
            return None
        if self._localization is None:
            return "the map"
        if SCAN_FRAME not in self._base_from:
            return "static transforms on /tf_static"
        if self._measured.odom is None:
            return "odometry"
        if not self._measured.scanned:
            return "a scan"
        return None

    def nominal_rates_hz(self) -> dict[str, float]:
        """See Node."""
        if self._localization is None or not self._started:
            return {}
        return {TF.name: 1e9 / STEP_PERIOD_NS, AMCL_POSE.name: 1e9 / _AMCL_POSE_PERIOD_NS}

    def facts(self) -> dict[str, str]:
        """The state, how well the scans match the map, and the number of particles."""
        localization = self._localization
        if self._is_off():
            return {"state": "off: mapping localises the robot"}
        if localization is None:
            return {"state": self._state()}
        return {
            "state": self._state(),
            "quality": f"{localization.quality:.2f}",
            "particles": str(len(localization.particles())),
        }

    def warning(self) -> str:
        """See Node: that the settings leave nothing of the scans."""
        return self._localization.warning if self._localization is not None else ""

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Process sensor messages, publish pose and status."""
        if self._watch.restarted(now_ns, inbox.new(SIMULATION_STATS)):
            _LOG.info("simulation restarted; resetting localization")
            self._reset()
        self._kept = inbox.latest(LOCALIZATION_CHECKPOINT) or self._kept
        if self._resumed:
            # What others keep is of this process itself.
            self._kept = None
        self._learn_world(inbox)
        if self._is_off():
            self._leave_to_mapping(inbox)
            return
        self._localize(inbox)
        self._reinitialize(inbox)
        self._publish(now_ns, outbox)

    def _is_off(self) -> bool:
        """Whether mapping localises the robot in this run."""
        return self._world is not None and self._world.slam

    def _leave_to_mapping(self, inbox: Inbox) -> None:
        """Publish nothing. Of sensors only the newest messages wait, undecoded."""
        inbox.new(INITIAL_POSE)
        inbox.new(GLOBAL_LOCALIZATION_REQUEST)
        for request in inbox.requests(REINITIALIZE_GLOBAL_LOCALIZATION):
            request.respond(Reply(error="slam: mapping localises the robot of this run"))

    def _learn_world(self, inbox: Inbox) -> None:
        """Process latched topics. The same world or map, received again, changes nothing."""
        world = inbox.latest(WORLD)
        if world is not None and (self._world is None or world.hash != self._world.hash):
            self._world = world
            self.world_hash = world.hash
            self._reset()
            self._register_markers()
        grid = inbox.latest(MAP)
        if grid is not None and not msg.same_grid(grid, self._map):
            if len(grid.data) > MAX_MAP_CELLS:
                inbox.reject(MAP, "too many cells")
                _LOG.error("map: %d cells: must be at most %d", len(grid.data), MAX_MAP_CELLS)
            else:
                self._map = grid
                self._reset()
        entities = inbox.latest(ENTITIES)
        if entities is not None:
            self._entities = entities
            self._register_markers()
        if self._static_frames.receive(inbox, TF_STATIC):
            sensors = (SCAN_FRAME, CAMERA_OPTICAL_FRAME)
            self._base_from = self._static_frames.chains(BASE_FOOTPRINT_FRAME, sensors)

    def _register_markers(self) -> None:
        """Store the pose of each known marker. Two of one id cannot be distinguished: neither is
        used.
        """
        self._markers = {}
        if self._world is None:
            return
        known: Sequence[MarkerEntity | MappedMarker]
        if self._world.mapped_markers is not None:
            known = self._world.mapped_markers
        elif self._entities is not None and self._entities.world_hash == self._world.hash:
            known = self._entities.markers
        else:
            return
        doubled: set[int] = set()
        for entity in known:
            # Detections tell the id alone.
            if entity.marker_id in self._markers:
                doubled.add(entity.marker_id)
            self._markers[entity.marker_id] = pose_matrix(entity)
        for marker_id in sorted(doubled):
            if marker_id not in self._doubled:
                _LOG.warning("marker %d is in two places: ignored", marker_id)
            del self._markers[marker_id]
        self._doubled = doubled

    def _reset(self) -> None:
        """Drop all measurements; the filter restarts at the start pose."""
        self._measured = PoseMeasurements()
        self._started = False
        self._schedule.clear()
        self._reports.restart()
        self._localization = None
        self._misplaced.clear()
        if self._map is None or self._world is None or self._is_off():
            return
        cells = np.array(msg.cells_from_grid(self._map), np.int8)
        resolution_m = self._map.info.resolution
        origin = msg.se2_from_pose(self._map.info.origin)
        try:
            self._localization = Localization(
                self._config,
                cells,
                resolution_m,
                origin,
                random_generator(self._watch.seed, "localization/filter"),
                unseen_cells(cells, resolution_m, origin, self._world.unseen),
            )
        except ValueError as error:
            _LOG.error("map: %s", error)

    def _localize(self, inbox: Inbox) -> None:
        """Update the pose: odometry first, then scans and detections, oldest first."""
        localization = self._localization
        odometry, scans = inbox.new(ODOM), inbox.new(SCAN)
        sightings, poses = inbox.new(DETECTIONS), inbox.new(INITIAL_POSE)
        if localization is None:
            return
        for odom in odometry:
            stamp_ns = msg.ns_from_time(odom.header.stamp)
            if not self._watch.is_of_this_run(stamp_ns, ODOM, inbox):
                continue
            odom_from_base = msg.se2_from_pose(odom.pose.pose)
            corrected = self._measured.note_odometry(stamp_ns, odom_from_base)
            localization.odometry(stamp_ns, corrected)
        latest = self._measured.odom
        if latest is None or SCAN_FRAME not in self._base_from:
            return
        if not self._started and not self._resumes(localization, latest[1], inbox):
            return
        self._resumed = True
        if not self._started:
            self._start_at(localization, latest[1])
        for initial in poses:
            self._take_initial_pose(localization, initial, inbox)
        for stamp_ns, message in by_stamp(scans, sightings):
            if isinstance(message, msg.LaserScan):
                if self._watch.is_of_this_run(stamp_ns, SCAN, inbox):
                    scan = Scan.from_message(message, Mount.of(self._base_from[SCAN_FRAME]))
                    if problem := self._measured.add_scan(scan, localization):
                        inbox.reject(SCAN, problem)
            elif self._watch.is_of_this_run(stamp_ns, DETECTIONS, inbox):
                self._take_detections(localization, stamp_ns, message, inbox)

    def _resumes(self, localization: Localization, odom_from_base: SE2, inbox: Inbox) -> bool:
        """Go on from the pose of the process before, if there was one in this run; returns whether
        that is known.
        """
        kept = self._kept
        if not inbox.is_handed_over:
            return False
        if kept is None or self._world is None or kept.world_hash != self._world.hash:
            return True
        if kept.epoch is not None and self._watch.epoch is None:
            # The news of the run is yet to come.
            return False
        if kept.epoch != self._watch.epoch or kept.state == "uninitialized":
            return True
        self._started = True
        if kept.state == "searching":
            localization.global_localization()
            return True
        moved = kept.odom_from_base.se2().inverse() @ odom_from_base
        drift = self._config.odometry_drift_ratio * moved.distance_m(SE2(0.0, 0.0, 0.0))
        covariance = PlanarCovariance(*kept.covariance).matrix() + self._initial_covariance(drift)
        pose = kept.map_from_base.se2() @ moved
        localization.initialize(pose, covariance)
        _LOG.warning("localization resumed: %.3f %.3f %.3f", *pose)
        return True

    def _start_at(self, localization: Localization, odom_from_base: SE2) -> None:
        """Set the initial pose from the world's start and odometry, which begins at zero there.

        This holds at the start, and for a process that is started while the robot is driving.
        """
        assert self._world is not None
        self._started = True
        config, origin = self._config, SE2(0.0, 0.0, 0.0)
        pose = self._world.start.se2() @ odom_from_base
        drift = config.odometry_drift_ratio * odom_from_base.distance_m(origin)
        if not (config.initialize_at_start_pose or config.set_initial_pose):
            localization.global_localization()
            return
        if config.set_initial_pose:
            given = config.initial_pose
            pose = SE2(given.x, given.y, given.yaw)
        localization.initialize(pose, self._initial_covariance(drift))
        _LOG.info("Setting pose: %.3f %.3f %.3f", *pose)

    def _initial_covariance(self, drift: float = 0.0) -> Array:
        """(3, 3) of (x, y, yaw), with this much more standard deviation in m and rad."""
        variance_m2 = portable.square(self._config.initial_pose_std_m + drift)
        variance_rad2 = portable.square(self._config.initial_pose_std_rad + drift)
        return np.diag([variance_m2, variance_m2, variance_rad2])

    def _take_initial_pose(
        self, localization: Localization, initial: msg.PoseWithCovarianceStamped, inbox: Inbox
    ) -> None:
        pose = msg.se2_from_pose(initial.pose.pose)
        assert self._map is not None
        problem = ""
        if initial.header.frame_id not in ("", MAP_FRAME):
            problem = "frame_id is not map"
        elif not msg.grid_contains(self._map, pose.x_m, pose.y_m):
            problem = "outside the map"
        else:
            index = np.ix_([0, 1, 5], [0, 1, 5])
            covariance = np.array(initial.pose.covariance, np.float64).reshape(6, 6)[index]
            try:
                localization.initialize(pose, covariance + self._initial_covariance())
            except ValueError:
                problem = "invalid covariance"
        if problem:
            inbox.reject(INITIAL_POSE, problem)
            _LOG.warning("initial pose %.3f %.3f %.3f rejected: %s", *pose, problem)
        else:
            _LOG.info("Setting pose: %.3f %.3f %.3f", *pose)

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
            localization.marker(stamp_ns, entry, marker_candidates(detection), camera)
        self._tell_misplaced(localization)

    def _marker_of(self, detection: msg.Detection3D) -> Array | None:
        """map_from_marker of a detection; None if it is not one of the world's markers."""
        if not detection.results:
            return None
        try:
            return self._markers.get(int(detection.results[0].hypothesis.class_id))
        except ValueError:
            return None

    def _tell_misplaced(self, localization: Localization) -> None:
        """Warn of each marker that is not used any longer, and say which one is again."""
        seen_at = localization.misplaced
        for marker_id, map_from_marker in self._markers.items():
            seen = seen_at.get(marker_key(map_from_marker))
            if (seen is None) == (marker_id not in self._misplaced):
                continue
            mapped = _place_of(map_from_marker)
            if seen is None:
                self._misplaced.remove(marker_id)
                _LOG.info("marker %d is seen at %s, as mapped: used again", marker_id, mapped)
                continue
            self._misplaced.add(marker_id)
            _LOG.warning(
                "marker %d is mapped at %s but seen at %s, and the scans agree with that: not "
                "used until it is seen where it is mapped",
                marker_id, mapped, _place_of(seen),
            )  # fmt: skip

    def _reinitialize(self, inbox: Inbox) -> None:
        """Answer the requests for global localisation."""
        for request in inbox.requests(REINITIALIZE_GLOBAL_LOCALIZATION):
            missing = self.waiting_for()
            if self._localization is None or missing is not None:
                request.respond(Reply(error=f"localization is waiting for {missing}"))
                continue
            self._localization.global_localization()
            request.respond(Reply())
        asked = inbox.new(GLOBAL_LOCALIZATION_REQUEST)
        if asked and self._localization is not None and self.waiting_for() is None:
            self._localization.global_localization()

    def _state(self) -> State:
        localization = self._localization
        if localization is None or not self._started or not self._measured.scanned:
            return "uninitialized"
        return localization.state

    def _publish(self, now_ns: int, outbox: Outbox) -> None:
        """Publish the pose, the particles and the status."""
        localization = self._localization
        if localization is not None and self._started and localization.initialized:
            map_from_odom = self._measured.map_from_odom(localization)
            outbox.put(TF, transform_message(now_ns, map_from_odom))
            if self._schedule.is_due("amcl_pose", now_ns, _AMCL_POSE_PERIOD_NS):
                assert self._measured.odom is not None
                outbox.put(AMCL_POSE, pose_message(self._measured.odom[0], *localization.pose()))
            if self._schedule.is_due("particles", now_ns, _PARTICLES_PERIOD_NS):
                particles = localization.particles()
                outbox.offer(PARTICLE_CLOUD, lambda: cloud_message(now_ns, particles))
            if self._schedule.is_due("checkpoint", now_ns, _CHECKPOINT_PERIOD_NS):
                outbox.offer(LOCALIZATION_CHECKPOINT, lambda: self._checkpoint(localization))
        status = self._status()
        if self._reports.is_due(now_ns, status):
            outbox.put(LOCALIZATION_STATUS, status)

    def _status(self) -> LocalizationStatus:
        localization, state = self._localization, self._state()
        reasons = () if localization is None else localization.reasons
        return LocalizationStatus(
            state=state,
            quality=0.0 if localization is None else localization.quality,
            reason="; ".join(filter(None, (*reasons, self.warning()))),
            wants_motion=localization is not None and localization.wants_motion,
            epoch=self._watch.epoch,
            wheel_slip=self._measured.slips,
            suspect=localization is not None and state == "localized" and localization.is_suspect,
        )

    def _checkpoint(self, localization: Localization) -> LocalizationCheckpoint:
        """What a process that is started again goes on with."""
        assert self._measured.odom is not None
        pose, covariance = localization.pose()
        return LocalizationCheckpoint(
            world_hash=self.world_hash,
            epoch=self._watch.epoch,
            state=self._state(),
            odom_from_base=Planar.of(self._measured.odom[1]),
            map_from_base=Planar.of(pose),
            covariance=tuple(PlanarCovariance.from_matrix(covariance)),
        )


def _place_of(map_from_marker: Array) -> str:
    """`(1.20 -0.35), facing 90 degrees`."""
    x_m, y_m = map_from_marker[:2, 3].tolist()
    normal_x, normal_y, normal_z = map_from_marker[:3, 2].tolist()
    facing = f"facing {round(math.degrees(portable.atan2(normal_y, normal_x))) % 360} degrees"
    if abs(normal_z) > math.hypot(normal_x, normal_y):
        facing = "facing " + ("up" if normal_z > 0.0 else "down")
    return f"({x_m:.2f} {y_m:.2f}), {facing}"
