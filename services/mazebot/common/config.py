"""The base of all configurations, and their errors in one line."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import to_jsonable_python


class ConfigError(Exception):
    """An error in the user's input; its text is the one line to show."""


class ServiceConfig(BaseModel):
    """The fields common to every service's configuration."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    seed: int = Field(
        7, ge=0, le=2**63 - 1, description="the run's seed; each random stream derives from it"
    )


def changed_defaults(config: ServiceConfig) -> dict[str, Any]:
    """The defaults, as JSON values, of the fields that have another value."""
    changed = {
        name: field.get_default(call_default_factory=True)
        for name, field in type(config).model_fields.items()
        if not field.is_required()
    }
    changed = {name: value for name, value in changed.items() if value != getattr(config, name)}
    defaults: dict[str, Any] = to_jsonable_python(changed)
    return defaults


class PlainText:
    """Annotation of a list field whose flag or variable is read as plain text, not as JSON."""


def one_line(error: ValidationError, source: Callable[[str], str] = lambda _: "") -> str:
    """The errors, field by field, in one line; `source` returns the origin of a field's value."""
    parts = []
    for problem in error.errors():
        field = ".".join(str(part) for part in problem["loc"]) or "(whole)"
        origin = source(str(problem["loc"][0])) if problem["loc"] else ""
        got = f"{problem['input']!r:.80}{f' from {origin}' if origin else ''}"
        parts.append(f"{field}: {must(problem['msg'])} (got {got})")
    return "; ".join(parts)


def must(message: str) -> str:
    """A message of pydantic, rephrased as what the value must be."""
    text = message.removeprefix("Value error, ").replace("Input should be", "must be")
    # For a text that is not a number, the part after the comma adds nothing.
    return " ".join(text.partition(", unable to")[0].split())


def fail(message: str) -> None:
    """Print one line on standard error and exit with code 2."""
    sys.stderr.write(f"error: {' '.join(message.split())}\n")
    raise SystemExit(2)
