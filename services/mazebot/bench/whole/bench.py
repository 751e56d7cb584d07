"""`make bench`: speed and memory, measured on this machine, in comparison with other simulators."""

from __future__ import annotations

import argparse
import json
import logging
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from mazebot.bench.bench_figures import Figure, as_json, figure, missing, tables
from mazebot.bench.parts import bench_parts
from mazebot.bench.whole import bench_loop, bench_peers
from mazebot.common.files.root import ROOT

_WIRE_DEADLINE_S = 120.0


def main(arguments: list[str] | None = None) -> None:
    """Measure, print tables, write JSON."""
    parser = argparse.ArgumentParser(prog="bench", description=__doc__)
    parser.add_argument("--json", type=Path, default=Path("bench.json"), help="output file")
    parser.add_argument("--quick", action="store_true", help="few repeats, as a smoke test")
    options = parser.parse_args(arguments)
    logging.disable(logging.INFO)
    console = Console()
    if not console.is_terminal:
        console.width = 140
    sections = _sections(quick=options.quick)
    figures: list[Figure] = []
    start_s = time.perf_counter()
    for number, (name, measure) in enumerate(sections.items(), 1):
        console.print(f"{number}/{len(sections)} {name}", style="dim")
        figures += measure()
    for table in tables(figures):
        console.print(table)
    settings = {"quick": options.quick, "took_s": round(time.perf_counter() - start_s, 1)}
    report = as_json(figures, settings)
    options.json.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    about = report["machine"]
    console.print(f"{about['processor']}, {about['cores']} cores, {about['system']}")
    console.print(f"figures: {options.json}", soft_wrap=True)


def _sections(quick: bool) -> dict[str, Callable[[], list[Figure]]]:
    """The measurements, in order. Fast operations are repeated many times."""
    few, many = (1, 3) if quick else (5, 200)
    episode_s, episodes = (1.0, 1) if quick else (30.0, 3)
    loaded = bench_parts.worlds()
    enhanced = loaded["enhanced"]
    sections: dict[str, Callable[[], list[Figure]]] = {
        "physics and lidar": lambda: bench_parts.simulation(loaded, many),
        "against plain PyBullet and ir-sim": lambda: [
            bench_parts.sensors_and_steps(enhanced, few, few),
            *bench_peers.plain_pybullet(enhanced.world, few, few, 2 * few),
            *bench_peers.ir_sim(enhanced.world, few, few),
        ],
        "camera": lambda: bench_parts.cameras(loaded, many),
        "wire": lambda: wire(many),
        "whole loop": lambda: bench_loop.loops(enhanced.world, episode_s, episodes),
    }
    if not quick:
        sections["whole tour"] = bench_loop.whole_tour
        sections["start"] = lambda: bench_loop.starts(few)
        sections["worlds"] = lambda: bench_parts.generation(few)
    return sections


def wire(repeats: int) -> list[Figure]:
    """Encoding, decoding, and a round trip through a router in its own process."""
    done = subprocess.run(
        [sys.executable, "-m", "mazebot.bench.parts.wire_speed", str(repeats)],
        capture_output=True, text=True, check=False, timeout=_WIRE_DEADLINE_S, cwd=ROOT,
    )  # fmt: skip
    if done.returncode:
        why = (done.stderr.strip().splitlines() or ["no result"])[-1]
        return [missing("wire", "there and back through a router", "ms", why)]
    measured = json.loads(done.stdout.splitlines()[-1])
    return [
        figure("wire", f"{name}: {way}", "ms", taken_ms)
        for name, ways in measured.items()
        for way, taken_ms in ways.items()
    ]


if __name__ == "__main__":
    main()
