"""The settings with which a service is replayed: those of the recording, unless given otherwise."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from mazebot.cli.parsing.known import fields_of_all, model_of
from mazebot.common.config import (
    ConfigError,
    ServiceConfig,
    merged,
    one_line,
    setting_names,
    value_of,
)
from mazebot.common.messages.topics import SERVICES
from mazebot.common.node.node import Node
from mazebot.common.settings.known_settings import matching, unknown_setting
from mazebot.common.settings.load import read_settings
from mazebot.common.settings.settings import flag_of, settings

REPLAYABLE = tuple(service for service in SERVICES if service != "recorder")
"""The recorder sends nothing but its verdict, which holds wall times."""
_NO_ENVIRONMENT = "MAZEBOT_REPLAY_"
"""No variable begins so: the recording's settings hold, whatever the environment contains."""


@dataclass(frozen=True)
class Settings:
    """The configuration of a service in a replay."""

    config: ServiceConfig
    changed: dict[str, tuple[Any, Any]]
    """The fields that are others than in the recording, with both values."""


def check_service(service: str) -> None:
    """Raises ConfigError where a service cannot be replayed."""
    if service not in REPLAYABLE:
        expected = f"must be one of {', '.join(REPLAYABLE)}"
        if service == "recorder":
            expected = f"publishes only an evaluation with wall times: {expected}"
        raise ConfigError(f"--service: {service!r:.60}: {expected}")


def settings_of(
    service: str, recorded: Mapping[str, Any], path: Path | None, overrides: Sequence[str]
) -> Settings:
    """The recorded settings, under those of a settings file, under `name=value` overrides.

    Raises ConfigError where one is unknown or invalid.
    """
    model = model_of(service)
    names = setting_names(model)
    given = {name: value for name, value in recorded.items() if name in names}
    filed = {} if path is None else read_settings(path, fields_of_all()).get(service, {})
    values = merged(given, filed)
    flags = [_flag(service, override, names) for override in overrides]
    overridden = [flag.partition("=")[0] for flag in flags]

    def source(field: str) -> str:
        if flag_of(field) in overridden:
            return "--set"
        return "the recording" if value_of(filed, field) is None else str(path)

    try:
        if flags:
            values = settings(model, service, flags, _NO_ENVIRONMENT, values)
        config = model.model_validate(values)
        before = model.model_validate(given).model_dump(mode="json") if recorded else {}
    except ValidationError as error:
        raise ConfigError(f"{service}: {one_line(error, source)}") from error
    now = config.model_dump(mode="json")
    both = {name: (value_of(before, name), value_of(now, name)) for name in names if before}
    changed = {
        name: values
        for name, values in both.items()
        if values[0] != values[1] and not isinstance(values[0], dict)
    }
    return Settings(config, changed)


def _flag(service: str, override: str, names: Collection[str]) -> str:
    name, equals, value = override.partition("=")
    if not equals or not name:
        raise ConfigError(f"--set: {override!r:.60}: must be name=value")
    found = matching(name, names)
    if not found:
        hint = unknown_setting(name, names)
        raise ConfigError(f"--set: {override!r:.60}: {service} has no setting {name!r:.40}{hint}")
    if len(found) > 1:
        raise ConfigError(f"--set: {override!r:.60}: ambiguous: must be {' or '.join(found)}")
    return f"{flag_of(found[0])}={value}"


def make_node(service: str, config: ServiceConfig) -> Node:
    """A service's node. Raises ConfigError where it cannot run with these settings."""
    module = import_module(f"mazebot.{service}.node")
    node: Node = getattr(module, f"{service.capitalize()}Node")(config)
    return node
