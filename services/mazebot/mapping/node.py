"""The node: odometry, scans and markers in; the map, its graph and the robot's pose in it out. The
only file here that uses topics.
"""

from __future__ import annotations

import logging
from typing import ClassVar, Literal

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    CAMERA_OPTICAL_FRAME,
    SCAN_FRAME,
    SE2,
    Array,
)
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import LocalizationStatus, World
from mazebot.common.messages.scan import Mount, Scan
from mazebot.common.messages.slam_documents import PoseGraph
from mazebot.common.messages.topics import (
    AMCL_POSE,
    DETECTIONS,
    LOCALIZATION_STATUS,
    MAP,
    ODOM,
    POSE_GRAPH,
    SCAN,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    WORLD,
)
from mazebot.common.node.frame_tree import FrameTree
from mazebot.common.node.node import Inbox, Node, Outbox
from mazebot.common.node.pose_estimate import (
    by_stamp,
    marker_candidates,
    pose_message,
    transform_message,
)
from mazebot.common.node.pose_measurements import PoseMeasurements, StatusReports
from mazebot.common.node.schedule import Schedule
from mazebot.common.node.simulation_watch import SimulationWatch
from mazebot.mapping.config import STEP_PERIOD_NS, MappingConfig
from mazebot.mapping.graph.graph_file import load_graph
from mazebot.mapping.kernels import compile_kernels
from mazebot.mapping.messages import map_message, marker_name, planar
from mazebot.mapping.slam import Slam

_LOG = logging.getLogger("mapping")

_AMCL_POSE_PERIOD_NS = 100_000_000
_GRAPH_PERIOD_NS = 5_000_000_000
_LATE_NS = 2_000_000_000
"""A process that receives its first odometry later than this may have been restarted."""
_RETURN_NS = 3_000_000_000
"""It waits this long for the pose graph of its previous process."""
_NEAR_M, _NEAR_RAD = 0.1, 0.2
"""So near to what it was, odometry goes on."""


_CARRIED_OFF = (
    "all at once, the scans do not match the map any more: the robot was carried off; nothing is "
    "added to the map until the robot has moved and is found on it"
)


class MappingNode(Node):
    """Makes the map and localises the robot in it: owns `map -> odom` in a run with slam."""

    name: ClassVar[str] = "mapping"
    _config: MappingConfig
    period_ns: ClassVar[int | None] = STEP_PERIOD_NS

    def __init__(self, config: MappingConfig) -> None:
        """Raises ConfigError where a saved graph cannot be read."""
        self._config = config
        if config.mode == "localization" and config.map_file_name is None:
            raise ConfigError("mapping: mode: localization: must come with a map_file_name")
        self._saved = None if config.map_file_name is None else load_graph(config.map_file_name)
        if self._saved is not None:
            Slam.restored(config, self._saved)
        self._watch = SimulationWatch(config.seed)
        self._world: World | None = None
        self._static_frames = FrameTree()
        self._base_from: dict[str, Array] = {}
        self._returned: PoseGraph | None = None
        """The pose graph of this service's previous process."""
        self._received_ns: int | None = None
        """When the first odometry was received."""
        self._left: tuple[SE2, SE2] | None = None
        """Odometry at the end of the run before, and the map from it."""
        self._slam: Slam | None = None
        self._measured = PoseMeasurements()
        self._schedule = Schedule()
        self._reports = StatusReports(_LOG)
        self._published_map: int | None = None
        """Version of the map last published."""
        self._published_graph: tuple[int, int] | None = None
        """Version and number of loops of the graph last published."""
        self._counts = {"keyframes": 0, "markers": 0}
        """Of the graph last published."""

    def prepare(self) -> None:
        """See Node."""
        compile_kernels(self._config)

    def waiting_for(self) -> str | None:
        """A phrase for the first missing input that keeps the map from being made."""
        if self._world is None:
            return "the world"
        if not self._world.slam:
            # The robot has a map, and localization finds it there.
            return None
        if SCAN_FRAME not in self._base_from:
            return "static transforms on /tf_static"
        if self._measured.odom is None:
            return "odometry"
        if self._slam is None:
            return "its previous pose graph on /pose_graph"
        if not self._measured.scanned:
            return "a scan"
        return None

    def nominal_rates_hz(self) -> dict[str, float]:
        """See Node."""
        if self._slam is None:
            return {}
        return {TF.name: 1e9 / STEP_PERIOD_NS, AMCL_POSE.name: 1e9 / _AMCL_POSE_PERIOD_NS}

    def facts(self) -> dict[str, str]:
        """How well the scans fit, how large the graph is, and how many loops were closed."""
        slam = self._slam
        if self._world is not None and not self._world.slam:
            return {"state": "off: the robot has a map"}
        if slam is None:
            return {"state": self._state()}
        return {
            "state": self._state(),
            "quality": f"{slam.quality:.2f}",
            **{name: str(count) for name, count in self._counts.items()},
            "loops": str(slam.loops),
            "loops rejected": str(slam.loops_rejected),
        }

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Process sensor messages; publish the pose, the map and its graph."""
        if self._watch.restarted(now_ns, inbox.new(SIMULATION_STATS)):
            _LOG.info("simulation restarted; resetting the map")
            left = None
            if self._slam is not None and self._measured.odom is not None:
                left = self._measured.odom[1], self._measured.map_from_odom(self._slam)
            self._reset()
            self._returned, self._left = None, left
        for graph in inbox.new(POSE_GRAPH):
            self._returned = graph
        self._learn_world(inbox)
        if self._world is None or not self._world.slam:
            return
        self._measure(now_ns, self._world, inbox)
        self._publish(now_ns, self._world, outbox)

    def _learn_world(self, inbox: Inbox) -> None:
        """Process latched topics. The same world, received again, changes nothing."""
        world = inbox.latest(WORLD)
        if world is not None and (self._world is None or world.hash != self._world.hash):
            self._world = world
            self.world_hash = world.hash
            self._reset()
            self._left = None
        if self._static_frames.receive(inbox, TF_STATIC):
            sensors = (SCAN_FRAME, CAMERA_OPTICAL_FRAME)
            self._base_from = self._static_frames.chains(BASE_FOOTPRINT_FRAME, sensors)

    def _reset(self) -> None:
        """Drop the map and all measurements."""
        self._slam = self._received_ns = None
        self._measured = PoseMeasurements()
        self._schedule.clear()
        self._reports.restart()
        self._published_map = self._published_graph = None
        self._counts = dict.fromkeys(self._counts, 0)

    def _measure(self, now_ns: int, world: World, inbox: Inbox) -> None:
        """Take in measurements: odometry first, then scans and detections, oldest first."""
        odometry, scans, sightings = inbox.new(ODOM), inbox.new(SCAN), inbox.new(DETECTIONS)
        for odom in odometry:
            stamp_ns = msg.ns_from_time(odom.header.stamp)
            if not self._watch.is_of_this_run(stamp_ns, ODOM, inbox):
                continue
            odom_from_base = msg.se2_from_pose(odom.pose.pose)
            corrected = self._measured.note_odometry(stamp_ns, odom_from_base)
            if self._slam is None:
                self._slam = self._started(now_ns, world, odom_from_base)
            if self._slam is not None:
                self._slam.odometry(stamp_ns, corrected)
        slam = self._slam
        if slam is None or SCAN_FRAME not in self._base_from:
            return
        for stamp_ns, message in by_stamp(scans, sightings):
            if isinstance(message, msg.LaserScan):
                if self._watch.is_of_this_run(stamp_ns, SCAN, inbox):
                    scan = Scan.from_message(message, Mount.of(self._base_from[SCAN_FRAME]))
                    if problem := self._measured.add_scan(scan, slam):
                        inbox.reject(SCAN, problem)
            elif self._watch.is_of_this_run(stamp_ns, DETECTIONS, inbox):
                self._take_detections(slam, stamp_ns, message, inbox)

    def _started(self, now_ns: int, world: World, odom_from_base: SE2) -> Slam | None:
        """The map to start from: that of the previous process, the saved one, or an empty one; None
        while the first of these may still come.
        """
        if self._received_ns is None:
            self._received_ns = now_ns
        before = self._returned
        if before is not None and self._watch.epoch is not None:
            if (before.world_hash, before.epoch) == (world.hash, self._watch.epoch):
                try:
                    slam = self._restored(before)
                except ConfigError as error:
                    _LOG.error("failed to restore the previous pose graph: %s", error)
                    self._returned = None
                else:
                    _LOG.info("restored the previous pose graph of %.1f s", before.stamp_ns * 1e-9)
                    return slam
        elif self._received_ns > _LATE_NS and now_ns - self._received_ns < _RETURN_NS:
            return None
        map_from_odom = world.start.se2()
        if self._left is not None and _has_only_time_begun_anew(self._left[0], odom_from_base):
            map_from_odom = self._left[1]
        elif self._config.map_start_pose is not None:
            map_from_odom = SE2(*self._config.map_start_pose) @ odom_from_base.inverse()
        if self._saved is None:
            return Slam(self._config, map_from_odom)
        _LOG.info("Loaded a pose graph of %d keyframes", len(self._saved.nodes))
        start = {"map_from_odom": planar(map_from_odom)}
        return self._restored(self._saved.model_copy(update=start))

    def _restored(self, graph: PoseGraph) -> Slam:
        slam = Slam.restored(self._config, graph)
        slam.fixed = self._config.mode == "localization"
        return slam

    def _take_detections(
        self, slam: Slam, stamp_ns: int, seen: msg.Detection3DArray, inbox: Inbox
    ) -> None:
        camera = self._base_from.get(CAMERA_OPTICAL_FRAME)
        if camera is None:
            return
        for detection in seen.detections:
            name = marker_name(detection)
            if name is None or not detection.results:
                inbox.reject(DETECTIONS, "unknown marker")
                continue
            slam.marker(stamp_ns, *name, marker_candidates(detection), camera)

    def _state(self) -> Literal["uninitialized", "localized", "lost"]:
        if self._slam is None or not self._measured.scanned:
            return "uninitialized"
        return "lost" if self._slam.is_lost else "localized"

    def _publish(self, now_ns: int, world: World, outbox: Outbox) -> None:
        """Publish the pose, the status, the map and its graph."""
        slam = self._slam
        if slam is not None:
            outbox.put(TF, transform_message(now_ns, self._measured.map_from_odom(slam)))
            if self._schedule.is_due("amcl_pose", now_ns, _AMCL_POSE_PERIOD_NS):
                assert self._measured.odom is not None
                outbox.put(AMCL_POSE, pose_message(self._measured.odom[0], *slam.pose()))
            if self._measured.scanned:
                self._publish_map(now_ns, slam, outbox)
                self._publish_graph(now_ns, slam, world, outbox)
        status = self._status()
        if self._reports.is_due(now_ns, status):
            outbox.put(LOCALIZATION_STATUS, status)

    def _status(self) -> LocalizationStatus:
        slam, state = self._slam, self._state()
        return LocalizationStatus(
            state=state,
            quality=0.0 if slam is None else slam.quality,
            reason=_CARRIED_OFF if state == "lost" else "",
            wants_motion=state == "lost",
            epoch=self._watch.epoch,
            wheel_slip=self._measured.slips,
            suspect=slam is not None and state == "localized" and slam.is_suspect,
        )

    def _publish_map(self, now_ns: int, slam: Slam, outbox: Outbox) -> None:
        if slam.map_version == self._published_map:
            return
        period_ns = max(round(self._config.map_update_interval * 1e9), STEP_PERIOD_NS)
        if self._published_map is not None and not self._schedule.is_due("map", now_ns, period_ns):
            return
        self._published_map = slam.map_version
        grid = slam.grid()
        outbox.put(MAP, map_message(now_ns, grid.cells, grid.resolution_m, grid.origin))

    def _publish_graph(self, now_ns: int, slam: Slam, world: World, outbox: Outbox) -> None:
        state = slam.graph_version, slam.loops
        published = self._published_graph
        if state == published:
            return
        looped = published is None or published[1] != slam.loops
        if not looped and not self._schedule.is_due("graph", now_ns, _GRAPH_PERIOD_NS):
            return
        self._published_graph = state
        self._schedule.put_off("graph", now_ns + _GRAPH_PERIOD_NS)
        graph = slam.document(now_ns)
        self._counts = {"keyframes": len(graph.nodes), "markers": len(graph.landmarks)}
        epoch = self._watch.epoch or 0
        more = {
            "world_hash": world.hash,
            "epoch": epoch,
            "map_from_odom": planar(self._measured.map_from_odom(slam)),
        }
        outbox.put(POSE_GRAPH, graph.model_copy(update=more))


def _has_only_time_begun_anew(before: SE2, odom_from_base: SE2) -> bool:
    """Whether odometry goes on from where it was, and not from zero: the robot is where it was."""
    begin = SE2(0.0, 0.0, 0.0)
    goes_on = odom_from_base.is_near(before, _NEAR_M, _NEAR_RAD)
    return goes_on and not odom_from_base.is_near(begin, _NEAR_M, _NEAR_RAD)
