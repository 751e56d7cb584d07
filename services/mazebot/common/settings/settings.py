"""Configuration values from flags and the environment."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Collection, Mapping
from typing import Annotated, Any

from pydantic_settings import (
    BaseSettings,
    CliSettingsSource,
    EnvSettingsSource,
    NoDecode,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    SettingsError,
)

from mazebot.common.config import ConfigError, PlainText, ServiceConfig, setting_names
from mazebot.common.settings.known_settings import matching, unknown_setting


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
    names = setting_names(model)
    flags = [_in_full(word, names) for word in arguments]

    class _Environment(EnvSettingsSource):
        def _load_env_vars(self) -> Mapping[str, str | None]:
            """The variables, each by the dotted name of the setting that it stands for."""
            start = env_prefix.lower()
            found = {}
            for variable, value in super()._load_env_vars().items():
                name = variable.removeprefix(start).replace("__", ".")
                full = matching(name, names) if variable.startswith(start) else []
                named = start + full[0].replace(".", "__") if len(full) == 1 else variable
                found[named] = value
            return found

    class Settings(BaseSettings):
        model_config = SettingsConfigDict(
            env_prefix=env_prefix,
            env_nested_delimiter="__",
            extra="forbid",
            frozen=True,
            allow_inf_nan=False,
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
                cli_parse_args=flags,
                cli_prog_name=f"python -m mazebot.{service}",
                cli_kebab_case=True,
                cli_exit_on_error=False,
            )
            return cli, _Environment(settings_cls), init_settings

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
        raise ConfigError(f"{service}: {_plain(str(error), flags, env_prefix, names)}") from error


def flag_of(name: str) -> str:
    """The flag of a setting, by its dotted name."""
    return f"--{name.replace('_', '-')}"


def _in_full(word: str, names: Collection[str]) -> str:
    """A flag with the dotted name of its setting in full. Raises ConfigError where it stands for
    more than one.
    """
    if not word.startswith("--"):
        return word
    flag, equals, value = word.partition("=")
    found = matching(flag.removeprefix("--").replace("-", "_"), names)
    if len(found) > 1:
        raise ConfigError(f"{flag}: ambiguous: must be {' or '.join(map(flag_of, found))}")
    return f"{flag_of(found[0])}{equals}{value}" if found else word


def _plain(message: str, arguments: list[str], env_prefix: str, names: Collection[str]) -> str:
    """pydantic-settings' message, with the flag or variable, the value and what is allowed."""
    unknown = re.search(r"unrecognized arguments: (.*)", message)
    if unknown:
        name, _, value = unknown[1].replace("=", " ", 1).partition(" ")
        given = f"{value!r:.60}: " if value else ""
        hint = unknown_setting(name.removeprefix("--").replace("-", "_"), names, flag_of)
        return f"{name}: {given}no such flag{hint}"
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
