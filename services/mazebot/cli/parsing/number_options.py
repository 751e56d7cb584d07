"""Options that take several numbers, as `--at 1 2 0.5`."""

from __future__ import annotations

import math
from typing import Any

from mazebot.cli.parsing.command import Command
from mazebot.cli.parsing.poses import are_numbers
from mazebot.common.config import ConfigError

MOST_NUMBERS = {
    "--at": 3, "--rpy": 3, "--box": 3, "--cylinder": 2, "--sphere": 1, "--scale": 3, "--colour": 3,
    "--path": 2000,
}  # fmt: skip
"""Maximum count of numbers after an option."""


class NumbersCommand(Command):
    """A command whose options in MOST_NUMBERS take the numbers after them as one text."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join the numbers, then parse as usual."""
        joined: list[str] = []
        waiting = list(reversed(args))
        while waiting:
            word = waiting.pop()
            joined.append(word)
            numbers: list[str] = []
            while waiting and len(numbers) < MOST_NUMBERS.get(word, 0) and are_numbers(waiting[-1]):
                numbers.append(waiting.pop())
            if numbers:
                joined.append(" ".join(numbers))
        return super().parse_args(ctx, joined)


def numbers(option: str, text: str, *counts: int) -> tuple[float, ...]:
    """The finite numbers in an option's text; their count is one of `counts`, or any if none given.

    Raises ConfigError, in one line.
    """
    words = text.replace(",", " ").split()
    if not all(are_numbers(word) and math.isfinite(float(word)) for word in words):
        raise ConfigError(f"{option}: {text!r:.60}: must be finite numbers")
    if counts and len(words) not in counts:
        many = " or ".join(map(str, counts))
        raise ConfigError(f"{option}: {text!r:.60}: must be {many} number{'s' * (many != '1')}")
    return tuple(float(word) for word in words)
