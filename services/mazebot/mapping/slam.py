"""Simultaneous localisation and mapping: the robot's pose, and the map that it makes on the way.

Every scan is matched to a local map of the keyframes around that are trusted: connected through the
graph by a way that is not much longer than the straight one. A scan becomes a keyframe only where
no trusted one is near, so that neither the graph nor the time of a step grows in a known place.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, PlanarCovariance, wrap_angle
from mazebot.common.maths.odometry_history import NO_ODOMETRY, OdometryHistory
from mazebot.common.messages.scan import Scan
from mazebot.common.messages.slam_documents import PoseGraph
from mazebot.mapping.graph.graph_file import NodeScan, graph_document, graph_of, metres, millimetres
from mazebot.mapping.graph.landmarks import MarkerCandidate, MarkerLandmarks
from mazebot.mapping.graph.optimizer import CHI2_99, Covariances
from mazebot.mapping.graph.pose_graph import ODOMETRY, SCAN_MATCH, Graph, information_of
from mazebot.mapping.loops.carried_off import CarriedOff
from mazebot.mapping.loops.loop_closer import LoopCloser
from mazebot.mapping.loops.loop_closing import explains, find_loop
from mazebot.mapping.matching.correlative import correlate
from mazebot.mapping.matching.local_map import LocalMap, compacted, local_map
from mazebot.mapping.matching.occupancy import (
    MapGrid,
    Occupancy,
    Structures,
    coarse_grid,
    share_behind_walls,
    share_contradicted,
    share_in_free,
)
from mazebot.mapping.matching.odometry_quality import OdometryQuality
from mazebot.mapping.matching.odometry_scale import OdometryScale
from mazebot.mapping.matching.refine import Refined, refine
from mazebot.mapping.matching.scan_points import (
    ScanPoints,
    moved_cloud,
    scan_points,
    surface_cloud,
    thinned,
)
from mazebot.mapping.params import SlamParams

_SPACING_M = 0.01
_MOST_RETURNS = 720
_FEW_RETURNS = 10
"""A scan with fewer returns does not correct the pose."""
_FEW_SHARE = 0.1
"""And with less than this share of its beams it may be none of what is there:"""
_BLANK_SHARE = 0.3
"""it shows no open floor if more of its beams than this pass through walls."""
_SPINS_UP_NS = 2_000_000_000
"""Before a first scan without returns is believed: a lidar's motor takes as long."""
_JUMP_M, _JUMP_M_S = 1.0, 5.0
"""Odometry that moves by more at once may have jumped: the scan decides. Where it cannot, what is
faster has jumped.
"""
_FASTER = 2.0
"""A speed is unusual at so much more than usual: logs are sparse, and their clocks wrong."""
_JUMPED_FIT, _JUMPED_FIT_USUAL = 0.2, 0.5
"""The robot stayed about where it was if the scan fits there by so much better; the second where
its speed was not unusual, since scans may be missing, and where a corridor leaves its place open.
"""
_STAYED_FIT, _JUMPED_LEAST = 0.7, 3.0
"""And if so much fits there, and is by so much more likely, as a logarithm: what has just been seen
is seen again, but a few returns fit somewhere.
"""
_STILL_M = 0.01
_JUMP_STD_M, _JUMP_STD_RAD = 0.3, 0.3
_FLOOR_STD_M, _FLOOR_STD_RAD = 1e-3, 5e-4
"""What a scan adds to the pose's uncertainty, at least: matches of one place share their errors."""
_LINK_STD_M, _LINK_STD_RAD = 1e-3, 1e-3
"""Of the local map itself, whose keyframes are not exact."""
_DRIFT_M2_PER_M = 0.01
"""A wrong scale of odometry errs the same way all along a corridor: so the variance must grow for
the sum of 1 % of 100 m to be one standard deviation.
"""
_LINKS = 3
"""Keyframes at most that a new one is linked to."""
_KNOWN_FIT, _KNOWN_FACTOR = 0.9, 2.0
"""Where this share of the returns fits, keyframes may be so much farther apart."""
_SURE_FIT = 0.8
"""A scan that fits so well adds to what the keyframe next to it has seen."""
_MOST_SCANS, _REBUILD_SCANS = 16, 4
"""Scans of a keyframe, and how many of them are added until the local map is rebuilt."""
_LOOK_AGAIN_NS, _GONE_TWICE = 500_000_000, 2
"""So often a scan next to a keyframe is compared with the grid; twice in a row, what has gone is no
chance.
"""
_MOST_AGAIN, _AGAIN_M = 4, 0.5
"""Keyframes for the sake of what has gone, at most, and within which distance: what several have
seen there, such as glass at right angles, stays.
"""
_COMPACT_M = 0.025
"""Their returns are averaged within cells of this side."""
_LOST_FIT = 0.3
"""Below it a scan does not constrain the pose."""
_BEGIN = PlanarCovariance(x_x=0.01, y_y=0.01, yaw_yaw=0.01)
"""Of the pose of a robot that comes to a map made before."""
_WINDOW, _MOST_WINDOW_M, _MOST_WINDOW_RAD = 2.0, 1.5, 0.8
"""Standard deviations of the prediction that are searched, and the half of the window at most."""
_BETTER_FIT = 0.03
_DOUBTFUL, _ODD, _USUAL_GAIN = 0.1, 0.2, 0.05
"""A fit so much below the usual one is doubtful; below that, no base for a keyframe."""
_DISCORD = 0.25
"""`Refined.discord` of scans that err as `scan_match_std_m` has it: half of this standard deviation
is the lidar's noise, by which returns differ; the rest they have in common.
"""
_SURE_SHARE = 0.15
"""Where a smaller share of the returns constrains a direction, and against odometry, odometry is
believed: a person walks ahead of the robot in a corridor.
"""
_DOUBTED = np.outer([1.0, 1.0, 0.1], [1.0, 1.0, 0.1])
"""What is left of odometry's information where another pose fits better. Its turns err: wheels slip
in them, and stamps differ. Of its ways it is believed: see above.
"""
_ALIKE = 10.0
"""Returns that fit or do not fit together, as neighbours do."""
_TURNS = (-2.0, -1.0, 1.0, 2.0)
"""Standard deviations of the heading from which a doubtful match is tried again."""
_SURE_PULL_M = 0.1
"""Of the refinement of a pose that was searched for: within two of the cells searched."""
_LARGE_MOVE_M, _LARGE_TURN_RAD = 0.3, 0.35
"""Since the last scan: beyond it odometry is no start for the refinement."""
_HALF_TRACK_M = 0.15
_JUDGED = 100
_MARKER_NODE_M = 1.0
"""A sighting is attached to a keyframe within this."""
_ROUND_RAD = 5.5
"""A lidar that sees more than this sees the same in whatever direction the robot faces."""


NOT_VALID = (
    "with angles or a range_min that are not finite, beams over more than a turn, or a range_max "
    "that is not larger"
)
NO_RETURNS = "without returns"
NOT_LATER = "not later than the one before"
TOO_SOON = "within minimum_time_interval"
CARRIED_OFF = "after the robot was carried off"


class Jump(NamedTuple):
    """A step of odometry between two scans that the second one contradicts."""

    from_ns: int
    to_ns: int
    moved: SE2


class Slam:
    """Odometry, scans and markers in; pose, grid and graph out. Times count on from the last."""

    def __init__(self, params: SlamParams, map_from_odom: SE2) -> None:
        """`map_from_odom`: where the robot is, if odometry were exact; at the start, it is."""
        self._params = params
        self._history = OdometryHistory()
        self._graph = Graph()
        self._begun_ns: int | None = None
        """Stamp of the first scan of all."""
        self._seen: list[ScanPoints] = []
        self._clouds: list[Array] = []
        """Of each node, what several scans saw there, as `local_map` takes it."""
        self._scans_of: list[int] = []
        """Of each node, how many scans those are."""
        self._placed: list[Array] = []
        """Of each node, (3, 3) covariance of its pose in the local map then, by its own axes."""
        self._stamps_ns: list[int] = []
        self._occupancy = Occupancy(params.resolution)
        self._grid: tuple[int, MapGrid] | None = None
        self._structures: tuple[int, Structures] | None = None
        self._looked_again_ns = 0
        self._gone = 0
        """Scans in a row that showed something to be gone."""
        self._again: list[int] = []
        """Keyframes for the sake of what has gone."""
        self._map_from_odom = map_from_odom
        self._scanned: tuple[int, SE2] | None = None
        """Stamp of the last scan, and odometry there."""
        self._pose = map_from_odom
        """map_from_base at the last scan."""
        self._covariance = PlanarCovariance()
        """Of the pose in the local map."""
        self._local_spread: tuple[tuple[int, int], Array] = ((-1, -1), np.zeros((3, 3)))
        """Version of the graph, node, and its (3, 3) covariance in the map."""
        self._local: LocalMap | None = None
        self._local_nodes: NDArray[np.int64] = np.zeros(0, np.int64)
        self._local_at = self._pose
        self._visited = False
        """Whether the robot came next to another node."""
        self._drift = np.zeros((2, 2))
        """Covariance in the map, since the last keyframe, of ways that odometry alone measured."""
        self._usual_discord = 0.0
        """Running mean of how much the parts of the scans contradict each other."""
        self._usual_speed_m_s = _JUMP_M_S / _FASTER
        """Running mean by odometry, in motion."""
        self._usual_fit = 1.0
        """Running mean of the share of returns that fit."""
        self._surprise: Array | None = None
        """(3, 3) square of how far the last scan was from where odometry had it, if too far: a
        scan that was paired with odometry of another time makes the next step err as much.
        """
        self._wheels = OdometryQuality()
        self._scale = OdometryScale()
        self._unlearnt_rad2 = 0.0
        """Of the last motion, how much more its turn may vary by the parameters than as learnt."""
        self._reference = -1
        """The trusted node next to the robot."""
        self._markers = MarkerLandmarks(self._graph)
        self._closer = LoopCloser(self._graph)
        self._tried: set[int] = set()
        """Nodes at which a loop was looked for since the last one was found."""
        self.left_out: Counter[str] = Counter()
        """Scans that were not used, by what they lack."""
        self.jumps: list[Jump] = []
        """Steps of odometry that were not believed."""
        self.fixed = False
        """The map stays as it is: scans only correct the pose."""
        self._carried = CarriedOff(params)
        self.map_version = 0
        self.graph_version = 0
        self.quality = 0.0

    @classmethod
    def restored(cls, params: SlamParams, document: PoseGraph) -> Slam:
        """Go on with a graph, from where its `map_from_odom` puts the robot.

        Raises ConfigError in one line where the document contradicts itself.
        """
        slam = cls(params, document.map_from_odom.se2())
        loaded = graph_of(document)
        slam._graph = loaded.graph
        slam._markers = MarkerLandmarks.restored(loaded.graph, loaded.landmarks)
        for node, scan in enumerate(loaded.scans):
            seen = ScanPoints(metres(scan.points_mm), metres(scan.misses_mm), scan.sensor)
            slam._placed.append(np.zeros((3, 3)))
            slam._keep(scan.stamp_ns, seen, thinned(seen.points_m, _SPACING_M, _MOST_RETURNS))
            slam._occupancy.add(loaded.graph.pose(node), seen)
        slam._covariance = _BEGIN
        slam._closer = LoopCloser(
            loaded.graph, closed=document.loops, rejected=document.loops_rejected
        )
        slam.map_version = slam.graph_version = 1
        return slam

    def document(self, stamp_ns: int) -> PoseGraph:
        """The graph with its scans and markers; `restored` continues from it."""
        scans = [
            NodeScan(at_ns, millimetres(seen.points_m), millimetres(seen.misses_m), seen.sensor)
            for at_ns, seen in zip(self._stamps_ns, self._seen, strict=True)
        ]
        return graph_document(
            self._graph,
            scans,
            self._markers.documents(),
            stamp_ns=stamp_ns,
            map_from_odom=self._map_from_odom,
            resolution_m=self._params.resolution,
            loops=self.loops,
            loops_rejected=self.loops_rejected,
        )

    def anchor(self) -> tuple[int, SE2]:
        """The keyframe next to the robot at the last scan, and the pose of its base in that
        keyframe's frame: it stays right when the graph is optimised. -1 before the first keyframe.
        """
        if self._reference < 0:
            return -1, self._pose
        return self._reference, self._graph.pose(self._reference).inverse() @ self._pose

    @property
    def loops(self) -> int:
        """Loops closed, by lidar or by marker."""
        return self._closer.closed

    @property
    def loops_rejected(self) -> int:
        """Loops tried and found wrong."""
        return self._closer.rejected

    @property
    def is_lost(self) -> bool:
        """Whether the robot was carried off: nothing is added to the map until scans fit again."""
        return self._carried.is_certain

    @property
    def is_suspect(self) -> bool:
        """Whether it may have been, just now."""
        return self._carried.is_possible and not self._carried.is_certain

    @property
    def keyframes(self) -> int:
        """Number of keyframes."""
        return len(self._seen)

    @property
    def graph(self) -> Graph:
        """The graph as it is: not to be written to."""
        return self._graph

    def odometry(self, stamp_ns: int, odom_from_base: SE2) -> None:
        """Add odometry; a message that is not later than the last one, or not finite, is ignored.

        As TF has it, map_from_odom changes with scans only.
        """
        self._history.add(stamp_ns, odom_from_base)

    def correct_odometry(self, odom_from_base: SE2) -> None:
        """Correct the latest odometry, whose last part was not the robot's own motion."""
        self._history.correct(odom_from_base)

    def map_from_odom(self) -> SE2:
        """As corrected by the last scan."""
        return self._map_from_odom

    def pose(self) -> tuple[SE2, Array]:
        """map_from_base by the latest odometry, and the (3, 3) covariance of x, y and yaw: that in
        the local map, and that of the local map, by the graph.
        """
        if not self._history:
            return self._pose, self._covariance.matrix()
        pose = self._map_from_odom @ self._history.latest[1]
        if self._reference < 0:
            return pose, self._covariance.matrix()
        here = (self.graph_version, self._reference)
        if self._local_spread[0] != here:
            self._local_spread = here, Covariances(self._graph).node(self._reference)
        node = self._graph.pose(self._reference)
        lever = np.eye(3)
        lever[0, 2], lever[1, 2] = node.y_m - pose.y_m, pose.x_m - node.x_m
        spread = portable.product(lever, self._local_spread[1], lever.T)
        return pose, self._covariance.matrix() + spread

    def grid(self) -> MapGrid:
        """The map; the same object until `map_version` changes."""
        if self._grid is None or self._grid[0] != self.map_version:
            self._grid = (self.map_version, self._occupancy.grid())
        return self._grid[1]

    def contradicted(self) -> Array:
        """(n,) of keyframes, all or 100 to 200 of them: `share_contradicted` by the map of all."""
        keyframes = [(self._graph.pose(node), seen) for node, seen in enumerate(self._seen)]
        grid = coarse_grid(keyframes, self._params.resolution)
        some = keyframes[:: max(1, len(keyframes) // _JUDGED)]
        return np.array([share_contradicted(grid, pose, seen) for pose, seen in some])

    def has_odometry(self, stamp_ns: int) -> bool:
        """Whether there is odometry for a time."""
        return self._history.at(stamp_ns) is not None

    def scan(self, scan: Scan) -> bool:
        """Correct the pose by a scan, and add to the map what it shows; True if it was used.

        A scan is not used if it is not later than the last one, if there is no odometry for its
        stamp, if its description is not valid, if it has no returns where walls are, or while the
        robot is lost.
        """
        p, stamp_ns = self._params, scan.stamp_ns
        odom_from_base = self._history.at(stamp_ns)
        if odom_from_base is None:
            self.left_out[NO_ODOMETRY] += 1
            return False
        is_placed = all(map(math.isfinite, scan.base_from_scan))
        if not (is_placed and scan.has_angles and scan.has_limits):
            self.left_out[NOT_VALID] += 1
            return False
        if self._scanned is not None:
            elapsed_s = (stamp_ns - self._scanned[0]) * 1e-9
            if elapsed_s <= 0.0 or elapsed_s < p.minimum_time_interval:
                self.left_out[NOT_LATER if elapsed_s <= 0.0 else TOO_SOON] += 1
                return False
        if p.min_laser_range >= 0.0:
            scan = replace(scan, range_min_m=p.min_laser_range)
        seen = scan_points(scan, p.max_laser_range)
        sees_round = abs(scan.angle_increment_rad) * len(scan.ranges_m) > _ROUND_RAD
        returns = thinned(seen.points_m, _SPACING_M, _MOST_RETURNS)
        motion = self._predict(stamp_ns, odom_from_base, returns, seen.sensor)
        is_empty = len(seen.points_m) < max(1, min(_FEW_RETURNS, _FEW_SHARE * len(scan.ranges_m)))
        if not self._seen:
            self._begun_ns = stamp_ns if self._begun_ns is None else self._begun_ns
            if is_empty and stamp_ns - self._begun_ns < _SPINS_UP_NS:
                self.left_out[NO_RETURNS] += 1
                return False
            self._scanned = (stamp_ns, odom_from_base)
            if not self.fixed:
                self.quality = 1.0 if len(returns) else 0.0
                self._add_keyframe(stamp_ns, seen, returns, matched=False)
            return True
        if is_empty and self._is_blank(seen):
            self._scanned = (stamp_ns, odom_from_base)
            self._map_from_odom = self._pose @ odom_from_base.inverse()
            self.left_out[NO_RETURNS] += 1
            return False
        usual_fit = self._usual_fit
        fit = self._match(returns, seen.sensor, motion)
        self._scanned = (stamp_ns, odom_from_base)
        if fit is not None:
            has_jumped = bool(self.jumps) and self.jumps[-1].to_ns == stamp_ns
            self._judge(fit, motion, has_jumped, returns, seen.sensor)
            if self._carried.is_possible:
                self._usual_fit = usual_fit
        if self.fixed or self._carried.is_possible:
            self._local_map()
        elif self._wants_keyframe(fit, sees_round):
            self._add_keyframe(stamp_ns, seen, returns, fit is not None and fit >= _LOST_FIT)
        elif fit is not None and fit >= max(self._usual_fit - _DOUBTFUL, _SURE_FIT):
            self._enrich(returns, seen.sensor)
            self._look_again(stamp_ns, seen)
        if self._visited:
            self._visited = False
            self._close_loop(self._reference)
        if self.is_lost:
            self._look_for_itself(odom_from_base, returns, seen.sensor)
        self._map_from_odom = self._pose @ odom_from_base.inverse()
        if self._carried.is_possible:
            self.left_out[CARRIED_OFF] += 1
            return False
        return True

    def _is_blank(self, seen: ScanPoints) -> bool:
        """Whether a scan with hardly a return shows nothing: neither does it see open floor, or
        that is behind walls of the map, as where a lidar drops out.
        """
        if not len(seen.misses_m):
            return True
        behind = share_behind_walls(self.grid(), self._pose, seen.misses_m, seen.sensor)
        return behind > _BLANK_SHARE

    def _judge(
        self, fit: float, moved: SE2 | None, has_jumped: bool, returns: Array, sensor: SE2
    ) -> None:
        """Whether the robot was carried off, by how well its scan fits after a motion, and whether
        that is what the robot did.
        """
        if moved is None:
            before: float | None = math.inf
        else:
            before = None if has_jumped or _is_large(moved) else self.quality
        self._carried.judge(
            fit,
            before,
            lambda: share_behind_walls(self.grid(), self._pose, returns, sensor),
            lambda: share_in_free(self.grid(), self._pose, returns),
        )
        self.quality = fit

    def _look_for_itself(self, odom_from_base: SE2, returns: Array, sensor: SE2) -> None:
        """Take the pose of a robot that was carried off from where its scans fit the map."""
        self._carried.see(odom_from_base, returns, sensor)
        found = self._carried.find(self._graph, self._clouds, self.grid, self._scatter)
        if found is None:
            return
        self._pose, self._covariance = found, _BEGIN
        self._reference = -1
        self._local = None

    def marker(
        self,
        stamp_ns: int,
        dictionary: str,
        marker_id: int,
        candidates: Sequence[MarkerCandidate],
        base_from_camera: Array,
    ) -> bool:
        """Take a sighting of a marker into account; True if it was used.

        The candidates, of which at most one is right, are camera_from_marker (4, 4), its (6, 6)
        covariance and its score; the camera's frame is optical. A marker that was seen long before
        closes a loop.
        """
        odom_from_base = self._history.at(stamp_ns)
        if odom_from_base is None or self._reference < 0 or self.fixed or self._carried.is_possible:
            return False
        graph = self._graph
        before = graph.pose(self._reference)
        node_from_base = before.inverse() @ (self._map_from_odom @ odom_from_base)
        if node_from_base.distance_m(SE2(0.0, 0.0, 0.0)) > _MARKER_NODE_M:
            return False
        sighted = self._markers.sight(
            self._reference, node_from_base, self._link_covariance(before.yaw_rad), dictionary,
            marker_id, candidates, base_from_camera,
        )  # fmt: skip
        if sighted.outcome == "ignored":
            return False
        self.graph_version += 1
        if sighted.outcome == "loop":
            self._closer.closed += 1
            self._tried = set()
            self._follow(before)
            assert self._scanned is not None
            self._map_from_odom = self._pose @ self._scanned[1].inverse()
        elif sighted.outcome == "loop_rejected":
            self._closer.rejected += 1
        return True

    def _keep(self, stamp_ns: int, seen: ScanPoints, returns: Array) -> None:
        """Keep the scan of a new node."""
        self._stamps_ns.append(stamp_ns)
        self._seen.append(seen)
        self._clouds.append(surface_cloud(returns, seen.sensor))
        self._scans_of.append(1)

    def _enrich(self, returns: Array, sensor: SE2) -> None:
        """Add a scan to what the keyframe next to the robot has seen: noise averages out."""
        node = self._reference
        if self._scans_of[node] >= _MOST_SCANS:
            return
        base_from_here = self._graph.pose(node).inverse() @ self._pose
        if base_from_here.distance_m(SE2(0.0, 0.0, 0.0)) > self._params.minimum_travel_distance:
            return
        more = moved_cloud(surface_cloud(returns, sensor), base_from_here)
        self._clouds[node] = np.concatenate([self._clouds[node], more])
        self._scans_of[node] += 1
        if self._scans_of[node] == _MOST_SCANS:
            self._clouds[node] = compacted(self._clouds[node], _COMPACT_M)
        if self._scans_of[node] % _REBUILD_SCANS == 0:
            self._local = None

    def _look_again(self, stamp_ns: int, seen: ScanPoints) -> None:
        """Make a scan next to a keyframe one too, where it shows that something has gone: people
        whom keyframes have seen would stay in the map, and close doors.
        """
        if stamp_ns - self._looked_again_ns < _LOOK_AGAIN_NS:
            return
        self._looked_again_ns = stamp_ns
        if self._structures is None or self._structures[0] != self.map_version:
            self._structures = self.map_version, Structures.of(self.grid())
        structures = self._structures[1]
        self._gone = self._gone + 1 if structures.gone(self._pose, seen) else 0
        if self._gone < _GONE_TWICE:
            return
        again = np.array(self._again, np.int64)
        if np.count_nonzero(self._away_m(again) <= _AGAIN_M) >= _MOST_AGAIN:
            return
        known = structures.without_new(self._pose, seen)
        returns = thinned(known.points_m, _SPACING_M, _MOST_RETURNS)
        if len(returns) >= _FEW_RETURNS:
            self._again.append(len(self._seen))
            self._add_keyframe(stamp_ns, known, returns, matched=True)

    def _predict(
        self, stamp_ns: int, odom_from_base: SE2, returns: Array, sensor: SE2
    ) -> SE2 | None:
        """Move the pose as odometry moved; that motion, None before the first scan of all."""
        p = self._params
        if self._scanned is None:
            self._pose = self._map_from_odom @ odom_from_base
            return None
        before_ns, before = self._scanned
        moved = before.inverse() @ odom_from_base
        factor = self._scale.factor
        moved = SE2(factor * moved.x_m, factor * moved.y_m, moved.yaw_rad)
        self._unlearnt_rad2 = 0.0
        far_m = moved.distance_m(SE2(0.0, 0.0, 0.0))
        elapsed_s = (stamp_ns - before_ns) * 1e-9
        if self._jumped(moved, elapsed_s, returns, sensor):
            self.jumps.append(Jump(before_ns, stamp_ns, moved))
            moved, far_m = SE2(0.0, 0.0, 0.0), 0.0
            std_m = max(_JUMP_STD_M, self._usual_speed_m_s * elapsed_s)
            along = across = std_m * std_m
            turn = _JUMP_STD_RAD * _JUMP_STD_RAD
        else:
            self._learn_speed(far_m, elapsed_s)
            # Both wheels err on the way that they roll, also in a turn on the spot.
            rolled_m = far_m + _HALF_TRACK_M * abs(moved.yaw_rad)
            along = (
                portable.square(p.odometry_translation_ratio * far_m)
                + portable.square(p.odometry_translation_std_m_per_sqrt_m) * rolled_m
            )
            turn = (
                portable.square(p.odometry_rotation_ratio * moved.yaw_rad)
                + portable.square(p.odometry_rotation_std_rad_per_sqrt_m) * rolled_m
            )
            self._wheels.begin(self._covariance, along, turn)
            along = across = self._wheels.shift * along + _FLOOR_STD_M * _FLOOR_STD_M
            self._unlearnt_rad2 = max(0.0, 1.0 - self._wheels.turn) * turn
            turn = self._wheels.turn * turn + _FLOOR_STD_RAD * _FLOOR_STD_RAD
        pose = self._pose @ moved
        self._scale.begin(self._pose, pose)
        c, s = portable.cos_sin(self._pose.yaw_rad)
        self._covariance = (
            self._covariance.moved(-(pose.y_m - self._pose.y_m), pose.x_m - self._pose.x_m)
            .spread(along, c, s, 0.0)
            .spread(across, -s, c, 0.0)
            .spread(turn, 0.0, 0.0, 1.0)
        )
        if self._surprise is not None:
            matrix = self._covariance.matrix() + self._surprise
            self._covariance = PlanarCovariance.from_matrix(matrix)
            self._surprise = None
        self._pose = pose
        return moved

    def _jumped(self, moved: SE2, elapsed_s: float, returns: Array, sensor: SE2) -> bool:
        """Whether odometry jumped, and the robot moved as usual: of an unusual step the scan
        decides.
        """
        far_m = moved.distance_m(SE2(0.0, 0.0, 0.0))
        speed_m_s = far_m / elapsed_s
        if far_m <= _JUMP_M:
            return False
        p = self._params
        if len(returns) < _FEW_RETURNS or not p.use_scan_matching or not self._seen:
            return speed_m_s > _JUMP_M_S
        usual_m = self._usual_speed_m_s * elapsed_s
        usual = far_m <= _FASTER * usual_m
        there = self._pose @ moved
        if usual and self._fitted(there, 0.0, returns, sensor).fit >= self._usual_fit - _ODD:
            return False
        reach_m = _WINDOW * p.odometry_translation_ratio * far_m
        went = self._fitted(there, reach_m, returns, sensor)
        turned = self._pose @ SE2(0.0, 0.0, moved.yaw_rad)
        stayed = max(
            (
                self._fitted(pose, _WINDOW * usual_m, returns, sensor)
                for pose in (self._pose, turned)
            ),
            key=lambda fitted: fitted.fit,
        )
        # Where the robot stayed, most fits; where little does, nothing speaks against odometry.
        if stayed.fit < (self._usual_fit - _DOUBTFUL if usual else _STAYED_FIT):
            return False
        better = stayed.fit - went.fit
        if better * _independent(returns) < _JUMPED_LEAST:
            return False
        # Along a corridor, all places fit, up to where it was not seen yet.
        unsure = usual or stayed.open_direction or went.open_direction
        return better > (_JUMPED_FIT_USUAL if unsure else _JUMPED_FIT)

    def _fitted(self, pose: SE2, window_m: float, returns: Array, sensor: SE2) -> Refined:
        """Where the returns fit best around a pose; without a window, found from there alone."""
        local = self._local_map()
        loose = np.diag([1.0 / (std * std) for std in (_JUMP_STD_M, _JUMP_STD_M, _JUMP_STD_RAD)])
        if window_m > 0.0:
            pose = self._correlated(local, pose, loose, returns, window_m, _MOST_WINDOW_RAD)
        std_m = self._params.scan_match_std_m
        return refine(local, pose, loose, returns, sensor, std_m)

    def _correlated(
        self,
        local: LocalMap,
        pose: SE2,
        prior: Array,
        returns: Array,
        window_m: float,
        window_rad: float,
    ) -> SE2:
        """Where a scan fits best in a window, which is at least as large as the parameters say."""
        p = self._params
        least_m = p.correlation_search_space_dimension / 2.0
        return correlate(
            local, pose, thinned(returns, p.line_cell_m, 180),
            max(least_m, min(window_m, _MOST_WINDOW_M)),
            max(p.coarse_search_angle_offset, min(window_rad, _MOST_WINDOW_RAD)),
            p.coarse_angle_resolution, p.correlation_search_space_smear_deviation, prior,
            3.0 / _independent(returns),
        ).map_from_base  # fmt: skip

    def _learn_speed(self, far_m: float, elapsed_s: float) -> None:
        if far_m > _STILL_M:
            self._usual_speed_m_s += _USUAL_GAIN * (far_m / elapsed_s - self._usual_speed_m_s)

    def _match(self, returns: Array, sensor: SE2, moved: SE2 | None) -> float | None:
        """Correct the predicted pose by a scan; the share of returns that fit, None if it was not
        used. `moved` since the scan before; None: there was none, the robot may be anywhere near.
        """
        p = self._params
        if len(returns) < _FEW_RETURNS or not p.use_scan_matching:
            return None
        std_m = p.scan_match_std_m * math.sqrt(self._scatter)
        local = self._local_map()
        prior = information_of(self._covariance.matrix())
        found = refine(local, self._pose, prior, returns, sensor, std_m)
        expected = max(self._usual_fit - _DOUBTFUL, p.link_match_minimum_response_fine)
        way_m = math.inf if moved is None else moved.distance_m(SE2(0.0, 0.0, 0.0))
        far = moved is None or _is_large(moved)
        doubtful = far or found.fit < expected
        if far and found.fit < _LOST_FIT:
            # However good odometry has been, this time it may err as much as the parameters say.
            self._covariance = self._covariance.spread(self._unlearnt_rad2, 0.0, 0.0, 1.0)
            prior = information_of(self._covariance.matrix())
        # Of a short step the window alone is a limit: slip and stamps err more than it is long.
        by_odometry, likely = prior, prior if far else np.zeros((3, 3))
        contradicted = self._is_far(found, prior)
        if contradicted and not found.open_direction:
            sure = refine(
                local, self._pose, prior, returns, sensor, std_m,
                few_share=_SURE_SHARE,
            )  # fmt: skip
            found = sure if sure.open_direction else found
        if contradicted or doubtful:
            doubted = prior * _DOUBTED
            other = refine(
                local, self._pose, doubted, returns, sensor, std_m,
                found.map_from_base,
            )  # fmt: skip
            if doubtful:
                other = self._searched(local, prior, likely, returns, sensor, std_m, other)
                better = self._worth(other, likely, returns) - self._worth(found, likely, returns)
                if not far and other.fit < expected:
                    # Beside what is new, little fits wherever the robot may be.
                    better = 0.0
            else:
                better = other.fit - found.fit
            if better > (_BETTER_FIT if doubtful else 0.0):
                found, prior = other, doubted
        if far and _LOST_FIT <= found.fit < expected and self._unlearnt_rad2 > 0.0:
            # Where all fits within what the parameters allow, that is where the robot is.
            learnt = self._covariance
            self._covariance = learnt.spread(self._unlearnt_rad2, 0.0, 0.0, 1.0)
            loose = information_of(self._covariance.matrix())
            other = self._searched(local, loose, loose, returns, sensor, std_m, found)
            if other.fit >= expected:
                found, prior = other, loose * _DOUBTED
            else:
                self._covariance = learnt
        self._usual_fit += _USUAL_GAIN * (found.fit - self._usual_fit)
        discord = found.discord * self._scatter
        self._usual_discord += _USUAL_GAIN * (discord - self._usual_discord)
        if found.fit < _LOST_FIT:
            return found.fit
        if not (contradicted or found.fit < expected):
            self._scale.learn(self._pose, self._covariance, found)
        if not (found.open_direction or doubtful or contradicted):
            self._wheels.learn(self._pose, self._covariance, found)
        if found.open_direction and moved is not None:
            xy_information = found.information[:2, :2]
            trace = float(xy_information[0, 0] + xy_information[1, 1])
            open_share = np.eye(2) - xy_information / trace if trace > 0.0 else np.eye(2)
            self._drift += _DRIFT_M2_PER_M * way_m * open_share
        if far and self._is_far(found, by_odometry):
            off = self._off(found)
            self._surprise = np.outer(off, off)
        self._pose = found.map_from_base
        self._covariance = PlanarCovariance.from_matrix(information_of(prior + found.information))
        return found.fit

    @property
    def _scatter(self) -> float:
        """Factor of the variances by the parameters, at least 1: how much more the scans contradict
        the map and themselves than these say.
        """
        return max(1.0, self._usual_discord / _DISCORD)

    def _worth(self, found: Refined, prior: Array, returns: Array) -> float:
        """The share of returns that fit, less what it takes to believe that odometry was so wrong.

        Both are logarithms of likelihoods: a return that fits counts 1, and odometry's errors have
        long tails, as Student's t distribution with three degrees of freedom.
        """
        unlikely = portable.log(1.0 + self._far(found, prior) / 3.0)
        return found.fit - 3.0 * unlikely / _independent(returns)

    def _is_far(self, found: Refined, prior: Array) -> bool:
        """Whether a pose is farther from the predicted one than odometry's errors go."""
        return self._far(found, prior) > CHI2_99

    def _far(self, found: Refined, prior: Array) -> float:
        """Squared Mahalanobis distance of a pose from the predicted one."""
        off = self._off(found)
        return float(portable.product(off, prior, off))

    def _off(self, found: Refined) -> Array:
        """x, y and yaw of a pose less those of the predicted one."""
        there, here = found.map_from_base, self._pose
        yaw_rad = wrap_angle(there.yaw_rad - here.yaw_rad)
        return np.array([there.x_m - here.x_m, there.y_m - here.y_m, yaw_rad])

    def _searched(
        self,
        local: LocalMap,
        prior: Array,
        likely: Array,
        returns: Array,
        sensor: SE2,
        std_m: float,
        found: Refined,
    ) -> Refined:
        """What fits clearly better in a window around the prediction, or what was found.

        `likely`: (3, 3) information by which what is farther counts for less.
        """
        doubted = prior * _DOUBTED
        deviation_rad = math.sqrt(self._covariance.yaw_yaw)
        best, worth = found, self._worth(found, likely, returns)
        for turns in _TURNS:
            turned = self._pose @ SE2(0.0, 0.0, turns * deviation_rad)
            other = refine(local, self._pose, doubted, returns, sensor, std_m, turned)
            others = self._worth(other, likely, returns)
            if others > worth + _BETTER_FIT:
                best, worth = other, others
        if best.fit >= self._usual_fit - _DOUBTFUL:
            return best
        deviation_m = math.sqrt(max(self._covariance.x_x, self._covariance.y_y))
        coarse = self._correlated(
            local, self._pose, likely, returns, _WINDOW * deviation_m, _WINDOW * deviation_rad
        )
        # What fits by chance would pull a scan, of which much is new, from its right place.
        other = refine(
            local, self._pose, doubted, returns, sensor, std_m, coarse, pull_m=_SURE_PULL_M
        )
        return other if self._worth(other, likely, returns) > worth + _BETTER_FIT else best

    def _local_map(self) -> LocalMap:
        """The map around the pose."""
        p = self._params
        stale = self._local_at.distance_m(self._pose) > p.minimum_travel_distance
        if self._local is not None and not stale:
            return self._local
        graph = self._graph
        if self._reference < 0:
            self._reference = int(np.argmin(self._away_m(np.arange(len(graph.poses)))))
        radius_m = graph.radius_m(
            self._reference, p.link_scan_maximum_distance, self._seen[self._reference].reach_m,
            p.scan_buffer_size,
        )  # fmt: skip
        trusted, _ = graph.trusted_and_candidates(self._reference, radius_m)
        away_m = self._away_m(trusted)
        nodes = trusted[np.argsort(away_m, kind="stable")][: p.scan_buffer_size]
        if int(nodes[0]) != self._reference:
            self._reference = int(nodes[0])
            self._visited = True
        self._local_nodes, self._local_at = nodes, self._pose
        # In their own order, so that the same keyframes give the same map.
        ordered = np.sort(nodes).tolist()
        self._local = local_map(
            [graph.pose(node) for node in ordered],
            [self._clouds[node] for node in ordered],
            p.line_cell_m,
        )
        return self._local

    def _away_m(self, nodes: NDArray[np.int64]) -> Array:
        poses = self._graph.poses[nodes]
        return portable.hypot_each(poses[:, 0] - self._pose.x_m, poses[:, 1] - self._pose.y_m)

    def _wants_keyframe(self, fit: float | None, sees_round: bool) -> bool:
        """Whether no trusted keyframe is near the pose."""
        p = self._params
        self._local_map()
        away_m = self._away_m(self._local_nodes)
        apart_m = p.minimum_travel_distance
        if fit is not None and fit >= _KNOWN_FIT:
            apart_m *= _KNOWN_FACTOR
        if fit is not None and fit < max(self._usual_fit - _ODD, _LOST_FIT):
            # Wherever this is, it must not be drawn into the map around for the sake of a step.
            apart_m *= _KNOWN_FACTOR
        near = self._local_nodes[away_m <= apart_m]
        if not len(near) or sees_round:
            return not len(near)
        yaws = self._graph.poses[near, 2].tolist()
        turned = min(abs(wrap_angle(yaw - self._pose.yaw_rad)) for yaw in yaws)
        return turned > p.minimum_travel_heading

    def _add_keyframe(self, stamp_ns: int, seen: ScanPoints, returns: Array, matched: bool) -> None:
        """Make the scan at the pose a node, linked to those nearest to it."""
        graph = self._graph
        node = graph.add_node(self._pose)
        self._placed.append(self._link_covariance(self._pose.yaw_rad))
        self._keep(stamp_ns, seen, returns)
        if node > 0:
            away_m = self._away_m(self._local_nodes)
            nearest = self._local_nodes[np.argsort(away_m, kind="stable")]
            links = nearest[: _LINKS if matched else 1].tolist()
            for source in links:
                of_source = graph.pose(source)
                covariance = self._link_covariance(of_source.yaw_rad) + self._placed[source]
                graph.add_edge(
                    SCAN_MATCH if matched else ODOMETRY, source, node,
                    of_source.inverse() @ self._pose, covariance * len(links),
                )  # fmt: skip
        self._covariance = PlanarCovariance(
            x_x=1e-6 * self._scatter, y_y=1e-6 * self._scatter, yaw_yaw=2.5e-7 * self._scatter
        )
        self._drift = np.zeros((2, 2))
        self._reference = node
        self._local = None
        self._occupancy.add(self._pose, seen)
        self.map_version += 1
        self.graph_version += 1
        self._close_loop(node)

    def _close_loop(self, node: int) -> None:
        """Look for a loop at a node, and close it if it holds."""
        if self.fixed or not self._params.do_loop_closing or node in self._tried:
            return
        self._tried.add(node)
        candidate = find_loop(
            self._graph, self._clouds, self._seen, node, self._params, self._scatter
        )
        if candidate is None:
            return
        before = self._graph.pose(self._reference)
        verdict = self._closer.close(
            candidate, lambda loop: explains(self._graph, self._seen, loop, self._params)
        )
        self.graph_version += 1
        if not verdict.accepted:
            return
        self._tried = {node}
        self._follow(before)

    def _follow(self, before: SE2) -> None:
        """The nodes have moved: take the pose along with its reference, which was at `before`, and
        redraw the grid.
        """
        self._pose = self._graph.pose(self._reference) @ (before.inverse() @ self._pose)
        self._local = None
        self._occupancy.rebuild(
            (self._graph.pose(node), seen) for node, seen in enumerate(self._seen)
        )
        self.map_version += 1
        self.graph_version += 1

    def _link_covariance(self, yaw_rad: float) -> Array:
        """(3, 3) of the pose in the local map, by the axes of a node."""
        c, s = portable.cos_sin(yaw_rad)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        covariance = portable.product(turn, self._covariance.matrix(), turn.T)
        covariance[:2, :2] += portable.product(turn[:2, :2], self._drift, turn[:2, :2].T)
        covariance[0, 0] += self._scatter * _LINK_STD_M * _LINK_STD_M
        covariance[1, 1] += self._scatter * _LINK_STD_M * _LINK_STD_M
        covariance[2, 2] += self._scatter * _LINK_STD_RAD * _LINK_STD_RAD
        return covariance


def _is_large(moved: SE2) -> bool:
    """Whether a step between two scans is."""
    far_m = moved.distance_m(SE2(0.0, 0.0, 0.0))
    return far_m > _LARGE_MOVE_M or abs(moved.yaw_rad) > _LARGE_TURN_RAD


def _independent(returns: Array) -> float:
    """So many returns say as much, each for itself."""
    return max(len(returns) / _ALIKE, 1.0)
