"""The whole loop in its own process: real time factor, duration of each part, and memory.
`python -m mazebot.bench.whole.bench_loop JSON` prints one episode.
"""

from __future__ import annotations

import functools
import importlib.util
import json
import logging
import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from mazebot.bench.bench_figures import Figure, figure, timed_ms
from mazebot.bench.memory import peak_mb
from mazebot.bench.whole.bench_peers import PlainPyBullet
from mazebot.common.files.root import ROOT
from mazebot.common.garbage import collections_held_off, settled
from mazebot.common.messages.documents import World
from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.embedded.demo import FIRST_STEP, DemoOptions, build_nodes
from mazebot.navigation.control.mppi.mppi import MPPIController as Controller
from mazebot.navigation.planning.planner import Planner
from mazebot.perception.detect import Detector

Measured = dict[str, Any]

WITHOUT_CAMERA = {"camera": False, "record": False, "renderer": "none"}
LOOPS: dict[str, dict[str, Any]] = {
    "no camera": WITHOUT_CAMERA,
    "camera 640x480 RGB-D at 10 Hz": {"record": False},
    "camera and recording": {},
}
_LOOPS_GROUP = "whole loop, one process"
_PLAIN_S, _PLAIN_RUNS = 2.0, 5
WARM_UP_S = 1.0
"""Simulation time in which the world is loaded and missing kernels are compiled."""
_DEADLINE_S = 600.0
_DRIVES = "Begin navigating"
"""Log message of navigation when it is localised and starts towards the first goal."""


def loops(world: World, episode_s: float, repeats: int) -> list[Figure]:
    """Figures of the start of the enhanced tour, for each way of running it; also as ratios to
    plain PyBullet in its maze just before and after: a machine's speed changes within minutes.
    """
    figures = []
    with closing(PlainPyBullet(world)) as plain:
        drive = functools.partial(plain.drive, _PLAIN_S)
        for name, options in LOOPS.items():
            episodes, ratios = [], []
            before_ms = timed_ms(drive, _PLAIN_RUNS)
            for _ in range(repeats):
                episodes.append(episode_in_own_process(options, episode_s))
                after_ms = timed_ms(drive, _PLAIN_RUNS)
                plain_factor = _PLAIN_S * 1e3 / statistics.median(before_ms + after_ms)
                ratios.append(episodes[-1]["real_time_factor"] / plain_factor)
                before_ms = after_ms
            factors = [episode["real_time_factor"] for episode in episodes]
            hashes = {episode["state_hash"] for episode in episodes}
            note = f"state {', '.join(sorted(hashes))}"
            figures.append(figure(_LOOPS_GROUP, name, "x real time", factors, note))
            beside = f"{name}, ratio to plain PyBullet"
            figures.append(figure(_LOOPS_GROUP, beside, "", ratios))
            peaks = [episode["peak_mb"] for episode in episodes]
            figures.append(figure("memory of the whole process", name, "MB", peaks))
            if name == list(LOOPS)[-1]:
                figures += _parts(episodes[-1], episode_s)
    return sorted(figures, key=lambda one: one.group != _LOOPS_GROUP)


def whole_tour() -> list[Figure]:
    """The enhanced tour from start to end, with camera and recording."""
    measured = episode_in_own_process({}, None)
    name = "the whole tour, camera and recording"
    factor, note = measured["real_time_factor"], f"state {measured['state_hash']}"
    return [
        figure(_LOOPS_GROUP, name, "x real time", [factor], note),
        figure("memory of the whole process", name, "MB", [measured["peak_mb"]]),
    ]


def starts(repeats: int) -> list[Figure]:
    """Times from the start of the `mazebot demo` process in the enhanced world, with recording, to
    the first step of physics, and until the robot is localised and drives.
    """
    group = "start of mazebot demo"
    figures = []
    ways = {"to the first simulated step": FIRST_STEP, "until it is localised and drives": _DRIVES}
    warm = [_start_s({}, list(ways.values())) for _ in range(repeats)]
    with tempfile.TemporaryDirectory() as folder:
        cold = _start_s({"NUMBA_CACHE_DIR": folder}, list(ways.values()))
    for number, name in enumerate(ways):
        figures.append(figure(group, name, "s", [one[number] for one in warm], _bytecode_note()))
        figures.append(figure(group, f"{name}, kernels to be compiled", "s", [cold[number]]))
    return figures


def _bytecode_note() -> str:
    """A note if the packages lack the bytecode from `make env`: then a start takes far longer."""
    spec = importlib.util.find_spec("rerun")
    compiled = spec is not None and spec.cached is not None and Path(spec.cached).is_file()
    return "" if compiled else "packages not compiled to bytecode: make env"


def _parts(episode: Measured, episode_s: float) -> list[Figure]:
    """Durations of the services and of their expensive parts."""
    figures = []
    for name, taken_ms in episode["services_ms"].items():
        per_second = sum(taken_ms) / episode_s
        note = f"{per_second:.1f} ms a simulated second"
        figures.append(
            figure("service, camera and recording on", name, "ms a step", taken_ms, note)
        )
    for name, taken_ms in episode["parts_ms"].items():
        figures.append(figure("navigation and perception", name, "ms", taken_ms))
    return figures


def episode(options: dict[str, Any], episode_s: float | None) -> Measured:
    """Drive `episode_s` seconds of the enhanced tour after a warm-up, or with None all of it, and
    measure.
    """
    services_ms: dict[str, list[float]] = defaultdict(list)
    parts_ms: dict[str, list[float]] = defaultdict(list)
    _time_method(Planner, "plan", parts_ms["planner, one plan"])
    _time_method(Controller, "step", parts_ms["controller, one step"])
    _time_method(Detector, "detect", parts_ms["marker detector, one picture 640x480"])
    # Garbage collection as in mazebot demo: none up to the first step, then without older objects.
    with tempfile.TemporaryDirectory() as folder, collections_held_off():
        out_dir = Path(folder) / "run"
        nodes = build_nodes(DemoOptions(out_dir=out_dir, **options))
        for node in nodes:
            node.prepare()
            _time_method(node, "step", services_ms[node.name])
        executive = Executive(nodes, MemoryTransport())
        try:
            executive.run(lambda: executive.now_ns > 0)
            settled()
            executive.run(lambda: executive.now_ns >= WARM_UP_S * 1e9)
            for taken_ms in (*services_ms.values(), *parts_ms.values()):
                taken_ms.clear()
            start_s, start_ns = time.perf_counter(), executive.now_ns
            end_ns = math.inf if episode_s is None else start_ns + episode_s * 1e9
            executive.run(lambda: executive.now_ns >= end_ns)
            taken_s = time.perf_counter() - start_s
            driven_s = (executive.now_ns - start_ns) * 1e-9
        finally:
            executive.close()
        summary = json.loads((out_dir / "summary.json").read_text(encoding="utf-8"))
    return {
        "real_time_factor": driven_s / taken_s,
        "peak_mb": peak_mb(),
        "state_hash": summary["state_hash"],
        "services_ms": {name: taken for name, taken in services_ms.items() if taken},
        "parts_ms": parts_ms,
    }


def _time_method(owner: Any, name: str, taken_ms: list[float]) -> None:
    """Make a method of an object, or of all objects of a class, record each call's duration."""
    method: Callable[..., Any] = getattr(owner, name)

    @functools.wraps(method)
    def timed(*args: Any, **kwargs: Any) -> Any:
        start_s = time.perf_counter()
        try:
            return method(*args, **kwargs)
        finally:
            taken_ms.append((time.perf_counter() - start_s) * 1e3)

    setattr(owner, name, timed)


def episode_in_own_process(options: dict[str, Any], episode_s: float | None) -> Measured:
    """An episode in a fresh process, so that memory is measured separately."""
    request = json.dumps({"options": options, "episode_s": episode_s})
    done = subprocess.run(
        [sys.executable, "-m", "mazebot.bench.whole.bench_loop", request],
        capture_output=True, text=True, check=True, timeout=_DEADLINE_S, cwd=ROOT,
    )  # fmt: skip
    measured: Measured = json.loads(done.stdout.splitlines()[-1])
    return measured


def _start_s(environment: dict[str, str], signs: list[str]) -> list[float]:
    """Seconds from the start of the command's process until it prints each sign, in order."""
    with tempfile.TemporaryDirectory() as folder:
        start_s = time.perf_counter()
        command = [sys.executable, "-m", "mazebot.cli", "demo", "--out", f"{folder}/run"]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT,
            env={**os.environ, **environment},
        )  # fmt: skip
        taken_s: list[float] = []
        for line in process.stdout or ():
            if signs[len(taken_s)] in line:
                taken_s.append(time.perf_counter() - start_s)
            if len(taken_s) == len(signs):
                break
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=_DEADLINE_S)
    if len(taken_s) < len(signs):
        raise RuntimeError(f"mazebot demo did not start: {output.strip().splitlines()[-1:]}")
    return taken_s


def main() -> None:
    """Print one episode as JSON."""
    logging.disable(logging.INFO)
    request = json.loads(sys.argv[1])
    print(json.dumps(episode(request["options"], request["episode_s"])))  # noqa: T201


if __name__ == "__main__":
    main()
