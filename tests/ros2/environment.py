"""The environment of what others wrote for ROS 2."""

from __future__ import annotations

import subprocess
from pathlib import Path

from mazebot.common.files.root import ROOT

FOLDER = ROOT / ".venv-ros2"
OTHERS = Path(__file__).with_name("others")


def command(script: str, *arguments: str) -> list[str]:
    """The command that runs a script of `others` there."""
    return [str(FOLDER / "bin" / "python"), str(OTHERS / f"{script}.py"), *arguments]


def output_of(script: str, *arguments: str) -> str:
    """What a script prints; its errors are those of the test."""
    return subprocess.run(
        command(script, *arguments), check=True, stdout=subprocess.PIPE, text=True, timeout=100
    ).stdout
