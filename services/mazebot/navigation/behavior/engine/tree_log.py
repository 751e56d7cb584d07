"""What a tree did between two reports: more than its last tick shows."""

from __future__ import annotations

from mazebot.navigation.behavior.engine.tree import BehaviorTree, NodeSnapshot, NodeStatus


class TreeLog:
    """Collects what the ticks of a tree answered. A node that is ticked once a second, and answers
    at once, would seldom be seen by who looks five times a second.
    """

    def __init__(self) -> None:
        self._nodes: tuple[NodeSnapshot, ...] = ()
        """Of the trees before the newest one."""
        self._tree: BehaviorTree | None = None
        self._since = 0
        """First tick of the newest tree that counts."""

    def add(self, tree: BehaviorTree | None) -> None:
        """Note that a tree was ticked, or that none runs: what ran before it is forgotten then."""
        if tree is self._tree:
            return
        self._nodes = self._seen() if tree is not None else ()
        self._tree = tree
        self._since = tree.run.tick_number if tree is not None else 0

    def take(self) -> tuple[NodeSnapshot, ...]:
        """The newest tree, each node with its newest answer since the last call; IDLE: it was not
        ticked.
        """
        nodes = self._seen()
        self._nodes, self._tree = (), None
        return nodes

    def _seen(self) -> tuple[NodeSnapshot, ...]:
        if self._tree is None:
            return ()
        before = {(one.uid, one.kind, one.name): one for one in self._nodes}
        return tuple(
            before.get((one.uid, one.kind, one.name), one) if one.status is NodeStatus.IDLE else one
            for one in self._tree.snapshot(self._since)
        )
