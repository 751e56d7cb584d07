"""Files that a command writes, beside those that it reads."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mazebot.common.config import ConfigError
from mazebot.common.files.reading import was_opened


def refuse_inputs(option: str, outputs: Iterable[Path]) -> None:
    """Raises ConfigError where a file to be written is one that the command has read: to be called
    after reading, before writing.
    """
    for output in outputs:
        if was_opened(output):
            raise ConfigError(
                f"{option}: {output}: is a file that this command reads: must be another one"
            )
