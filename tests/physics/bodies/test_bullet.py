"""What PyBullet is given and never lets go of takes no memory."""

from __future__ import annotations

import gc
import platform
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from mazebot.bench.memory import resident_mb
from mazebot.common.messages.documents import Cone, SimulationControl
from mazebot.common.messages.topics import SIMULATION_CONTROL
from mazebot.physics.bodies.bullet import lent
from mazebot.physics.camera.camera import Intrinsics
from mazebot.physics.camera.renderers import make_renderer
from mazebot.physics.camera.scene import build_scene
from tests.physics.driver import world
from tests.physics.own_process import figures
from tests.physics.stage import OPEN, Stage, crate


def kept_bytes(cycle: Callable[[], object]) -> int:
    """What Python holds more of after thirty cycles than before them: the least of three times,
    since what other tests have left to this process allocates as well.
    """
    for _ in range(10):
        cycle()
    gc.collect()
    tracemalloc.start()
    try:
        kept = []
        for _ in range(3):
            before, _ = tracemalloc.get_traced_memory()
            for _ in range(30):
                cycle()
            gc.collect()
            kept.append(tracemalloc.get_traced_memory()[0] - before)
        return min(kept)
    finally:
        tracemalloc.stop()


def test_what_is_lent_is_what_was_given() -> None:
    given = [np.arange(6.0).reshape(2, 3), np.arange(12.0).reshape(4, 3), np.ones((1, 3))]
    for values in given:
        assert lent("vertices", values) == values.tolist()
    assert lent("indices", np.array([3, 1, 2])) == [3, 1, 2]


def test_pybullet_says_nothing_of_its_own(capfd: pytest.CaptureFixture[str]) -> None:
    stage = Stage()
    stage.load(OPEN)
    stage.desire(crate("heap", 2.0, mass_kg=1.0))
    stage.wait(0.1)
    stage.node.close()
    assert capfd.readouterr() == ("", "")


def test_hulls_that_come_and_go_leave_nothing() -> None:
    stage = Stage()
    stage.load(OPEN)
    heap = crate("heap", 2.0, geometry=Cone(radius_m=0.1, length_m=0.3), mass_kg=1.0)

    def cycle() -> None:
        stage.desire(heap)
        stage.desire()
        stage.sent.clear()

    assert kept_bytes(cycle) < 30_000
    stage.node.close()


def test_scenes_that_come_and_go_leave_nothing() -> None:
    renderer = make_renderer("tiny", Intrinsics.from_horizontal_fov(32, 24, 1.0))
    assert renderer is not None
    walls = [(f"Wall_{n}", 1.0, float(n), 0.0, 0.0) for n in range(20)]
    scene = build_scene(world(walls=walls), {})

    def cycle() -> None:
        renderer.set_scene(scene)
        renderer.render(np.eye(4))

    assert kept_bytes(cycle) < 30_000
    renderer.close()


def begun_again_mb() -> tuple[float, float]:
    """Memory of this process after one world, and after as many more as fill the heap."""
    stage = Stage()
    stage.load(OPEN)
    resident = []
    for things in range(9):
        request = SimulationControl(reset="all")
        stage.inbox.ask(SIMULATION_CONTROL, request, lambda reply: None)
        stage.turn()
        stage.now_ns = stage.node.now_ns
        stage.desire(*(crate(f"crate_{n}", n - 5.0, 1.0) for n in range(things)))
        stage.sent.clear()
        resident.append(resident_mb())
    stage.node.close()
    return resident[0], resident[-1]


@pytest.mark.slow
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc has thresholds to fix")
def test_worlds_that_are_made_anew_leave_no_holes() -> None:
    first_mb, last_mb = figures(__name__, "begun_again_mb()", timeout_s=60)
    assert last_mb - first_mb < 5.0
