"""Values that are right alone and not together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from mazebot.common.nav2_params.entry import Entry, short_class
from mazebot.common.nav2_params.parameter import Value


def contradictions(
    name: str, tree: Mapping[str, Mapping[str, Value]], entries: Iterable[Entry]
) -> list[str]:
    """One-line errors of values that contradict each other: Nav2, too, rejects them at startup."""
    problems = []
    at = {(entry.node, entry.name): entry for entry in entries}

    def refuse(node: str, parameter: str, value: Value, must: str) -> None:
        entry = at.get((node, parameter))
        line = f":{entry.leaf.line}" if entry else ""
        problems.append(f"{name}{line}: {node}.{parameter}: {value!r:.60}: {must}")

    amcl = tree.get("amcl", {})
    if amcl and amcl["min_particles"] > amcl["max_particles"]:
        most = amcl["max_particles"]
        refuse("amcl", "min_particles", amcl["min_particles"],
               f"must be at most max_particles, {most}")  # fmt: skip
    server = tree.get("controller_server", {})
    for space, inner in server.items():
        if isinstance(inner, dict) and short_class(inner.get("plugin")) == "MPPIController":
            period = 1.0 / server["controller_frequency"]
            if period > inner["model_dt"] + 1e-6:
                refuse("controller_server", f"{space}.model_dt", inner["model_dt"],
                       f"must be at least the controller's period, {period:g} s")  # fmt: skip
    return problems
