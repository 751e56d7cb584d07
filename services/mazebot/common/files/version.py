"""Mazebot's version, which pyproject.toml alone states."""

import functools
import tomllib
from importlib import metadata

from mazebot.common.files.root import ROOT


@functools.cache
def mazebot_version() -> str:
    """Of the checkout's pyproject.toml, else of the installed package; "unknown" without either.

    The metadata of an editable install is that of the day on which it was installed.
    """
    try:
        with (ROOT / "pyproject.toml").open("rb") as file:
            return str(tomllib.load(file)["project"]["version"])
    except (OSError, KeyError, tomllib.TOMLDecodeError):
        pass
    try:
        return metadata.version("mazebot")
    except metadata.PackageNotFoundError:
        return "unknown"
