"""Evaluates a run against the ground truth: localisation, marker detection, and navigation."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, SCAN_FRAME, SE2, Array, wrap_angle
from mazebot.common.maths.pose_history import PoseHistory
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import ActionFeedback, ActionResult
from mazebot.common.messages.documents import (
    BodyEntity,
    Contact,
    Entities,
    Evaluation,
    GoalReport,
    LocalizationConsistency,
    MarkerEntity,
    NavigationResult,
    Planar,
    World,
)
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.messages import (
    chain_transforms,
    matrix_from_pose,
    ns_from_time,
    se2_from_pose,
)
from mazebot.common.messages.slam_documents import ExplorationStatus, PoseGraph
from mazebot.common.recordings.series import RunSeries
from mazebot.recorder.judging.consistency import inside_95_percent
from mazebot.recorder.judging.driven_way import DrivenWay
from mazebot.recorder.judging.error_summary import ErrorSummary
from mazebot.recorder.judging.history import RunHistory
from mazebot.recorder.judging.obstacles import obstacles, read_meshes
from mazebot.recorder.judging.plan import Plan
from mazebot.recorder.judging.recent_rows import RecentRows
from mazebot.recorder.judging.shortest_path import ShortestPath

if TYPE_CHECKING:
    from mazebot.recorder.judging.map.mapping import MappingEvaluation

GOAL_TOLERANCE_M = 0.25
"""A goal counts as reached within this distance: Nav2's `xy_goal_tolerance`,"""
GOAL_TOLERANCE_RAD = 0.25
"""and within this angle: Nav2's `yaw_goal_tolerance`."""
SAME_PLACE_M = 1e-3
"""A goal nearer than this to a named location gets its name."""

Result = NavigationResult | ActionResult
_DRIVE = "navigate_to_pose"
_PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
"""Of a pose's covariance: x, y and yaw."""

P = TypeVar("P")
_Pending = deque[tuple[int, P]]
# Entries that wait for the ground truth, with their stamps.

_TRUTH_DEPTH = 30 * 60
_PENDING_DEPTH = 1000
_RECENT_ESTIMATES = 10 * 60 * 15
"""A quarter of an hour's: the mean error of a goal that took longer may cover only its last part.
"""
_MOST_CONTACTS = 1000
"""Contacts listed one by one; further ones are only counted."""
_GOALS_UNDER_WAY = 16


_NONE_SET: set[str] = set()
"""Shared: otherwise pydantic would keep the set of field names for each report."""


@dataclass(slots=True)
class _Judged:
    """A goal that has ended, and the errors and contacts on the way. Small: a run may have
    thousands.
    """

    start_ns: int
    end_ns: int
    verdict: GoalReport
    """The last report."""
    errors: int = 0
    error_sum_m: float = 0.0
    contacts: int = 0
    _is_told: bool = False
    """Whether the verdict includes all errors and contacts."""

    def see_error(self, stamp_ns: int, error_m: float) -> None:
        if self.start_ns <= stamp_ns <= self.end_ns:
            self.errors += 1
            self.error_sum_m += error_m
            self._is_told = False

    def see_contact(self, stamp_ns: int) -> None:
        if self.start_ns <= stamp_ns <= self.end_ns:
            self.contacts += 1
            self._is_told = False

    def report(self) -> GoalReport:
        if not self._is_told:
            mean_m = self.error_sum_m / self.errors if self.errors else None
            seen = {"localisation_error_m": mean_m, "contacts": self.contacts}
            self.verdict = GoalReport.model_construct(_NONE_SET, **dict(self.verdict) | seen)
            self._is_told = True
        return self.verdict


class RunEvaluation:
    """Evaluates one run in one world, from its messages in the order of arrival.

    An estimate is compared with the true pose at its own stamp, interpolated between the true poses
    around it, as soon as both are there: the order in which topics arrive does not matter.

    What is measured:

    - localisation error: distance and angle between an estimated pose and the true one, over all
      estimates from the first on.
    - marker error: distance between a marker's detected position (the best solution, in the
      camera's frame, transformed into the map by the robot's true pose) and its true position.
    - odometry drift: distance between the pose by wheel odometry alone, relative to the world's
      start pose, and the true one, at the newest odometry message.
    - consistency: the share of those estimates whose 95 % ellipsoid holds the true pose.
    - markers seen: the number of images in which each marker of the world was detected.
    - a task sent as an action is judged as a goal is: by its goal in the map, or, where it has
      none, by where it should have led from the true pose at its start.
    - a goal is reached if navigation reports so and the robot's true pose is within 0.25 m and
      0.25 rad of it; its path is the true one, from the start to the end that navigation reports,
      and its shortest path leads from the robot's true position at its start, around the walls and
      the bodies that were static when the goal was sent.
    - where the robot makes the map itself: see `MappingEvaluation`.
    """

    def __init__(self, world: World, assets: Mapping[str, bytes] | None = None) -> None:
        """`assets` by sha256 may be filled later: the world's meshes are looked up in them when the
        first goal has ended.
        """
        self._world = world
        self._assets = {} if assets is None else assets
        self._truth = PoseHistory(_TRUTH_DEPTH)
        self._way = DrivenWay()
        self.history = RunHistory()
        self._entities: tuple[MarkerEntity, ...] = ()
        self._standing: tuple[BodyEntity, ...] = ()
        self._standing_at: dict[int | str, tuple[BodyEntity, ...]] = {}
        """Static bodies at the time a goal was sent, by its stamp or its id."""
        self._static: list[msg.TransformStamped] = []
        self._estimates: _Pending[tuple[SE2, Array]] = deque(maxlen=_PENDING_DEPTH)
        self._odometry: _Pending[SE2] = deque(maxlen=_PENDING_DEPTH)
        self._detections: _Pending[msg.Detection3DArray] = deque(maxlen=_PENDING_DEPTH)
        self._results: _Pending[Result] = deque(maxlen=_PENDING_DEPTH)
        self._goals: list[_Judged] = []
        self._goal_stamps_ns: set[int] = set()
        self._goal_ids: set[str] = set()
        self._paths: tuple[tuple[BodyEntity, ...], ShortestPath] | None = None
        self._plan = Plan(world, self._assets)
        self._contacts: list[Contact] = []
        self._contact_stamps_ns: deque[int] = deque(maxlen=_MOST_CONTACTS)
        self._contact_count = 0
        self._seen: Counter[str] = Counter()
        self._recent_error_m = RecentRows(1, _RECENT_ESTIMATES, _RECENT_ESTIMATES * 11 // 10)
        self._error_m, self._error_rad = ErrorSummary(), ErrorSummary()
        self._marker_error_m = ErrorSummary()
        self._estimate_count, self._inside_count = 0, 0
        self._drift_m: float | None = None
        self._mapping: MappingEvaluation | None = None
        if world.slam:
            from mazebot.recorder.judging.map.mapping import MappingEvaluation  # noqa: PLC0415 - Numba

            self._mapping = MappingEvaluation(world, self._assets)

    def set_entities(self, entities: Entities) -> None:
        """Set the entities of the world."""
        self._entities = entities.markers
        self._standing = tuple(body for body in entities.bodies if not body.moves)
        if self._mapping is not None:
            self._mapping.set_entities(self._entities, self._standing)

    def add_static_transforms(self, transforms: msg.TFMessage) -> None:
        """Add fixed frames of the robot."""
        known = {entry.child_frame_id: entry for entry in (*self._static, *transforms.transforms)}
        self._static = list(known.values())
        base_from_scan = chain_transforms(self._static, BASE_FOOTPRINT_FRAME, SCAN_FRAME)
        if self._mapping is not None and base_from_scan is not None:
            self._mapping.set_scan_height(float(base_from_scan[2, 3]))

    def add_ground_truth(self, odometry: msg.Odometry) -> None:
        """Add a true pose, map from base_footprint; one older than the newest is dropped."""
        stamp_ns = ns_from_time(odometry.header.stamp)
        pose = matrix_from_pose(odometry.pose.pose)
        newest_ns = self._truth.newest_ns
        if newest_ns is None or stamp_ns > newest_ns:
            self._truth.add(stamp_ns, pose)
            self._way.add(stamp_ns, _planar(pose))
            twist = odometry.twist.twist
            self.history.add_truth(stamp_ns, _planar(pose), twist.linear.x, twist.angular.z)
        self._settle()

    def add_odometry(self, odometry: msg.Odometry) -> None:
        """Add wheel odometry, odom from base_footprint."""
        stamp_ns = ns_from_time(odometry.header.stamp)
        self._odometry.append((stamp_ns, se2_from_pose(odometry.pose.pose)))

    def add_estimate(self, estimate: msg.PoseWithCovarianceStamped) -> None:
        """Add an estimated pose, map from base_footprint, with its covariance."""
        stamp_ns = ns_from_time(estimate.header.stamp)
        covariance = np.asarray(estimate.pose.covariance).reshape(6, 6)[_PLANAR]
        self._estimates.append((stamp_ns, (se2_from_pose(estimate.pose.pose), covariance)))

    def add_detections(self, detections: msg.Detection3DArray) -> None:
        """Add the markers detected in one image, in the camera's optical frame."""
        classes = {d.results[0].hypothesis.class_id for d in detections.detections if d.results}
        for class_id in sorted(classes - self._seen.keys()):
            self.history.see_marker(ns_from_time(detections.header.stamp), class_id)
        self._seen.update(sorted(classes))
        if detections.detections:
            self._detections.append((ns_from_time(detections.header.stamp), detections))

    def add_contact(self, contact: Contact) -> None:
        """Add a contact."""
        stamp_ns = _ns(contact.time_s)
        self._contact_count += 1
        if len(self._contacts) < _MOST_CONTACTS:
            self._contacts.append(contact)
        self._contact_stamps_ns.append(stamp_ns)
        for judged in self._goals[-_GOALS_UNDER_WAY:]:
            judged.see_contact(stamp_ns)

    def add_goal(self, goal: msg.PoseStamped) -> None:
        """Add a goal that was sent."""
        stamp_ns = ns_from_time(goal.header.stamp)
        self._goal_stamps_ns.add(stamp_ns)
        self._remember_standing(stamp_ns)

    def add_feedback(self, feedback: ActionFeedback) -> None:
        """Add the progress of an action; its first one tells that it was sent."""
        if feedback.goal_id and feedback.goal_id not in self._goal_ids:
            self._goal_ids.add(feedback.goal_id)
            self._remember_standing(feedback.goal_id)

    def _remember_standing(self, goal: int | str) -> None:
        self._standing_at[goal] = self._standing
        while len(self._standing_at) > _GOALS_UNDER_WAY:
            del self._standing_at[next(iter(self._standing_at))]

    def add_result(self, result: Result) -> None:
        """Add the result of a goal; one aborted by a restart of its world is not counted."""
        if result.error_code == ErrorCode.WORLD_RESTARTED:
            return
        if isinstance(result, ActionResult):
            self._goal_ids.add(result.goal_id)
        else:
            self._goal_stamps_ns.add(result.goal_stamp_ns)
        self._results.append((_ns(result.end_time_s), result))

    def add_map(self, grid: msg.OccupancyGrid) -> None:
        """Add a map that the robot has made; it is judged if the world's request says so."""
        if self._mapping is not None:
            self._mapping.add_map(grid, self._now_s(), self._driven_m())

    def add_scan(self, scan: msg.LaserScan) -> None:
        """Add a scan."""
        if self._mapping is not None:
            self._mapping.add_scan(scan)

    def add_pose_graph(self, graph: PoseGraph) -> None:
        """Add the pose graph of the map."""
        if self._mapping is not None:
            self._mapping.add_graph(graph)

    def add_exploration(self, status: ExplorationStatus) -> None:
        """Add the explorer's state."""
        if self._mapping is not None:
            self._mapping.add_exploration(status, self._now_s())

    @property
    def true_faces_m(self) -> Array | None:
        """(n, 2, 2) segments, from and to, of the walls that the lidar can see; None: the robot has
        made no map.
        """
        return None if self._mapping is None else self._mapping.true_faces_m

    @property
    def goals_ended(self) -> tuple[int, int]:
        """Number of ended goals that still wait for a true pose, and of those that are judged."""
        return len(self._results), len(self._goals)

    def evaluation(self, recording: str = "") -> Evaluation:
        """The evaluation of the run so far.

        A goal that ended after the newest true pose is judged by that pose, and again when a newer
        one has arrived. Before the first true pose, no goal is judged.
        """
        self._settle()
        return Evaluation(
            goals=tuple(self._reports()),
            contacts=tuple(self._contacts),
            markers_seen={
                class_id: self._seen[class_id]
                for class_id in dict.fromkeys(str(entity.marker_id) for entity in self._entities)
            },
            localisation_error_m=self._error_m.statistics(),
            localisation_error_rad=self._error_rad.statistics(),
            localization=LocalizationConsistency(
                inside_95_percent=self._inside_count / self._estimate_count
                if self._estimate_count
                else None,
                estimates=self._estimate_count,
            ),
            marker_error_m=self._marker_error_m.statistics(),
            odometry_drift_m=self._drift_m,
            mapping=self._mapping.evaluation(self._driven_m(), self._way_pose)
            if self._mapping is not None
            else None,
            recording=recording,
        )

    def series(self, evaluation: Evaluation, now_s: float) -> RunSeries:
        """The run so far over time; `evaluation` is its newest one."""
        return self.history.series(
            self._world, evaluation, self._entities, self._plan.rings(self._standing), now_s
        )

    def totals(self) -> dict[str, Any]:
        """Totals of the run that the evaluation does not contain, as JSON values.

        `contacts` is their number, `distance_m` the length driven, None before the first true pose,
        and `spl` success weighted by
        path length, https://arxiv.org/abs/1807.06757: the mean over the goals of navigate_to_pose
        that have ended of reached x shortest / max(driven, shortest); None where no goal has.
        """
        self._settle()
        reports = self._reports()
        drives = [report for report in reports if report.action == _DRIVE]
        return {
            "distance_m": self._driven_m(),
            "contacts": self._contact_count,
            "goals_sent": len(self._goal_stamps_ns) + len(self._goal_ids),
            "goals_reached": sum(report.reached for report in reports),
            "spl": sum(map(_path_efficiency, drives)) / len(drives) if drives else None,
        }

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """The evaluation's state so far, as JSON values and as arrays, for `restore()`.

        Data of the world's latched messages is not included: they are received again.
        """
        self._settle()
        goals = [
            {
                "start_ns": judged.start_ns,
                "end_ns": judged.end_ns,
                "verdict": judged.report().model_dump(mode="json"),
                "errors": judged.errors,
                "error_sum_m": judged.error_sum_m,
                "contacts": judged.contacts,
            }
            for judged in self._goals
        ]
        values = {
            "goals": goals,
            "results": [result.model_dump(mode="json") for result in self._waiting_results(False)],
            "action_results": [
                result.model_dump(mode="json") for result in self._waiting_results(True)
            ],
            "goal_stamps_ns": sorted(self._goal_stamps_ns),
            "goal_ids": sorted(self._goal_ids),
            "estimates": [self._estimate_count, self._inside_count],
            "contacts": [contact.model_dump(mode="json") for contact in self._contacts],
            "contact_stamps_ns": list(self._contact_stamps_ns),
            "contact_count": self._contact_count,
            "seen": dict(self._seen),
            "drift_m": self._drift_m,
            "history": self.history.values(),
        }
        if self._mapping is not None:
            values["mapping"], mapping_arrays = self._mapping.state()
        arrays = {
            "recent_error/stamps_ns": self._recent_error_m.stamps_ns,
            "recent_error/rows": self._recent_error_m.rows,
        }
        for name, part in self._lasting():
            arrays |= {f"{name}/{key}": array for key, array in part.state().items()}
        if self._mapping is not None:
            arrays |= {f"mapping/{key}": array for key, array in mapping_arrays.items()}
        return values, arrays

    def restore(self, values: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a saved `state()`.

        Raises ValueError, KeyError, TypeError if it is invalid.
        """
        for name, part in self._lasting():
            start = f"{name}/"
            part.restore(
                {key.removeprefix(start): arrays[key] for key in arrays if key.startswith(start)}
            )
        if self._mapping is not None:
            start = "mapping/"
            self._mapping.restore(
                values["mapping"],
                {key.removeprefix(start): arrays[key] for key in arrays if key.startswith(start)},
            )
        rows = zip(
            arrays["recent_error/stamps_ns"].tolist(),
            arrays["recent_error/rows"].tolist(),
            strict=True,
        )
        for stamp_ns, row in rows:
            self._recent_error_m.add(stamp_ns, row)
        for goal in values["goals"]:
            verdict = GoalReport.model_validate(goal["verdict"])
            self._goals.append(_Judged(**{**goal, "verdict": verdict}))
        for result in values["results"]:
            self.add_result(NavigationResult.model_validate(result))
        for result in values["action_results"]:
            self.add_result(ActionResult.model_validate(result))
        self._goal_ids.update(values["goal_ids"])
        self._estimate_count, self._inside_count = map(int, values["estimates"])
        self._goal_stamps_ns.update(values["goal_stamps_ns"])
        self._contacts = [Contact.model_validate(contact) for contact in values["contacts"]]
        self._contact_stamps_ns.extend(values["contact_stamps_ns"])
        self._contact_count = values["contact_count"]
        self._seen.update(values["seen"])
        self._drift_m = values["drift_m"]
        self.history.restore_values(values["history"])

    def _lasting(self) -> tuple[tuple[str, DrivenWay | ErrorSummary | RunHistory], ...]:
        """The parts that have arrays in their state."""
        return (
            ("way", self._way),
            ("error_m", self._error_m),
            ("error_rad", self._error_rad),
            ("marker_error_m", self._marker_error_m),
            ("history", self.history),
        )

    def _reports(self) -> list[GoalReport]:
        """The goals that have ended."""
        provisional = [judged for _, result in self._results for judged in self._judge(result)]
        return [judged.report() for judged in (*self._goals, *provisional)]

    def _waiting_results(self, are_actions: bool) -> list[Result]:
        return [
            result for _, result in self._results if isinstance(result, ActionResult) == are_actions
        ]

    def _shortest_path_m(self, key: int | str, start: SE2, goal: SE2) -> float | None:
        """For the robot's disc, around the walls and the bodies that were static at that time."""
        standing = self._standing_at.get(key, self._standing)
        if self._paths is None or self._paths[0] != standing:
            meshes = read_meshes((*self._world.bodies, *standing), self._assets)
            shortest = ShortestPath(obstacles(self._world, meshes, standing))
            self._paths = standing, shortest
        return self._paths[1].length_m(start[:2], goal[:2])

    def _settle(self) -> None:
        """Judge the waiting entries, as far as the ground truth reaches."""
        newest_ns = self._truth.newest_ns
        if newest_ns is None:
            return
        for stamp_ns, (estimate, covariance) in _take_until(newest_ns, self._estimates):
            true_pose = self._true_pose(stamp_ns)
            if true_pose is not None:
                error_m = estimate.distance_m(true_pose)
                turn_rad = wrap_angle(estimate.yaw_rad - true_pose.yaw_rad)
                self._error_m.add(error_m)
                self._error_rad.add(abs(turn_rad))
                apart = (estimate.x_m - true_pose.x_m, estimate.y_m - true_pose.y_m, turn_rad)
                self._estimate_count += 1
                self._inside_count += inside_95_percent(np.array(apart), covariance)
                self._recent_error_m.add(stamp_ns, (error_m,))
                self.history.add_estimate(stamp_ns, estimate, error_m, abs(turn_rad))
                if self._mapping is not None:
                    self._mapping.add_pose(estimate, true_pose)
                for judged in self._goals[-_GOALS_UNDER_WAY:]:
                    judged.see_error(stamp_ns, error_m)
        map_from_start = self._world.start.se2()
        for stamp_ns, odom_from_base in _take_until(newest_ns, self._odometry):
            true_pose = self._true_pose(stamp_ns)
            if true_pose is not None:
                self._drift_m = (map_from_start @ odom_from_base).distance_m(true_pose)
        for _, detections in _take_until(newest_ns, self._detections):
            self._judge_detections(detections)
        for _, result in _take_until(newest_ns, self._results):
            self._goals.extend(self._judge(result))

    def _now_s(self) -> float:
        """Time of the newest true pose."""
        return (self._truth.newest_ns or 0) * 1e-9

    def _driven_m(self) -> float | None:
        return None if self._truth.newest_ns is None else self._way.total_m

    def _way_pose(self, stamp_ns: int) -> SE2 | None:
        """The true pose at any time of the run."""
        at = self._way.at(stamp_ns) if self._way.is_known(stamp_ns) else None
        return None if at is None else at[0]

    def _true_pose(self, stamp_ns: int) -> SE2 | None:
        matrix = self._truth.at(stamp_ns)
        return None if matrix is None else _planar(matrix)

    def _judge_detections(self, detections: msg.Detection3DArray) -> None:
        map_from_base = self._truth.at(ns_from_time(detections.header.stamp))
        base_from_camera = chain_transforms(
            self._static, BASE_FOOTPRINT_FRAME, detections.header.frame_id
        )
        if map_from_base is None or base_from_camera is None:
            return
        map_from_camera = map_from_base @ base_from_camera
        for detection in detections.detections:
            entities = [
                e for e in self._entities if f"{e.dictionary}:{e.marker_id}" == detection.id
            ]
            if detection.results and entities:
                p = detection.results[0].pose.pose.position
                seen_at = (map_from_camera @ np.array([p.x, p.y, p.z, 1.0]))[:3]
                self._marker_error_m.add(
                    min(float(np.linalg.norm(seen_at - e.position_m)) for e in entities)
                )

    def _judge(self, result: Result) -> list[_Judged]:
        """A goal and its report; empty before the first true pose."""
        start_ns, end_ns = _ns(result.start_time_s), _ns(result.end_time_s)
        at_start, at_end = self._way.at(start_ns), self._way.at(end_ns)
        if at_start is None or at_end is None:
            return []
        (start, start_m), (end, end_m) = at_start, at_end
        if isinstance(result, ActionResult):
            action, stamp_ns, goal_id = result.action, 0, result.goal_id
        else:
            action, stamp_ns, goal_id = _DRIVE, result.goal_stamp_ns, ""
        goal = _goal(result, start)
        # Not where the recorder was restarted at that time: navigation's report alone is left.
        is_known = goal is not None and self._way.is_known(end_ns)
        error_m = error_rad = shortest_m = None
        is_there = True
        if goal is not None and is_known:
            error_m = end.distance_m(goal)
            error_rad = abs(wrap_angle(end.yaw_rad - goal.yaw_rad))
            is_there = error_m <= GOAL_TOLERANCE_M and error_rad <= GOAL_TOLERANCE_RAD
        if goal is not None and action == _DRIVE:
            shortest_m = self._shortest_path_m(goal_id or stamp_ns, start, goal)
        report = GoalReport(
            name=action if result.goal is None else self._name(result.goal.se2()),
            reached=result.error_code == 0 and is_there,
            time_s=result.end_time_s - result.start_time_s,
            path_length_m=end_m - start_m,
            shortest_path_m=shortest_m,
            goal_error_m=error_m,
            goal_error_rad=error_rad,
            recoveries=result.number_of_recoveries,
            error_code=result.error_code,
            error_msg=result.error_msg,
            goal_stamp_ns=stamp_ns,
            action=action,
            goal_id=goal_id,
            start_time_s=result.start_time_s,
            goal=None if goal is None else Planar(x_m=goal.x_m, y_m=goal.y_m, yaw_rad=goal.yaw_rad),
        )
        judged = _Judged(start_ns, end_ns, report)
        stamps_ns = self._recent_error_m.stamps_ns
        on_the_way = (stamps_ns >= start_ns) & (stamps_ns <= end_ns)
        judged.errors = int(np.count_nonzero(on_the_way))
        judged.error_sum_m = float(self._recent_error_m.rows[on_the_way].sum())
        for stamp_ns in self._contact_stamps_ns:
            judged.see_contact(stamp_ns)
        return [judged]

    def _name(self, goal: SE2) -> str:
        for location in self._world.locations:
            if goal.distance_m(location.se2()) <= SAME_PLACE_M:
                return location.name
        return "home" if goal.distance_m(self._world.start.se2()) <= SAME_PLACE_M else "goal"


def _goal(result: Result, start: SE2) -> SE2 | None:
    """Where a task should have ended; None where that was not said."""
    if result.goal is not None:
        return result.goal.se2()
    if isinstance(result, ActionResult) and result.displacement is not None:
        return start @ result.displacement.se2()
    return None


def _planar(matrix: Array) -> SE2:
    yaw_rad = math.atan2(float(matrix[1, 0]), float(matrix[0, 0]))
    return SE2(float(matrix[0, 3]), float(matrix[1, 3]), yaw_rad)


def _take_until(newest_ns: int, pending: _Pending[P]) -> list[tuple[int, P]]:
    """Remove and return the entries stamped no later than the newest true pose."""
    ready = [entry for entry in pending if entry[0] <= newest_ns]
    if ready:
        waiting = [entry for entry in pending if entry[0] > newest_ns]
        pending.clear()
        pending.extend(waiting)
    return ready


def _ns(time_s: float) -> int:
    return round(time_s * 1e9)


def _path_efficiency(goal: GoalReport) -> float:
    if not goal.reached or goal.shortest_path_m is None:
        return 0.0
    longer_m = max(goal.path_length_m, goal.shortest_path_m)
    return goal.shortest_path_m / longer_m if longer_m > 0.0 else 1.0
