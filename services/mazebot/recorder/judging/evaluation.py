"""Evaluates a run against the ground truth: localisation, marker detection, and navigation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, SCAN_FRAME, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import ActionFeedback
from mazebot.common.messages.documents import Contact, Entities, Evaluation, Parameters, World
from mazebot.common.messages.messages import ns_from_time
from mazebot.common.messages.slam_documents import ExplorationStatus, PoseGraph
from mazebot.common.recordings.series import RunSeries
from mazebot.recorder.judging.error_summary import ErrorSummary
from mazebot.recorder.judging.goals.goal_evaluation import GoalEvaluation, Result, ns_from_s
from mazebot.recorder.judging.goals.tolerance import tolerance_of
from mazebot.recorder.judging.history import RunHistory
from mazebot.recorder.judging.marker_errors import MarkerErrors
from mazebot.recorder.judging.plan import Plan
from mazebot.recorder.judging.poses.driven_way import DrivenWay
from mazebot.recorder.judging.poses.pose_errors import PoseErrors
from mazebot.recorder.judging.poses.true_poses import TruePoses

if TYPE_CHECKING:
    from mazebot.recorder.judging.map.mapping import MappingEvaluation

_MOST_CONTACTS = 1000
"""Contacts listed one by one; further ones are only counted."""


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
    - the goals: see `GoalEvaluation`.
    - where the robot makes the map itself: see `MappingEvaluation`.
    """

    def __init__(self, world: World, assets: Mapping[str, bytes] | None = None) -> None:
        """`assets` by sha256 may be filled later: the world's meshes are looked up in them when the
        first goal has ended.
        """
        self._world = world
        assets = {} if assets is None else assets
        self.history = RunHistory()
        self._truth = TruePoses()
        self._poses = PoseErrors(world.start.se2())
        self._markers = MarkerErrors()
        self._goals = GoalEvaluation(world, assets, self._truth.way, self._poses.recent_m)
        self._plan = Plan(world, assets)
        self._contacts: list[Contact] = []
        self._contact_count = 0
        self._mapping: MappingEvaluation | None = None
        if world.slam:
            from mazebot.recorder.judging.map.mapping import MappingEvaluation  # noqa: PLC0415 - Numba

            self._mapping = MappingEvaluation(world, assets)

    def set_entities(self, entities: Entities) -> None:
        """Set the entities of the world."""
        self._markers.entities = entities.markers
        self._goals.standing = tuple(body for body in entities.bodies if not body.moves)
        if self._mapping is not None:
            self._mapping.set_entities(entities.markers, self._goals.standing)

    def add_static_transforms(self, transforms: msg.TFMessage) -> None:
        """Add fixed frames of the robot."""
        self._markers.add_static_transforms(transforms)
        base_from_scan = self._markers.static.chain(BASE_FOOTPRINT_FRAME, SCAN_FRAME)
        if self._mapping is not None and base_from_scan is not None:
            self._mapping.set_scan_height(float(base_from_scan[2, 3]))

    def add_ground_truth(self, odometry: msg.Odometry) -> None:
        """Add a true pose, map from base_footprint; one older than the newest is dropped."""
        added = self._truth.add(odometry)
        if added is not None:
            twist = odometry.twist.twist
            self.history.add_truth(*added, twist.linear.x, twist.angular.z)
        self._settle()

    def add_odometry(self, odometry: msg.Odometry) -> None:
        """Add wheel odometry, odom from base_footprint."""
        self._poses.add_odometry(odometry)

    def add_estimate(self, estimate: msg.PoseWithCovarianceStamped) -> None:
        """Add an estimated pose, map from base_footprint, with its covariance."""
        self._poses.add_estimate(estimate)

    def add_detections(self, detections: msg.Detection3DArray) -> None:
        """Add the markers detected in one image, in the camera's optical frame."""
        for marker_id in self._markers.add(detections):
            self.history.see_marker(ns_from_time(detections.header.stamp), marker_id)

    def add_contact(self, contact: Contact) -> None:
        """Add a contact."""
        self._contact_count += 1
        if len(self._contacts) < _MOST_CONTACTS:
            self._contacts.append(contact)
        self._goals.see_contact(ns_from_s(contact.time_s))

    def add_parameters(self, told: Parameters) -> None:
        """Add the configuration of a service: navigation's says what a reached goal is."""
        if told.service == "navigation":
            self._goals.tolerance = tolerance_of(told.values)

    def add_goal(self, goal: msg.PoseStamped) -> None:
        """Add a goal that was sent."""
        self._goals.add_goal(goal)

    def add_feedback(self, feedback: ActionFeedback) -> None:
        """Add the progress of an action."""
        self._goals.add_feedback(feedback)

    def add_result(self, result: Result) -> None:
        """Add the result of a goal; one aborted by a restart of its world is not counted."""
        self._goals.add_result(result)

    def add_map(self, grid: msg.OccupancyGrid) -> None:
        """Add a map that the robot has made; it is judged if the world's request says so."""
        if self._mapping is not None:
            self._mapping.add_map(grid, self._truth.now_s, self._truth.driven_m)

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
        self._goals.add_exploration(status)
        if self._mapping is not None:
            self._mapping.add_exploration(status, self._truth.now_s)

    @property
    def true_faces_m(self) -> Array | None:
        """(n, 2, 2) segments, from and to, of the walls that the lidar can see; None: the robot has
        made no map.
        """
        return None if self._mapping is None else self._mapping.true_faces_m

    @property
    def goals_ended(self) -> tuple[int, int]:
        """Number of ended goals that still wait for a true pose, and of those that are judged."""
        return self._goals.ended

    @property
    def goals_sent(self) -> int:
        """Number of goals sent, with those given up."""
        return self._goals.sent

    def evaluation(self, recording: str = "") -> Evaluation:
        """The evaluation of the run so far.

        A goal that ended after the newest true pose is judged by that pose, and again when a newer
        one has arrived. Before the first true pose, no goal is judged.
        """
        self._settle()
        return Evaluation(
            goals=tuple(self._goals.reports()),
            contacts=tuple(self._contacts),
            markers_seen=self._markers.seen_of_world(),
            localisation_error_m=self._poses.error_m.statistics(),
            localisation_error_rad=self._poses.error_rad.statistics(),
            localization=self._poses.consistency(),
            marker_error_m=self._markers.error_m.statistics(),
            odometry_drift_m=self._poses.drift_m(self._truth),
            mapping=self._mapping.evaluation(self._truth.driven_m, self._truth.on_the_way)
            if self._mapping is not None
            else None,
            recording=recording,
        )

    def series(self, evaluation: Evaluation, now_s: float) -> RunSeries:
        """The run so far over time; `evaluation` is its newest one."""
        rings = self._plan.rings(self._goals.standing)
        return self.history.series(self._world, evaluation, self._markers.entities, rings, now_s)

    def totals(self) -> dict[str, Any]:
        """Totals of the run that the evaluation does not contain, as JSON values: `contacts` is
        their number, `distance_m` the length driven, None before the first true pose; the goals'
        as in `GoalEvaluation.totals`.
        """
        self._settle()
        return {
            "distance_m": self._truth.driven_m,
            "contacts": self._contact_count,
            **self._goals.totals(),
        }

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """The evaluation's state so far, as JSON values and as arrays, for `restore()`.

        Data of the world's latched messages is not included: they are received again.
        """
        self._settle()
        values = {
            **self._goals.values(),
            **self._poses.values(self._truth),
            "contacts": [contact.model_dump(mode="json") for contact in self._contacts],
            "contact_count": self._contact_count,
            "seen": dict(self._markers.seen),
            "history": self.history.values(),
        }
        arrays = self._poses.arrays()
        for name, part in self._lasting():
            arrays |= {f"{name}/{key}": array for key, array in part.state().items()}
        if self._mapping is not None:
            values["mapping"], mapping_arrays = self._mapping.state()
            arrays |= {f"mapping/{key}": array for key, array in mapping_arrays.items()}
        return values, arrays

    def restore(self, values: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a saved `state()`.

        Raises ValueError, KeyError, TypeError if it is invalid.
        """

        def of(name: str) -> dict[str, NDArray[Any]]:
            start = f"{name}/"
            return {key.removeprefix(start): arrays[key] for key in arrays if key.startswith(start)}

        for name, part in self._lasting():
            part.restore(of(name))
        if self._mapping is not None:
            self._mapping.restore(values["mapping"], of("mapping"))
        self._poses.restore(values, arrays)
        self._goals.restore(values)
        self._contacts = [Contact.model_validate(contact) for contact in values["contacts"]]
        self._contact_count = values["contact_count"]
        self._markers.seen.update(values["seen"])
        self.history.restore_values(values["history"])

    def _lasting(self) -> tuple[tuple[str, DrivenWay | ErrorSummary | RunHistory], ...]:
        """The parts that have arrays in their state."""
        return (
            ("way", self._truth.way),
            ("error_m", self._poses.error_m),
            ("error_rad", self._poses.error_rad),
            ("marker_error_m", self._markers.error_m),
            ("history", self.history),
        )

    def _settle(self) -> None:
        """Judge the waiting entries, as far as the ground truth reaches."""
        newest_ns = self._truth.newest_ns
        if newest_ns is None:
            return
        for pose in self._poses.settle(self._truth, newest_ns):
            self.history.add_estimate(pose.stamp_ns, pose.estimate, pose.error_m, pose.error_rad)
            if self._mapping is not None:
                self._mapping.add_pose(pose.estimate, pose.truth)
            self._goals.see_error(pose.stamp_ns, pose.error_m)
        self._markers.settle(self._truth, newest_ns)
        self._goals.settle(newest_ns)
