"""The figures of a run's summary, named for people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

_SHOWN: tuple[tuple[str, str, str, float, int], ...] = (
    # Name, path in summary.json, unit, factor, decimals.
    ("simulated time", "sim_time_s", "s", 1.0, 1),
    ("wall time", "wall_time_s", "s", 1.0, 1),
    ("real-time factor", "real_time_factor", "x", 1.0, 2),
    ("goals reached", "goals_reached", "", 1.0, 0),
    ("goals sent", "goals_sent", "", 1.0, 0),
    ("success weighted by path length", "spl", "", 1.0, 3),
    ("true path", "distance_m", "m", 1.0, 2),
    ("localisation error, mean", "localisation_error_m.mean", "mm", 1e3, 1),
    ("localisation error, 95 %", "localisation_error_m.p95", "mm", 1e3, 1),
    ("localisation error, largest", "localisation_error_m.max", "mm", 1e3, 1),
    ("heading error, mean", "localisation_error_rad.mean", "mrad", 1e3, 1),
    ("estimates inside 95 %", "localization.inside_95_percent", "%", 1e2, 1),
    ("marker error, mean", "marker_error_m.mean", "mm", 1e3, 1),
    ("odometry drift", "odometry_drift_m", "m", 1.0, 3),
    ("contacts", "contacts.count", "", 1.0, 0),
    ("walls found", "mapping.walls_found_share", "%", 1e2, 1),
    ("floor mapped", "mapping.coverage_share", "%", 1e2, 1),
)


@dataclass(frozen=True)
class Figure:
    """One figure of a run."""

    name: str
    text: str
    """With its unit."""


def figures_of(summary: Mapping[str, Any]) -> tuple[Figure, ...]:
    """The figures that were measured."""
    found = []
    for name, path, unit, factor, decimals in _SHOWN:
        value: Any = summary
        for part in path.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        if isinstance(value, int | float) and not isinstance(value, bool):
            text = f"{factor * value:.{decimals}f}"
            found.append(Figure(name, f"{text} {unit}".strip()))
    return tuple(found)
