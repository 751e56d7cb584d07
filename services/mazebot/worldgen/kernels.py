"""Compiles the kernels for mazes and their checks, so that the first maze takes no longer."""

from __future__ import annotations

from mazebot.worldgen.check import problems_of
from mazebot.worldgen.difficulty import difficulty
from mazebot.worldgen.recipe.loader import load_world


def compile_kernels() -> None:
    """Generate a maze by each algorithm with kernels, one with loops; check one, and markers."""
    loaded = load_world("maze", overrides=("maze.algorithm=recursive_backtracker",))
    difficulty(loaded)
    load_world("maze", overrides=("maze.algorithm=wilson", "maze.braiding=0.5"))
    problems_of("enhanced")
