"""Checks for unknown settings, done before a command runs."""

from __future__ import annotations

import os
import shlex
from collections.abc import Collection
from importlib import import_module
from pathlib import Path

from mazebot.common.config import ConfigError, ServiceConfig, setting_names
from mazebot.common.settings.known_settings import ALONE, PREFIX, unknown_variable
from mazebot.common.settings.load import read_settings, sections

_ELSEWHERE = {
    "SEED": "--seed {} or MAZEBOT_SEED={}",
    "WORLD": "--world {}",
    "SET": "--set {}",
    "WORLD_SET": "--set {}",
    "WORLDS_DIR": "--worlds-dir {} or MAZEBOT_WORLDGEN_WORLDS_DIR={}",
    "PACE": "",
}
"""Variables that only make and Docker Compose read, and the replacement for a run in one process.
"""


def check_environment() -> None:
    """Raises ConfigError where a `MAZEBOT_*` variable belongs to no service."""
    mine = [name for name in os.environ if name.upper().startswith(PREFIX)]
    # Every command that connects handles this variable itself.
    if {name.upper() for name in mine} - {"MAZEBOT_BUS_CONNECT", *ALONE}:
        problem = unknown_variable(mine, fields_of_all())
        if problem:
            raise ConfigError(problem)


def check_file(path: Path) -> None:
    """Raises ConfigError where a settings file has an unknown section or field."""
    read_settings(path, fields_of_all())


def check_not_for_make(given: Collection[str], reads: Collection[str] = ()) -> None:
    """Raises ConfigError where the environment sets a variable for make or Docker Compose that this
    command ignores, unless it `reads` it, or the corresponding option is `given`.
    """
    for name, instead in _ELSEWHERE.items():
        value = os.environ.get(name)
        option = instead.partition(" ")[0]
        if not value or option in given or name in reads:
            continue
        if name == "PACE":
            if value == "lockstep":
                continue
            must = "a run in one process always runs in lockstep, as fast as possible"
        else:
            must = f"must be given as {instead.format(shlex.quote(value), shlex.quote(value))}"
        raise ConfigError(f"{name}: {value!r:.60}: only used by make and Compose: {must}")


def fields_of_all() -> dict[str, Collection[str]]:
    """The names of all settings, by section."""
    return {section: setting_names(model_of(section)) for section in sections()}


def model_of(section: str) -> type[ServiceConfig]:
    """The configuration of a section, by its name: `bus` or a service."""
    where = "common.bus" if section == "bus" else section
    module = import_module(f"mazebot.{where}.config")
    name = "".join(word.capitalize() for word in section.split("_"))
    model: type[ServiceConfig] = getattr(module, f"{name}Config")
    return model
