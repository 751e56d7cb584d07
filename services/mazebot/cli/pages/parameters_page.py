"""Prints docs/parameters.md from the configuration of every service."""

from __future__ import annotations

import re
import sys
from typing import Any

from mazebot.bringup.config import BringupConfig
from mazebot.cli.pages.schema_words import default_in_yaml, kind_in_words, one_cell
from mazebot.common.bus.config import BusConfig
from mazebot.common.config import ServiceConfig
from mazebot.common.files.root import ROOT
from mazebot.console.config import ConsoleConfig
from mazebot.explorer.config import ExplorerConfig
from mazebot.localization.config import LocalizationConfig
from mazebot.mapping.config import MappingConfig
from mazebot.navigation.config import NavigationConfig
from mazebot.perception.config import PerceptionConfig
from mazebot.physics.config import PhysicsConfig
from mazebot.recorder.config import RecorderConfig
from mazebot.ros2_bridge.config import Ros2BridgeConfig
from mazebot.router.config import RouterConfig
from mazebot.spawner.config import SpawnerConfig
from mazebot.worldgen.config import WorldgenConfig

CONFIGS: dict[str, type[ServiceConfig]] = {
    "bus": BusConfig,
    "worldgen": WorldgenConfig,
    "physics": PhysicsConfig,
    "spawner": SpawnerConfig,
    "perception": PerceptionConfig,
    "localization": LocalizationConfig,
    "mapping": MappingConfig,
    "navigation": NavigationConfig,
    "explorer": ExplorerConfig,
    "recorder": RecorderConfig,
    "bringup": BringupConfig,
    "console": ConsoleConfig,
    "router": RouterConfig,
    "ros2_bridge": Ros2BridgeConfig,
}

UNITS = {
    "m_s2": "m/s²",
    "rad_s2": "rad/s²",
    "m_per_sqrt_m": "m/√m",
    "rad_s": "rad/s",
    "m_s": "m/s",
    "n_m": "N m",
    "hz": "Hz",
    "rad": "rad",
    "px": "px",
    "mib": "MiB",
    "cells": "cells",
    "s": "s",
    "m": "m",
}
"""Suffixes of field names and their units, longer suffixes first."""

_UNIT = re.compile(r"(m/s2|rad/s2|m/s|rad/s|1/m|m|rad|s)(?:; |$)")
"""A unit at the start of a description: names taken from Nav2 contain none."""

_HEAD = """# Parameters

Generated from the services' `config.py` files by `make generate`; do not edit.

Every parameter of every service: its unit, valid values, default and meaning. A parameter is set in
one of five places; the first that sets it wins:

1. a flag of one service: `python -m mazebot.physics --scan-rate-hz 5`
2. the environment: `MAZEBOT_PHYSICS_SCAN_RATE_HZ=5`
3. a YAML file with a section for each service, named by `MAZEBOT_CONFIG` or `--config`:

   ```yaml
   physics: {scan_rate_hz: 5.0}
   navigation:
     controller_server: {max_linear_vel: 0.3, mppi: {batch_size: 1000}}
   ```

4. [a parameter file of Nav2](nav2-params.md), named by `MAZEBOT_PARAMS` or `--params`
5. the default.

A setting of a section has a dotted name: `--controller-server.max-linear-vel 0.3`, and with two
underscores for a dot `MAZEBOT_NAVIGATION_CONTROLLER_SERVER__MAX_LINEAR_VEL=0.3`. Where the last
part of the name is unique, it is enough: `--max-linear-vel 0.3`.
A value that is a mapping or a list is JSON in the environment
(`MAZEBOT_BRINGUP_GOAL='[0.5, -0.9, 0]'`). `MAZEBOT_SEED` sets the seed of all
services. The values in force are on the topic `/parameters` and in the `config.yaml` of every run.
"""


def parameters_page() -> str:
    """Return the text of the page."""
    parts = [_HEAD]
    for name, config in CONFIGS.items():
        about = " ".join((config.__doc__ or "").split())
        head = [f"## {name}", "", about, "", "| parameter | unit | value | default | meaning |"]
        schema = config.model_json_schema()
        rows = [
            row
            for row in parameter_rows(schema, schema.get("$defs", {}))
            if name == "bus" or row[0] != "seed"
        ]
        lines = [f"| `{row[0]}` | {' | '.join(row[1:])} |" for row in rows]
        parts.append("\n".join([*head, "| --- " * 5 + "|", *lines]) + "\n")
    return "\n".join(parts)


def parameter_rows(
    schema: dict[str, Any], definitions: dict[str, Any], prefix: str = ""
) -> list[tuple[str, str, str, str, str]]:
    """Name, unit, value, default and meaning of each field; nested fields have dotted names."""
    rows = []
    for name, field in schema["properties"].items():
        if "$ref" in field:
            nested = definitions[field["$ref"].rpartition("/")[2]]
            rows += parameter_rows(nested, definitions, f"{prefix}{name}.")
            continue
        unit, meaning = unit_and_meaning(name, field.get("description", ""))
        each = field.get("additionalProperties")
        if isinstance(each, dict) and "$ref" in each:
            default = default_in_yaml(list(field.get("default", {})))
            rows.append((prefix + name, "", "mapping of names to sections", default, meaning))
            nested = definitions[each["$ref"].rpartition("/")[2]]
            rows += parameter_rows(nested, definitions, f"{prefix}{name}.NAME.")
            continue
        # A default folder is relative to the repository, not to this machine's root.
        value = field.get("default")
        if isinstance(value, str):
            value = value.removeprefix(f"{ROOT}/")
        rows.append(
            (
                prefix + name,
                unit,
                kind_in_words(field, definitions),
                default_in_yaml(value),
                one_cell(meaning),
            )
        )
    return rows


def unit_and_meaning(name: str, description: str) -> tuple[str, str]:
    """The unit of a field, by its name's suffix or its description's start, and the other text.

    The unit is "" where there is none.
    """
    match = _UNIT.match(description)
    if match:
        return match[1].replace("s2", "s²"), description[match.end() :]
    for ending, unit in UNITS.items():
        if name.endswith(f"_{ending}"):
            return unit, description
    return "", description


if __name__ == "__main__":
    sys.stdout.write(parameters_page())
