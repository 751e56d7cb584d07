"""The settings of a run, by name: from its summary.json and config.yaml."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mazebot.common.config import ConfigError
from mazebot.common.files import bounded_yaml
from mazebot.common.files.limits import MAX_DOCUMENT_BYTES
from mazebot.common.files.reading import NotReadableError, read_limited
from mazebot.common.files.yaml_words import line_and_words
from mazebot.common.recordings.run_folder import CONFIG, SUMMARY

_NO_MATTER = ("services.recorder.", "world_hash")
"""Settings without influence on the run, and one that the summary gives better."""


def settings_of(folder: Path) -> dict[str, Any]:
    """All settings of a run, by name: world, seed, versions, and `service.field`.

    Raises ConfigError with one line where a file cannot be read, or holds no settings.
    """
    summary = read_summary(folder)
    named = ("world", "world_hash", "seed", "renderer")
    settings = {name: summary[name] for name in named if name in summary}
    settings |= _flat("", {"version": summary.get("versions")})
    for name, value in _flat("", read_config(folder)).items():
        if not name.startswith(_NO_MATTER):
            settings.setdefault(name.removeprefix("services."), value)
    return settings


def read_summary(folder: Path) -> dict[str, Any]:
    """The summary.json of a run; empty if it has none. Raises as `settings_of`."""
    return _mapping(folder / SUMMARY, json.loads)


def read_config(folder: Path) -> dict[str, Any]:
    """The config.yaml of a run; empty if it has none. Raises as `settings_of`."""
    return _mapping(folder / CONFIG, bounded_yaml.load)


def _mapping(path: Path, parse: Callable[[str], Any]) -> dict[str, Any]:
    """The content of a run's file; empty if it is missing, as in a run that was killed."""
    try:
        content = parse(read_limited(path, MAX_DOCUMENT_BYTES).decode())
    except FileNotFoundError:
        return {}
    except NotReadableError as error:
        raise ConfigError(f"{path}: {error}") from error
    except (OSError, *bounded_yaml.ERRORS) as error:
        line, reason = line_and_words(error)
        raise ConfigError(f"{path}{f':{line}' if line else ''}: {reason}") from error
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: contains no settings")
    return content


def _flat(prefix: str, values: dict[Any, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat |= _flat(f"{prefix}{name}.", value)
        else:
            flat[f"{prefix}{name}"] = value
    return flat
