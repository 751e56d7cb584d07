"""Compiles every kernel, so that none is left to compile when a robot moves or a maze is asked for:
drives half a second of the enhanced tour. `make env` runs it.
"""

from __future__ import annotations

import logging
import tempfile
from pathlib import Path

from services.common.node.executive import Executive, MemoryTransport
from services.embedded.demo import DemoOptions, build_nodes
from services.worldgen.kernels import compile_kernels

EPISODE_S = 0.5
"""In which every sensor has spoken, and the first path is planned."""


def main() -> None:
    """Drive, and make mazes."""
    logging.disable(logging.WARNING)
    compile_kernels()
    with tempfile.TemporaryDirectory() as folder:
        options = DemoOptions(out_dir=Path(folder) / "run", record=False)
        executive = Executive(build_nodes(options), MemoryTransport())
        try:
            executive.run(lambda: executive.now_ns >= EPISODE_S * 1e9)
        finally:
            executive.close()


if __name__ == "__main__":
    main()
