"""Software versions and hardware used for a run."""

from __future__ import annotations

import functools
import os
import platform
from importlib import metadata
from pathlib import Path

from mazebot.common.files.version import mazebot_version
from mazebot.common.recordings.summary import Hardware

_PACKAGES = ("numpy", "pybullet", "eclipse-zenoh", "rerun-sdk", "opencv")
_OPENCV = (
    "opencv-contrib-python-headless",
    "opencv-python-headless",
    "opencv-contrib-python",
    "opencv-python",
)


def versions() -> dict[str, str]:
    """Version of Mazebot, Python and the packages that a run's numbers depend on."""
    found = {"mazebot": mazebot_version(), "python": platform.python_version()}
    for package in _PACKAGES:
        names = _OPENCV if package == "opencv" else (package,)
        found[package] = next((text for text in map(_version, names) if text), "not installed")
    return found


def hardware() -> Hardware:
    """The computer that this process runs on."""
    return Hardware(
        processor=_field("/proc/cpuinfo", "model name")
        or platform.processor()
        or platform.machine(),
        cores=os.cpu_count(),
        memory_mib=_memory_mib(),
        system=f"{platform.system()} {platform.release()}",
    )


def _memory_mib() -> int | None:
    words = _field("/proc/meminfo", "MemTotal").split()
    return int(words[0]) // 1024 if words and words[0].isdecimal() else None


def _field(path: str, name: str) -> str:
    """The first value of that name in a file of the kernel; empty if there is none."""
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return ""
    fields = (line.partition(":") for line in lines)
    return next((value.strip() for key, _, value in fields if key.strip() == name), "")


@functools.cache
def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""
