"""The list of the kernels that are compiled in advance; `observed_kernels` writes it."""

from __future__ import annotations

import functools
import importlib
from pathlib import Path
from typing import NamedTuple

from mazebot.common.maths import portable_kernels  # noqa: F401 - makes those of `portable`
from mazebot.common.maths.kernel_types import types_of
from mazebot.common.maths.kernels import KERNELS

LIST = Path(__file__).with_name("kernels.txt")
SIGNED = "signed"
"""In place of the types of arguments of a kernel with a signature at its definition."""


class Listed(NamedTuple):
    """A line of the list."""

    module: str
    name: str
    types: str

    def compile(self) -> None:
        """Get its machine code, from the disk if it is there."""
        importlib.import_module(self.module)
        types = () if self.types == SIGNED else types_of(self.types)
        KERNELS[self.module, self.name].compile(types)


@functools.cache
def listed() -> tuple[Listed, ...]:
    """All lines, in the order in which a tour needs the kernels first."""
    lines = LIST.read_text(encoding="utf-8").splitlines()
    return tuple(Listed(*line.split(" ", 2)) for line in lines)
