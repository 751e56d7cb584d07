"""The settings with which a service is replayed: those of the recording, unless given otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from mazebot.cli.parsing.known import fields_of_all, model_of
from mazebot.common.config import ConfigError, ServiceConfig, one_line
from mazebot.common.messages.topics import SERVICES
from mazebot.common.node.node import Node
from mazebot.common.settings.known_settings import unknown_name
from mazebot.common.settings.load import read_settings
from mazebot.common.settings.settings import settings

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
    fields = model.model_fields
    given = {name: value for name, value in recorded.items() if name in fields}
    values = dict(given)
    filed: dict[str, Any] = {}
    if path is not None:
        filed = read_settings(path, fields_of_all()).get(service, {})
        values |= filed
    flags = [_flag(service, override, fields) for override in overrides]
    named = {override.partition("=")[0].partition(".")[0] for override in overrides}

    def source(field: str) -> str:
        if field in named:
            return "--set"
        return str(path) if field in filed else "the recording"

    try:
        if flags:
            values = settings(model, service, flags, _NO_ENVIRONMENT, values)
        config = model.model_validate(values)
        before = model.model_validate(given).model_dump(mode="json") if recorded else {}
    except ValidationError as error:
        raise ConfigError(f"{service}: {one_line(error, source)}") from error
    now = config.model_dump(mode="json")
    changed = {name: (before[name], now[name]) for name in before if before[name] != now[name]}
    return Settings(config, changed)


def _flag(service: str, override: str, fields: Mapping[str, Any]) -> str:
    name, equals, value = override.partition("=")
    top = name.partition(".")[0]
    if not equals or not name:
        raise ConfigError(f"--set: {override!r:.60}: must be name=value")
    if top not in fields:
        hint = unknown_name(top, fields)
        raise ConfigError(f"--set: {override!r:.60}: {service} has no setting {top!r:.40}{hint}")
    return f"--{name.replace('_', '-')}={value}"


def make_node(service: str, config: ServiceConfig) -> Node:
    """A service's node. Raises ConfigError where it cannot run with these settings."""
    module = import_module(f"mazebot.{service}.node")
    node: Node = getattr(module, f"{service.capitalize()}Node")(config)
    return node
