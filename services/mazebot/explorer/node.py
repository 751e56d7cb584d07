"""The node: the map and the robot's pose in, goals out. The only file here that uses topics."""

from __future__ import annotations

import logging
from typing import ClassVar

import numpy as np

from mazebot.common.maths.frames import MAP_FRAME, SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import NavigationStatus, World
from mazebot.common.messages.slam_documents import ExplorationStatus
from mazebot.common.messages.topics import (
    AMCL_POSE,
    EXPLORATION_STATUS,
    EXPLORE_RESUME,
    FRONTIERS,
    GOAL_POSE,
    MAP,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    SIMULATION_STATS,
    WORLD,
)
from mazebot.common.node.node import Beat, Inbox, Node, Outbox
from mazebot.common.node.simulation_watch import SimulationWatch
from mazebot.common.world.costmap import MAX_MAP_CELLS
from mazebot.explorer.config import STEP_PERIOD_NS, ExplorerConfig
from mazebot.explorer.explorer import Explorer, MapSoFar
from mazebot.explorer.kernels import compile_kernels
from mazebot.explorer.messages import frontiers_message

_LOG = logging.getLogger("explorer")

_STATUS_PERIOD_NS = 1_000_000_000
_LOST = "the robot's pose is not known: it is searched for"


class ExplorerNode(Node):
    """Drives the robot until it has seen all the floor that it can reach, and home.

    It begins by itself when the world's request wants exploring (`slam` and `explore`) and
    navigation is active. A false on EXPLORE_RESUME stops it, a true resumes it.
    """

    name: ClassVar[str] = "explorer"
    _config: ExplorerConfig
    period_ns: ClassVar[int | None] = STEP_PERIOD_NS
    wakes = (NAVIGATION_RESULT,)

    def __init__(self, config: ExplorerConfig) -> None:
        self._config = config
        self._watch = SimulationWatch(config.seed)
        self._world: World | None = None
        self._map: msg.OccupancyGrid | None = None
        self._navigation: NavigationStatus | None = None
        self._explorer: Explorer | None = None
        self._posed = False
        self._beat = Beat(_STATUS_PERIOD_NS)
        self._published: tuple[str, str, int | None, int | None] | None = None
        """State, reason, goal and epoch of the status last published."""
        self._kept: tuple[ExplorationStatus, str] | None = None
        """The last status of the process before, and the hash of its world."""
        self._resumed = False
        """Whether that has been taken up, or there was none."""

    def prepare(self) -> None:
        """See Node."""
        compile_kernels(self._config)

    def waiting_for(self) -> str | None:
        """A phrase for the first missing input that keeps the exploration from beginning."""
        if self._world is None:
            return "the world"
        if not self._wanted():
            return None
        if self._map is None:
            return "the map"
        if not self._posed:
            return "the robot's pose"
        if self._navigation is None or not self._navigation.navigation_active:
            return "navigation to become active"
        return None

    def nominal_rates_hz(self) -> dict[str, float]:
        """See Node."""
        return {}

    def facts(self) -> dict[str, str]:
        """The state, and how much of the floor has been seen."""
        explorer = self._explorer
        if explorer is None:
            return {"state": "off: no exploration requested"}
        return {
            "state": explorer.state,
            "seen": f"{100.0 * explorer.seen_share():.1f} %",
            "frontiers": str(explorer.reachable),
            "driven": f"{explorer.driven_m:.1f} m",
        }

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Process the map, the pose and results; publish a goal when there is another one."""
        if self._watch.restarted(now_ns, inbox.new(SIMULATION_STATS)):
            _LOG.info("simulation restarted; resetting the exploration")
            self._reset()
        self._learn(now_ns, inbox)
        explorer = self._explorer
        if explorer is not None and not self._goes_on(inbox, explorer):
            return
        self._hear_resume(inbox)
        if explorer is None:
            return
        for ended in inbox.new(NAVIGATION_RESULT):
            explorer.ended(now_ns, ended.goal_stamp_ns, ended.error_code, ended.error_msg)
        goal = None
        if self._navigation and (self.waiting_for() is None or explorer.state != "waiting"):
            goal = explorer.step(now_ns)
        # First, so that navigation knows whose goal it is.
        self._publish(now_ns, outbox, explorer)
        if goal is not None:
            self._send(now_ns, outbox, goal)

    def _goes_on(self, inbox: Inbox, explorer: Explorer) -> bool:
        """Take up the exploration of the process before, if it was in this run; False: whether
        there was one is not known yet.
        """
        for status, envelope in inbox.arrivals(EXPLORATION_STATUS):
            self._kept = status, envelope.world_hash
        if self._resumed:
            return True
        if not inbox.is_handed_over or (self._kept and self._watch.epoch is None):
            return False
        self._resumed = True
        if self._kept is not None:
            status, world_hash = self._kept
            if (world_hash, status.epoch) == (self.world_hash, self._watch.epoch):
                _LOG.warning("explorer resumed: the exploration is %s", status.state)
                explorer.go_on(
                    status.model_copy(update={"reason": ""}) if status.reason == _LOST else status
                )
        return True

    def _hear_resume(self, inbox: Inbox) -> None:
        for resume in inbox.new(EXPLORE_RESUME):
            if self._explorer is None:
                inbox.reject(EXPLORE_RESUME, "no exploration requested")
            elif resume.data:
                self._explorer.resume()
            else:
                self._explorer.pause()

    def _wanted(self) -> bool:
        return self._world is not None and self._world.slam and self._world.explore

    def _learn(self, now_ns: int, inbox: Inbox) -> None:
        """Read what has come."""
        world = inbox.latest(WORLD)
        if world is not None:
            known = self._world
            self._world = world
            self.world_hash = world.hash
            if known is None or (known.hash, known.slam) != (world.hash, world.slam):
                self._reset()
        if self._wanted() != (self._explorer is not None):
            self._reset()
        for status in inbox.new(NAVIGATION_STATUS):
            self._navigation = status
            if self._explorer is not None:
                self._explorer.is_localized = status.navigation_active
                self._explorer.is_held = status.is_held
                if status.is_busy:
                    self._explorer.navigation_is_busy(now_ns)
        self._take_map(inbox)
        for pose in inbox.new(AMCL_POSE):
            stamp_ns = msg.ns_from_time(pose.header.stamp)
            if self._watch.is_of_this_run(stamp_ns, AMCL_POSE, inbox) and self._explorer:
                self._posed = True
                self._explorer.take_pose(msg.se2_from_pose(pose.pose.pose))

    def _take_map(self, inbox: Inbox) -> None:
        if self._explorer is None:
            # Until the world is known, the map waits.
            return
        grid = self._watch.latest_of_this_run(MAP, inbox)
        if grid is None or msg.same_grid(grid, self._map):
            return
        if len(grid.data) > MAX_MAP_CELLS or not len(grid.data):
            inbox.reject(MAP, "invalid number of cells")
            _LOG.error("map: %d cells: must be 1 to %d", len(grid.data), MAX_MAP_CELLS)
            return
        self._map = grid
        cells = np.array(msg.cells_from_grid(grid), np.int8)
        origin = msg.se2_from_pose(grid.info.origin)
        self._explorer.take_map(MapSoFar(cells, grid.info.resolution, origin))

    def _reset(self) -> None:
        """Forget what was explored."""
        self._map = self._navigation = None
        self._posed = False
        self._published = None
        self._explorer = None
        if self._wanted() and self._world is not None:
            self._explorer = Explorer(self._config, self._world.start.se2())

    def _send(self, now_ns: int, outbox: Outbox, goal: SE2) -> None:
        outbox.put(
            GOAL_POSE,
            msg.PoseStamped(header=msg.header(now_ns, MAP_FRAME), pose=msg.pose_from_se2(goal)),
        )

    def _publish(self, now_ns: int, outbox: Outbox, explorer: Explorer) -> None:
        """Publish status and frontiers, once a second and when the state or the goal is another
        one.
        """
        missing = self.waiting_for()
        reason = explorer.reason
        if explorer.state == "waiting" and missing is not None:
            reason = f"waiting for {missing}"
        elif explorer.state in ("exploring", "returning") and not explorer.is_localized:
            reason = _LOST
        status = (explorer.state, reason, explorer.goal_stamp_ns, self._watch.epoch)
        due = self._beat.due(now_ns)
        if not due and status == self._published:
            return
        self._published = status
        seen = explorer.seen
        outbox.put(
            EXPLORATION_STATUS,
            ExplorationStatus(
                state=explorer.state,
                reason=reason,
                frontiers=len(seen.frontiers) if seen is not None else 0,
                reachable=explorer.reachable,
                set_aside=explorer.set_aside,
                left_out=explorer.left_out,
                free_m2=explorer.free_m2(),
                seen_share=min(explorer.seen_share(), 1.0),
                driven_m=explorer.driven_m,
                goals=explorer.goals,
                goal_stamp_ns=explorer.goal_stamp_ns,
                explored_s=explorer.explored_ns * 1e-9,
                places_set_aside=explorer.places_set_aside(),
                epoch=self._watch.epoch or 0,
            ),
        )
        if self._config.visualize and seen is not None:
            outbox.put(FRONTIERS, frontiers_message(now_ns, seen, explorer.aim))
