"""One run's messages, judged for its summary and kept as its map."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages.messages import ns_from_time
from mazebot.common.messages.slam_documents import PoseGraph
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    AMCL_POSE,
    CLOCK,
    CONTACTS,
    DETECTIONS,
    DIAGNOSTICS,
    ENTITIES,
    EXPLORATION_STATUS,
    GOAL_POSE,
    GROUND_TRUTH_ODOM,
    MAP,
    NAVIGATION_RESULT,
    ODOM,
    PARAMETERS,
    POSE_GRAPH,
    ROSOUT,
    SCAN,
    SIMULATION_STATS,
    TF_STATIC,
    Topic,
)
from mazebot.common.node.diagnostics import REJECTED_KEY
from mazebot.common.recordings.run_folder import RunFolder
from mazebot.recorder.judging.evaluation import RunEvaluation
from mazebot.recorder.judging.wall_time import WallTime
from mazebot.recorder.keeping.run.map_folder import MapFolder
from mazebot.recorder.keeping.run.setting import Setting


class RunJudge:
    """Hands each message to what judges it, and holds the result."""

    def __init__(self, world: doc.World, setting: Setting) -> None:
        self.evaluation = RunEvaluation(world, setting.assets)
        self.stats: doc.SimulationStats | None = None
        self.rebuilds = 0
        self.wall_time = WallTime()
        self.rejected: dict[tuple[str, str, str], int] = {}
        """Messages that other services rejected: by service, topic and reason."""
        self._setting = setting
        self._world = world
        self._clock_ns: int | None = None
        """Time of the newest clock message since the last tick."""
        self._ticked_ns = 0
        self._maps = MapFolder() if world.slam else None
        self._judges = _JUDGES | (_SLAM_JUDGES if world.slam else {})

    def take(self, topic: Topic[Any], message: Any) -> None:
        """Judge a message, if anything judges its topic."""
        judge = self._judges.get(topic)
        if judge is not None:
            judge(self, message)

    def tick(self, now_s: float, now_ns: int) -> None:
        """Relate simulation time to the wall clock. Called once for all messages of a step: only
        the newest of them arrived just now.
        """
        if not self._setting.config.keeps_messages and now_ns > self._ticked_ns:
            # No clock message is received.
            self._clock_ns = self._ticked_ns = now_ns
        if self._clock_ns is not None:
            self.wall_time.tick(now_s, self._clock_ns)
            is_paused = self.stats is not None and self.stats.paused
            self.evaluation.history.tick(now_s, self._clock_ns, is_paused)
            self._clock_ns = None

    def write_map(self, folder: RunFolder, now_ns: int, all_of_it: bool = False) -> None:
        """Write what is new of the robot's map."""
        if self._maps is not None and not folder.is_gone:
            self._maps.write(folder.path, now_ns, all_of_it)

    def write_map_again(self) -> None:
        """Write the whole map again, since the folder is another one."""
        if self._maps is not None:
            self._maps.write_all_again()

    def _take_clock(self, clock: msg.Clock) -> None:
        self._clock_ns = ns_from_time(clock.clock)

    def _take_map(self, grid: msg.OccupancyGrid) -> None:
        self.evaluation.add_map(grid)
        if self._maps is not None:
            self._maps.add_map(grid)

    def _take_pose_graph(self, graph: PoseGraph) -> None:
        if graph.world_hash in ("", self._world.hash):
            self.evaluation.add_pose_graph(graph)
            if self._maps is not None:
                self._maps.add_pose_graph(graph)

    def _take_entities(self, entities: doc.Entities) -> None:
        if entities.world_hash == self._world.hash:
            self.evaluation.set_entities(entities)

    def _take_stats(self, stats: doc.SimulationStats) -> None:
        if stats.world_hash != self._world.hash:
            return
        before, self.stats = self.stats, stats
        if before is not None and before.epoch != stats.epoch and stats.sim_time_s > 0.0:
            self.rebuilds += abs(stats.epoch - before.epoch)
        change = self.wall_time.pause if stats.paused else self.wall_time.resume
        change(self._setting.wall_clock_s())

    def _take_diagnostics(self, array: Any) -> None:
        self.evaluation.history.add_diagnostics(array)
        for status in array.status:
            if status.name == "recorder":
                continue
            for value in status.values:
                if value.key.startswith(REJECTED_KEY) and value.value.isdecimal():
                    topic, _, reason = value.key.removeprefix(REJECTED_KEY).partition(": ")
                    self.rejected[status.name, topic, reason] = int(value.value)


_JUDGES: dict[Topic[Any], Callable[[RunJudge, Any], None]] = {
    CLOCK: RunJudge._take_clock,
    ENTITIES: RunJudge._take_entities,
    TF_STATIC: lambda judge, tree: judge.evaluation.add_static_transforms(tree),
    GROUND_TRUTH_ODOM: lambda judge, odometry: judge.evaluation.add_ground_truth(odometry),
    ODOM: lambda judge, odometry: judge.evaluation.add_odometry(odometry),
    AMCL_POSE: lambda judge, pose: judge.evaluation.add_estimate(pose),
    DETECTIONS: lambda judge, seen: judge.evaluation.add_detections(seen),
    CONTACTS: lambda judge, contact: judge.evaluation.add_contact(contact),
    PARAMETERS: lambda judge, told: judge.evaluation.add_parameters(told),
    GOAL_POSE: lambda judge, goal: judge.evaluation.add_goal(goal),
    NAVIGATION_RESULT: lambda judge, result: judge.evaluation.add_result(result),
    ACTION_FEEDBACK: lambda judge, feedback: judge.evaluation.add_feedback(feedback),
    ACTION_RESULT: lambda judge, result: judge.evaluation.add_result(result),
    SIMULATION_STATS: RunJudge._take_stats,
    DIAGNOSTICS: RunJudge._take_diagnostics,
    ROSOUT: lambda judge, log: judge.evaluation.history.add_log(log),
}
_SLAM_JUDGES: dict[Topic[Any], Callable[[RunJudge, Any], None]] = {
    MAP: RunJudge._take_map,
    POSE_GRAPH: RunJudge._take_pose_graph,
    EXPLORATION_STATUS: lambda judge, status: judge.evaluation.add_exploration(status),
    SCAN: lambda judge, scan: judge.evaluation.add_scan(scan),
}
"""Those of a robot that makes the map."""
JUDGED: tuple[Topic[Any], ...] = (*_JUDGES, *_SLAM_JUDGES)
"""The topics whose messages are judged."""
