"""Decorator nodes: those of BehaviorTree.CPP 4 and of nav2_behavior_tree."""

from __future__ import annotations

from collections.abc import Sequence

from mazebot.common.maths.frames import SE2
from mazebot.navigation.behavior.engine.ports import Port, as_status, out
from mazebot.navigation.behavior.engine.tree import Node, NodePlace, NodeStatus
from mazebot.navigation.behavior.nodes.goals import goals_on_blackboard
from mazebot.navigation.behavior.nodes.path_parts import length_left_m
from mazebot.navigation.planning.path import PlannedPath

RUNNING, SUCCESS, FAILURE, SKIPPED = (
    NodeStatus.RUNNING,
    NodeStatus.SUCCESS,
    NodeStatus.FAILURE,
    NodeStatus.SKIPPED,
)


class Decorator(Node):
    """A node with one child."""

    fewest_children = most_children = 1

    @property
    def child(self) -> Node:
        """Its child."""
        return self.children[0]

    def _ended(self, status: NodeStatus) -> NodeStatus:
        """The status, with the child reset where it has ended."""
        if status is not RUNNING:
            self.child.halt()
        return status


class Inverter(Decorator):
    """Failure for success, success for failure."""

    def _tick(self, now_ns: int) -> NodeStatus:
        status = self._ended(self.child.tick(now_ns))
        return {SUCCESS: FAILURE, FAILURE: SUCCESS}.get(status, status)


class ForceSuccess(Decorator):
    """Success, however the child ends."""

    def _tick(self, now_ns: int) -> NodeStatus:
        status = self._ended(self.child.tick(now_ns))
        return SUCCESS if status is FAILURE else status


class ForceFailure(Decorator):
    """Failure, however the child ends."""

    def _tick(self, now_ns: int) -> NodeStatus:
        status = self._ended(self.child.tick(now_ns))
        return FAILURE if status is SUCCESS else status


class KeepRunningUntilFailure(Decorator):
    """Ticks its child again when it has succeeded; ends only when it fails."""

    def _tick(self, now_ns: int) -> NodeStatus:
        status = self._ended(self.child.tick(now_ns))
        return FAILURE if status is FAILURE else RUNNING


class Repeat(Decorator):
    """Ticks its child until it has succeeded `num_cycles` times (-1: without end) or fails."""

    ports = (Port("num_cycles", "times", required=True),)

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._cycles = 0

    def _tick(self, now_ns: int) -> NodeStatus:
        wanted = self.times("num_cycles")
        while wanted < 0 or self._cycles < wanted:
            status = self._ended(self.child.tick(now_ns))
            if status is not SUCCESS:
                if status is FAILURE:
                    self._cycles = 0
                return status
            self._cycles += 1
            if wanted < 0:
                # Without end: one cycle a tick, or the tick would have none either.
                return RUNNING
        self._cycles = 0
        return SUCCESS

    def _halt(self) -> None:
        self._cycles = 0
        super()._halt()


class RetryUntilSuccessful(Decorator):
    """Ticks its child until it succeeds or has failed `num_attempts` times (-1: without end)."""

    ports = (Port("num_attempts", "times", required=True),)

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._attempts = 0

    def _tick(self, now_ns: int) -> NodeStatus:
        wanted = self.times("num_attempts")
        while wanted < 0 or self._attempts < wanted:
            status = self._ended(self.child.tick(now_ns))
            if status is not FAILURE:
                if status is SUCCESS:
                    self._attempts = 0
                return status
            self._attempts += 1
            if wanted < 0:
                return RUNNING
        self._attempts = 0
        return FAILURE

    def _halt(self) -> None:
        self._attempts = 0
        super()._halt()


class _Timed(Decorator):
    """A decorator that counts the time since it was first reached."""

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._start_ns = 0

    def _elapsed_ns(self, now_ns: int) -> int:
        if self.status is not RUNNING:
            self._start_ns = now_ns
        return now_ns - self._start_ns


class Timeout(_Timed):
    """Fails when its child runs for longer than `msec` milliseconds; 0: it may run for ever."""

    ports = (Port("msec", "natural", required=True),)

    def _tick(self, now_ns: int) -> NodeStatus:
        limit_ns, elapsed_ns = self.natural("msec") * 1_000_000, self._elapsed_ns(now_ns)
        if self.status is RUNNING and 0 < limit_ns <= elapsed_ns:
            self.child.halt()
            return FAILURE
        return self._ended(self.child.tick(now_ns))


class Delay(_Timed):
    """Ticks its child from `delay_msec` milliseconds after it was first reached."""

    ports = (Port("delay_msec", "natural", required=True),)

    def _tick(self, now_ns: int) -> NodeStatus:
        if self._elapsed_ns(now_ns) < self.natural("delay_msec") * 1_000_000:
            return RUNNING
        return self._ended(self.child.tick(now_ns))


class RunOnce(Decorator):
    """Ticks its child until it has ended once; after that it is skipped, or answers the same."""

    ports = (Port("then_skip", "flag", "true"),)

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._answer: NodeStatus | None = None

    def _tick(self, now_ns: int) -> NodeStatus:
        if self._answer is not None:
            return SKIPPED if self.flag("then_skip") else self._answer
        status = self._ended(self.child.tick(now_ns))
        if status in (SUCCESS, FAILURE):
            self._answer = status
        return status


class Precondition(Decorator):
    """Ticks its child where the script `if` holds, and until it has ended; else answers `else`."""

    ports = (
        Port("if", "script", required=True),
        Port("else", "status", "FAILURE"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        if self.child.status is not RUNNING and not self.holds("if"):
            return NodeStatus[as_status(self.get("else"))]
        return self._ended(self.child.tick(now_ns))


class SingleTrigger(Decorator):
    """Ticks its child until it has ended once; after that it fails."""

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._done = False

    def _tick(self, now_ns: int) -> NodeStatus:
        if not self.status.active:
            self._done = False
        if self._done:
            return FAILURE
        status = self._ended(self.child.tick(now_ns))
        self._done = status in (SUCCESS, FAILURE)
        return status


class Paced(Decorator):
    """Ticks its child first, while it runs, and when it is due; answers RUNNING in between."""

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._first = True

    def _tick(self, now_ns: int) -> NodeStatus:
        if not self.status.active:
            self._first = True
            self._begin(now_ns)
        if not (self._first or self.child.status is RUNNING or self._due(now_ns)):
            return RUNNING
        self._first = False
        status = self._ended(self.child.tick(now_ns))
        if status is SUCCESS:
            self._begin(now_ns)
        return status

    def _begin(self, now_ns: int) -> None:
        """The child has succeeded now, or the node begins."""
        raise NotImplementedError

    def _due(self, now_ns: int) -> bool:
        """Whether the child is to be ticked again."""
        raise NotImplementedError


class RateController(Paced):
    """Ticks its child `hz` times a second after each success."""

    ports = (Port("hz", "number", "10.0"),)

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._start_ns = 0

    def _begin(self, now_ns: int) -> None:
        self._start_ns = now_ns

    def _due(self, now_ns: int) -> bool:
        hz = self.number("hz")
        return hz > 0.0 and (now_ns - self._start_ns) * hz >= 1e9


class DistanceController(Paced):
    """Ticks its child each time that the robot has moved by `distance` m in a straight line."""

    ports = (
        Port("distance", "number", "1.0"),
        Port("global_frame"),
        Port("robot_base_frame"),
    )

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._start = SE2(0.0, 0.0, 0.0)

    def _begin(self, now_ns: int) -> None:
        self._start = self.context.pose()

    def _due(self, now_ns: int) -> bool:
        return self._start.distance_m(self.context.pose()) >= self.number("distance")


class GoalUpdatedController(Paced):
    """Ticks its child first, and again for each new goal."""

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._goals: tuple[SE2, ...] = ()

    def _begin(self, now_ns: int) -> None:
        self._goals = goals_on_blackboard(self.place.blackboard)

    def _due(self, now_ns: int) -> bool:
        return self._goals != goals_on_blackboard(self.place.blackboard)


class SpeedController(GoalUpdatedController):
    """Ticks its child at a rate between `min_rate` and `max_rate` Hz by the robot's speed, and at
    once for a new goal.
    """

    ports = (
        Port("min_rate", "number", "0.1"),
        Port("max_rate", "number", "1.0"),
        Port("min_speed", "number", "0.0"),
        Port("max_speed", "number", "0.5"),
    )

    _FILTER_S = 0.3
    """bt_navigator's filter_duration: the speed is smoothed over it."""

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._start_ns = 0
        self._speed_m_s = 0.0

    def _begin(self, now_ns: int) -> None:
        super()._begin(now_ns)
        self._start_ns = now_ns

    def _due(self, now_ns: int) -> bool:
        share = min(self.place.run.control_period_s / self._FILTER_S, 1.0)
        self._speed_m_s += share * (abs(self.context.velocity().linear_m_s) - self._speed_m_s)
        slow, fast = self.number("min_speed"), self.number("max_speed")
        ratio = min(max((self._speed_m_s - slow) / max(fast - slow, 1e-9), 0.0), 1.0)
        rates = self.number("min_rate"), self.number("max_rate")
        hz = rates[0] + ratio * (rates[1] - rates[0])
        return super()._due(now_ns) or (now_ns - self._start_ns) * hz >= 1e9


class GoalUpdater(Decorator):
    """Gives its child the goal last received on `goal_update`, or else the goal of the task, whose
    other goals stay as they are.
    """

    ports = (
        Port("input_goal", "pose"),
        Port("input_goals", "poses"),
        out("output_goal", "pose"),
        out("output_goals", "poses"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        goal = self.context.updated_goal() or self.pose("input_goal")
        goals = self.poses("input_goals")
        if goal is not None:
            self.put("output_goal", goal)
        if goals:
            self.put("output_goals", goals)
        return self._ended(self.child.tick(now_ns))


class PathLongerOnApproach(Decorator):
    """Ticks its child where a new path to the same goal is `length_factor` times as long as the one
    before, and that one is shorter than `prox_len` m; else succeeds.
    """

    ports = (
        Port("path", "path", required=True),
        Port("prox_len", "number", "3.0"),
        Port("length_factor", "number", "2.0"),
    )

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._old: PlannedPath | None = None

    def _tick(self, now_ns: int) -> NodeStatus:
        new, old = self.path("path"), self._old
        if self.child.status is RUNNING or self._is_longer(old, new):
            status = self.child.tick(now_ns)
            if status in (RUNNING, SKIPPED):
                return status
            self._old = new
            return self._ended(status)
        self._old = new
        return SUCCESS

    def _is_longer(self, old: PlannedPath | None, new: PlannedPath | None) -> bool:
        if old is None or new is None or old is new or old.goal != new.goal:
            return False
        left_m = length_left_m(old, self.context.pose())
        return left_m < self.number("prox_len") and new.length_m > left_m * self.number(
            "length_factor"
        )
