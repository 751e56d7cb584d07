"""`make bench-slam`: explorations of worlds that the robot has no map of, judged by the truth.

python -m mazebot.bench.slam.slam_bench [--world NAME] [--seeds N] [--policy tour,nearest]
    [--slip S] [--noise S] [--camera] [--keep FOLDER] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import logging
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import yaml
from rich import box
from rich.console import Console
from rich.table import Table

from mazebot.bench.slam.exploration import WORLDS, offline_tour_m, place_of
from mazebot.bench.slam.open_worlds import GENERATED, WITHOUT_EDGE, written
from mazebot.common.config import ConfigError
from mazebot.common.messages.documents import MapEvaluation
from mazebot.common.messages.topics import SCAN
from mazebot.common.node.executive import Executive, MemoryTransport, StalledError
from mazebot.common.node.node import Inbox, Node, Outbox
from mazebot.embedded.demo import DemoOptions, build_nodes
from mazebot.explorer.params import ExplorerParams
from mazebot.mapping.node import MappingNode

LEAST_COVERAGE, LEAST_WALLS_FOUND = 0.99, 0.97
MOST_PATH_ERROR_M, MOST_WITH_ODOMETRY_ERRORS_M = 0.05, 0.10
"""Of the 95th percentile; the second where slip or noise is added to the wheels."""
MOST_S = 1800.0
"""Simulation time after which an exploration counts as failed."""


@dataclass(frozen=True)
class SlamRun:
    """How one exploration went; what was not measured is None."""

    world: str
    seed: int
    policy: str
    exploration: str
    """The explorer's last state."""
    reason: str
    coverage: float | None
    walls_found: float | None
    walls_true: float | None
    free_wrong: float | None
    path_error_p95_m: float | None
    path_error_max_m: float | None
    contacts: int
    driven_m: float | None
    tour_m: float | None
    """Of the offline tour, which knows the map; None: not planned."""
    keyframes: int
    loops: int
    loops_rejected: int
    false_loops: int
    markers_found: int
    markers_missing: int
    markers_false: int
    marker_error_p95_m: float | None
    scan_median_ms: float
    """Processor time of mapping's step with a scan."""
    scan_p99_ms: float
    scan_max_ms: float
    sim_time_s: float
    wall_time_s: float
    state_hash: str
    most_path_error_m: float

    @property
    def ratio(self) -> float | None:
        """Driven length over that of the offline tour."""
        if self.driven_m is None or self.tour_m is None:
            return None
        return self.driven_m / self.tour_m

    def failures(self) -> list[str]:
        """What is not as it must be, in words."""
        found = [] if self.exploration == "complete" else [self.exploration or "not explored"]
        least = (
            ("coverage", self.coverage, LEAST_COVERAGE),
            ("walls found", self.walls_found, LEAST_WALLS_FOUND),
        )
        for name, value, limit in least:
            if name == "coverage" and self.world in WITHOUT_EDGE:
                continue
            if value is None or value < limit:
                found.append(f"{name} {_number(value, 3)}")
        error_m = self.path_error_p95_m
        if error_m is None or error_m > self.most_path_error_m:
            found.append(f"path error p95 {_number(error_m, 3)} m")
        if self.contacts:
            found.append(f"{self.contacts} contacts")
        if self.false_loops:
            found.append(f"{self.false_loops} false loops")
        return found


def main() -> int:
    """Explore and print; return 0 if every run is as it must be."""
    logging.disable(logging.WARNING)
    options = _options()
    console = Console()
    if not console.is_terminal:
        console.width = 160
    runs: list[SlamRun] = []
    for world in options.world or [*WORLDS, *GENERATED]:
        for seed in range(options.seed, options.seed + options.seeds):
            for policy in options.policy.split(","):
                doing = f"{world} {seed} {policy}: exploring"
                if not console.is_terminal:
                    console.print(doing, style="dim", highlight=False)
                with console.status(doing):
                    one = explore(world, seed, policy, options)
                runs.append(one)
                verdict = "; ".join(one.failures()) or "ok"
                console.print(f"{world} {seed} {policy}: {verdict}", style="dim", highlight=False)
                if options.json is not None:
                    rows = [asdict(run) | {"failures": run.failures()} for run in runs]
                    options.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    console.print(table_of(runs))
    for line in savings(runs):
        console.print(line, highlight=False)
    return 0 if all(not run.failures() for run in runs if run.policy == "tour") else 1


def explore(world: str, seed: int, policy: str, options: argparse.Namespace) -> SlamRun:
    """Explore one of WORLDS or GENERATED in one process, in lockstep."""
    has_errors = bool(options.slip or options.noise)
    physics = {"wheel_slip": options.slip, "wheel_noise_m_per_sqrt_m": options.noise}
    settings: dict[str, Any] = {"explorer": {"choice": policy}}
    if has_errors:
        settings["physics"] = {key: value for key, value in physics.items() if value}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        name, overrides = WORLDS.get(world) or (str(written(world, seed, folder)), ())
        settings_file = folder / "settings.yaml"
        settings_file.write_text(yaml.safe_dump(settings), encoding="utf-8")
        out_dir = folder / "run"
        if options.keep is not None:
            out_dir = options.keep / f"{world}_{seed}_{policy}"
        nodes = build_nodes(
            DemoOptions(
                world_name=name, seed=seed, out_dir=out_dir, record=options.record,
                camera=options.camera, overrides=tuple(one.format(seed=seed) for one in overrides),
                slam=True, settings=settings_file,
            )
        )  # fmt: skip
        for node in nodes:
            node.prepare()
        taken_ms = _timed(nodes)
        executive = Executive(nodes, MemoryTransport())
        begun = time.perf_counter()
        try:
            executive.run(lambda: executive.now_ns > MOST_S * 1e9)
        except StalledError as error:
            raise ConfigError(str(error)) from error
        finally:
            executive.close()
        wall_s = time.perf_counter() - begun
        summary = json.loads((out_dir / "summary.json").read_text(encoding="utf-8"))
    tour_m = None
    if world in WORLDS:
        tour_m = offline_tour_m(place_of(world, seed), ExplorerParams())
    return _run_of(world, seed, policy, summary, tour_m, taken_ms, wall_s, has_errors)


def _run_of(
    world: str,
    seed: int,
    policy: str,
    summary: dict[str, Any],
    tour_m: float | None,
    taken_ms: list[float],
    wall_s: float,
    has_errors: bool,
) -> SlamRun:
    mapping = MapEvaluation.model_validate(summary["mapping"])
    scans = sorted(taken_ms) or [0.0]
    return SlamRun(
        world=world,
        seed=seed,
        policy=policy,
        exploration=mapping.exploration,
        reason=mapping.exploration_reason,
        coverage=mapping.coverage_share,
        walls_found=mapping.walls_found_share,
        walls_true=mapping.walls_true_share,
        free_wrong=mapping.free_wrong_share,
        path_error_p95_m=mapping.trajectory_error_m.p95,
        path_error_max_m=mapping.trajectory_error_m.max,
        contacts=summary["contacts"]["count"],
        driven_m=mapping.driven_m,
        tour_m=tour_m,
        keyframes=mapping.keyframes,
        loops=mapping.loops,
        loops_rejected=mapping.loops_rejected,
        false_loops=mapping.false_loops,
        markers_found=mapping.markers.found,
        markers_missing=mapping.markers.missing,
        markers_false=mapping.markers.false,
        marker_error_p95_m=mapping.markers.error_m.p95,
        scan_median_ms=statistics.median(scans),
        scan_p99_ms=scans[min(len(scans) - 1, int(0.99 * len(scans)))],
        scan_max_ms=scans[-1],
        sim_time_s=summary["sim_time_s"] or 0.0,
        wall_time_s=wall_s,
        state_hash=summary["state_hash"] or "",
        most_path_error_m=MOST_WITH_ODOMETRY_ERRORS_M if has_errors else MOST_PATH_ERROR_M,
    )


def _timed(nodes: Iterable[Node]) -> list[float]:
    """The processor times (ms) of mapping's steps with a scan, filled in as they happen."""
    taken_ms: list[float] = []
    (mapping,) = (node for node in nodes if isinstance(node, MappingNode))
    step = mapping.step

    def timed(now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        has_scan = inbox.pending(SCAN)
        begun = time.thread_time()
        step(now_ns, inbox, outbox)
        if has_scan:
            taken_ms.append((time.thread_time() - begun) * 1e3)

    cast("Any", mapping).step = timed
    return taken_ms


def table_of(runs: Iterable[SlamRun]) -> Table:
    """A row for each world and policy: how many runs are as they must be, and the worst figures."""
    table = Table(
        "world", "policy", "well", "mapped", "walls found", "walls true", "free wrong",
        "path p95 m", "contacts", "driven m", "/ tour", "loops", "false", "keyframes",
        "scan ms", "max", box=box.SIMPLE_HEAD,
        title="worst of all seeds; medians of driven, / tour, loops, keyframes and scan ms",
    )  # fmt: skip
    groups: dict[tuple[str, str], list[SlamRun]] = {}
    for run in runs:
        groups.setdefault((run.world, run.policy), []).append(run)
    for (world, policy), group in groups.items():
        table.add_row(world, policy, *_row(group))
    return table


def _row(group: list[SlamRun]) -> list[str]:
    def least(value: Callable[[SlamRun], float | None]) -> str:
        return _number(min((value(run) or 0.0 for run in group), default=None), 4)

    def most(value: Callable[[SlamRun], float | None], digits: int) -> str:
        measured = [one for one in map(value, group) if one is not None]
        return _number(max(measured, default=None), digits)

    def median(value: Callable[[SlamRun], float | None], digits: int) -> str:
        measured = [one for one in map(value, group) if one is not None]
        return _number(statistics.median(measured) if measured else None, digits)

    return [
        f"{sum(not run.failures() for run in group)} of {len(group)}",
        least(lambda run: run.coverage),
        least(lambda run: run.walls_found),
        least(lambda run: run.walls_true),
        most(lambda run: run.free_wrong, 4),
        most(lambda run: run.path_error_p95_m, 3),
        str(sum(run.contacts for run in group)),
        median(lambda run: run.driven_m, 1),
        median(lambda run: run.ratio, 2),
        median(lambda run: run.loops, 0),
        str(sum(run.false_loops for run in group)),
        median(lambda run: run.keyframes, 0),
        median(lambda run: run.scan_median_ms, 1),
        most(lambda run: run.scan_max_ms, 0),
    ]


def savings(runs: Iterable[SlamRun]) -> list[str]:
    """By how much the tour drives less than the nearest frontier, a line for each world."""
    driven = {(run.world, run.seed, run.policy): run.driven_m for run in runs}
    shares: dict[str, list[float]] = {}
    for (world, seed, policy), driven_m in driven.items():
        nearest_m = driven.get((world, seed, "nearest"))
        if policy == "tour" and driven_m is not None and nearest_m:
            shares.setdefault(world, []).append(1.0 - driven_m / nearest_m)
    return [
        f"{world}: the tour is {statistics.mean(saved):.0%} shorter than by nearest frontier "
        f"({len(saved)} seeds, {min(saved):.0%} to {max(saved):.0%})"
        for world, saved in shares.items()
    ]


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Explores worlds without a map.")
    parser.add_argument(
        "--world", action="append", choices=[*WORLDS, *GENERATED], help="default: all"
    )
    parser.add_argument("--seed", type=int, default=1, help="the first one")
    parser.add_argument("--seeds", type=int, default=5, help="how many")
    parser.add_argument("--policy", default="tour,nearest", help="explorer's `choice`, by commas")
    parser.add_argument("--slip", type=float, default=0.0, help="physics' wheel_slip")
    parser.add_argument("--noise", type=float, default=0.0, help="wheel_noise_m_per_sqrt_m")
    parser.add_argument("--camera", action="store_true", help="with images and markers")
    parser.add_argument("--record", action="store_true", help="with run.rrd; see --keep")
    parser.add_argument("--keep", type=Path, help="folder for the runs")
    parser.add_argument("--json", type=Path, help="file of the figures")
    options = parser.parse_args()
    for policy in options.policy.split(","):
        ExplorerParams(choice=policy)
    return options


if __name__ == "__main__":
    sys.exit(main())
