"""Where the worlds and models that ship are, in its own module for processes that import little
else.
"""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[2]

ROOT = _PACKAGE if (_PACKAGE / "worlds").is_dir() else _PACKAGE.parents[1]
"""The folder that holds worlds/ and models/: the package itself if it is installed, else the
repository.
"""
