"""Compiles what makes and judges mazes, so that the first takes no longer than the next."""

from __future__ import annotations

from services.worldgen.check import problems_of
from services.worldgen.difficulty import difficulty
from services.worldgen.recipe.loader import load_world


def compile_kernels() -> None:
    """Make a maze by each algorithm that has kernels, one with loops; judge one, and markers."""
    loaded = load_world("maze", overrides=("maze.algorithm=recursive_backtracker",))
    difficulty(loaded)
    load_world("maze", overrides=("maze.algorithm=wilson", "maze.braiding=0.5"))
    problems_of("enhanced")
