"""What the file holds of a robot that stands, and of lines and events while nothing changes."""

from __future__ import annotations

import re
import subprocess
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb

from mazebot.recorder.stream.recording import AGAIN_NS, Recording
from mazebot.recorder.stream.rerun_program import rerun_binary

STEP_NS = 100_000_000
STEPS = 2 * AGAIN_NS // STEP_NS


@pytest.fixture
def rows(tmp_path: Path) -> Callable[[Callable[[Recording, int], None]], Counter[str]]:
    """Draws steps of 0.1 s; the rows that the file has of each entity."""

    def draw(step: Callable[[Recording, int], None]) -> Counter[str]:
        path = tmp_path / "run.rrd"
        recording = Recording(
            "run", path=path, live=None, blueprint=rrb.Blueprint(), properties={"seed": "1"}
        )
        for number in range(STEPS):
            recording.at(number * STEP_NS)
            step(recording, number)
        recording.close()
        command = [str(rerun_binary()), "rrd", "print", str(path)]
        said = subprocess.run(command, capture_output=True, check=True, text=True).stdout
        counted: Counter[str] = Counter()
        for count, entity in re.findall(r"with (\d+) rows .* - /(\S+)", said):
            counted[entity] += int(count)
        return counted

    return draw


def test_what_does_not_change_is_written_once_and_now_and_then_again(
    rows: Callable[[Callable[[Recording, int], None]], Counter[str]],
) -> None:
    picture = np.zeros((4, 4), np.uint8)

    def standing(recording: Recording, number: int) -> None:
        trembling = 1e-17 * (number % 2)
        recording.log("points", rr.Points3D([(1.0, 2.0, 3.0)]))
        recording.log("static", rr.Points3D([(1.0, 2.0, 3.0)]), static=True)
        recording.log("said", rr.TextLog("here"))
        recording.log_later("picture", lambda: rr.Image(picture))
        recording.transform("robot", (trembling, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), "map", "robot")
        recording.scalar("speed", trembling)
        recording.scalar("noise", float(number))

    counted = rows(standing)
    assert counted["static"] == 1
    assert counted["points"] == counted["picture"] == counted["robot"] == 2
    assert 10 <= counted["speed"] <= 22
    assert counted["noise"] == counted["said"] == STEPS


def test_what_changes_is_written_whenever_it_does(
    rows: Callable[[Callable[[Recording, int], None]], Counter[str]],
) -> None:
    def to_and_fro(recording: Recording, number: int) -> None:
        x_m = float(number // 10 % 2)
        recording.log("points", rr.Points3D([(x_m, 2.0, 3.0)]))
        kinds = rr.Points3D([(0.0, 0.0, 0.0)]), rr.Boxes3D(half_sizes=[(1.0, 1.0, 1.0)])
        recording.log("static", kinds[number // 10 % 2], static=True)
        recording.transform("robot", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), "map", "robot", x_m > 0)
        recording.scalar("speed", x_m)

    counted = rows(to_and_fro)
    assert counted["points"] == counted["robot"] == STEPS // 10
    # The ends of each level stretch: a line between them is the one through all of its points.
    assert counted["speed"] == 2 * STEPS // 10
