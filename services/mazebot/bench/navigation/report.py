"""The figures of all trials as a table and as JSON, beside those of another run."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from mazebot.bench.navigation.metrics import percentile
from mazebot.bench.navigation.scenario import Row
from mazebot.common.config import ConfigError

_NOT_IN_JSON = ("way", "touches", "scene", "errors_m", "errors_rad")
LOWER_IS_BETTER = (
    "contacts_robot", "time_s_median", "jerk_m_s3", "jerk_rad_s3", "irregularity_rad_m",
    "recoveries", "localisation_mean_m", "localisation_p95_m", "localisation_p95_deg", "alarms",
)  # fmt: skip

Summary = dict[str, Any]


def row_as_json(row: Row) -> dict[str, Any]:
    """One trial."""
    fields = dataclasses.asdict(row)
    return {name: _rounded(value) for name, value in fields.items() if name not in _NOT_IN_JSON}


def summary(rows: Sequence[Row]) -> Summary:
    """The figures of one scenario over all its trials; None where nothing was measured.

    Localisation is pooled over all claims of all trials, clearance is the least of all, times are
    of trials that reached their goal.
    """
    run = [row for row in rows if not row.skipped]
    if not run:
        return {"trials": 0, "skipped": rows[0].skipped if rows else "no trials"}
    metres = np.concatenate([row.errors_m for row in run])
    radians = np.concatenate([row.errors_rad for row in run])
    spls = [row.spl for row in run if row.spl is not None]
    clearances = [row.min_clearance_m for row in run if row.min_clearance_m is not None]
    found = {
        "trials": len(run),
        "seeds": len({row.seed for row in run}),
        "successes": sum(row.success for row in run),
        "reached": sum(row.reached for row in run),
        "contacts_robot": sum(row.contacts_robot for row in run),
        "contacts_other": sum(row.contacts_other for row in run),
        "contacts_per_km": _per_km(sum(row.contacts_robot for row in run), run),
        "spl": _mean(spls),
        "time_s_median": percentile(np.array([row.time_s for row in run if row.reached]), 50.0),
        "driven_m": sum(row.driven_m for row in run),
        "min_clearance_m": min(clearances, default=None),
        "clearance_p05_m": _mean([row.clearance_p05_m for row in run]),
        "jerk_m_s3": _mean([row.jerk_m_s3 for row in run]),
        "jerk_rad_s3": _mean([row.jerk_rad_s3 for row in run]),
        "irregularity_rad_m": _mean([row.irregularity_rad_m for row in run]),
        "recoveries": sum(row.recoveries for row in run),
        "localisation_mean_m": float(metres.mean()) if len(metres) else None,
        "localisation_p95_m": percentile(metres, 95.0),
        "localisation_p95_deg": percentile(np.degrees(radians), 95.0),
        "consistency": _consistency(run),
        "alarms": sum(row.alarms for row in run),
        "barn": _mean([row.barn for row in run]),
        "barn_own_speed": _mean([row.barn_own_speed for row in run]),
        **_extras(run),
    }
    return {name: _rounded(value) for name, value in found.items()}


def _extras(rows: Iterable[Row]) -> Summary:
    """Medians and 95th percentiles of the numbers that only one scenario measures."""
    values: dict[str, list[float]] = {}
    for row in rows:
        for name, value in row.extra.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                values.setdefault(name, []).append(float(value))
    parts: Summary = {}
    for name, found in values.items():
        parts[f"{name}_median"] = percentile(np.array(found), 50.0)
        parts[f"{name}_p95"] = percentile(np.array(found), 95.0)
        parts[f"{name}_count"] = len(found)
    return parts


def _consistency(rows: Iterable[Row]) -> float | None:
    pairs = [(row.consistency, len(row.errors_m)) for row in rows if row.consistency is not None]
    claims = sum(count for _, count in pairs)
    return sum(share * count for share, count in pairs) / claims if claims else None


def _per_km(count: int, rows: Iterable[Row]) -> float | None:
    driven_m = sum(row.driven_m for row in rows)
    return 1000.0 * count / driven_m if driven_m > 0.0 else None


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _rounded(value: Any) -> Any:
    """Five significant digits are enough; what is not finite is None."""
    if isinstance(value, Mapping):
        return {name: _rounded(one) for name, one in value.items()}
    if isinstance(value, float | np.floating):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    return value


def as_json(rows: Mapping[str, Sequence[Row]], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Everything: how it was run, a summary of each scenario, and each trial."""
    return {
        "settings": dict(settings),
        "scenarios": {name: summary(found) for name, found in rows.items()},
        "trials": [row_as_json(row) for found in rows.values() for row in found],
    }


def read_summaries(path: Path) -> dict[str, Summary]:
    """The summaries in the JSON of another run. Raises ConfigError, in one line."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        scenarios = content["scenarios"]
        return {str(name): dict(figures) for name, figures in scenarios.items()}
    except OSError as error:
        raise ConfigError(f"--baseline: {path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        reason = "must be the JSON of a run of this benchmark"
        raise ConfigError(f"--baseline: {path}: {reason} ({error})") from error


def table(summaries: Mapping[str, Summary]) -> Table:
    """One line a scenario."""
    heads = (
        "scenario", "success", "reached", "contacts", "SPL", "time s", "clear m", "jerk", "rec",
        "loc p95 m", "deg", "consistent", "alarms", "more",
    )  # fmt: skip
    made = Table(*heads, box=box.SIMPLE_HEAD)
    for name, found in summaries.items():
        if not found.get("trials"):
            made.add_row(name, *[""] * 12, str(found.get("skipped", "")), style="dim")
            continue
        count = found["trials"]
        made.add_row(
            name,
            f"{found['successes']}/{count}",
            f"{found['reached']}/{count}",
            f"{found['contacts_robot']}" + (f" +{n}" if (n := found["contacts_other"]) else ""),
            _shown(found["spl"], 3),
            _shown(found["time_s_median"], 1),
            _shown(found["min_clearance_m"], 3),
            _shown(found["jerk_m_s3"], 2),
            str(found["recoveries"]),
            _shown(found["localisation_p95_m"], 3),
            _shown(found["localisation_p95_deg"], 2),
            _shown(found["consistency"], 2),
            str(found["alarms"]),
            _more(found),
        )
    return made


def _more(found: Summary) -> str:
    """The medians of what only this scenario measures."""
    count = found["trials"]
    parts = []
    for name, value in found.items():
        if name.endswith("_median") and name != "time_s_median" and value is not None:
            what = name.removesuffix("_median")
            of = found[f"{what}_count"]
            parts.append(f"{what} {value:.3g}" + (f" in {of}/{count}" if of < count else ""))
    return ", ".join(parts)


def ratio_table(summaries: Mapping[str, Summary], baseline: Mapping[str, Summary]) -> Table:
    """This run beside another: shares of successes, and ratios of figures where both have them."""
    names = ("spl", *LOWER_IS_BETTER)
    made = Table("scenario", "success", *names, box=box.SIMPLE_HEAD, title="now / baseline")
    for name, found in summaries.items():
        old = baseline.get(name)
        if old is None or not old.get("trials") or not found.get("trials"):
            continue
        shares = (f"{one['successes']}/{one['trials']}" for one in (old, found))
        cells = [_ratio(found.get(key), old.get(key)) for key in names]
        made.add_row(name, " -> ".join(shares), *cells)
    return made


def _ratio(now: Any, before: Any) -> str:
    if not isinstance(now, int | float) or not isinstance(before, int | float):
        return ""
    if before == 0:
        return "=" if now == 0 else f"{before:g} -> {now:g}"
    return f"{now / before:.2f}"


def _shown(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
