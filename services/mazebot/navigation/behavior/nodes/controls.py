"""Control nodes: those of BehaviorTree.CPP 4 and of nav2_behavior_tree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from mazebot.navigation.behavior.engine.ports import Port
from mazebot.navigation.behavior.engine.tree import Node, NodePlace, NodeStatus

RUNNING, SUCCESS, FAILURE, SKIPPED = (
    NodeStatus.RUNNING,
    NodeStatus.SUCCESS,
    NodeStatus.FAILURE,
    NodeStatus.SKIPPED,
)


class Control(Node):
    """A node with children that decides which of them to tick."""

    fewest_children = 1
    most_children: ClassVar[int | None] = None


class InOrder(Control):
    """Ticks its children in order until one returns `ends`; while one runs, continues there."""

    ends: ClassVar[NodeStatus]
    completes: ClassVar[NodeStatus]
    """Its answer when no child has ended it."""
    keeps_place = False
    """Whether it continues at the child that has ended it, and also after a halt."""
    pauses = False
    """Whether it answers RUNNING between two children."""

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._current = 0
        self._skipped = 0

    def _tick(self, now_ns: int) -> NodeStatus:
        if not self.status.active:
            self._skipped = 0
        while self._current < len(self.children):
            status = self.children[self._current].tick(now_ns)
            if status is RUNNING:
                return RUNNING
            if status is self.ends:
                self.halt_children()
                if not self.keeps_place:
                    self._current = 0
                return status
            self._current += 1
            self._skipped += status is SKIPPED
            if self.pauses and status is not SKIPPED and self._current < len(self.children):
                return RUNNING
        all_skipped = self._skipped == len(self.children)
        self.halt_children()
        self._current = self._skipped = 0
        return SKIPPED if all_skipped else self.completes

    def _halt(self) -> None:
        if not self.keeps_place:
            self._current = self._skipped = 0
        super()._halt()


class InSequence(InOrder):
    """`Sequence`: succeeds when all children have; after a failure it starts over."""

    ends, completes = FAILURE, SUCCESS


class AsyncSequence(InSequence):
    """A Sequence that ticks one child a tick."""

    pauses = True


class SequenceWithMemory(InOrder):
    """A Sequence that continues at the child that failed."""

    ends, completes = FAILURE, SUCCESS
    keeps_place = True


class Fallback(InOrder):
    """Succeeds with the first child that does."""

    ends, completes = SUCCESS, FAILURE


class AsyncFallback(Fallback):
    """A Fallback that ticks one child a tick."""

    pauses = True


class Reactive(Control):
    """Ticks its children from the first in every tick; when one runs, the others are halted."""

    ends: ClassVar[NodeStatus]
    completes: ClassVar[NodeStatus]

    def _tick(self, now_ns: int) -> NodeStatus:
        all_skipped = True
        for child in self.children:
            status = child.tick(now_ns)
            all_skipped = all_skipped and status is SKIPPED
            if status is RUNNING:
                for other in self.children:
                    if other is not child:
                        other.halt()
                return RUNNING
            if status is self.ends:
                self.halt_children()
                return status
            if status is SKIPPED:
                child.halt()
        self.halt_children()
        return SKIPPED if all_skipped else self.completes


class ReactiveSequence(Reactive):
    """Succeeds when all children do in one tick."""

    ends, completes = FAILURE, SUCCESS


class ReactiveFallback(Reactive):
    """Succeeds with the first child that does, all ticked again in every tick."""

    ends, completes = SUCCESS, FAILURE


class PipelineSequence(Control):
    """Ticks all children up to the furthest one reached, in every tick.

    An earlier child that runs again is passed over, so that a path is replanned while the one
    before is followed.
    """

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._furthest = 0

    def _tick(self, now_ns: int) -> NodeStatus:
        for index, child in enumerate(self.children):
            status = child.tick(now_ns)
            if status is FAILURE:
                self.halt_children()
                self._furthest = 0
                return FAILURE
            if status is RUNNING and index >= self._furthest:
                self._furthest = index
                return RUNNING
        self.halt_children()
        self._furthest = 0
        return SUCCESS

    def _halt(self) -> None:
        self._furthest = 0
        super()._halt()


class RecoveryNode(Control):
    """Ticks its first child; when that fails the second one, and then the first again.

    Every retry begins with the error codes of the first child cleared, so that a recovery is never
    chosen by a failure that has been overcome.
    """

    ports = (Port("number_of_retries", "natural", "1"),)
    fewest_children = most_children = 2

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._recovering = False
        self._counted = False
        self._retries = 0

    def _tick(self, now_ns: int) -> NodeStatus:
        main, recovery = self.children
        while True:
            if not self._recovering:
                status = main.tick(now_ns)
                if status is RUNNING:
                    return RUNNING
                if status is not FAILURE or self._retries >= self.natural("number_of_retries"):
                    return self._end(status)
                main.halt()
                self._recovering = True
                self._counted = False
            status = recovery.tick(now_ns)
            if status in (RUNNING, SUCCESS) and not self._counted:
                # One that fails at once, as where nothing could help, is no recovery.
                self._counted = True
                self.place.run.number_of_recoveries += 1
            if status is RUNNING:
                return RUNNING
            if status is SKIPPED:
                self._recovering = False
                self.halt_children()
                return FAILURE
            if status is FAILURE:
                return self._end(FAILURE)
            recovery.halt()
            self._recovering = False
            self._retries += 1
            for node in main.walk():
                if node.key("error_code_id") is not None:
                    node.put("error_code_id", 0)

    @property
    def recovers(self) -> bool:
        """See Node."""
        return self._recovering

    def renew(self) -> None:
        """See Node."""
        self._retries = 0
        super().renew()

    def _end(self, status: NodeStatus) -> NodeStatus:
        self._recovering, self._retries = False, 0
        self.halt_children()
        return status

    def _halt(self) -> None:
        self._end(FAILURE)


class RoundRobin(Control):
    """Ticks one child until it ends, at the next call the next one.

    A child's success is its answer, whichever child it is, and the one after it is next; after the
    last child the first one is. A failure continues with the next child in the same tick; at the
    last child it is the answer, unless it wraps round: then only after all have failed.
    """

    ports = (Port("wrap_around", "flag", "false"),)

    def __init__(self, place: NodePlace, children: Sequence[Node] = ()) -> None:
        super().__init__(place, children)
        self._current = 0
        self._failed = self._skipped = 0

    def _tick(self, now_ns: int) -> NodeStatus:
        count = len(self.children)
        if not self.status.active:
            self._failed = self._skipped = 0
        while self._failed + self._skipped < count:
            status = self.children[self._current].tick(now_ns)
            if status is RUNNING:
                return RUNNING
            self._current = (self._current + 1) % count
            if status is SUCCESS:
                return self._end(SUCCESS)
            self._failed += status is FAILURE
            self._skipped += status is SKIPPED
            if self._current == 0 and not self.flag("wrap_around"):
                break
        return self._end(FAILURE if self._failed else SKIPPED)

    def _end(self, status: NodeStatus) -> NodeStatus:
        self._failed = self._skipped = 0
        self.halt_children()
        return status

    def _halt(self) -> None:
        self._current = 0
        self._end(FAILURE)


class NonblockingSequence(Control):
    """Ticks all children in every tick, also those after one that runs."""

    def _tick(self, now_ns: int) -> NodeStatus:
        running, skipped = False, 0
        for child in self.children:
            status = child.tick(now_ns)
            if status is FAILURE:
                self.halt_children()
                return FAILURE
            running = running or status is RUNNING
            skipped += status is SKIPPED
        if running:
            return RUNNING
        self.halt_children()
        return SKIPPED if skipped == len(self.children) else SUCCESS


class PersistentSequence(Control):
    """A Sequence that keeps its place in the port `current_child_idx`, also when it is halted. A
    new goal begins at the first child.
    """

    ports = (Port("current_child_idx", "integer", required=True),)

    def _tick(self, now_ns: int) -> NodeStatus:
        index = 0 if self.get("current_child_idx") is None else self.integer("current_child_idx")
        while 0 <= index < len(self.children):
            status = self.children[index].tick(now_ns)
            if status is RUNNING:
                return RUNNING
            if status is FAILURE:
                self.halt_children()
                return FAILURE
            index += 1
            self.put("current_child_idx", index)
        self.halt_children()
        self.put("current_child_idx", 0)
        return SUCCESS

    def renew(self) -> None:
        """See Node."""
        if self.status is not RUNNING:
            self.put("current_child_idx", 0)
        super().renew()
