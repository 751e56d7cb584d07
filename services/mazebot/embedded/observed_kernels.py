"""Which kernels Python calls when a robot drives or explores, when a camera draws, and when a maze
is made. `make generate` writes them into the list of those that are compiled in advance.
"""

from __future__ import annotations

import logging
import sys
import tempfile
from pathlib import Path

from mazebot.common.maths import kernels
from mazebot.common.maths.kernel_types import text_of
from mazebot.common.maths.kernels import Kernel, Types
from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.embedded.demo import DemoOptions, build_nodes
from mazebot.embedded.kernel_list import SIGNED, Listed
from mazebot.navigation import kernels as navigation_kernels
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.control.yielding.giving_way import GivingWayParams
from mazebot.physics.camera import cpu_camera, gl_camera
from mazebot.worldgen.kernels import compile_kernels

EPISODE_S = 0.5
"""Time within which every sensor has published, and the first path is planned."""


def observed() -> tuple[Listed, ...]:
    """What the list must contain: drives, explores, draws and makes mazes. Must be called before
    anything else uses kernels.
    """
    found: dict[Listed, None] = {}

    def used(kernel: Kernel) -> None:
        if kernel.is_signed:
            found[Listed(kernel.module, kernel.name, SIGNED)] = None

    def called(kernel: Kernel, types: Types) -> None:
        found[Listed(kernel.module, kernel.name, text_of(types))] = None

    kernels.USE_LISTENERS.append(used)
    kernels.CALL_LISTENERS.append(called)
    try:
        _use_all()
    finally:
        kernels.USE_LISTENERS.remove(used)
        kernels.CALL_LISTENERS.remove(called)
    return tuple(found)


def _use_all() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for slam in (False, True):
            _drive(Path(folder) / ("slam" if slam else "tour"), slam)
    # What no tour needs, and some configuration does.
    navigation_kernels.compile_kernels(NavigationConfig(giving_way=GivingWayParams(enabled=True)))
    cpu_camera.compile_kernels()
    gl_camera.compile_kernels()
    compile_kernels()


def _drive(out_dir: Path, slam: bool) -> None:
    options = DemoOptions(out_dir=out_dir, record=False, slam=slam, renderer="cpu")
    executive = Executive(build_nodes(options), MemoryTransport())
    try:
        executive.run(lambda: executive.now_ns >= EPISODE_S * 1e9)
        for node in executive.nodes:
            node.prepare()
    finally:
        executive.close()


def main() -> None:
    """Print the list."""
    logging.disable(logging.WARNING)
    for one in observed():
        sys.stdout.write(" ".join(one) + "\n")


if __name__ == "__main__":
    main()
