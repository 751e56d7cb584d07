"""The tours of the shipped worlds, by the command, and the state hashes that they have."""

import os
import subprocess
import sys
from pathlib import Path

from mazebot.common.files.root import ROOT

SEED = 7
GOLDEN_TOURS = {
    "maze": "b49176234461d522",
    "maze_rooms": "19fb8b8f2a2e9280",
    "sim_house": "5d399b7f95d015ab",
    "sim_house_enhanced": "2b38e8548e025976",
    "sim_house_floor": "2b38e8548e025976",
    "sim_house_markers": "cf6087a0c0b84a57",
    "sim_house_rooms": "69b345e3bda578a7",
    "sim_house_slam": "1924aece25703792",
}
"""State hash of the whole tour."""


def run(command: list[str], setting: dict[str, str]) -> str:
    """What a process prints on another processor, so to speak."""
    environment = {**os.environ, "PYTHONHASHSEED": "0", **setting}
    done = subprocess.run(
        [sys.executable, *command], cwd=ROOT, env=environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def drive_tour(world: str, out_dir: Path, setting: dict[str, str]) -> None:
    """The whole tour of a world with its camera, on another processor, so to speak."""
    options = ["--world", world, "--seed", str(SEED), "--renderer", "cpu", "--no-record"]
    run(["-m", "mazebot.cli", "demo", *options, "--out", str(out_dir)], setting)
