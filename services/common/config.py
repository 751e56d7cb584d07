"""Configuration: flags over environment over YAML file over defaults, and one line for each
mistake.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_settings import (
    BaseSettings,
    CliSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    SettingsError,
)

ROOT = Path(__file__).resolve().parents[2]
"""The folder that holds services/, worlds/ and models/."""


class ConfigError(Exception):
    """A mistake in a person's input: its text is the one line to show."""


class ServiceConfig(BaseModel):
    """What every service's configuration has."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    seed: int = Field(7, ge=0, description="the run's one seed; each random stream derives from it")


C = TypeVar("C", bound=ServiceConfig)


def load(model: type[C], service: str, arguments: list[str]) -> C:
    """Read a service's configuration.

    Flags (`--scan-rate-hz 5`) win over the environment (`MAZEBOT_PHYSICS_SCAN_RATE_HZ`), over the
    service's section
    of the YAML file that `--config` or `MAZEBOT_CONFIG` names, over the defaults.

    Raises ConfigError with one line that names the source, the field and the value.
    """
    rest, path = _take_config_flag(arguments)
    section = _yaml_section(path, service) if path else {}
    if os.environ.get("MAZEBOT_SEED"):
        # One seed for all services, under one name.
        section = {**section, "seed": os.environ["MAZEBOT_SEED"]}
    prefix = f"MAZEBOT_{service.upper()}_"

    class Settings(BaseSettings):
        model_config = SettingsConfigDict(
            env_prefix=prefix, extra="forbid", frozen=True, allow_inf_nan=False
        )

        @classmethod
        def settings_customise_sources(
            cls,
            settings_cls: type[BaseSettings],
            init_settings: PydanticBaseSettingsSource,
            env_settings: PydanticBaseSettingsSource,
            dotenv_settings: PydanticBaseSettingsSource,
            file_secret_settings: PydanticBaseSettingsSource,
        ) -> tuple[PydanticBaseSettingsSource, ...]:
            cli: CliSettingsSource[BaseSettings] = CliSettingsSource(
                settings_cls,
                cli_parse_args=rest,
                cli_prog_name=f"python -m services.{service}",
                cli_kebab_case=True,
                cli_exit_on_error=False,
            )
            return cli, env_settings, init_settings

    fields: dict[str, Any] = {
        "__annotations__": {k: f.rebuild_annotation() for k, f in model.model_fields.items()},
        "__module__": model.__module__,
        "__doc__": model.__doc__,
    }
    for name, info in model.model_fields.items():
        fields[name] = info
    settings_type: type[BaseSettings] = type(model.__name__, (Settings,), fields)
    try:
        # Only what somebody set: what is not set may follow from what is.
        values = settings_type(**section).model_dump(exclude_unset=True)
        return model.model_validate(values)
    except ValidationError as error:
        raise ConfigError(f"{service}: {one_line(error)}") from error
    except SettingsError as error:
        raise ConfigError(f"{service}: {' '.join(str(error).split())}") from error


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


def _take_config_flag(arguments: list[str]) -> tuple[list[str], Path | None]:
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
