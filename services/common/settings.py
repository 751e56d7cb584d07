"""What flags and the environment say of a configuration."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic_settings import (
    BaseSettings,
    CliSettingsSource,
    NoDecode,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    SettingsError,
)

from services.common.config import ConfigError, PlainText, ServiceConfig


def settings(
    model: type[ServiceConfig],
    service: str,
    arguments: list[str],
    env_prefix: str,
    section: dict[str, Any],
) -> dict[str, Any]:
    """The values that somebody set: flags win over the environment, and that over `section`.

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
        # Only what somebody set: what is not set may follow from what is.
        return settings_type(**section).model_dump(exclude_unset=True)
    except SettingsError as error:
        raise ConfigError(f"{service}: {' '.join(str(error).split())}") from error
