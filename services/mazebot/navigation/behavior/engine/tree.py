"""The behaviour tree engine: nodes that are ticked and halted, with the semantics of
BehaviorTree.CPP 4.
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType
from typing import ClassVar, NamedTuple, Protocol, TypeVar

from mazebot.common.maths.frames import SE2
from mazebot.navigation.behavior.context import CostmapName, NavigationContext, TrackingFeedback
from mazebot.navigation.behavior.docking.docking import DockingParams, DockingStep
from mazebot.navigation.behavior.engine.blackboard import Blackboard
from mazebot.navigation.behavior.engine.ports import (
    Port,
    as_costmap,
    as_flag,
    as_integer,
    as_layers,
    as_natural,
    as_number,
    as_pose,
    as_poses,
    as_times,
)
from mazebot.navigation.behavior.engine.running_actions import RunningActions
from mazebot.navigation.behavior.engine.script import Script, ScriptError, read_script
from mazebot.navigation.behavior.motions.motion import BehaviorServerParams, Motion
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.planning.path import PlannedPath, dense

_LOG = logging.getLogger("navigation")
T = TypeVar("T")


class NodeStatus(Enum):
    """What a node answers when it is ticked; IDLE: it has not been since it was last reset."""

    IDLE = "IDLE"
    RUNNING = "RUNNING"
    SUCCESS = "SUCCESS"
    FAILURE = "FAILURE"
    SKIPPED = "SKIPPED"

    @property
    def active(self) -> bool:
        """Whether a node with this status keeps what it remembers (BT::isStatusActive)."""
        return self not in (NodeStatus.IDLE, NodeStatus.SKIPPED)


BEFORE: Mapping[str, NodeStatus] = MappingProxyType(
    {
        "_failureIf": NodeStatus.FAILURE,
        "_successIf": NodeStatus.SUCCESS,
        "_skipIf": NodeStatus.SKIPPED,
        "_while": NodeStatus.SKIPPED,
    }
)
"""Attributes with a condition for a node that begins, in the order in which they are asked, and
what it answers instead of being ticked: where the condition holds, and for `_while` where not."""
AFTER = ("_onSuccess", "_onFailure", "_onHalted", "_post")
"""Attributes with a script that runs after a node has ended."""


class TreeError(Exception):
    """A tree that cannot go on: the one-line message names the node and its port."""


@dataclass(frozen=True, slots=True)
class Ending:
    """How a task has ended."""

    code: int
    message: str


class Errand(Protocol):
    """A task within a task."""

    def step(self, now_ns: int) -> Ending | None:
        """Advance by one control period; the ending in its last one."""
        ...

    def halt(self) -> None:
        """Cancel what runs."""
        ...


@dataclass(frozen=True, slots=True)
class Failure:
    """How an action of a tree failed."""

    action: str
    code: int
    message: str
    tick_number: int


@dataclass
class TreeRun:
    """What all nodes of one tree share."""

    context: NavigationContext
    behaviors: BehaviorServerParams = field(default_factory=BehaviorServerParams)
    docking: DockingParams = field(default_factory=DockingParams)
    control_period_s: float = 0.05
    """Time between two ticks: over it a behaviour may change its speeds at its first step."""
    navigate: Callable[[SE2, RunningActions], Errand] | None = None
    """Begins a NavigateToPose by its default tree, among the actions that run, for actions that
    drive somewhere first.
    """
    tick_number: int = 0
    number_of_recoveries: int = 0
    plans: int = 0
    """Paths computed so far."""
    tracking: TrackingFeedback | None = None
    """Newest feedback of FollowPath."""
    running_motion: Motion | None = None
    """The behaviour that runs, for feedback."""
    docking_step: DockingStep | None = None
    """The newest state of DockRobot."""
    failures: list[Failure] = field(default_factory=list)
    """The newest failure of each action."""
    actions: RunningActions = field(default_factory=RunningActions)
    """Those that run."""
    _commander: tuple[int, Node | None] = (-1, None)
    """The node whose command holds, and the tick in which it was given."""
    _told_of_two: bool = False

    def drive(self, node: Node, velocity: Velocity) -> None:
        """Command a velocity for this tick. A stop gives way to the command of another node."""
        if velocity != STOP:
            self.commands(node)
        elif self._other(node) is not None:
            return
        else:
            self.releases(node)
        self.context.drive(velocity)

    def commands(self, node: Node) -> None:
        """Note that from now on a node's command holds in this tick; warn, once, where another node
        has given one.
        """
        other = self._other(node)
        if other is not None and not self._told_of_two:
            self._told_of_two = True
            _LOG.warning(
                "%s and %s drive the robot at once: it obeys the one that is ticked last",
                other, node,
            )  # fmt: skip
        self._commander = (self.tick_number, node)

    def releases(self, node: Node) -> None:
        """Note that a node has ended its command."""
        if self._commander[1] is node:
            self._commander = (-1, None)

    def _other(self, node: Node) -> Node | None:
        """The other node whose command holds in this tick."""
        tick_number, commander = self._commander
        return commander if tick_number == self.tick_number and commander is not node else None

    def failed(self, action: str, code: int, message: str) -> None:
        """Remember a failure of an action."""
        self.failures = [one for one in self.failures if one.action != action]
        self.failures.append(Failure(action, code, message, self.tick_number))

    def cause(self) -> Failure | None:
        """The failure that a task which has failed is to report.

        The newest of planning and control, since recoveries are only tried because of one; without
        any, the newest of all. Nav2 reports the lowest code, also where that failure was overcome.
        """
        causes = [one for one in self.failures if 100 <= one.code < 600] or self.failures
        return max(causes, key=lambda one: one.tick_number, default=None)


@dataclass(frozen=True)
class NodePlace:
    """What a node is given at its construction."""

    uid: int
    kind: str
    name: str
    attributes: dict[str, str]
    """Text of each port that the XML gives."""
    blackboard: Blackboard
    run: TreeRun
    in_recovery: bool = False
    """Whether it lies below the second child of a RecoveryNode."""
    line: int = 0
    """In the XML, from 1; 0: there is none."""


class NodeSnapshot(NamedTuple):
    """One line of a drawn tree."""

    uid: int
    name: str
    kind: str
    status: NodeStatus
    """What it answered last in the ticks that count; IDLE where none of them reached it."""
    depth: int


class Node(ABC):
    """A node; its class defines which ports it has and how many children it takes."""

    ports: ClassVar[tuple[Port, ...]] = ()
    fewest_children: ClassVar[int] = 0
    most_children: ClassVar[int | None] = 0

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        self.place = place
        self.children = tuple(children)
        self.status = NodeStatus.IDLE
        """What it answered last, until its parent resets it."""
        self._answered = NodeStatus.IDLE
        self._answered_in_tick = -1
        self._keys = {port: _key(port, text) for port, text in place.attributes.items()}
        self._defaults = {port.name: port.default for port in self.ports}
        self._scripted = any(name in place.attributes for name in (*BEFORE, *AFTER))
        self._scripts: dict[str, Script] = {}

    def __str__(self) -> str:
        return f"{self.place.kind} '{self.place.name}'"

    @property
    def recovers(self) -> bool:
        """Whether it runs because something failed."""
        return False

    @property
    def context(self) -> NavigationContext:
        """The robot and its costmaps, planner and controller."""
        return self.place.run.context

    def tick(self, now_ns: int) -> NodeStatus:
        """Let the node work for one tick; returns its status, never IDLE."""
        if self._scripted:
            status = self._refused() or self._tick(now_ns)
            self._run_after(status)
        else:
            status = self._tick(now_ns)
        assert status is not NodeStatus.IDLE, f"{self} returned IDLE"
        self.status = self._answered = status
        self._answered_in_tick = self.place.run.tick_number
        return status

    def halt(self) -> None:
        """Stop the node if it is running, and reset its status to IDLE."""
        if self.status is NodeStatus.RUNNING:
            self._halt()
            self._run_given("_onHalted")
        self.status = NodeStatus.IDLE

    def _refused(self) -> NodeStatus | None:
        """The answer that a script before the tick gives; None: the node is ticked."""
        if self.status.active:
            running = self.status is NodeStatus.RUNNING and "_while" in self.place.attributes
            if running and not self.holds("_while"):
                self.halt()
                return NodeStatus.SKIPPED
            return None
        for name, answer in BEFORE.items():
            if name in self.place.attributes and self.holds(name) != (name == "_while"):
                return answer
        return None

    def _run_after(self, status: NodeStatus) -> None:
        if status is NodeStatus.SUCCESS:
            self._run_given("_onSuccess")
        elif status is NodeStatus.FAILURE:
            self._run_given("_onFailure")
        else:
            return
        self._run_given("_post")

    def _run_given(self, name: str) -> None:
        if name in self.place.attributes:
            self.run(name)

    def failed_in(self, tick_number: int) -> bool:
        """Whether it answered FAILURE in a tick."""
        failed = self._answered is NodeStatus.FAILURE
        return failed and self._answered_in_tick == tick_number

    def snapshot(self, depth: int, since: int) -> NodeSnapshot:
        """This node as one line, with its newest answer since a tick."""
        place = self.place
        answered = self._answered if self._answered_in_tick >= since else NodeStatus.IDLE
        return NodeSnapshot(place.uid, place.name, place.kind, answered, depth)

    def walk(self) -> Iterator[Node]:
        """This node and all below it."""
        return (node for node, _ in self.walk_with_depth())

    def walk_with_depth(self, depth: int = 0) -> Iterator[tuple[Node, int]]:
        """This node and all below it, each before its children, with their depths."""
        yield self, depth
        for child in self.children:
            yield from child.walk_with_depth(depth + 1)

    @abstractmethod
    def _tick(self, now_ns: int) -> NodeStatus: ...

    def _halt(self) -> None:
        """Stop what runs; the status is still RUNNING."""
        self.halt_children()

    def renew(self) -> None:
        """Forget what counts for one goal alone, here and below: the task has a new one."""
        for child in self.children:
            child.renew()

    def halt_children(self, first: int = 0) -> None:
        """Halt the children from an index on."""
        for child in self.children[first:]:
            child.halt()

    def key(self, port: str) -> str | None:
        """Blackboard key that a port refers to; None for a literal or a port that is not given."""
        return self._keys.get(port)

    def get(self, port: str) -> object | None:
        """Value of an input port: from the blackboard, the XML or the port's default."""
        key, place = self._keys.get(port), self.place
        given: object | None
        given = place.attributes.get(port) if key is None else place.blackboard.get(key)
        return self._defaults.get(port) if given is None else given

    def number(self, port: str) -> float:
        """Value of an input port that holds a number."""
        return self._read(port, as_number)

    def integer(self, port: str) -> int:
        """Value of an input port that holds a whole number."""
        return self._read(port, as_integer)

    def natural(self, port: str) -> int:
        """Value of an input port that holds a whole number of at least 0."""
        return self._read(port, as_natural)

    def times(self, port: str) -> int:
        """Value of an input port that says how often: at least 0, or -1 for without end."""
        return self._read(port, as_times)

    def flag(self, port: str) -> bool:
        """Value of an input port that holds true or false."""
        return self._read(port, as_flag)

    def costmap(self, port: str) -> CostmapName:
        """Value of an input port that names a clear service: the costmap of that."""
        return self._read(port, as_costmap)

    def layers(self, port: str) -> tuple[str, ...]:
        """Value of an input port that names layers to clear; empty: all."""
        return self._read(port, as_layers)

    def text(self, port: str) -> str:
        """Value of an input port as text; empty where there is none."""
        value = self.get(port)
        return "" if value is None else str(value)

    def pose(self, port: str) -> SE2 | None:
        """Value of an input port that holds a pose in the map frame; None where there is none."""
        return None if self.get(port) is None else self._read(port, as_pose)

    def poses(self, port: str) -> tuple[SE2, ...]:
        """Value of an input port that holds poses; empty where there are none."""
        return () if self.get(port) is None else self._read(port, as_poses)

    def path(self, port: str) -> PlannedPath | None:
        """Value of an input port that holds a path; None where there is none."""
        value = self.get(port)
        if value is not None and not isinstance(value, PlannedPath):
            raise TreeError(f"{self}, port {port!r}: must be a path on the blackboard")
        return value

    def holds(self, port: str) -> bool:
        """Whether the condition of an input port that holds a script is true."""
        return self._script(port, Script.holds)

    def run(self, port: str) -> None:
        """Run the script of an input port."""
        self._script(port, Script.run)

    def _script(self, port: str, work: Callable[[Script, Blackboard], T]) -> T:
        text = self.text(port)
        try:
            if text not in self._scripts:
                self._scripts[text] = read_script(text)
            return work(self._scripts[text], self.place.blackboard)
        except ScriptError as error:
            raise TreeError(f"{self}, port {port!r}: {error}") from None

    def put(self, port: str, value: object) -> None:
        """Write an output port, if the XML connects it to the blackboard. A sparse path is made
        dense, to be followed.
        """
        key = self.key(port)
        if key is not None:
            self.place.blackboard.set(
                key, dense(value) if isinstance(value, PlannedPath) else value
            )

    def _read(self, port: str, convert: Callable[[object], T]) -> T:
        try:
            return convert(self.get(port))
        except ValueError as error:
            raise TreeError(f"{self}, port {port!r}: {error}") from None


def is_key(text: str) -> bool:
    """Whether a port's text is a key of the blackboard, `{key}`, also between spaces, and no value,
    as BehaviorTree.CPP's isBlackboardPointer has it.
    """
    stripped = text.strip(" ")
    return stripped.startswith("{") and stripped.endswith("}")


def _key(port: str, text: str) -> str | None:
    if not is_key(text):
        return None
    inner = text.strip(" ")[1:-1].strip()
    return port if inner == "=" else inner


class BehaviorTree:
    """A tree that can be ticked, with its blackboard."""

    def __init__(self, name: str, root: Node, blackboard: Blackboard, run: TreeRun) -> None:
        self.name = name
        self.root = root
        self.blackboard = blackboard
        self.run = run
        self._nodes = tuple(root.walk_with_depth())

    def tick(self, now_ns: int) -> NodeStatus:
        """Tick the root once; when the tree has ended it is reset, and the next tick starts over.

        Raises TreeError where a port holds nothing that its node can use.
        """
        self.run.tick_number += 1
        status = self.root.tick(now_ns)
        if status is not NodeStatus.RUNNING:
            self.root.halt()
        return status

    def halt(self) -> None:
        """Cancel what runs."""
        self.root.halt()

    def renew(self) -> None:
        """Begin with a new goal: what runs goes on, but no recovery because of the goal before."""
        if any(node.recovers for node, _ in self._nodes):
            self.halt()
        self.root.renew()

    def failed_node(self) -> Node:
        """The node because of which the last tick failed: the last one on the way of failures
        from the root.
        """
        node, tick = self.root, self.run.tick_number
        while failed := [child for child in node.children if child.failed_in(tick)]:
            node = failed[-1]
        return node

    def snapshot(self, since: int | None = None) -> tuple[NodeSnapshot, ...]:
        """The newest answer of every node since a tick, parents before their children; None: in
        the last tick.
        """
        first = self.run.tick_number if since is None else since
        return tuple([node.snapshot(depth, first) for node, depth in self._nodes])
