"""Options shared by several commands."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from mazebot.common.config import ConfigError

RESOURCE_PATHS = ("MAZEBOT_RESOURCE_PATH", "GZ_SIM_RESOURCE_PATH")
ROUTER = "tcp/127.0.0.1:7447"
Connect = Annotated[
    str,
    typer.Option(envvar="MAZEBOT_BUS_CONNECT", help="Zenoh endpoint of the stack's router"),
]
Json = Annotated[bool, typer.Option("--json", help="print JSON")]
UseAruco = Annotated[
    str | None,
    typer.Option(
        "--use_aruco", "--use-aruco", envvar="USE_ARUCO", help="True or False [default: True]"
    ),
]
TextureBase = Annotated[
    Path | None,
    typer.Option(
        "--texture_base", "--texture-base", envvar="TEXTURE_BASE",
        help="folder of the wall textures [default: worlds/textures]",
    ),
]  # fmt: skip
Camera = Annotated[
    bool | None, typer.Option("--camera/--no-camera", help="simulate one [default: camera]")
]


def print_json(value: object) -> None:
    """Print a value for programs."""
    sys.stdout.write(json.dumps(value, indent=2, allow_nan=False) + "\n")


def model_folders(option: str, given: Sequence[Path] | None) -> tuple[Path, ...]:
    """Folders of models: those given, then those of the environment.

    Raises ConfigError where a given one is not a folder.
    """
    for folder in given or ():
        if not folder.is_dir():
            raise ConfigError(f"{option}: {folder}: must be a folder")
    listed = (
        Path(part)
        for variable in RESOURCE_PATHS
        for part in os.environ.get(variable, "").split(os.pathsep)
        if part
    )
    return (*(given or ()), *listed)


def xacro_arguments(arguments: Sequence[str] | None) -> dict[str, str]:
    """The values of `--arg name:=value` by name.

    Raises ConfigError where one has another form.
    """
    pairs = {}
    for argument in arguments or []:
        name, given, value = argument.partition(":=")
        if not given or not name:
            raise ConfigError(f"--arg: {argument!r}: must be name:=value")
        pairs[name] = value
    return pairs
