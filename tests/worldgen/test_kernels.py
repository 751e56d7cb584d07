"""What is compiled ahead of the first world."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

AHEAD = "from mazebot.worldgen.kernels import compile_kernels\ncompile_kernels()"
AFTER = """
from mazebot.worldgen.build import figures
from mazebot.worldgen.recipe.loader import load_world
for algorithm in ("wilson", "recursive_backtracker", "rooms"):
    for braiding in (0.0, 0.5):
        overrides = (f"maze.algorithm={algorithm}", f"maze.braiding={braiding}")
        figures(load_world("maze", overrides=overrides))
"""


@pytest.mark.slow
def test_no_maze_has_anything_left_to_compile(tmp_path: Path) -> None:
    def compiled_by(code: str) -> set[str]:
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        subprocess.run([sys.executable, "-c", code], check=True, timeout=110, env=environment)
        return {path.name for path in tmp_path.rglob("*.nbc")}

    ahead = compiled_by(AHEAD)
    assert ahead
    assert compiled_by(AFTER) == ahead
