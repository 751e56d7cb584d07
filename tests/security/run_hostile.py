"""Gives every hostile file to its reader, each in a child process, and prints what came of it.

    python -m tests.security.run_hostile [NAME...]

prints one line each: seconds, MB over the process' own, exit code, and the line that refuses it.
With --json it prints JSON objects. The children are forked from one process that has imported all
readers, so that time and memory are those of the file.
"""

from __future__ import annotations

import json
import os
import re
import resource
import select
import signal
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2

from mazebot.cli import app
from mazebot.common.config import ConfigError
from mazebot.mapping.graph.graph_file import load_graph
from mazebot.navigation.behavior.nodes.xml_loader import read_tree_file
from tests.security.hostile_files import (
    CAMERA,
    CASES,
    DIFF,
    INFO,
    PARAMS,
    PLAN,
    SDF,
    Hostile,
    all_of,
    cdr_scan,
    database,
    log_of,
    map_of,
    mcap_file,
    mesh,
    message,
    png,
    run,
    scan_channel,
    sdf,
    text,
)  # fmt: skip

DEADLINE_S = 20
ADDRESS_SPACE_BYTES = 2 << 30
"""More than the process has already: a last bound, so that no bomb ends the machine."""
_WARM = (
    (SDF, text("world.sdf", sdf("<visual name='v'><pose>x</pose></visual>"))),
    (SDF, mesh("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")),
    (SDF, mesh("m.dae", "<x/>")),
    (SDF, mesh("m.glb", "x")),
    (PLAN, map_of("m.pgm", text("m.pgm", b"P5 40 40 255\n" + b"\xff" * 1600))),
    (PARAMS, text("nav2.yaml", "amcl: {ros__parameters: {alpha1: 0.2}}")),
    (CAMERA, all_of(text("picture.png", png(64, 64, 64)), text("camera.yaml", "a: 1"))),
    (log_of("a.mcap"), text("a.mcap", mcap_file(scan_channel(), message(cdr_scan(9))))),
    (log_of("bag.db3"), database("CREATE TABLE x(y)")),
    (log_of("a.csv"), text("a.csv", "x")),
    (log_of("a.log"), text("a.log", "FLASER x")),
    (INFO, run(summary="{}", config="{}")),
    (DIFF, run(summary="{}", config="{}")),
    (("demo", "--config", "c.yaml"), text("c.yaml", "x: 1")),
    (("replay", "a.mcap"), text("a.mcap", "x")),
    (("tree", "t.xml"), text("t.xml", "<x/>")),
    (("waypoints", "./w.yaml"), text("w.yaml", "x: 1")),
)
"""Bad files, but harmless ones: what reading each kind imports."""


@dataclass(frozen=True)
class Outcome:
    """What came of a file."""

    name: str
    exit_code: int
    """Negative: the signal that ended the process."""
    seconds: float
    extra_mb: float
    """Highest resident memory, with that of its own children, over that before."""
    stdout: str
    stderr: str


def main() -> None:
    """Run all cases, or those that are named."""
    as_json = "--json" in sys.argv
    names = {word for word in sys.argv[1:] if not word.startswith("-")}
    sys.argv[1:] = []
    # Threads of OpenCV do not outlive a fork, and would be waited for.
    cv2.setNumThreads(0)
    for number, (command, write) in enumerate(_WARM):
        _warm(Hostile(f"warm-{number}", command, write, ()))
    for case in CASES:
        if not names or case.name in names:
            outcome = run_case(case)
            sys.stdout.write(f"{json.dumps(asdict(outcome)) if as_json else _row(outcome)}\n")
            sys.stdout.flush()


def _row(outcome: Outcome) -> str:
    line = outcome.stderr.strip() or outcome.stdout.strip()
    return (
        f"{outcome.seconds:6.2f} s {outcome.extra_mb:6.0f} MB {outcome.exit_code:4d} "
        f"{outcome.name:22s} {line[:230]!r}"
    )


def _warm(case: Hostile) -> None:
    with tempfile.TemporaryDirectory() as folder:
        case.write(Path(folder))
        saved = os.dup(1), os.dup(2)
        _in_folder(folder)
        try:
            _command(case.command)
        except SystemExit:
            pass
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os.dup2(saved[0], 1)
            os.dup2(saved[1], 2)
            os.chdir("/")


def _in_folder(folder: str) -> None:
    os.chdir(folder)
    for number, name in ((1, ".stdout"), (2, ".stderr")):
        opened = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(opened, number)
        os.close(opened)


def _command(words: tuple[str, ...]) -> None:
    """Run a command of mazebot, or one of the two readers that have no command of their own."""
    readers = {"tree": read_tree_file, "graph": load_graph}
    if words[0] in readers:
        try:
            readers[words[0]](Path(words[1]))
        except ConfigError as error:
            sys.stderr.write(f"error: {error}\n")
            sys.exit(2)
        return
    sys.argv[1:] = words
    app.main()


def run_case(case: Hostile) -> Outcome:
    """Write the files of a case, and read them in a child."""
    with tempfile.TemporaryDirectory() as folder:
        case.write(Path(folder))
        begin_s = time.monotonic()
        child = os.fork()
        if child == 0:
            _child(case, folder)
        watch = os.pidfd_open(child)
        ended, _, _ = select.select([watch], [], [], DEADLINE_S)
        os.close(watch)
        if not ended:
            os.kill(child, signal.SIGKILL)
        _, status, usage = os.wait4(child, 0)
        seconds = time.monotonic() - begin_s
        stdout, stderr = (
            Path(folder, name).read_bytes()[:200_000].decode(errors="replace")
            for name in (".stdout", ".stderr")
        )
        peak = re.search(r"^PEAK (-?\d+)$", stderr, re.MULTILINE)
        stderr = re.sub(r"^PEAK -?\d+\n", "", stderr, flags=re.MULTILINE)
        extra_kb = int(peak[1]) if peak else usage.ru_maxrss
        return Outcome(
            case.name, os.waitstatus_to_exitcode(status), round(seconds, 2), extra_kb / 1024,
            stdout, stderr,
        )  # fmt: skip


def _child(case: Hostile, folder: str) -> None:
    code: object = 99
    try:
        _in_folder(folder)
        Path("/proc/self/clear_refs").write_text("5")
        before = _status_kb("VmHWM")
        space = _status_kb("VmSize") * 1024 + ADDRESS_SPACE_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (space, space))
        try:
            _command(case.command)
            code = 0
        except SystemExit as ended:
            code = ended.code
        except BaseException as error:
            sys.stderr.write(f"Traceback: {type(error).__name__}: {error}\n")
        sys.stdout.flush()
        sys.stderr.flush()
        of_children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        extra = max(_status_kb("VmHWM") - before, of_children - before)
        sys.stderr.write(f"PEAK {extra}\n")
        sys.stderr.flush()
    finally:
        os._exit(code if isinstance(code, int) else 98)


def _status_kb(name: str) -> int:
    found = re.search(rf"{name}:\s+(\d+)", Path("/proc/self/status").read_text())
    return int(found[1]) if found else 0


if __name__ == "__main__":
    main()
