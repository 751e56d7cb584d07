"""The figures of a run: single numbers out of its summary.json, and which way they are better."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

Direction = Literal["lower", "higher", "neither"]


class Figure(NamedTuple):
    """A number that two runs can be compared by."""

    name: str
    """Its path in summary.json; or what it is computed from."""
    title: str
    unit: str
    better: Direction
    digits: int
    """Decimals that are worth printing."""


FIGURES = (
    Figure("goals_reached", "goals reached", "", "higher", 0),
    Figure("goals_missed", "goals not reached", "", "lower", 0),
    Figure("spl", "success weighted by path length", "", "higher", 3),
    Figure("sim_time_s", "simulated time", "s", "neither", 1),
    Figure("goal_time_s", "time of all goals", "s", "lower", 1),
    Figure("distance_m", "distance driven", "m", "neither", 2),
    Figure("contacts.count", "contacts", "", "lower", 0),
    Figure("recoveries", "recoveries", "", "lower", 0),
    Figure("goal_error_m", "goal error, mean", "m", "lower", 3),
    Figure("localisation_error_m.mean", "localisation error, mean", "m", "lower", 4),
    Figure("localisation_error_m.p95", "localisation error, 95th percentile", "m", "lower", 4),
    Figure("localisation_error_m.max", "localisation error, maximum", "m", "lower", 4),
    Figure("localisation_error_rad.p95", "heading error, 95th percentile", "rad", "lower", 4),
    Figure("localization.inside_95_percent", "estimates inside 95 % ellipse", "", "neither", 3),
    Figure("marker_error_m.mean", "marker error, mean", "m", "lower", 4),
    Figure("markers_seen", "markers seen", "", "higher", 0),
    Figure("odometry_drift_m", "odometry drift at the end", "m", "lower", 3),
    Figure("mapping.coverage_share", "floor mapped, share", "", "higher", 3),
    Figure("mapping.explored_s", "explored after", "s", "lower", 1),
    Figure("mapping.walls_found_share", "walls found, share", "", "higher", 3),
    Figure("mapping.walls_true_share", "occupied cells true, share", "", "higher", 3),
    Figure("mapping.free_wrong_share", "free cells wrong, share", "", "lower", 4),
    Figure("mapping.trajectory_error_m.rmse", "trajectory error, rmse", "m", "lower", 4),
    Figure("mapping.loops", "loops closed", "", "neither", 0),
    Figure("mapping.false_loops", "false loops", "", "lower", 0),
    Figure("real_time_factor", "real-time factor", "x", "higher", 2),
    Figure("messages_lost", "messages lost", "", "lower", 0),
    Figure("messages_rejected", "messages rejected", "", "lower", 0),
)


def figures_of(summary: Mapping[str, Any]) -> dict[str, float | None]:
    """The value of each figure by name; None where a run has none."""
    goals = [goal for goal in _objects(summary.get("goals")) if goal.get("given_up") is not True]
    messages = summary.get("messages")
    topics = _objects(list(messages.values())) if isinstance(messages, dict) else []
    errors_m = [value for goal in goals if (value := _number(goal.get("goal_error_m"))) is not None]
    seen = summary.get("markers_seen")
    computed = {
        "goals_missed": float(goals_sent(summary))
        - sum(goal.get("reached") is True for goal in goals),
        "goal_time_s": _sum(goals, "time_s") if goals else None,
        "recoveries": _sum(goals, "recoveries") if goals else None,
        "goal_error_m": sum(errors_m) / len(errors_m) if errors_m else None,
        "markers_seen": float(sum(bool(count) for count in seen.values()))
        if isinstance(seen, dict) and seen
        else None,
        "messages_lost": _sum(topics, "lost") if topics else None,
        "messages_rejected": _sum(topics, "rejected") if topics else None,
    }
    if not summary:
        return dict.fromkeys(figure.name for figure in FIGURES)
    return {
        figure.name: computed[figure.name]
        if figure.name in computed
        else _number(_at(summary, figure.name))
        for figure in FIGURES
    }


def goals_sent(summary: Mapping[str, Any]) -> int:
    """Number of goals, without those given up: also one that had not ended when the run did. Of a
    robot whose true pose is not known no goal is judged, and none counts.
    """
    goals = [goal for goal in _objects(summary.get("goals")) if goal.get("given_up") is not True]
    sent = None if summary.get("distance_m") is None else _number(summary.get("goals_sent"))
    return max(int(sent or 0), len(goals))


def figure_text(figure: Figure, value: float | None, signed: bool = False) -> str:
    """A value with its decimals; a dash where there is none."""
    if value is None:
        return "-"
    return f"{value:{'+' if signed else ''}.{figure.digits}f}"


def _at(values: Any, path: str) -> Any:
    for part in path.split("."):
        values = values.get(part) if isinstance(values, Mapping) else None
    return values


def _number(value: Any) -> float | None:
    if not isinstance(value, int | float) or isinstance(value, bool) or abs(value) >= 1e300:
        return None
    return float(value)


def _sum(entries: list[dict[str, Any]], name: str) -> float:
    return sum(_number(entry.get(name)) or 0.0 for entry in entries)


def _objects(values: Any) -> list[dict[str, Any]]:
    return (
        [entry for entry in values if isinstance(entry, dict)] if isinstance(values, list) else []
    )
