"""Files that lead further and further into what reads them, each kind in a process of its own.

    python -m tests.fuzz [READER...] [--seconds S] [--seed N] [--found FOLDER] [--corpus FOLDER]

Atheris, of .venv-fuzz, watches which branches a file reaches. Where it is not installed, the
examples are changed without looking. The files that show a fault are kept; the exit code is then 1.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import random
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType

import cv2

from mazebot.bench.fuzz.mutations import mutated
from mazebot.common.files.root import ROOT
from tests.fuzz.readers import CORPUS, READERS, Reader
from tests.fuzz.trial import Trial

LONGEST_BYTES = 4096
_ATHERIS = ROOT.glob(".venv-fuzz/lib/python*/site-packages")
_WATCHED = (
    "mazebot.cli",
    "mazebot.common.files",
    "mazebot.common.messages",
    "mazebot.common.nav2_params",
    "mazebot.common.recordings",
    "mazebot.common.settings",
    "mazebot.common.world.map_files",
    "mazebot.common.world.marker_dictionary",
    "mazebot.mapping.graph.graph_file",
    "mazebot.navigation.behavior",
    "mazebot.worldgen.assets",
    "mazebot.worldgen.check",
    "mazebot.worldgen.recipe",
    "mazebot.worldgen.sdf",
    "rosbags",
    "trimesh.exchange",
    "yaml",
)
"""Modules and packages whose branches are watched: not what Numba compiles."""
_HANGS_S = 60
_MOST_MB = 4000


def main() -> int:
    """Read files for some seconds a reader."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("readers", nargs="*", metavar="READER")
    many = parser.add_mutually_exclusive_group()
    many.add_argument("--seconds", type=int, default=20, help="for each reader")
    many.add_argument("--files", type=int, help="for each reader, in place of a time")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--found", type=Path, default=Path("fuzz-findings"))
    parser.add_argument("--corpus", type=Path, help="folder for files that reach something new")
    options = parser.parse_args()
    known = {reader.name: reader for reader in READERS}
    for name in options.readers:
        if name not in known:
            parser.error(f"READER: {name!r}: must be one of {', '.join(known)}")
    # Threads of OpenCV do not outlive a fork, and would be waited for.
    cv2.setNumThreads(0)
    readers = [known[name] for name in options.readers] or list(READERS)
    sys.path += map(str, _ATHERIS)
    is_guided = importlib.util.find_spec("atheris") is not None
    with tempfile.TemporaryDirectory() as name:
        # Of this run alone: what was found before and is found again is no success.
        found = Path(name, "found")
        found.mkdir()
        for reader in readers:
            trial = Trial(reader, Path(name, "files"), found)
            for data in reader.examples():
                trial.read(data)
        if is_guided:
            _watch()
        else:
            _say("atheris is not installed: files are changed without looking at what they reach")
        ended = [_ended_well(reader, options, Path(name), is_guided) for reader in readers]
        files = sorted(found.iterdir())
        if files:
            shutil.copytree(found, options.found, dirs_exist_ok=True)
        for file in files:
            what = f": {file.read_text().strip()}" if file.suffix == ".txt" else ""
            _say(f"found: {options.found / file.name}{what}")
    return 1 if files or not all(ended) else 0


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def _watch() -> None:
    """Count the branches of all functions of the modules that are watched, and loaded by now."""
    import atheris

    for function in _functions():
        atheris.instrument_func(function)


def _functions() -> Iterator[FunctionType]:
    for name, module in list(sys.modules.items()):
        if any(name == one or name.startswith(f"{one}.") for one in _WATCHED):
            for value in list(vars(module).values()):
                members = vars(value).values() if isinstance(value, type) else (value,)
                for member in members:
                    function = _behind(member)
                    if isinstance(function, FunctionType) and function.__module__ == name:
                        yield function


def _behind(member: object) -> object:
    """The function of a method, or of a property."""
    if isinstance(member, staticmethod | classmethod):
        return member.__func__
    return member.fget if isinstance(member, property) else member


def _ended_well(reader: Reader, options: argparse.Namespace, folder: Path, is_guided: bool) -> bool:
    """Read files in a child; whether it has ended as it should."""
    log, begin_s = folder / "log", time.monotonic()
    child = os.fork()
    if child == 0:
        try:
            for number in (1, 2):
                os.dup2(os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND), number)
            trial = Trial(reader, folder / "files", folder / "found")
            (_guided if is_guided else _blind)(trial, options, folder)
        finally:
            os._exit(98)
    _, status = os.waitpid(child, 0)
    said = log.read_text(errors="replace")
    log.unlink()
    counts = re.findall(r"number_of_executed_units: +(\d+)", said)
    code = os.waitstatus_to_exitcode(status)
    problem = "" if code == 0 else f": ended with {code}: {said[-300:]!r}"
    seconds = time.monotonic() - begin_s
    _say(f"{reader.name}: {int(counts[-1]) if counts else 0:,} files in {seconds:.0f} s{problem}")
    return code == 0


def _guided(trial: Trial, options: argparse.Namespace, folder: Path) -> None:
    """Ends the process."""
    import atheris

    reached = (options.corpus or folder / "reached") / trial.reader.name
    reached.mkdir(parents=True, exist_ok=True)

    def read(data: bytes) -> None:
        trial.read(data)

    atheris.Setup(
        [
            "fuzz", f"-seed={options.seed}",
            f"-runs={options.files}" if options.files else f"-max_total_time={options.seconds}",
            f"-max_len={LONGEST_BYTES}", f"-timeout={_HANGS_S}", f"-rss_limit_mb={_MOST_MB}",
            f"-artifact_prefix={folder}/found/{trial.reader.name}-", "-print_final_stats=1",
            str(reached), str(CORPUS / trial.reader.name),
        ],
        read,
    )  # fmt: skip
    atheris.Fuzz()


def _blind(trial: Trial, options: argparse.Namespace, _: Path) -> None:
    """Ends the process."""
    examples = list(trial.reader.examples())
    rng = random.Random(f"{options.seed} {trial.reader.name}")
    end_s, count = time.monotonic() + options.seconds, 0
    while count < options.files if options.files else time.monotonic() < end_s:
        trial.read(mutated(rng.choice(examples), examples, rng)[:LONGEST_BYTES])
        count += 1
    _say(f"number_of_executed_units: {count}")
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
