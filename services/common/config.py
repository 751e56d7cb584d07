"""What every configuration has, and what is wrong with one in one line."""

from __future__ import annotations

import sys
from collections.abc import Callable

from pydantic import BaseModel, ConfigDict, Field, ValidationError


class ConfigError(Exception):
    """A mistake in the user's input: its text is the one line to show."""


class ServiceConfig(BaseModel):
    """What every service's configuration has."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    seed: int = Field(
        7, ge=0, le=2**63 - 1, description="the run's one seed; each random stream derives from it"
    )


class PlainText:
    """Marks a field, in its annotation, that takes a flag or a variable as the text it is, where
    others that hold lists take JSON.
    """


def one_line(error: ValidationError, source: Callable[[str], str] = lambda _: "") -> str:
    """What is wrong, field by field, in one line; `source` says where the value of a field is
    from.
    """
    parts = []
    for problem in error.errors():
        field = ".".join(str(part) for part in problem["loc"]) or "(whole)"
        origin = source(str(problem["loc"][0])) if problem["loc"] else ""
        got = f"{problem['input']!r:.80}{f' from {origin}' if origin else ''}"
        parts.append(f"{field}: {must(problem['msg'])} (got {got})")
    return "; ".join(parts)


def must(said: str) -> str:
    """What pydantic says of a value, as what the value must be."""
    text = said.removeprefix("Value error, ").replace("Input should be", "must be")
    # Of a text that is no number, what comes after the comma says nothing new.
    return " ".join(text.partition(", unable to")[0].split())


def fail(message: str) -> None:
    """Print one line on standard error and leave with exit code 2."""
    sys.stderr.write(f"error: {' '.join(message.split())}\n")
    raise SystemExit(2)
