"""Configuration values from flags and the environment."""

from __future__ import annotations

import itertools
import os
import re
from typing import Annotated, Any

from pydantic_settings import (
    BaseSettings,
    CliSettingsSource,
    NoDecode,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    SettingsError,
)

from mazebot.common.config import ConfigError, PlainText, ServiceConfig
from mazebot.common.settings.known_settings import unknown_name


def settings(
    model: type[ServiceConfig],
    service: str,
    arguments: list[str],
    env_prefix: str,
    section: dict[str, Any],
) -> dict[str, Any]:
    """The values that were set: flags win over the environment, and the environment over `section`.

    Raises ConfigError, or pydantic's ValidationError.
    """

    class Settings(BaseSettings):
        model_config = SettingsConfigDict(
            env_prefix=env_prefix, extra="forbid", frozen=True, allow_inf_nan=False
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
                cli_parse_args=arguments,
                cli_prog_name=f"python -m services.{service}",
                cli_kebab_case=True,
                cli_exit_on_error=False,
            )
            return cli, env_settings, init_settings

    annotations: dict[str, Any] = {}
    for name, info in model.model_fields.items():
        annotation = info.rebuild_annotation()
        plain = PlainText in info.metadata
        annotations[name] = Annotated[annotation, NoDecode] if plain else annotation
    fields: dict[str, Any] = {
        **model.model_fields,
        "__annotations__": annotations,
        "__module__": model.__module__,
        "__doc__": model.__doc__,
    }
    settings_type: type[BaseSettings] = type(model.__name__, (Settings,), fields)
    try:
        # Only values that were set: defaults may depend on them.
        return settings_type(**section).model_dump(exclude_unset=True)
    except SettingsError as error:
        flags = [f"--{name.replace('_', '-')}" for name in model.model_fields]
        raise ConfigError(
            f"{service}: {_plain(str(error), arguments, env_prefix, flags)}"
        ) from error


def _plain(message: str, arguments: list[str], env_prefix: str, flags: list[str]) -> str:
    """pydantic-settings' message, with the flag or variable, the value and what is allowed."""
    unknown = re.search(r"unrecognized arguments: (.*)", message)
    if unknown:
        name, _, value = unknown[1].replace("=", " ", 1).partition(" ")
        given = f"{value!r:.60}: " if value else ""
        return f"{name}: {given}no such flag{unknown_name(name, flags)}"
    alone = re.search(r"argument (--\S+): expected", message)
    if alone:
        return f"{alone[1]}: must be followed by a value"
    field = re.search(r'field "(\w+)"|encountered for (\w+)', message)
    if field is None:
        return " ".join(message.split())
    name = field[1] or field[2]
    flag = f"--{name.replace('_', '-')}"
    values = [value for word, value in itertools.pairwise(arguments) if word == flag]
    values += [word.removeprefix(f"{flag}=") for word in arguments if word.startswith(f"{flag}=")]
    origin = flag if values else f"{env_prefix}{name}".upper()
    value = values[-1] if values else os.environ.get(origin, "")
    return f"{name}: must be JSON (got {value!r:.80} from {origin})"
