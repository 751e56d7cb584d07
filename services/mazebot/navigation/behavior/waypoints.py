"""FollowWaypoints: waypoint after waypoint, with a task at each, as Nav2's waypoint follower."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.actions import (
    FollowWaypoints,
    NavigateToPose,
    TaskFeedback,
    WaypointWork,
)
from mazebot.navigation.behavior.engine.tree import BehaviorTree, Ending
from mazebot.navigation.behavior.nodes.nodes_goals import Statuses, WaypointState, WaypointStatus
from mazebot.navigation.behavior.tasks import TreeTask
from mazebot.navigation.errors import NavigationError


class WaypointTask(Protocol):
    """What is done at a waypoint (Nav2's waypoint_task_executor_plugin)."""

    def step(self, since_ns: int, now_ns: int, index: int) -> bool:
        """Work at a waypoint reached at `since_ns`; True when it is done.

        Raises NavigationError (TASK_EXECUTOR_FAILED) where it fails.
        """
        ...


@dataclass(frozen=True)
class WaitAtWaypoint:
    """Stand for a while."""

    waypoint_pause_duration_s: float = 0.2
    enabled: bool = True

    def step(self, since_ns: int, now_ns: int, index: int) -> bool:
        """Done when the time has passed."""
        return not self.enabled or now_ns - since_ns >= self.waypoint_pause_duration_s * 1e9


@dataclass
class WaypointExchange:
    """What tasks at waypoints want from outside, and what has come."""

    photo_wanted_at: int | None = None
    """Index of the waypoint at which a picture is wanted, until it has been asked for."""
    photos: int = 0
    """Pictures taken so far."""
    inputs: int = 0
    """Inputs so far."""


@dataclass
class PhotoAtWaypoint:
    """Take a picture."""

    exchange: WaypointExchange
    timeout_s: float = 5.0
    enabled: bool = True
    _asked: tuple[int, int] | None = None
    """When its waypoint was reached, and the number of pictures before."""

    def step(self, since_ns: int, now_ns: int, index: int) -> bool:
        """Done when the picture has been taken."""
        if not self.enabled:
            return True
        if self._asked is None or self._asked[0] != since_ns:
            self._asked = since_ns, self.exchange.photos
            self.exchange.photo_wanted_at = index
        if self.exchange.photos > self._asked[1]:
            return True
        if now_ns - since_ns > self.timeout_s * 1e9:
            self.exchange.photo_wanted_at = None
            raise NavigationError(
                ErrorCode.TASK_EXECUTOR_FAILED,
                f"photo at waypoint {index}: no camera image received within "
                f"{self.timeout_s:.1f} s",
            )
        return False


@dataclass
class InputAtWaypoint:
    """Stand until an input comes."""

    exchange: WaypointExchange
    timeout_s: float = 10.0
    enabled: bool = True
    _begun: tuple[int, int] | None = None
    """When its waypoint was reached, and the number of inputs before."""

    def step(self, since_ns: int, now_ns: int, index: int) -> bool:
        """Done when an input has come since the waypoint was reached."""
        if self._begun is None or self._begun[0] != since_ns:
            self._begun = since_ns, self.exchange.inputs
        if not self.enabled or self.exchange.inputs > self._begun[1]:
            return True
        if now_ns - since_ns > self.timeout_s * 1e9:
            raise NavigationError(
                ErrorCode.TASK_EXECUTOR_FAILED,
                f"input at waypoint {index}: none received within {self.timeout_s:.1f} s",
            )
        return False


class WorkOfEach:
    """Each waypoint has work of its own: pictures, pauses and inputs, at the same time."""

    def __init__(self, works: Sequence[WaypointWork], exchange: WaypointExchange) -> None:
        self._tasks: list[list[WaypointTask]] = []
        for work in works:
            tasks: list[WaypointTask] = [WaitAtWaypoint(work.wait_s)]
            if work.photo:
                tasks.append(PhotoAtWaypoint(exchange))
            if work.input_timeout_s is not None:
                tasks.append(InputAtWaypoint(exchange, work.input_timeout_s))
            self._tasks.append(tasks)

    def step(self, since_ns: int, now_ns: int, index: int) -> bool:
        """Done when all is done; all begin at once."""
        done = True
        for task in self._tasks[index]:
            done = task.step(since_ns, now_ns, index) and done
        return done


class FollowWaypointsTask:
    """The waypoints of one request; each is a task NavigateToPose."""

    needs_localization = True

    def __init__(
        self,
        request: FollowWaypoints,
        navigate: Callable[[NavigateToPose], TreeTask],
        waypoint_task: WaypointTask,
        stop_on_failure: bool,
    ) -> None:
        """Begin.

        Args:
            request: the waypoints.
            navigate: makes the task that drives to one.
            waypoint_task: what to do at each.
            stop_on_failure: end at the first waypoint that is missed.

        Raises NavigationError with NO_VALID_WAYPOINTS.
        """
        count = len(request.poses)
        if not 0 <= request.goal_index < count or request.number_of_loops < 0:
            raise NavigationError(
                ErrorCode.NO_VALID_WAYPOINTS,
                f"{count} waypoints, goal_index {request.goal_index}, number_of_loops "
                f"{request.number_of_loops}: must be at least one waypoint, goal_index 0 to "
                f"{max(count - 1, 0)} and number_of_loops 0 or more",
            )
        if request.works and len(request.works) != count:
            raise NavigationError(
                ErrorCode.NO_VALID_WAYPOINTS,
                f"{len(request.works)} tasks for {count} waypoints: must be one for each, or none",
            )
        self._request = request
        self._navigate = navigate
        self._at_waypoint = waypoint_task
        self._stop_on_failure = stop_on_failure
        self.current_waypoint = request.goal_index
        self._rounds_left = request.number_of_loops
        self._missed: list[WaypointStatus] = list(request.missed)
        self._recoveries = 0
        self._reached_ns: int | None = None
        self._drive: TreeTask | None = None

    def _pose(self) -> SE2:
        return self._request.poses[self.current_waypoint]

    def step(self, now_ns: int) -> Ending | None:
        """Drive to the waypoint, or work there."""
        try:
            if self._reached_ns is None:
                ending = self._go(now_ns)
                if ending is None or ending.code:
                    return self._miss(ending) if ending else None
                self._reached_ns = now_ns
            if not self._at_waypoint.step(self._reached_ns, now_ns, self.current_waypoint):
                return None
        except NavigationError as error:
            return self._miss(Ending(int(error.code), error.message))
        return self._next()

    def _go(self, now_ns: int) -> Ending | None:
        if self._drive is None:
            # A goal that is refused is missed without a drive.
            self._drive = self._navigate(NavigateToPose(self._pose()))
        ending = self._drive.step(now_ns)
        if ending is not None:
            self._recoveries += self._drive.tree.run.number_of_recoveries
            self._drive.tree.run.number_of_recoveries = 0
        return ending

    def _miss(self, ending: Ending) -> Ending | None:
        index = self.current_waypoint
        self._missed.append(
            WaypointStatus(index, self._pose(), WaypointState.FAILED, ending.code, ending.message)
        )
        if not self._stop_on_failure:
            return self._next()
        if ending.code == ErrorCode.TASK_EXECUTOR_FAILED:
            return ending
        return Ending(
            int(ErrorCode.STOP_ON_MISSED_WAYPOINT),
            f"waypoint {index} was missed: error {ending.code}: {ending.message}",
        )

    def _next(self) -> Ending | None:
        self._reached_ns = None
        if self.current_waypoint + 1 == len(self._request.poses) and self._rounds_left == 0:
            return Ending(0, "")
        self.current_waypoint += 1
        if self.current_waypoint == len(self._request.poses):
            self._rounds_left -= 1
            self.current_waypoint = 0
        self._drive = None
        return None

    def halt(self) -> None:
        """Cancel the drive."""
        if self._drive is not None:
            self._drive.halt()

    def feedback(self, running_s: float) -> TaskFeedback:
        """That of the drive, and which waypoint it is."""
        of_drive = TaskFeedback(FollowWaypoints.action, running_s)
        if self._drive is not None:
            of_drive = self._drive.feedback(running_s)
        return replace(
            of_drive,
            action=FollowWaypoints.action,
            current_waypoint=self.current_waypoint,
            number_of_loops=self._rounds_left,
            number_of_recoveries=self._recoveries + of_drive.number_of_recoveries,
            number_of_poses_remaining=len(self._request.poses) - self.current_waypoint,
            waypoint_statuses=self.statuses(),
        )

    def running_tree(self) -> BehaviorTree | None:
        """The tree of the drive."""
        return self._drive.running_tree() if self._drive is not None else None

    def statuses(self) -> Statuses:
        """The waypoints missed."""
        return tuple(self._missed)
