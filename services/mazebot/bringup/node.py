"""Requests a world, waits until localisation and navigation are active, drives the tour, prints its
table.
"""

from __future__ import annotations

import logging

from mazebot.bringup.config import BringupConfig
from mazebot.bringup.table import exploration_table, tour_table
from mazebot.bringup.tour import NoLocationsError, tour_goals
from mazebot.common.maths.frames import MAP_FRAME
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    Evaluation,
    NavigationResult,
    NavigationStatus,
    Planar,
    World,
    WorldRequest,
)
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.slam_documents import ExplorationStatus
from mazebot.common.messages.topics import (
    DIAGNOSTICS,
    EVALUATION,
    EXPLORATION_STATUS,
    GOAL_POSE,
    MAP,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    SERVICES,
    WORLD,
    WORLD_REQUEST,
    WORLD_STATUS,
)
from mazebot.common.node.diagnostics import WAITING_KEY
from mazebot.common.node.node import Inbox, Node, Outbox

_LOG = logging.getLogger("bringup")
_MANAGERS = ("lifecycle_manager_localization", "lifecycle_manager_navigation")
_MAPPERS = ("mapping", "explorer")
_ACTIVE = "Managed nodes are active"

_SAME_RESOLUTION_M = 1e-6
"""A map's message has single precision."""

EXIT_NOT_REACHED = 1
EXIT_REFUSED = 2
EXIT_NOT_ACTIVE = 3

EVALUATION_PATIENCE_S = 5.0
"""Simulation time to wait for the recorder's evaluation before the tour ends without it."""


class BringupNode(Node):
    """Controls a run, from the request for a world to the table of its tour."""

    name = "bringup"
    _config: BringupConfig
    period_ns = 100_000_000
    wakes = (
        WORLD_STATUS, WORLD, NAVIGATION_STATUS, NAVIGATION_RESULT, EXPLORATION_STATUS, EVALUATION,
    )  # fmt: skip

    def __init__(self, config: BringupConfig) -> None:
        self._config = config
        self._request = WorldRequest(
            world_name=config.world_name,
            use_aruco=config.use_aruco,
            overrides=config.world_overrides,
            slam=config.slam,
            explore=config.explore,
        )
        self._unneeded = (self.name, *(("localization",) if config.slam else _MAPPERS))
        self._exploration: ExplorationStatus | None = None
        """Of this run, once it is navigation's turn."""
        self._requested = False
        self._clock_seen_ns: int | None = None
        self._offered: World | None = None
        self._map: msg.OccupancyGrid | None = None
        self._world: World | None = None
        self._goals: list[tuple[str, Planar]] = []
        self._goal_index = 0
        self._goal_stamp_ns: int | None = None
        self._busy_ns = 0
        """When navigation was last busy."""
        self._active = dict.fromkeys(_MANAGERS, False)
        self._navigation = NavigationStatus(localization_active=False, navigation_active=False)
        self._waiting: dict[str, str] = {}
        self._results: list[NavigationResult] = []
        self._evaluation: Evaluation | None = None
        self._tour_end_ns = 0
        self._now_ns = 0
        self._restarted = False
        """Whether no valid navigation status was received since the simulation was reset."""

    def waiting_for(self) -> str | None:
        """The services that the tour is waiting for, and why."""
        if all(self._active.values()) or self.exit_code is not None:
            return None
        if not self._config.drive:
            return "the world" if self._world is None else "the simulation"
        missing = []
        for service in SERVICES:
            if service in self._unneeded:
                continue
            if service not in self._waiting:
                missing.append(f"{service} (not running)")
            elif self._waiting[service]:
                missing.append(f"{service} (waiting for {self._waiting[service]})")
        return ", ".join(missing) or "localization and navigation to become active"

    @property
    def progress(self) -> tuple[int, int, str]:
        """Number of goals done, number of all goals, and the name of the current goal."""
        name = self._goals[self._goal_index][0] if self._goal_index < len(self._goals) else ""
        return self._goal_index, len(self._goals) or len(self._config.tour), name

    @property
    def explores(self) -> bool:
        """Whether the explorer drives."""
        return self._request.explores

    @property
    def exploration(self) -> ExplorationStatus | None:
        """How far the exploration has come; None where nothing is explored."""
        return self._exploration if self._request.explores else None

    @property
    def recording(self) -> str:
        """The run's folder, as reported by the recorder; empty before that."""
        return self._evaluation.recording if self._evaluation else ""

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Advance the run."""
        if not self._requested:
            self._requested = True
            outbox.put(WORLD_REQUEST, self._request)
        if now_ns < self._now_ns:
            self._restart()
        self._now_ns = now_ns
        self._listen(now_ns, inbox)
        if self._is_replaced() or self.exit_code is not None or self._world is None:
            return
        if not self._config.drive:
            # Time passes only in a world that is loaded.
            self.exit_code = 0 if now_ns > 0 else None
            return
        self._announce(now_ns)
        if not all(self._active.values()):
            return
        if self._goal_index < len(self._goals):
            self._drive(now_ns, inbox, outbox)
            return
        if self._config.slam and not self._goals:
            self._await_map(now_ns)
            return
        evaluation = self._own_evaluation()
        if evaluation is None or len(evaluation.goals) < len(self._results):
            if now_ns - self._tour_end_ns <= EVALUATION_PATIENCE_S * 1e9:
                return
        self._finish(evaluation)

    def _await_map(self, now_ns: int) -> None:
        """End when the exploration has; without one, the client that drives ends the run."""
        status = self._exploration
        if status is None or status.state not in ("complete", "failed"):
            self._tour_end_ns = now_ns
            return
        evaluation = self._evaluation
        mapping = None if evaluation is None else evaluation.mapping
        if mapping is None or mapping.exploration != status.state:
            if now_ns - self._tour_end_ns <= EVALUATION_PATIENCE_S * 1e9:
                return
        table = exploration_table(status, evaluation)
        if status.state == "complete":
            _LOG.info("exploration complete\n%s", table)
        else:
            _LOG.error("exploration failed: %s\n%s", status.reason, table)
        self.exit_code = 0 if status.state == "complete" else EXIT_NOT_REACHED

    def _restart(self) -> None:
        """Restart the tour, also one that has ended: the goals so far belong to another run."""
        if self._world is not None and self._config.drive and not self._config.only_ask:
            _LOG.info("simulation restarted; restarting the tour")
            self.exit_code = None
        self._exploration = None
        self._clock_seen_ns = None
        self._goal_index = 0
        self._goal_stamp_ns = None
        self._active = dict.fromkeys(_MANAGERS, False)
        self._navigation = NavigationStatus(localization_active=False, navigation_active=False)
        self._results.clear()
        self._evaluation = None
        self._restarted = True

    def _listen(self, now_ns: int, inbox: Inbox) -> None:
        for status in inbox.new(WORLD_STATUS):
            if status.request != self._request:
                continue
            if self._config.only_ask:
                other = bool(status.error and status.world_hash)
                self.exit_code = EXIT_REFUSED if other else 0
                if not other:
                    continue
            if status.error:
                _LOG.error("%s", status.error)
                self.exit_code = EXIT_REFUSED
            else:
                self.world_hash = status.world_hash
        self._offered = inbox.latest(WORLD) or self._offered
        self._map = inbox.latest(MAP) or self._map
        offered = self._offered
        if self._world is None and offered and offered.hash == self.world_hash:
            # The map of a run with slam comes later, and has no place for a tour.
            if self._map is not None or self._config.slam:
                self._enter(offered, self._map)
        for array in inbox.new(DIAGNOSTICS):
            for status_of in array.status:
                values = {value.key: value.value for value in status_of.values}
                self._waiting[status_of.name] = values.get(WAITING_KEY, "")
        for navigation in inbox.new(NAVIGATION_STATUS):
            if self._restarted and navigation.localization_active:
                # From before the reset: navigation restarts without localisation.
                continue
            self._restarted = False
            self._navigation = navigation
            if navigation.is_busy:
                self._busy_ns = now_ns
        self._evaluation = inbox.latest(EVALUATION) or self._evaluation
        for exploration in inbox.new(EXPLORATION_STATUS):
            if self._request.explores and not self._restarted:
                self._exploration = exploration

    def _is_replaced(self) -> bool:
        """Whether another world runs in the place of this run's: its tour has no place in it."""
        world, offered = self._world, self._offered
        if world is None or offered is None or offered.hash == self.world_hash:
            return False
        if self.exit_code is None:
            _LOG.error("world %s runs in the place of %s: the run ends", offered.name, world.name)
            self.exit_code = EXIT_NOT_REACHED
        return True

    def _enter(self, world: World, grid: msg.OccupancyGrid | None) -> None:
        try:
            self._goals = self._goals_in(world, grid) if self._config.drive else []
        except ValueError as error:
            _LOG.error("%s", error)
            nowhere = isinstance(error, NoLocationsError)
            self.exit_code = EXIT_NOT_REACHED if nowhere else EXIT_REFUSED
            return
        self._world = world
        self._tell_of(world)

    def _tell_of(self, world: World) -> None:
        walls, bodies, markers = len(world.walls), len(world.bodies), len(world.markers)
        _LOG.info(
            "world %s (%s): %d walls, %d bodies, %d markers",
            *(world.name, world.hash, walls, bodies, markers),
        )

    def _goals_in(self, world: World, grid: msg.OccupancyGrid | None) -> list[tuple[str, Planar]]:
        """Raises ValueError where the tour has no valid goals."""
        if self._request.explores or (self._config.slam and self._config.goal is None):
            return []
        if self._config.goal is None:
            assert grid is not None
            cells, origin = msg.cells_from_grid(grid), msg.se2_from_pose(grid.info.origin)
            if abs(grid.info.resolution - world.map_resolution_m) > _SAME_RESOLUTION_M:
                # The map is another one than the world's.
                world = world.model_copy(update={"map_resolution_m": grid.info.resolution})
            return tour_goals(world, self._config.tour, cells, origin, self._config.seed)
        x_m, y_m, yaw_rad = self._config.goal
        return [("goal", Planar(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad))]

    def _announce(self, now_ns: int) -> None:
        states = (self._navigation.localization_active, self._navigation.navigation_active)
        for manager, active in zip(_MANAGERS, states, strict=True):
            if active and not self._active[manager]:
                self._active[manager] = True
                logging.getLogger(manager).info(_ACTIVE)
        if self._clock_seen_ns is None and now_ns > 0:
            # The stack may have run for a long time before this demo was started.
            self._clock_seen_ns = now_ns
        waited_ns = now_ns - (self._clock_seen_ns or now_ns)
        if not all(self._active.values()) and waited_ns > self._config.bringup_timeout_s * 1e9:
            logging.getLogger(_MANAGERS[1]).error(
                "Failed to bring up all requested nodes. Aborting bringup. Waiting for %s",
                self.waiting_for(),
            )
            self.exit_code = EXIT_NOT_ACTIVE

    def _drive(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        name, goal = self._goals[self._goal_index]
        for result in inbox.new(NAVIGATION_RESULT):
            if result.goal_stamp_ns != self._goal_stamp_ns:
                continue
            if result.error_code == ErrorCode.WORLD_RESTARTED:
                # Navigation has lost the goal; it is sent again.
                continue
            if result.error_code == ErrorCode.PREEMPTED:
                _LOG.info("%s: a new goal comes first: the tour goes on when it has ended", name)
                self._busy_ns = now_ns
                continue
            self._results.append(result)
            self._goal_index += 1
            self._goal_stamp_ns = None
            self._tour_end_ns = now_ns
            if result.error_code == ErrorCode.CANCELED:
                _LOG.warning("%s: canceled: the tour ends", name)
                self._goal_index = len(self._goals)
            elif result.error_code:
                _LOG.warning("%s: error %d: %s", name, result.error_code, result.error_msg)
            else:
                taken_s = result.end_time_s - result.start_time_s
                _LOG.info("%s: reached after %.1f s", name, taken_s)
            return
        idle_ns = now_ns - self._busy_ns
        lost = not self._navigation.is_busy and idle_ns > self._config.resend_after_s * 1e9
        ready = self._navigation.localization_active and self._navigation.navigation_active
        if self._goal_stamp_ns is not None and not (lost and ready):
            return
        again = " (resent: navigation has no goal)" if self._goal_stamp_ns is not None else ""
        _LOG.info(
            "%s: driving to (%.2f, %.2f, %.2f)%s", name, goal.x_m, goal.y_m, goal.yaw_rad, again
        )
        self._goal_stamp_ns = self._busy_ns = now_ns
        outbox.put(
            GOAL_POSE,
            msg.PoseStamped(
                header=msg.header(now_ns, MAP_FRAME), pose=msg.pose_from_se2(goal.se2())
            ),
        )

    def _own_evaluation(self) -> Evaluation | None:
        """The recorder's evaluation, reduced to this node's goals, because others may send goals
        too.
        """
        if self._evaluation is None:
            return None
        verdicts = {goal.goal_stamp_ns: goal for goal in self._evaluation.goals if not goal.goal_id}
        ours = [verdicts.get(result.goal_stamp_ns) for result in self._results]
        # The recorder knows only the names of locations, not those of a default tour.
        goals = tuple(
            goal.model_copy(update={"name": name})
            for goal, (name, _) in zip(ours, self._goals, strict=False)
            if goal is not None
        )
        return self._evaluation.model_copy(update={"goals": goals})

    def _finish(self, evaluation: Evaluation | None) -> None:
        """End with the table; for goals that the recorder missed, navigation's result counts."""
        goals = evaluation.goals if evaluation is not None else ()
        if evaluation is not None and goals:
            _LOG.info("tour finished\n%s", tour_table(evaluation))
        else:
            _LOG.warning("tour finished; no evaluation received from the recorder")
        evaluated = {goal.goal_stamp_ns for goal in goals}
        others = [result for result in self._results if result.goal_stamp_ns not in evaluated]
        for result in others if goals else ():
            ended = f"error {result.error_code}" if result.error_code else "reached"
            _LOG.warning(
                "not evaluated by the recorder: (%.2f, %.2f) %s after %.1f s",
                *(result.goal.x_m, result.goal.y_m, ended),
                result.end_time_s - result.start_time_s,
            )
        reached = [goal.reached for goal in goals] + [not other.error_code for other in others]
        self.exit_code = 0 if all(reached) else EXIT_NOT_REACHED
