"""Configuration: flags over environment over YAML file over defaults, and one line for each
mistake.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError


class ConfigError(Exception):
    """A mistake in a person's input: its text is the one line to show."""


class ServiceConfig(BaseModel):
    """What every service's configuration has."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    seed: int = Field(7, ge=0, description="the run's one seed; each random stream derives from it")


class PlainText:
    """Marks a field, in its annotation, that takes a flag or a variable as the text it is, where
    others that hold lists take JSON.
    """


C = TypeVar("C", bound=ServiceConfig)

_NOTHING: Mapping[str, object] = {}


def load(
    model: type[C], service: str, arguments: Sequence[str], given: Mapping[str, object] = _NOTHING
) -> C:
    """Read a service's configuration.

    Flags (`--scan-rate-hz 5`) win over the environment (`MAZEBOT_PHYSICS_SCAN_RATE_HZ`), over the
    service's section of the YAML file that `--config` or `MAZEBOT_CONFIG` names, over the defaults;
    and the values `given` by name win over all.

    Raises ConfigError with one line that names the source, the field and the value.
    """
    rest, path = _take_config_flag(arguments)
    values = _yaml_section(path, service) if path else {}
    if os.environ.get("MAZEBOT_SEED"):
        # One seed for all services, under one name.
        values = {**values, "seed": os.environ["MAZEBOT_SEED"]}
    prefix = f"MAZEBOT_{service.upper()}_"
    try:
        if rest or any(name.upper().startswith(prefix) for name in os.environ):
            # What reads them takes long to import.
            from services.common.settings import settings  # noqa: PLC0415

            values = settings(model, service, rest, prefix, values)
        return model.model_validate({**values, **given})
    except ValidationError as error:
        raise ConfigError(f"{service}: {one_line(error)}") from error


def one_line(error: ValidationError) -> str:
    """What is wrong, field by field, in one line."""
    parts = []
    for problem in error.errors():
        field = ".".join(str(part) for part in problem["loc"]) or "(whole)"
        parts.append(f"{field}: {problem['msg']} (got {problem['input']!r:.80})")
    return "; ".join(parts)


def fail(message: str) -> None:
    """Print one line on standard error and leave with exit code 2."""
    sys.stderr.write(f"error: {message}\n")
    raise SystemExit(2)


def _take_config_flag(arguments: Sequence[str]) -> tuple[list[str], Path | None]:
    rest: list[str] = []
    path = os.environ.get("MAZEBOT_CONFIG") or None
    words = iter(arguments)
    for word in words:
        if word == "--config":
            path = next(words, None)
            if path is None:
                raise ConfigError("--config: names no file")
        elif word.startswith("--config="):
            path = word.partition("=")[2]
        else:
            rest.append(word)
    return rest, Path(path) if path else None


def _yaml_section(path: Path, service: str) -> dict[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    if content is None:
        return {}
    section = content.get(service, {}) if isinstance(content, dict) else None
    if not isinstance(section, dict):
        raise ConfigError(f"{path}: {service}: must be a mapping of fields to values")
    return section
