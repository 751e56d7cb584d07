"""Software versions used for a run."""

from __future__ import annotations

import platform
import tomllib
from importlib import metadata

from services.common.root import ROOT

_PACKAGES = ("numpy", "pybullet", "eclipse-zenoh", "rerun-sdk", "opencv")
_OPENCV = (
    "opencv-contrib-python-headless",
    "opencv-python-headless",
    "opencv-contrib-python",
    "opencv-python",
)


def versions() -> dict[str, str]:
    """Version of Mazebot, Python and the packages that a run's numbers depend on."""
    found = {"mazebot": _mazebot(), "python": platform.python_version()}
    for package in _PACKAGES:
        names = _OPENCV if package == "opencv" else (package,)
        found[package] = next((text for text in map(_version, names) if text), "not installed")
    return found


def _mazebot() -> str:
    try:
        with (ROOT / "pyproject.toml").open("rb") as file:
            return str(tomllib.load(file)["project"]["version"])
    except (OSError, KeyError, tomllib.TOMLDecodeError):
        return _version("mazebot") or "unknown"


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""
