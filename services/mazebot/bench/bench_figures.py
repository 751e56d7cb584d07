"""Measured figures, each with its spread, as a text table and as JSON."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

_PACKAGES = ("eclipse-zenoh", "moderngl", "numba", "numpy", "opencv-contrib-python-headless",
             "pybullet", "rerun-sdk")  # fmt: skip


@dataclass(frozen=True)
class Figure:
    """One figure. If it could not be measured, `count` is 0 and `note` has the reason."""

    group: str
    name: str
    unit: str
    median: float
    p10: float
    p90: float
    least: float
    most: float
    count: int
    note: str = ""


def figure(group: str, name: str, unit: str, values: Sequence[float], note: str = "") -> Figure:
    """The figure of repeated measurements."""
    if not len(values):
        return missing(group, name, unit, note or "no measurements")
    p10, median, p90 = (float(value) for value in np.percentile(values, (10, 50, 90)))
    least, most = float(min(values)), float(max(values))
    return Figure(group, name, unit, median, p10, p90, least, most, len(values), note)


def missing(group: str, name: str, unit: str, why: str) -> Figure:
    """A figure that could not be measured."""
    return Figure(group, name, unit, 0.0, 0.0, 0.0, 0.0, 0.0, 0, why)


def timed_ms(work: Callable[[], object], repeats: int, warm: int = 1) -> list[float]:
    """Duration of each of `repeats` runs, after `warm` runs that load and compile."""
    for _ in range(warm):
        work()
    taken_ms = []
    for _ in range(repeats):
        start_s = time.perf_counter()
        work()
        taken_ms.append((time.perf_counter() - start_s) * 1e3)
    return taken_ms


def machine() -> dict[str, Any]:
    """Test conditions: processor, memory, system and software versions."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "cores_allowed": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None,
        "memory_mb": _memory_mb(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "load_average": list(os.getloadavg()),
        "packages": {name: version(name) for name in _PACKAGES},
    }


def tables(figures: Iterable[Figure]) -> list[Table]:
    """One table per group, in order of appearance."""
    made: dict[str, Table] = {}
    for one in figures:
        if one.group not in made:
            made[one.group] = Table(box=box.SIMPLE_HEAD)
            made[one.group].add_column(one.group)
            for column in ("median", "p10", "p90", "min", "max", "n", ""):
                made[one.group].add_column(column, justify="right")
            made[one.group].add_column("")
        if one.count == 0:
            made[one.group].add_row(one.name, *("-",) * 5, "0", one.unit, one.note)
            continue
        values = (one.median, one.p10, one.p90, one.least, one.most)
        made[one.group].add_row(
            one.name, *(_shown(value) for value in values), str(one.count), one.unit, one.note
        )
    return list(made.values())


def as_json(figures: Iterable[Figure], settings: dict[str, Any]) -> dict[str, Any]:
    """All figures and settings as JSON values."""
    return {
        "machine": machine(),
        "settings": settings,
        "figures": [asdict(one) for one in figures],
    }


def _shown(value: float) -> str:
    """Three significant digits."""
    if abs(value) >= 100.0:
        return f"{value:.0f}"
    return (
        f"{value:.1f}"
        if abs(value) >= 10.0
        else f"{value:.2f}"
        if abs(value) >= 1.0
        else (f"{value:.3f}")
    )


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _memory_mb() -> int | None:
    meminfo = Path("/proc/meminfo")
    if not meminfo.is_file():
        return None
    return int(meminfo.read_text(encoding="utf-8").split()[1]) // 1024
