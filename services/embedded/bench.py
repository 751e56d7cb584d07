"""`make bench`: what the README says of speed, measured on this machine."""

from __future__ import annotations

import functools
import logging
import platform
import resource
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from services.common.executive import Executive, MemoryTransport
from services.common.frames import LINK_FROM_OPTICAL, SE2
from services.common.node import Inbox, Node, Outbox
from services.embedded.demo import DemoOptions, build_nodes
from services.physics.camera import Intrinsics, RendererKind, make_renderer
from services.physics.scene import build_scene
from services.worldgen.loader import load_world
from services.worldgen.sdf.convert import to_recipe
from services.worldgen.sdf.read import read_sdf

EPISODE_S = 30.0
"""Simulation time of one episode: the start of the enhanced tour."""
REPEATS = 3
FRAMES = 100


def main() -> None:
    """Measure and print."""
    logging.disable(logging.INFO)
    console = Console()
    if not console.is_terminal:
        console.width = 120
    loops = Table("whole loop, one process", "real time factor", "min", "max", box=box.SIMPLE_HEAD)
    shares: dict[str, list[float]] = {}
    for name, options in (
        ("no camera, no recording", {"camera": False, "record": False, "renderer": "none"}),
        ("camera 640x480 at 10 Hz, no recording", {"record": False}),
        ("camera 640x480 at 10 Hz, recording", {}),
    ):
        factors = []
        for _ in range(REPEATS):
            factor, shares = _episode(options)
            factors.append(factor)
            console.print(f"{name}: {factor:.1f}x", style="dim")
        figures = (statistics.median(factors), min(factors), max(factors))
        loops.add_row(name, *(f"{figure:.1f}" for figure in figures))
    parts = Table(
        "service, camera and recording on", "median ms a step", "p99 ms", "ms a simulated second",
        box=box.SIMPLE_HEAD,
    )  # fmt: skip
    for name, steps_s in shares.items():
        if not steps_s:
            continue
        milliseconds = np.array(steps_s) * 1e3
        parts.add_row(
            name,
            f"{np.median(milliseconds):.3f}",
            f"{np.percentile(milliseconds, 99):.2f}",
            f"{milliseconds.sum() / EPISODE_S:.1f}",
        )
    cameras = Table("camera 640x480, enhanced world", "median ms", "p90 ms", box=box.SIMPLE_HEAD)
    cameras.add_row(*_camera("gl", FRAMES))
    cameras.add_row(*_camera("tiny", FRAMES // 10))
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    for table in (loops, parts, cameras, _worlds()):
        console.print(table)
    console.print(f"peak memory of this process: {memory_mb:.0f} MB")
    console.print(f"{platform.processor() or platform.machine()}, {platform.platform()}")


def _episode(options: dict[str, Any]) -> tuple[float, dict[str, list[float]]]:
    with tempfile.TemporaryDirectory() as folder:
        nodes = build_nodes(DemoOptions(out_dir=Path(folder) / "run", **options))
        times_s: dict[str, list[float]] = defaultdict(list)
        for node in nodes:
            _time_steps(node, times_s[node.name])
        executive = Executive(nodes, MemoryTransport())
        # The first steps load the world and compile what is not compiled.
        executive.run(lambda: executive.now_ns >= 1e9)
        for steps in times_s.values():
            steps.clear()
        start_s, start_ns = time.perf_counter(), executive.now_ns
        executive.run(lambda: executive.now_ns >= start_ns + EPISODE_S * 1e9)
        taken_s = time.perf_counter() - start_s
        executive.close()
    return EPISODE_S / taken_s, dict(times_s)


def _time_steps(node: Node, times_s: list[float]) -> None:
    step: Callable[[int, Inbox, Outbox], None] = node.step

    def timed(now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        start_s = time.perf_counter()
        step(now_ns, inbox, outbox)
        times_s.append(time.perf_counter() - start_s)

    node.step = timed  # type: ignore[method-assign]


def _camera(kind: RendererKind, frames: int) -> tuple[str, str, str]:
    loaded = load_world("enhanced")
    renderer = make_renderer(kind, Intrinsics.from_horizontal_fov(640, 480, 1.047))
    if renderer is None:
        raise ValueError(f"{kind}: not a renderer that draws")
    renderer.set_scene(build_scene(loaded.world, loaded.assets, ()))
    milliseconds = []
    for number in range(frames):
        turn_rad = 2.0 * np.pi * number / frames
        map_from_optical = SE2(0.0, 0.0, turn_rad).matrix(0.117) @ LINK_FROM_OPTICAL
        start_s = time.perf_counter()
        renderer.render(map_from_optical)
        milliseconds.append((time.perf_counter() - start_s) * 1e3)
    name = renderer.name
    renderer.close()
    return (
        name,
        f"{np.median(milliseconds):.1f}",
        f"{np.percentile(milliseconds, 90):.1f}",
    )


def _worlds() -> Table:
    """How long it takes to have a world."""
    table = Table("world", "median ms", "min", "max", box=box.SIMPLE_HEAD)
    size = ("maze.rows=50", "maze.columns=50")
    for kind in ("algorithm=wilson", "algorithm=recursive_backtracker", "algorithm=rooms",
                 "braiding=0.5"):  # fmt: skip
        overrides = (*size, f"maze.{kind}")
        milliseconds = _milliseconds(functools.partial(load_world, "maze", overrides=overrides))
        table.add_row(f"maze of 50 x 50 cells, {kind}, with its map", *milliseconds)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "wood.sdf"
        file.write_text(_wood(300), encoding="utf-8")
        milliseconds = _milliseconds(lambda: to_recipe(read_sdf(file), "wood"))
    table.add_row("SDF of 300 cylinders to a recipe", *milliseconds)
    return table


def _milliseconds(work: Callable[[], object]) -> tuple[str, str, str]:
    """Median, least and most of five goes, after one that compiles what is not compiled."""
    work()
    taken = []
    for _ in range(5):
        start_s = time.perf_counter()
        work()
        taken.append((time.perf_counter() - start_s) * 1e3)
    return f"{statistics.median(taken):.0f}", f"{min(taken):.0f}", f"{max(taken):.0f}"


def _wood(count: int) -> str:
    """SDF of static cylinders, one a model."""
    shape = "<geometry><cylinder><radius>0.075</radius><length>1</length></cylinder></geometry>"
    models = "".join(
        f"<model name='tree_{i}'><static>1</static><pose>{0.15 * (i % 30)} {0.15 * (i // 30)} 0 "
        f"0 0 0</pose><link name='link'><collision name='c'>{shape}</collision>"
        f"<visual name='v'>{shape}</visual></link></model>"
        for i in range(count)
    )
    return f"<sdf version='1.6'><world name='wood'>{models}</world></sdf>"


if __name__ == "__main__":
    main()
