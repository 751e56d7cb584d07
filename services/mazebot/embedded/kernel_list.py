"""The kernels that are compiled in advance: those that Python calls when a robot drives or
explores, when a camera draws, and when a maze is made. To write the list again:

    python -m mazebot.embedded.kernel_list > services/mazebot/embedded/kernels.txt
"""

from __future__ import annotations

import importlib
import logging
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from mazebot.common.maths import kernels
from mazebot.common.maths.kernel_types import text_of, types_of
from mazebot.common.maths.kernels import KERNELS, Kernel, Types

LIST = Path(__file__).with_name("kernels.txt")
EPISODE_S = 0.5
"""Time within which every sensor has published, and the first path is planned."""
_SIGNED = "signed"
"""In place of the types of arguments of a kernel with a signature at its definition."""


class Listed(NamedTuple):
    """A line of the list."""

    module: str
    name: str
    types: str

    def compile(self) -> None:
        """Get its machine code, from the disk if it is there."""
        importlib.import_module(self.module)
        types = () if self.types == _SIGNED else types_of(self.types)
        KERNELS[self.module, self.name].compile(types)


def listed() -> list[Listed]:
    """All lines, in the order in which a tour needs the kernels first."""
    lines = LIST.read_text(encoding="utf-8").splitlines()
    return [Listed(*line.split(" ", 2)) for line in lines]


def observed() -> list[Listed]:
    """What the list must contain: drives, explores, draws and makes mazes. Must be called before
    anything else uses kernels.
    """
    found: dict[Listed, None] = {}

    def used(kernel: Kernel) -> None:
        if kernel.is_signed:
            found[Listed(kernel.module, kernel.name, _SIGNED)] = None

    def called(kernel: Kernel, types: Types) -> None:
        found[Listed(kernel.module, kernel.name, text_of(types))] = None

    kernels.USE_LISTENERS.append(used)
    kernels.CALL_LISTENERS.append(called)
    try:
        _use_all()
    finally:
        kernels.USE_LISTENERS.remove(used)
        kernels.CALL_LISTENERS.remove(called)
    return list(found)


def _use_all() -> None:
    from mazebot.physics.camera import cpu_camera, gl_camera  # noqa: PLC0415 - use kernels at once
    from mazebot.worldgen.kernels import compile_kernels  # noqa: PLC0415

    with tempfile.TemporaryDirectory() as folder:
        for slam in (False, True):
            _drive(Path(folder) / ("slam" if slam else "tour"), slam)
    cpu_camera.compile_kernels()
    gl_camera.compile_kernels()
    compile_kernels()


def _drive(out_dir: Path, slam: bool) -> None:
    from mazebot.common.node.executive import Executive, MemoryTransport  # noqa: PLC0415
    from mazebot.embedded.demo import DemoOptions, build_nodes  # noqa: PLC0415

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
