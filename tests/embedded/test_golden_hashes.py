"""A run is a function of world, configuration and seed alone: its hashes, written down, hold on
every processor. Some of what processors differ in can be had on one: the C library without fused
multiply-add, OpenBLAS's kernels for an old one, NumPy and OpenCV without their wider vectors, and
Numba compiling for any x86-64.

A change that moves the robot otherwise changes the hashes, and is to say so.
"""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from mazebot.common.files.root import ROOT
from mazebot.embedded.session import Session

pytestmark = pytest.mark.skipif(
    platform.machine() != "x86_64", reason="PyBullet is compiled otherwise for other machines"
)

SEED = 7
SHORT = {"sim_house_enhanced": (-1.678, -1.178, -2.25), "maze": (0.0, -0.5, 0.5)}
"""World and goal of a short drive."""
GOLDEN_SHORT = {
    "sim_house_enhanced": ("73b7677f2d289f36", "4d86b505716ff7a8"),
    "maze": ("acf55da7affdc5f8", "5a66dfd5ea5b29dc"),
}
"""State hash and image hash when the goal is reached."""
GOLDEN_TOURS = {
    "maze": "2cea1c52cd4000c0",
    "maze_rooms": "19fb8b8f2a2e9280",
    "sim_house": "5d399b7f95d015ab",
    "sim_house_enhanced": "90c14e2624b087f2",
    "sim_house_floor": "90c14e2624b087f2",
    "sim_house_markers": "495e541083a08b64",
    "sim_house_rooms": "a9de8e04e0a9de5e",
    "sim_house_slam": "a68026edf7d6fe79",
}
"""State hash of the whole tour."""

C_LIBRARY = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"}
BLAS = {"OPENBLAS_CORETYPE": "Nehalem"}
NUMBA = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
VECTORS = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "OPENCV_CPU_DISABLE": "AVX2,FP16,AVX,SSE4.2,SSE4.1,SSSE3,POPCNT,AVX512-SKX",
    "OPENCV_IPP": "disabled",
}
PROCESSORS = {"the C library": C_LIBRARY, "BLAS": BLAS, "Numba": NUMBA, "vectors": VECTORS}

DRIVE = """
import json, sys
from tests.embedded.test_golden_hashes import short_drive
print(json.dumps(short_drive(sys.argv[1])))
"""
OTHER_SINE = """
import math, struct
print(hash(struct.pack("<9999d", *(math.exp(math.sin(k / 77)) for k in range(9999)))))
"""


def short_drive(world: str) -> tuple[str, str]:
    """State hash and image hash of a drive to a near goal."""
    with Session(world, SEED, renderer="cpu") as session:
        assert session.goal(*SHORT[world]).error_code == 0
        stats = session.stats
    return stats.state_hash, stats.image_hash


def run(command: list[str], setting: dict[str, str]) -> str:
    """What a process prints on another processor, so to speak."""
    environment = {**os.environ, "PYTHONHASHSEED": "0", **setting}
    done = subprocess.run(
        [sys.executable, *command], cwd=ROOT, env=environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize("world", SHORT)
def test_a_short_drive_has_the_hashes_that_are_written_down(world: str) -> None:
    assert short_drive(world) == GOLDEN_SHORT[world]


def test_a_short_drive_has_them_with_another_c_library_blas_and_vectors() -> None:
    setting = {**C_LIBRARY, **BLAS, **VECTORS}
    world = "sim_house_enhanced"
    assert tuple(json.loads(run(["-c", DRIVE, world], setting))) == GOLDEN_SHORT[world]


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("processor", PROCESSORS)
def test_short_drives_have_them_on_every_processor(processor: str, tmp_path: Path) -> None:
    setting = {**PROCESSORS[processor]}
    if processor == "Numba":
        setting["NUMBA_CACHE_DIR"] = str(tmp_path)
    for world, golden in GOLDEN_SHORT.items():
        assert tuple(json.loads(run(["-c", DRIVE, world], setting))) == golden, world


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("processor", ["this one", "all others at once"])
def test_every_tour_has_the_hash_that_is_written_down(processor: str, tmp_path: Path) -> None:
    setting: dict[str, str] = {}
    if processor != "this one":
        setting = {**C_LIBRARY, **BLAS, **NUMBA, **VECTORS, "NUMBA_CACHE_DIR": str(tmp_path)}
    hashes = {}
    for world in GOLDEN_TOURS:
        out_dir = tmp_path / world
        options = ["--world", world, "--seed", str(SEED), "--renderer", "cpu", "--no-record"]
        run(["-m", "mazebot.cli", "demo", *options, "--out", str(out_dir)], setting)
        hashes[world] = json.loads((out_dir / "summary.json").read_text())["state_hash"]
    assert hashes == GOLDEN_TOURS


@pytest.mark.slow
def test_the_settings_do_change_what_they_say() -> None:
    assert run(["-c", OTHER_SINE], C_LIBRARY) != run(["-c", OTHER_SINE], {})
