"""Where the repository is: apart from all else, for processes that need little else."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The folder that holds services/, worlds/ and models/."""
