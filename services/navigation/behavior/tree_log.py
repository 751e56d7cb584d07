"""What a tree did between two reports: more than its last tick shows."""

from __future__ import annotations

from collections.abc import Sequence

from services.navigation.behavior.tree import NodeSnapshot, NodeStatus


class TreeLog:
    """Collects the snapshots of ticks. A node that is ticked once a second, and answers at once,
    would seldom be seen by who looks five times a second.
    """

    def __init__(self) -> None:
        self._nodes: tuple[NodeSnapshot, ...] = ()

    def add(self, nodes: Sequence[NodeSnapshot]) -> None:
        """Add the snapshot of a tick."""
        before = {(one.uid, one.kind, one.name): one for one in self._nodes}
        self._nodes = tuple(
            before.get((one.uid, one.kind, one.name), one) if one.status is NodeStatus.IDLE else one
            for one in nodes
        )

    def take(self) -> tuple[NodeSnapshot, ...]:
        """The newest tree, each node with its newest answer since the last call; IDLE: it was not
        ticked.
        """
        nodes, self._nodes = self._nodes, ()
        return nodes
