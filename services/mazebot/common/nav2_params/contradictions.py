"""Values that are right alone and not together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from mazebot.common.nav2_params.entry import Entry, short_class
from mazebot.common.nav2_params.parameter import Value

_CORNERS = '"[[x, y], [x, y], [x, y]]"'
_CLASSES = ("plugin", "primary_controller")


def contradictions(
    name: str, tree: Mapping[str, Mapping[str, Value]], entries: Iterable[Entry]
) -> list[str]:
    """One-line errors of values that contradict each other: Nav2, too, refuses them when it starts,
    or does nothing sensible with them.
    """
    problems = []
    at = {(entry.node, entry.name): entry for entry in entries if entry.knowledge == "parameter"}

    def refuse(node: str, parameter: str, value: Value, must: str) -> None:
        entry = at.get((node, parameter))
        line = f":{entry.leaf.line}" if entry else ""
        problems.append(f"{name}{line}: {node}.{parameter}: {value!r:.60}: {must}")

    amcl = tree.get("amcl", {})
    if amcl and amcl["min_particles"] > amcl["max_particles"]:
        most = amcl["max_particles"]
        refuse("amcl", "min_particles", amcl["min_particles"],
               f"must be at most max_particles, {most}")  # fmt: skip
    for node, parameters in tree.items():
        for least, value, other, most in _ranges("", parameters):
            # Nav2's defaults are not ours.
            if (node, least) in at and (node, other) in at and other != "max_particles":
                refuse(node, least, value, f"must be at most {other.rpartition('.')[2]}, {most}")
    monitor = tree.get("collision_monitor", {})
    for zone in monitor.get("polygons") or []:
        values = monitor.get(zone)
        for parameter, must in _missing_of_zone(values if isinstance(values, dict) else {}):
            lines = [
                entry.leaf.line for entry in at.values()
                if entry.node == "collision_monitor" and entry.name.startswith(f"{zone}.")
            ]  # fmt: skip
            lines = lines or [at["collision_monitor", "polygons"].leaf.line]
            where = f"{name}:{lines[0]}: collision_monitor.{zone}.{parameter}"
            problems.append(f"{where}: is missing: must be {must}")
    server = tree.get("controller_server", {})
    # Nav2 does not read the parameters of one that is not listed.
    for space in server.get("controller_plugins") or []:
        for path, inner in _controllers(space, server.get(space)):
            period, step = 1.0 / server["controller_frequency"], inner.get("model_dt")
            if "MPPIController" in _classes_of(inner) and _exceeds(period - 1e-6, step):
                refuse("controller_server", f"{path}.model_dt", step,
                       f"must be at least the controller's period, {period:g} s")  # fmt: skip
    return problems


def _missing_of_zone(zone: Mapping[str, Value]) -> Iterator[tuple[str, str]]:
    """The parameters without which Nav2 knows no form or action of a zone of the collision monitor,
    each with what it must be.
    """
    kind, action = zone.get("type"), zone.get("action_type")
    if kind is None:
        yield "type", "polygon, circle or velocity_polygon"
    if action is None:
        yield "action_type", "stop, slowdown, limit, approach or none"
    if kind == "polygon" and action not in {None, "approach"} and not zone.get("points"):
        yield "points", f"{_CORNERS}: a form that a topic gives cannot be taken here"
    if kind == "circle" and zone.get("radius") is None:
        yield "radius", "in metres: a form that a topic gives cannot be taken here"
    for name in zone.get("velocity_polygons") or [] if kind == "velocity_polygon" else []:
        one = zone.get(name)
        values = one if isinstance(one, dict) else {}
        if not values.get("points"):
            yield f"{name}.points", _CORNERS
        for bound in ("linear_min", "linear_max", "theta_min", "theta_max"):
            if values.get(bound) is None:
                yield f"{name}.{bound}", "a speed"


def _controllers(name: str, space: Value) -> Iterator[tuple[str, Mapping[str, Value]]]:
    """The namespaces of a controller, and of the one that stands behind it, with their names."""
    if _is_space(space):
        yield name, space
        yield from _controllers(f"{name}.primary_controller", space.get("primary_controller"))


def _classes_of(space: Mapping[str, Value]) -> set[str]:
    return {short_class(space.get(key)) for key in _CLASSES}


def _is_space(value: Value) -> bool:
    return isinstance(value, dict)


def _ranges(prefix: str, space: Mapping[str, Value]) -> Iterator[tuple[str, Value, str, Value]]:
    """Each parameter that is a minimum and greater than the maximum beside it: name and value of
    both.
    """
    for name, value in space.items():
        if _is_space(value):
            yield from _ranges(f"{prefix}{name}.", value)
            continue
        words = name.split("_")
        if "min" not in words:
            continue
        other = "_".join("max" if word == "min" else word for word in words)
        most = space.get(other)
        # A negative maximum of what is positive means that there is none.
        none = _is_number(most) and _exceeds(0, most) and not _exceeds(0, value)
        if _exceeds(value, most) and not none:
            yield f"{prefix}{name}", value, f"{prefix}{other}", most


def _exceeds(least: Any, most: Any) -> bool:
    if isinstance(least, list) and isinstance(most, list) and len(least) == len(most):
        return any(_exceeds(one, other) for one, other in zip(least, most, strict=True))
    if not _is_number(least) or not _is_number(most):
        return False
    return float(least) > float(most)


def _is_number(value: Value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
