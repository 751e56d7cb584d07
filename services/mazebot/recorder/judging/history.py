"""What happened in a run over time: the tables and events of series.json."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mazebot.common.figures.goal_table import task_name
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Evaluation, GoalReport, MarkerEntity, World
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.messages import ns_from_time
from mazebot.common.node.diagnostics import MISSED_KEY, STEP_TIME_KEY
from mazebot.common.recordings.series import (
    MOST_EVENTS,
    MOST_ROWS,
    CostRows,
    EstimatedRows,
    PaceRows,
    Ring,
    RunSeries,
    SeriesEvent,
    SeriesGoal,
    SeriesMarker,
    TrueRows,
)
from mazebot.recorder.judging.map.thinned_rows import ThinnedRows

_POSE_PERIOD_NS = 100_000_000
_COST_PERIOD_NS = 1_000_000_000
_MOST_COSTS = 500
_MOST_SERVICES = 50
_PACE_PERIOD_S = 1.0
"""Wall time over which the real-time factor is measured."""
_MOST_GOALS = 1000
_MOST_TEXT = 300
_WARNING, _ERROR = 30, 40
"""Levels of /rosout."""

_Event = tuple[int, str, str, str]
# Stamp (ns), kind, level and text.


class RunHistory:
    """Keeps a run's motion, errors, costs and events in bounded memory."""

    def __init__(self) -> None:
        pose = ("x_m", "y_m", "yaw_rad")
        self._truth = ThinnedRows(
            (*pose, "speed_m_s", "yaw_rate_rad_s"), _POSE_PERIOD_NS, MOST_ROWS
        )
        self._estimate = ThinnedRows(
            (*pose, "error_m", "error_rad"), _POSE_PERIOD_NS, MOST_ROWS, peaks="error_m"
        )
        self._pace = ThinnedRows(("real_time_factor",), _COST_PERIOD_NS, _MOST_COSTS)
        self._costs: dict[str, ThinnedRows] = {}
        self._events: deque[_Event] = deque(maxlen=MOST_EVENTS)
        self._dropped = 0
        self._levels: dict[str, int] = {}
        self._paced: tuple[float, int] | None = None

    def add_truth(self, stamp_ns: int, pose: SE2, speed_m_s: float, rate_rad_s: float) -> None:
        """Add a true pose, map from base_footprint, and the velocity there."""
        self._truth.add(stamp_ns, (*pose, speed_m_s, rate_rad_s))

    def add_estimate(self, stamp_ns: int, pose: SE2, error_m: float, error_rad: float) -> None:
        """Add an estimated pose, map from base_footprint, and its errors."""
        self._estimate.add(stamp_ns, (*pose, error_m, error_rad))

    def see_marker(self, stamp_ns: int, class_id: str) -> None:
        """A marker was detected for the first time."""
        self._happened(stamp_ns, "marker", "info", f"marker {class_id} first seen")

    def add_diagnostics(self, array: msg.DiagnosticArray) -> None:
        """Add the status of services."""
        stamp_ns = ns_from_time(array.header.stamp)
        for status in array.status:
            name, level = status.name, int(status.level)
            before = self._levels.get(name)
            if before is None and len(self._levels) >= _MOST_SERVICES:
                continue
            self._levels[name] = level
            if before is not None and before != level:
                worse = "error" if level > 1 else "warning" if level else "info"
                self._happened(stamp_ns, "service", worse, f"{name}: {status.message}")
            values = {entry.key: entry.value for entry in status.values}
            if STEP_TIME_KEY in values:
                row = (_number(values[STEP_TIME_KEY]), _number(values.get(MISSED_KEY, "0")))
                self._costs_of(name).add(stamp_ns, row)

    def add_log(self, line: msg.Log) -> None:
        """Add a line of /rosout; only warnings and errors are kept."""
        if line.level >= _WARNING:
            level = "error" if line.level >= _ERROR else "warning"
            self._happened(ns_from_time(line.stamp), "log", level, f"{line.name}: {line.msg}")

    def tick(self, wall_s: float, now_ns: int, is_paused: bool) -> None:
        """Set the wall time of the newest clock message."""
        if is_paused or self._paced is None or now_ns < self._paced[1]:
            self._paced = wall_s, now_ns
        elif wall_s - self._paced[0] >= _PACE_PERIOD_S:
            factor = (now_ns - self._paced[1]) * 1e-9 / (wall_s - self._paced[0])
            self._pace.add(now_ns, (factor,))
            self._paced = wall_s, now_ns

    def series(
        self,
        world: World,
        evaluation: Evaluation,
        markers: tuple[MarkerEntity, ...],
        solid: tuple[Ring, ...],
        now_s: float,
    ) -> RunSeries:
        """The document for series.json, up to simulation time `now_s`."""
        goals = evaluation.goals[-_MOST_GOALS:]
        events, dropped = self._all_events(evaluation, goals)
        return RunSeries(
            world=world.name,
            world_hash=world.hash,
            slam=world.slam,
            sim_time_s=now_s,
            truth=TrueRows.model_construct(**_columns(self._truth)),
            estimate=EstimatedRows.model_construct(**_columns(self._estimate)),
            costs={
                name: CostRows.model_construct(**_columns(rows))
                for name, rows in sorted(self._costs.items())
            },
            pace=PaceRows.model_construct(**_columns(self._pace)),
            start=world.start,
            locations=world.locations,
            goals=tuple(map(_goal, goals)),
            markers=tuple(_marker(entity, evaluation.markers_seen) for entity in markers),
            events=events,
            events_dropped=dropped,
            solid=solid,
        )

    def values(self) -> dict[str, Any]:
        """The part of the state that is no array, as JSON values, for `restore_values()`."""
        return {"events": list(self._events), "dropped": self._dropped, "levels": self._levels}

    def restore_values(self, values: Mapping[str, Any]) -> None:
        """Continue from saved `values()`. Raises ValueError, KeyError, TypeError if invalid."""
        for stamp_ns, kind, level, text in values["events"]:
            self._events.append((int(stamp_ns), str(kind), str(level), str(text)))
        self._dropped = int(values["dropped"])
        self._levels = {str(name): int(level) for name, level in values["levels"].items()}

    def state(self) -> dict[str, NDArray[Any]]:
        """The rows so far, for `restore()`."""
        return {
            f"{name}/{key}": array
            for name, rows in self._tables().items()
            for key, array in rows.state().items()
        }

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from saved rows. Raises ValueError, KeyError, TypeError if they are invalid."""
        parts: dict[str, dict[str, NDArray[Any]]] = {}
        for path, array in state.items():
            name, _, key = path.rpartition("/")
            parts.setdefault(name, {})[key] = array
        for name in parts:
            if name.startswith("costs/"):
                self._costs_of(name.removeprefix("costs/"))
        for name, rows in self._tables().items():
            if name in parts:
                rows.restore(parts[name])

    def _tables(self) -> dict[str, ThinnedRows]:
        costs = {f"costs/{name}": rows for name, rows in self._costs.items()}
        return {"truth": self._truth, "estimate": self._estimate, "pace": self._pace, **costs}

    def _costs_of(self, service: str) -> ThinnedRows:
        if service not in self._costs:
            self._costs[service] = ThinnedRows(
                ("step_time_p99_ms", "missed_periods"),
                *(_COST_PERIOD_NS, _MOST_COSTS, "step_time_p99_ms"),
            )
        return self._costs[service]

    def _happened(self, stamp_ns: int, kind: str, level: str, text: str) -> None:
        self._dropped += len(self._events) == self._events.maxlen
        self._events.append((stamp_ns, kind, level, text))

    def _all_events(
        self, evaluation: Evaluation, goals: tuple[GoalReport, ...]
    ) -> tuple[tuple[SeriesEvent, ...], int]:
        """The newest events in order of time, and how many are left out."""
        events = list(self._events)
        for goal in goals:
            events += _goal_events(goal)
        for contact in evaluation.contacts:
            text = f"{contact.robot_link} touches {contact.body}"
            events.append((round(contact.time_s * 1e9), "contact", "warning", text))
        events.sort(key=lambda event: event[0])
        dropped = max(len(events) - MOST_EVENTS, 0)
        events = events[dropped:]
        stamps_ns = np.array([event[0] for event in events], np.int64)
        x_m, y_m = (self._true_at(stamps_ns, name) for name in ("x_m", "y_m"))
        listed = tuple(
            SeriesEvent.model_validate(
                {
                    "time_s": round(stamp_ns * 1e-9, 3),
                    "kind": kind,
                    "level": level,
                    "text": " ".join(text.split())[:_MOST_TEXT],
                    "x_m": x_m[row],
                    "y_m": y_m[row],
                }
            )
            for row, (stamp_ns, kind, level, text) in enumerate(events)
        )
        return listed, dropped + self._dropped

    def _true_at(self, stamps_ns: NDArray[np.int64], name: str) -> list[float | None]:
        if not len(self._truth.stamps_ns):
            return [None] * len(stamps_ns)
        values = np.interp(stamps_ns, self._truth.stamps_ns, self._truth.column(name))
        return [round(value, 3) for value in values.tolist()]


def _goal_events(goal: GoalReport) -> list[_Event]:
    if goal.start_time_s is None:
        return []
    start_ns = round(goal.start_time_s * 1e9)
    end_ns = round((goal.start_time_s + goal.time_s) * 1e9)
    name = task_name(goal)
    why = goal.error_msg or (f"error {goal.error_code}" if goal.error_code else "not at the goal")
    missed = (
        f"{name}: given up for a better goal" if goal.given_up else f"{name}: not reached: {why}"
    )
    ended = f"{name}: reached" if goal.reached else missed
    level = "info" if goal.reached or _is_canceled(goal) else "error"
    return [
        (start_ns, "goal", "info", f"{name}: started"),
        (end_ns, "goal", level, ended),
    ]


def _is_canceled(goal: GoalReport) -> bool:
    return goal.error_code in (ErrorCode.PREEMPTED, ErrorCode.CANCELED)


def _goal(report: GoalReport) -> SeriesGoal:
    start_s = report.start_time_s
    return SeriesGoal(
        name=report.name,
        action=report.action,
        start_s=start_s,
        end_s=None if start_s is None else round(start_s + report.time_s, 6),
        reached=report.reached,
        canceled=_is_canceled(report),
        pose=report.goal,
    )


def _marker(entity: MarkerEntity, seen: Mapping[str, int]) -> SeriesMarker:
    x, y, z, w = entity.orientation_xyzw
    # Its face is its z axis.
    yaw_rad = float(np.arctan2(2.0 * (y * z - w * x), 2.0 * (x * z + w * y)))
    return SeriesMarker(
        name=entity.name,
        marker_id=entity.marker_id,
        x_m=entity.position_m[0],
        y_m=entity.position_m[1],
        yaw_rad=yaw_rad,
        images=seen.get(str(entity.marker_id), 0),
    )


def _columns(rows: ThinnedRows) -> dict[str, Any]:
    """The columns of a document, rounded to what a plot can show."""
    columns: dict[str, Array] = {"time_s": np.asarray(rows.stamps_ns * 1e-9, float)}
    columns |= {name: rows.column(name) for name in rows.columns}
    return {name: tuple(np.round(column, 4).tolist()) for name, column in columns.items()}


def _number(text: str) -> float:
    """0 where a service gave no number."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if np.isfinite(value) else 0.0
