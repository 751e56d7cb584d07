"""Compiles every kernel in advance, by driving half a second of the enhanced tour and generating
mazes. `make env` runs it.
"""

from __future__ import annotations

import logging
import tempfile
from pathlib import Path

from services.common.node.executive import Executive, MemoryTransport
from services.embedded.demo import DemoOptions, build_nodes
from services.worldgen.kernels import compile_kernels

EPISODE_S = 0.5
"""Time within which every sensor has published, and the first path is planned."""


def main() -> None:
    """Drive, and generate mazes."""
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
