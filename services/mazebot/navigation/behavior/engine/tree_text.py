"""A ticked tree as text, one line a node."""

from __future__ import annotations

from collections.abc import Sequence

from mazebot.navigation.behavior.engine.tree import NodeSnapshot, NodeStatus

_MARKS = {
    NodeStatus.IDLE: " ",
    NodeStatus.RUNNING: ">",
    NodeStatus.SUCCESS: "+",
    NodeStatus.FAILURE: "x",
    NodeStatus.SKIPPED: "-",
}


def tree_text(nodes: Sequence[NodeSnapshot]) -> str:
    """The nodes, indented by their depth: `>` runs, `+` succeeded, `x` failed, `-` skipped."""
    return "\n".join(f"{_MARKS[one.status]} {'  ' * one.depth}{_label(one)}" for one in nodes)


def _label(node: NodeSnapshot) -> str:
    return node.kind if node.name == node.kind else f"{node.kind} {node.name!r}"
