"""Detection of markers, and times of single computations within a drive."""

from __future__ import annotations

import functools
import importlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from mazebot.bench.bench_figures import Figure, figure, missing, tables
from mazebot.bench.navigation.scenario import Options, RunSeed

_GROUP = "times within a drive, one thread"
PERCEPTION_PICTURES = 200
"""Pictures without markers; a full run has"""
PERCEPTION_PICTURES_FULL = 10_000


class Probe(NamedTuple):
    """A function or method whose calls are timed while a scenario is driven."""

    name: str
    module: str
    path: str
    """`Class.method`, or the name of a function"""
    goal: str


PROBES = (
    Probe("planner", "mazebot.navigation.planning.planner", "Planner.plan", ""),
    Probe("controller: MPPI", "mazebot.navigation.control.mppi.mppi", "MPPIController.step",
          "median 3 ms, p99 5 ms"),
    Probe("controller: regulated pure pursuit",
          "mazebot.navigation.control.regulated_pure_pursuit",
          "RegulatedPurePursuitController.step", ""),
    Probe("collision monitor", "mazebot.navigation.control.safety.collision_monitor",
          "CollisionMonitor.step", "0.2 ms"),
    Probe("localisation, one scan", "mazebot.localization.monte_carlo", "Localization.scan", ""),
    Probe("search of the whole map", "mazebot.localization.global_search.global_search",
          "global_search", "60 ms"),
)  # fmt: skip


def times(drives: Sequence[tuple[RunSeed, str]], options: Options) -> list[Figure]:
    """How long each probe's calls took while these scenarios were driven, one seed of each. A call
    of a controller steps five tracked posts, where there are so many.
    """
    taken_ms: dict[str, list[float]] = {probe.name: [] for probe in PROBES}
    with ExitStack() as stack:
        absent = {probe.name for probe in PROBES
                  if not stack.enter_context(_timed(probe, taken_ms[probe.name]))}  # fmt: skip
        for run, name in drives:
            run(name, 0, options)
    return [_figure(probe, taken_ms[probe.name], probe.name in absent) for probe in PROBES]


def _figure(probe: Probe, taken_ms: list[float], absent: bool) -> Figure:
    if absent:
        return missing(_GROUP, probe.name, "ms", "not implemented")
    if not taken_ms:
        return missing(_GROUP, probe.name, "ms", "not called in these drives")
    note = f"p99 {np.percentile(taken_ms, 99.0):.3g}"
    return figure(_GROUP, probe.name, "ms", taken_ms, note + (f"; {probe.goal}" * bool(probe.goal)))


@contextmanager
def _timed(probe: Probe, taken_ms: list[float]) -> Iterator[bool]:
    """Time the calls of a probe within the context; False where there is no such thing."""
    *owners, attribute = probe.path.split(".")
    try:
        owner: Any = importlib.import_module(probe.module)
        for one in owners:
            owner = getattr(owner, one)
        work = getattr(owner, attribute)
    except (ImportError, AttributeError):
        yield False
        return
    timer = _timer(work, taken_ms)
    places = [owner] if owners else _holders(attribute, work)
    for place in places:
        setattr(place, attribute, timer)
    try:
        yield True
    finally:
        for place in places:
            setattr(place, attribute, work)


def _timer(work: Callable[..., Any], taken_ms: list[float]) -> Callable[..., Any]:
    @functools.wraps(work)
    def timer(*args: Any, **named: Any) -> Any:
        start_s = time.perf_counter()
        try:
            return work(*args, **named)
        finally:
            taken_ms.append((time.perf_counter() - start_s) * 1e3)

    return timer


def _holders(attribute: str, work: object) -> list[Any]:
    """The modules that have a function under its name: those that imported it."""
    modules = [one for name, one in sys.modules.items() if name.startswith("mazebot.")]
    return [one for one in modules if getattr(one, attribute, None) is work]


def perception(pictures: int, seed: int) -> tuple[dict[str, Any], list[Table]]:
    """Recall, pose errors and wrong ids of marker detection, as figures and as tables. Without the
    measurement, an empty dictionary and a table that says so.
    """
    try:
        bench = importlib.import_module("mazebot.bench.parts.perception_bench")
    except ImportError:
        return {}, tables([missing("perception", "detection of markers", "", "not implemented")])
    figures = bench.perception_figures(pictures, seed)
    return figures, list(bench.perception_tables(figures))
