"""A run is a function of world, configuration and seed alone: its hashes, written down, hold on
every processor. Some of what processors differ in can be had on one: the C library without fused
multiply-add, OpenBLAS's kernels for an old one, NumPy and OpenCV without their wider vectors, and
Numba compiling for any x86-64.

A change that moves the robot otherwise changes the hashes, and is to say so.
"""

import json
import os
import platform
from pathlib import Path

import pytest

from mazebot.embedded.session import Session
from tests.embedded.golden_tours import GOLDEN_TOURS, SEED, drive_tour, run

pytestmark = pytest.mark.skipif(
    platform.machine() != "x86_64", reason="PyBullet is compiled otherwise for other machines"
)

SHORT = {"sim_house_enhanced": (-1.678, -1.178, -2.25), "maze": (0.0, -0.5, 0.5)}
"""World and goal of a short drive."""
GOLDEN_SHORT = {
    "sim_house_enhanced": ("73b7677f2d289f36", "975ba7c52852a752"),
    "maze": ("acf55da7affdc5f8", "243b07b47a128c17"),
}
"""State hash and image hash when the goal is reached."""
SOME_TOURS = ("sim_house", "sim_house_enhanced", "maze")
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


@pytest.fixture(scope="module")
def any_processor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where what is compiled for any processor is kept, which takes more than a minute: by all
    tests, also of another worker.
    """
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    kept = folder / "kernels_of_any_processor"
    kept.mkdir(exist_ok=True)
    return kept


@pytest.mark.parametrize("world", SHORT)
def test_a_short_drive_has_the_hashes_that_are_written_down(world: str) -> None:
    assert short_drive(world) == GOLDEN_SHORT[world]


@pytest.mark.slow
def test_a_short_drive_has_them_with_another_c_library_blas_and_vectors() -> None:
    setting = {**C_LIBRARY, **BLAS, **VECTORS}
    world = "sim_house_enhanced"
    assert tuple(json.loads(run(["-c", DRIVE, world], setting))) == GOLDEN_SHORT[world]


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("processor", PROCESSORS)
def test_short_drives_have_them_on_every_processor(processor: str, any_processor: Path) -> None:
    setting = {**PROCESSORS[processor]}
    if processor == "Numba":
        setting["NUMBA_CACHE_DIR"] = str(any_processor)
    for world, golden in GOLDEN_SHORT.items():
        assert tuple(json.loads(run(["-c", DRIVE, world], setting))) == golden, world


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    "world",
    [
        pytest.param(world, marks=[] if world in SOME_TOURS else pytest.mark.longest)
        for world in GOLDEN_TOURS
    ],
)
def test_every_tour_has_the_hash_that_is_written_down_with_all_others_at_once(
    world: str, any_processor: Path, tmp_path: Path
) -> None:
    setting = {**C_LIBRARY, **BLAS, **NUMBA, **VECTORS, "NUMBA_CACHE_DIR": str(any_processor)}
    drive_tour(world, tmp_path, setting)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["state_hash"] == GOLDEN_TOURS[world]


@pytest.mark.slow
def test_the_settings_do_change_what_they_say() -> None:
    assert run(["-c", OTHER_SINE], C_LIBRARY) != run(["-c", OTHER_SINE], {})
