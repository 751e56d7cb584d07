"""What the page knows of the robot: takes messages in, gives the frames that have changed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from mazebot.common.maths import portable
from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    MAP_FRAME,
    ODOM_FRAME,
    Array,
    se2_from_matrix,
)
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as tp
from mazebot.common.messages import wire
from mazebot.common.messages.documents import Document, Entities, SimulationStats, World
from mazebot.common.messages.topics import Delivery, Topic
from mazebot.console.live import drawing
from mazebot.console.live.frame import Frame, text_frame
from mazebot.console.live.history import History

WATCHED: tuple[Topic[Any], ...] = (
    tp.WORLD, tp.WORLD_STATUS, tp.MAP, tp.ENTITIES, tp.TF, tp.TF_STATIC, tp.SCAN,
    tp.GROUND_TRUTH_ODOM, tp.SIMULATION_STATS, tp.DETECTIONS, tp.AMCL_POSE, tp.PARTICLE_CLOUD,
    tp.LOCALIZATION_STATUS, tp.POSE_GRAPH, tp.EXPLORATION_STATUS, tp.FRONTIERS, tp.GLOBAL_COSTMAP,
    tp.LOCAL_COSTMAP, tp.PLAN, tp.CMD_VEL, tp.COLLISION_MONITOR_STATE, tp.ACTION_FEEDBACK,
    tp.ACTION_RESULT, tp.BEHAVIOR_TREE, tp.TRAJECTORIES, tp.NAVIGATION_STATUS,
    tp.NAVIGATION_RESULT, tp.EVALUATION, tp.DIAGNOSTICS, tp.ROSOUT, tp.CONTACTS, tp.GOAL_POSE,
)  # fmt: skip
CAMERA: tuple[Topic[Any], ...] = (tp.CAMERA_IMAGE, tp.CAMERA_INFO)
"""Watched only while a page shows it."""

_AS_THEY_ARE = {
    tp.WORLD_STATUS.name: "world_status",
    tp.SIMULATION_STATS.name: "stats",
    tp.LOCALIZATION_STATUS.name: "localization",
    tp.EXPLORATION_STATUS.name: "exploration",
    tp.COLLISION_MONITOR_STATE.name: "monitor",
    tp.ACTION_FEEDBACK.name: "feedback",
    tp.ACTION_RESULT.name: "action_result",
    tp.BEHAVIOR_TREE.name: "tree",
    tp.NAVIGATION_STATUS.name: "navigation",
    tp.NAVIGATION_RESULT.name: "navigation_result",
    tp.EVALUATION.name: "evaluation",
    tp.CONTACTS.name: "contact",
}
"""Documents that the page gets field by field, by topic."""
_MOST_FRAMES = 1000
"""Of TF: more than any world has, so that a hostile publisher does not fill the memory."""
_MOST_CONTACTS = 20


class View:
    """Turns messages into frames. Not for several threads at once."""

    def __init__(self, history: History | None = None) -> None:
        """`history`: what is kept for pages that come late."""
        self._history = history or History()
        self._transforms: dict[str, msg.TransformStamped] = {}
        self._world: World | None = None
        self._entities: Entities | None = None
        self._truth: msg.Odometry | None = None
        self._estimate: msg.PoseWithCovarianceStamped | None = None
        self._command: msg.TwistStamped | None = None
        self._scan: msg.LaserScan | None = None
        self._info: msg.CameraInfo | None = None
        self._has_moved = False
        self.restarted = False
        """Whether the simulation restarted in the last `frames`: what was drawn before is no
        longer valid.
        """
        self._drawn: dict[str, Callable[[Any], list[Frame]]] = {
            tp.WORLD.name: self._take_world,
            tp.MAP.name: lambda grid: [drawing.grid_frame("map", grid, None)],
            tp.ENTITIES.name: self._take_entities,
            tp.TF.name: self._take_frames,
            tp.TF_STATIC.name: self._take_frames,
            tp.SCAN.name: self._take_scan,
            tp.GROUND_TRUTH_ODOM.name: self._take_truth,
            tp.AMCL_POSE.name: self._take_estimate,
            tp.CMD_VEL.name: self._take_command,
            tp.PARTICLE_CLOUD.name: lambda cloud: [drawing.particles_frame(cloud)],
            tp.POSE_GRAPH.name: lambda graph: [drawing.graph_frame(graph)],
            tp.FRONTIERS.name: lambda array: [drawing.shapes_frame("frontiers", array)],
            tp.TRAJECTORIES.name: lambda array: [drawing.shapes_frame("trajectories", array)],
            tp.GLOBAL_COSTMAP.name: self._costmap("global_costmap"),
            tp.LOCAL_COSTMAP.name: self._costmap("local_costmap"),
            tp.PLAN.name: lambda path: [drawing.path_frame(path)],
            tp.DETECTIONS.name: self._take_detections,
            tp.DIAGNOSTICS.name: drawing.services_frame,
            tp.ROSOUT.name: lambda log: [drawing.log_frame(log)],
            tp.CAMERA_IMAGE.name: lambda image: [drawing.camera_frame(image)],
            tp.CAMERA_INFO.name: self._take_info,
            tp.GOAL_POSE.name: self._take_goal,
        }

    def frames(self, arrived: list[tuple[Topic[Any], Any]]) -> list[Frame]:
        """The frames of messages, oldest first; CDR bytes are decoded, what cannot be read or drawn
        is left out.
        """
        self._has_moved = self.restarted = False
        frames: list[Frame] = []
        for topic, raw in arrived:
            try:
                message = wire.decode(topic, raw) if isinstance(raw, bytes) else raw
                if isinstance(raw, bytes):
                    wire.validate(topic, message)
                frames += self._frames_of(topic, message)
            except (wire.WireError, ValueError, TypeError):
                # A message of another version, or a hostile one: the services count them.
                continue
        if self._scan is not None:
            map_from_lidar = self._map_from(self._scan.header.frame_id)
            if map_from_lidar is not None:
                frames.append(drawing.scan_frame(self._scan, map_from_lidar))
                self._scan = None
        if self._has_moved:
            frames.append(self._pose_frame())
        return frames

    def _frames_of(self, topic: Topic[Any], message: Any) -> list[Frame]:
        if topic.name in _AS_THEY_ARE:
            assert isinstance(message, Document)
            kind, is_event = _AS_THEY_ARE[topic.name], topic.delivery is Delivery.EVERY
            if isinstance(message, SimulationStats):
                self._notice_restart(message)
            content = message.model_dump(mode="json")
            if topic.name == tp.EVALUATION.name:
                content["contacts"] = content["contacts"][-_MOST_CONTACTS:]
                (content["mapping"] or {}).pop("coverage", None)
            return [text_frame(kind, content, is_event)]
        return self._drawn[topic.name](message)

    def _notice_restart(self, stats: SimulationStats) -> None:
        if self._history.is_restart(stats):
            self.restarted = True
            self._truth = self._estimate = self._command = self._scan = None
            self._history.clear()

    def _take_world(self, world: World) -> list[Frame]:
        self._world = world
        standing = self._entities
        again = [] if standing is None else self._take_entities(standing)
        return [drawing.world_frame(world), *again]

    def _take_entities(self, entities: Entities) -> list[Frame]:
        self._entities, world = entities, self._world
        of_this = world is not None and world.hash == entities.world_hash
        return [drawing.entities_frame(entities, world if of_this else None)]

    def _costmap(self, kind: str) -> Callable[[Any], list[Frame]]:
        def draw(grid: msg.OccupancyGrid) -> list[Frame]:
            frame = grid.header.frame_id
            placed = None if frame == MAP_FRAME else self._map_from(frame)
            if placed is None and frame != MAP_FRAME:
                return []
            return [drawing.grid_frame(kind, grid, placed)]

        return draw

    def _take_frames(self, tree: msg.TFMessage) -> list[Frame]:
        for entry in tree.transforms:
            child = entry.child_frame_id
            if child in self._transforms or len(self._transforms) < _MOST_FRAMES:
                self._transforms[child] = entry
        self._has_moved = True
        return []

    def _take_scan(self, scan: msg.LaserScan) -> list[Frame]:
        self._scan = scan
        return []

    def _take_truth(self, odometry: msg.Odometry) -> list[Frame]:
        self._truth, self._has_moved = odometry, True
        return []

    def _take_estimate(self, pose: msg.PoseWithCovarianceStamped) -> list[Frame]:
        self._estimate, self._has_moved = pose, True
        return []

    def _take_command(self, command: msg.TwistStamped) -> list[Frame]:
        self._command = command
        return []

    def _take_goal(self, goal: msg.PoseStamped) -> list[Frame]:
        return [text_frame("goal", {"pose": tuple(msg.se2_from_pose(goal.pose))}, is_event=True)]

    def _take_detections(self, array: msg.Detection3DArray) -> list[Frame]:
        return [drawing.detections_frame(array, self._info)] if array.detections else []

    def _take_info(self, info: msg.CameraInfo) -> list[Frame]:
        self._info = info
        return []

    def _map_from(self, frame: str) -> Array | None:
        """(4, 4) map_from_frame; None where it is not known. Without an estimate the true pose is
        taken, as the robot's frames then hang nowhere.
        """
        found = msg.chain_transforms(self._transforms.values(), MAP_FRAME, frame)
        if found is not None or self._truth is None:
            return found
        base_from_frame = msg.chain_transforms(
            self._transforms.values(), BASE_FOOTPRINT_FRAME, frame
        )
        if base_from_frame is None:
            return None
        map_from_base = msg.matrix_from_pose(self._truth.pose.pose)
        return portable.product(map_from_base, base_from_frame)

    def _pose_frame(self) -> Frame:
        """True and estimated pose, and those of bodies that move."""
        content: dict[str, Any] = {"truth": None, "estimate": None, "covariance": None}
        if self._truth is not None:
            content["time_s"] = drawing.stamp_s(self._truth.header)
            content["truth"] = tuple(msg.se2_from_pose(self._truth.pose.pose))
            self._history.add_pose("truth", *content["truth"][:2])
            twist = self._truth.twist.twist
            content["velocity"] = (twist.linear.x, twist.angular.z)
        if self._command is not None:
            twist = self._command.twist
            content["command"] = (twist.linear.x, twist.angular.z)
        if self._estimate is not None:
            # Between two estimates odometry leads on, as in RViz.
            estimate = msg.chain_transforms(
                self._transforms.values(), MAP_FRAME, BASE_FOOTPRINT_FRAME
            )
            if estimate is not None:
                content["estimate"] = tuple(se2_from_matrix(estimate))
                self._history.add_pose("estimate", *content["estimate"][:2])
            covariance = self._estimate.pose.covariance
            content["covariance"] = tuple(float(covariance[index]) for index in (0, 1, 7, 35))
        self._keep_for_plots(content)
        moved = {
            child: tuple(se2_from_matrix(msg.matrix_from_transform(entry.transform)))
            for child, entry in self._transforms.items()
            if entry.header.frame_id == MAP_FRAME and child != ODOM_FRAME
        }
        if moved:
            content["moved"] = moved
        return text_frame("pose", content)

    def _keep_for_plots(self, pose: dict[str, Any]) -> None:
        if pose["truth"] is None:
            return
        error_m = error_rad = None
        if pose["estimate"] is not None:
            x_m, y_m, yaw_rad = pose["truth"]
            error_m = math.dist((x_m, y_m), pose["estimate"][:2])
            error_rad = abs(math.remainder(pose["estimate"][2] - yaw_rad, 2.0 * math.pi))
        self._history.plots.add(pose["time_s"], *pose["velocity"], error_m, error_rad)
