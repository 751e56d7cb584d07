"""BehaviorTree.CPP's own control nodes that choose a branch, or run several at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from mazebot.navigation.behavior.engine.ports import Port
from mazebot.navigation.behavior.engine.script import as_text
from mazebot.navigation.behavior.engine.tree import Node, NodePlace, NodeStatus, TreeError
from mazebot.navigation.behavior.nodes.controls import Control

RUNNING, SUCCESS, FAILURE, SKIPPED = (
    NodeStatus.RUNNING,
    NodeStatus.SUCCESS,
    NodeStatus.FAILURE,
    NodeStatus.SKIPPED,
)


class AtOnce(Control):
    """Ticks in every tick all children that have not ended."""

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._ended: dict[int, NodeStatus] = {}

    def _share(self, port: str) -> int:
        """How many children a port means: -1 is all of them, -2 all but one."""
        wanted, count = self.integer(port), len(self.children)
        share = wanted if wanted >= 0 else count + wanted + 1
        if not 0 <= share <= count:
            raise TreeError(
                f"{self}, port {port!r}: {wanted}: must be at most {count}, its children"
            )
        return share

    def _count(self, status: NodeStatus) -> int:
        return sum(one is status for one in self._ended.values())

    def _end(self, status: NodeStatus) -> NodeStatus:
        self._ended.clear()
        self.halt_children()
        return status

    def _halt(self) -> None:
        self._end(FAILURE)


class Parallel(AtOnce):
    """Succeeds with `success_count` of its children, fails with `failure_count` of them."""

    ports = (
        Port("success_count", "integer", "-1"),
        Port("failure_count", "integer", "1"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        successes, failures = self._share("success_count"), self._share("failure_count")
        all_wanted = self.integer("success_count") < 0
        count, skipped = len(self.children), 0
        for index, child in enumerate(self.children):
            if index not in self._ended:
                status = child.tick(now_ns)
                skipped += status is SKIPPED
                if status in (SUCCESS, FAILURE):
                    self._ended[index] = status
            found = self._count(SUCCESS)
            if skipped < count and found + (skipped if all_wanted else 0) >= successes:
                return self._end(SUCCESS)
            failed = self._count(FAILURE)
            if count - failed < successes or (failed == failures and failed):
                return self._end(FAILURE)
        return SKIPPED if skipped == count else RUNNING


class ParallelAll(AtOnce):
    """Ends when all children have; fails if `max_failures` of them did."""

    ports = (Port("max_failures", "integer", "1"),)

    def _tick(self, now_ns: int) -> NodeStatus:
        failures, skipped = self._share("max_failures"), 0
        for index, child in enumerate(self.children):
            if index in self._ended:
                continue
            status = child.tick(now_ns)
            skipped += status is SKIPPED
            if status in (SUCCESS, FAILURE):
                self._ended[index] = status
        if skipped == len(self.children):
            return SKIPPED
        if skipped + len(self._ended) < len(self.children):
            return RUNNING
        return self._end(FAILURE if self._count(FAILURE) >= failures else SUCCESS)


class IfThenElse(Control):
    """Ticks its first child until that has ended, then the second after a success, the third after
    a failure.
    """

    fewest_children, most_children = 2, 3

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._branch = 0

    def _tick(self, now_ns: int) -> NodeStatus:
        if self._branch == 0:
            status = self.children[0].tick(now_ns)
            if status is SUCCESS:
                self._branch = 1
            elif status is FAILURE and len(self.children) == 3:
                self._branch = 2
            else:
                return status if status is RUNNING else self._end(status)
        status = self.children[self._branch].tick(now_ns)
        return status if status is RUNNING else self._end(status)

    def _end(self, status: NodeStatus) -> NodeStatus:
        self._branch = 0
        self.halt_children()
        return status

    def _halt(self) -> None:
        self._end(FAILURE)


class WhileDoElse(Control):
    """Ticks its first child in every tick, and with it the second one while it succeeds, the third
    one while it fails.
    """

    fewest_children, most_children = 2, 3

    def _tick(self, now_ns: int) -> NodeStatus:
        condition, *branches = self.children
        status = condition.tick(now_ns)
        if status in (SUCCESS, FAILURE):
            chosen = 0 if status is SUCCESS else 1
            for index, branch in enumerate(branches):
                if index != chosen:
                    branch.halt()
            if chosen < len(branches):
                status = branches[chosen].tick(now_ns)
        if status is not RUNNING:
            self.halt_children()
        return status


class Switch(Control):
    """Ticks the child of the first case that equals `variable`, or the last child."""

    cases: ClassVar[int]

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._running: int | None = None

    def _tick(self, now_ns: int) -> NodeStatus:
        variable = self.get("variable")
        chosen = next(
            (
                index
                for index in range(self.cases)
                if variable is not None and _equal(variable, self.get(f"case_{index + 1}"))
            ),
            self.cases,
        )
        if self._running not in (None, chosen):
            self.children[self._running or 0].halt()
        status = self.children[chosen].tick(now_ns)
        self._running = chosen if status is RUNNING else None
        if status is not RUNNING:
            self.halt_children()
        return status

    def _halt(self) -> None:
        self._running = None
        super()._halt()


def _equal(one: object, other: object) -> bool:
    if as_text(one) == as_text(other):
        return True
    try:
        return float(str(one)) == float(str(other))
    except ValueError:
        return False


def switch(cases: int) -> type[Switch]:
    """`Switch2` to `Switch6`."""
    return type(
        f"Switch{cases}",
        (Switch,),
        {
            "cases": cases,
            "fewest_children": cases + 1,
            "most_children": cases + 1,
            "ports": (
                Port("variable", "any", required=True),
                *(Port(f"case_{case + 1}", "any", required=True) for case in range(cases)),
            ),
        },
    )
