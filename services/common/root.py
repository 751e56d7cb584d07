"""The path of the repository, in its own module for processes that import little else."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The folder that holds services/, worlds/ and models/."""
