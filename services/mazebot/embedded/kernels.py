"""Compiles every kernel in advance, by driving half a second of the enhanced tour, as long without
a map, drawing by each renderer, and generating mazes. `make env` and the image's build run it.
"""

from __future__ import annotations

import logging
import tempfile
from pathlib import Path

from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.embedded.demo import DemoOptions, build_nodes
from mazebot.physics.camera import cpu_camera, gl_camera
from mazebot.worldgen.kernels import compile_kernels

EPISODE_S = 0.5
"""Time within which every sensor has published, and the first path is planned."""


def main() -> None:
    """Drive in a map and while one is made, draw, and generate mazes."""
    logging.disable(logging.WARNING)
    compile_kernels()
    cpu_camera.compile_kernels()
    gl_camera.compile_kernels()
    with tempfile.TemporaryDirectory() as folder:
        for slam in (False, True):
            out_dir = Path(folder) / ("slam" if slam else "tour")
            _drive(DemoOptions(out_dir=out_dir, record=False, slam=slam))


def _drive(options: DemoOptions) -> None:
    executive = Executive(build_nodes(options), MemoryTransport())
    try:
        executive.run(lambda: executive.now_ns >= EPISODE_S * 1e9)
    finally:
        executive.close()


if __name__ == "__main__":
    main()
