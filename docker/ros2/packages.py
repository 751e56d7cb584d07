"""Builds the message packages that `definitions.py` has written, side by side.

`python docker/ros2/packages.py FOLDER`, in an environment with the wheels of
requirements-bridge.lock, installs them into that environment. Needs g++.

It imports nothing of Mazebot: what it makes is kept until a definition changes.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

PREFIX = Path(sys.prefix)
_BUILT_IN = "/opt/python/cp311-cp311"
"""Where the wheels were built: paths in their CMake files."""


def make_wheels_relocatable() -> None:
    """Put this environment's paths in place of those of the machine that built the wheels."""
    replaced = {
        f"{_BUILT_IN}/include/python3.11": sysconfig.get_path("include"),
        f"{_BUILT_IN}/lib/python3.11/site-packages/numpy/_core/include": np.get_include(),
    }
    for file in PREFIX.glob("share/*/cmake/*.cmake"):
        text = file.read_text()
        if _BUILT_IN in text:
            for old, new in replaced.items():
                text = text.replace(old, new)
            file.write_text(text)


def build(source: Path) -> str:
    """Build a package and install it into this environment; its name."""
    made = source / "build"
    environment = {
        **os.environ,
        "PATH": f"{PREFIX / 'bin'}:{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": str(PREFIX),
    }
    configure = [
        "cmake", "-G", "Ninja", "-S", str(source), "-B", str(made), "-DBUILD_TESTING=OFF",
        f"-DCMAKE_PREFIX_PATH={PREFIX}", f"-DCMAKE_INSTALL_PREFIX={PREFIX}",
        f"-DPython3_EXECUTABLE={PREFIX / 'bin/python3'}", "-DPython3_FIND_VIRTUALENV=ONLY",
        "-DCMAKE_BUILD_TYPE=MinSizeRel", "-Wno-author",
    ]  # fmt: skip
    for command in (configure, ["cmake", "--build", str(made), "--target", "install"]):
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{source.name}: {' '.join(command)}\n{done.stdout[-3000:]}{done.stderr}")
    return source.name


def main() -> None:
    """Build all that are there."""
    sources = sorted(Path(sys.argv[1]).iterdir())
    make_wheels_relocatable()
    # One is configured, by one processor, while another one is compiled by all.
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for number, name in enumerate(pool.map(build, sources), 1):
            sys.stdout.write(f"built {name}: {number} of {len(sources)}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
