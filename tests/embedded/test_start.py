"""A run starts with what it needs: modules, and kernels that are compiled in advance."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mazebot.common.maths.kernel_types import text_of, types_of
from mazebot.embedded.kernel_list import SIGNED, listed

IMPORTED = """
import sys
from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.embedded.demo import DemoOptions, build_nodes

executive = Executive(build_nodes(DemoOptions(camera=False, record=False)), MemoryTransport())
executive.run(lambda: executive.now_ns > 0)
print(*sys.modules)
"""
UNUSED = (
    "mazebot.explorer",
    "mazebot.mapping",
    "mazebot.recorder.transcoding.job",
    "mazebot.recorder.transcoding.vp9",
    "mazebot.recorder.drawing.archetypes",
    "mazebot.recorder.judging.map.mapping",
    "mazebot.physics.camera.cpu_camera",
    "mazebot.physics.camera.gl_camera",
    "mazebot.worldgen.maze",
    "mazebot.console",
    "rerun",
    "trimesh",
    "scipy.linalg",
    "zenoh",
)
OBSERVED = """
import logging
from mazebot.embedded.observed_kernels import observed

logging.disable(logging.WARNING)
for one in observed():
    print(*one)
"""
EXPONENTIAL = """
import os, sys, time
import numpy as np
from rich.console import Console
from mazebot.common.maths import portable_kernels
from mazebot.common.maths.kernels import cache_folder
from mazebot.embedded.compile_progress import CompileProgress
from mazebot.embedded.compiling import CompilingStoppedError, compiled_side_by_side

def is_left():
    done = cache_folder(portable_kernels.sin) / "mazebot_compiled.json"
    return not done.exists() or done.read_text().count("mazebot.common.maths.port") < 2

stopped = sys.argv[1:] == ["stopped"]
try:
    with compiled_side_by_side(CompileProgress(Console()), lambda: stopped):
        print(portable_kernels.exp_each(np.zeros(1)))
        # What was not waited for is compiled meanwhile.
        while sys.argv[1:] == ["all"] and is_left():
            time.sleep(0.1)
except CompilingStoppedError:
    print("stopped")
children = f"/proc/self/task/{os.getpid()}/children"
print("children:", open(children).read() if os.path.exists(children) else "")
"""

PREPARED = """
import logging
from mazebot.common.maths.kernels import USE_LISTENERS
from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.embedded.demo import DemoOptions, build_nodes

logging.disable(logging.INFO)
nodes = build_nodes(DemoOptions(record=False))
for node in nodes:
    node.prepare()
USE_LISTENERS.append(lambda kernel: print(kernel.module, kernel.name))
executive = Executive(nodes, MemoryTransport())
executive.run(lambda: executive.now_ns >= 3e9)
executive.close()
"""
SESSION = """
import os, sys
from mazebot import Session

sys.stderr = sys.stdout
with Session("original", camera=False) as session:
    print(session.step().iterations)
children = f"/proc/self/task/{os.getpid()}/children"
print("children:", open(children).read() if os.path.exists(children) else "")
"""


def run(code: str, kernels: Path | None = None, *arguments: str) -> list[str]:
    """The lines that a program prints that keeps its kernels in a folder of its own."""
    done = start(code, kernels, *arguments)
    output, _ = done.communicate(timeout=900)
    assert done.returncode == 0
    return output.splitlines()


def start(code: str, kernels: Path | None, *arguments: str) -> subprocess.Popen[str]:
    environment = dict(os.environ)
    if kernels is not None:
        environment["NUMBA_CACHE_DIR"] = str(kernels)
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)


@pytest.mark.slow
def test_a_tour_imports_nothing_of_what_it_does_not_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAZEBOT_RECORDER_RECORDINGS_DIR", str(tmp_path))
    *_, modules = run(IMPORTED)
    imported = set(modules.split())
    assert "mazebot.navigation.node" in imported
    assert not imported & set(UNUSED)


@pytest.mark.slow
def test_every_kernel_that_python_calls_is_listed_and_no_other() -> None:
    found = run(OBSERVED)
    told = "make generate writes services/mazebot/embedded/kernels.txt again"
    assert set(found) == {" ".join(one) for one in listed()}, told


def test_types_are_read_as_they_were_written() -> None:
    texts = {one.types for one in listed()} - {SIGNED}
    assert len(texts) > 50
    for text in texts:
        assert text_of(types_of(text)) == text


@pytest.mark.slow
def test_a_service_that_is_prepared_has_nothing_left_to_compile() -> None:
    assert run(PREPARED) == []


@pytest.mark.slow
def test_what_is_compiled_is_told_and_never_compiled_again(tmp_path: Path) -> None:
    first, *_, value, children = run(EXPONENTIAL, tmp_path, "all")
    assert first.startswith("compiling kernels, once: 0 of ")
    assert value == "[1.]"
    assert children == "children: "
    compiled = sorted(tmp_path.rglob("*.nb?"))
    assert compiled
    assert run(EXPONENTIAL, tmp_path) == ["[1.]", "children: "]
    assert sorted(tmp_path.rglob("*.nb?")) == compiled


@pytest.mark.slow
def test_who_stops_while_kernels_are_compiled_leaves_no_process(tmp_path: Path) -> None:
    *_, last, children = run(EXPONENTIAL, tmp_path, "stopped")
    assert (last, children) == ("stopped", "children: ")
    assert run(EXPONENTIAL, tmp_path)[-2] == "[1.]"


@pytest.mark.slow
def test_two_at_once_do_not_harm_each_other(tmp_path: Path) -> None:
    both = [start(EXPONENTIAL, tmp_path, "all") for _ in range(2)]
    for one in both:
        output, _ = one.communicate(timeout=100)
        assert "[1.]" in output.splitlines()
    assert run(EXPONENTIAL, tmp_path) == ["[1.]", "children: "]


@pytest.mark.slow
def test_a_session_compiles_side_by_side_too(tmp_path: Path) -> None:
    first, *_, steps, children = run(SESSION, tmp_path)
    assert first.startswith("compiling kernels, once: 0 of ")
    assert (steps, children) == ("1", "children: ")


@pytest.mark.slow
@pytest.mark.longest
@pytest.mark.timeout(900)
def test_once_the_list_is_compiled_nothing_is_left(tmp_path: Path) -> None:
    run("from mazebot.embedded.kernels import compile_all; assert compile_all()", tmp_path)
    compiled = sorted(tmp_path.rglob("*.nbc"))
    run(OBSERVED, tmp_path)
    assert sorted(tmp_path.rglob("*.nbc")) == compiled
