"""Trees of nodes that answer what a test has written down."""

from __future__ import annotations

from typing import Any, cast

from mazebot.navigation.behavior.context import NavigationContext
from mazebot.navigation.behavior.engine.blackboard import Blackboard
from mazebot.navigation.behavior.engine.tree import Node, NodePlace, NodeStatus, TreeRun
from mazebot.navigation.behavior.nodes.node_kinds import NODE_KINDS
from tests.navigation.behavior.simulated_robot import SimulatedRobot

ANSWERS = {
    "R": NodeStatus.RUNNING,
    "S": NodeStatus.SUCCESS,
    "F": NodeStatus.FAILURE,
    "K": NodeStatus.SKIPPED,
}
TICK_NS = 50_000_000


class NoRobot:
    """A context that nothing may be asked of."""

    def __getattr__(self, name: str) -> Any:
        raise AssertionError(f"the tree asked for {name}")


def run_over(robot: SimulatedRobot | None = None) -> TreeRun:
    context = robot if robot is not None else NoRobot()
    return TreeRun(cast(NavigationContext, context))


class Scripted(Node):
    """Answers the letters of a script in turn, and the last one for ever."""

    def __init__(self, script: str) -> None:
        place = NodePlace(0, "Scripted", script, {}, Blackboard(), run_over())
        super().__init__(place)
        self.script = script
        self.ticks = 0
        self.halts = 0

    def _tick(self, now_ns: int) -> NodeStatus:
        answer = self.script[min(self.ticks, len(self.script) - 1)]
        self.ticks += 1
        return ANSWERS[answer]

    def _halt(self) -> None:
        self.halts += 1


class Ticked:
    """One node over scripted children, ticked every 50 ms."""

    def __init__(
        self, kind: str, *scripts: str, robot: SimulatedRobot | None = None, **ports: str
    ) -> None:
        self.blackboard = Blackboard()
        self.run = run_over(robot)
        self.children = [Scripted(script) for script in scripts]
        place = NodePlace(1, kind, kind, ports, self.blackboard, self.run)
        self.node = NODE_KINDS[kind](place, self.children)
        self.now_ns = 0

    def tick(self) -> str:
        """The letter of the answer."""
        self.run.tick_number += 1
        status = self.node.tick(self.now_ns)
        self.now_ns += TICK_NS
        return next(letter for letter, one in ANSWERS.items() if one is status)

    def ticks(self, count: int) -> str:
        return "".join(self.tick() for _ in range(count))

    def ticked(self) -> list[int]:
        """How often each child has been ticked."""
        return [child.ticks for child in self.children]

    def halted(self) -> list[int]:
        return [child.halts for child in self.children]
