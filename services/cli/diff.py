"""`mazebot diff`: the settings of two runs, and their first differences."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from services.cli.options import print_json
from services.common.config import ConfigError
from services.common.node.topics import CMD_VEL
from services.common.recordings.digests import DigestError, Digests, read_digests
from services.common.recordings.run_comparison import Comparison, Difference, compare
from services.common.recordings.run_folder import CONFIG, DIGESTS, LOCK, SUMMARY
from services.common.yaml_words import line_and_words

_CONTROL_RATE_HZ = CMD_VEL.rate_hz or 20.0
_MOST_LINES = 12
_NO_MATTER = ("services.recorder.", "world_hash")
"""Settings without influence on the run, and one that the summary gives better."""


def diff_runs(directory: Path, first: str, second: str, as_json: bool = False) -> int:
    """Print the differences of two runs, by folder or name, in settings and messages; return 0 if
    all messages are the same, else 1.

    Raises ConfigError where one of them is not a run, or has no digests.
    """
    folders = _find(directory, first), _find(directory, second)
    comparison = compare(_read(folders[0]), _read(folders[1]))
    code = 1 if comparison.differences else 0
    still = [(folder / LOCK).exists() for folder in folders]
    if as_json:
        one, other = map(_settings, folders)
        settings = {
            name: [one.get(name), other.get(name)]
            for name in dict.fromkeys((*one, *other))
            if one.get(name) != other.get(name)
        }
        told = {"same": not code, "settings": settings, "not_ended": still}
        print_json(told | dataclasses.asdict(comparison))
        return code
    lines = [*_told(*folders), *_said(comparison)]
    for which, open_still in zip(("first", "second"), still, strict=True):
        if open_still:
            lines.append(f"the {which} run has not ended, or its recorder was killed")
    sys.stdout.write("\n".join(lines) + "\n")
    return code


def _find(directory: Path, name: str) -> Path:
    for folder in (Path(name), directory / name):
        if any((folder / file).is_file() for file in (DIGESTS, SUMMARY)):
            return folder
    raise ConfigError(f"diff: {name!r} is no folder of a run, and no run in {directory}")


def _read(folder: Path) -> Digests:
    try:
        return read_digests(folder / DIGESTS)
    except FileNotFoundError as error:
        raise ConfigError(
            f"diff: {folder} has no {DIGESTS}: it was made without a recording"
        ) from error
    except OSError as error:
        raise ConfigError(f"diff: {folder / DIGESTS}: {error.strerror}") from error
    except DigestError as error:
        raise ConfigError(f"diff: {error}") from error


def _told(first: Path, second: Path) -> Iterator[str]:
    """The differences in the runs' settings."""
    one, other = _settings(first), _settings(second)
    same = True
    for name in dict.fromkeys((*one, *other)):
        if one.get(name) != other.get(name):
            same = False
            yield f"{name}: {_text(one, name)} | {_text(other, name)}"
    if same:
        world, seed = one.get("world", "?"), one.get("seed", "?")
        yield f"same world ({world}), seed ({seed}), configuration and versions"


def _settings(folder: Path) -> dict[str, Any]:
    """All settings of a run, by name."""
    summary = _mapping(folder / SUMMARY, json.loads)
    named = ("world", "world_hash", "seed", "renderer")
    settings = {name: summary[name] for name in named if name in summary}
    settings |= _flat("", {"version": summary.get("versions")})
    config = _mapping(folder / CONFIG, yaml.safe_load)
    for name, value in _flat("", config).items():
        if not name.startswith(_NO_MATTER):
            settings.setdefault(name.removeprefix("services."), value)
    return settings


def _mapping(path: Path, parse: Any) -> dict[str, Any]:
    """The content of a run's file; empty if it is missing, as in a run that was killed."""
    try:
        content = parse(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        line, said = line_and_words(error)
        raise ConfigError(f"diff: {path}{f':{line}' if line else ''}: {said}") from error
    if not isinstance(content, dict):
        raise ConfigError(f"diff: {path}: holds no settings")
    return content


def _flat(prefix: str, values: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat |= _flat(f"{prefix}{name}.", value)
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def _text(settings: dict[str, Any], name: str) -> str:
    return str(settings[name]) if name in settings else "-"


def _said(comparison: Comparison) -> Iterator[str]:
    """The differences in the runs' messages."""
    differences = comparison.differences
    first_ns, second_ns = comparison.ends_ns
    if differences:
        yield f"first difference: {_line(differences[0])}"
        for difference in differences[1:_MOST_LINES]:
            yield f"             then: {_line(difference)}"
        if len(differences) > _MOST_LINES:
            yield f"             and on {len(differences) - _MOST_LINES} more topics"
        yield f"{comparison.messages} messages are the same"
    else:
        common_s = min(first_ns, second_ns) * 1e-9
        yield f"the same: {comparison.messages} messages in {common_s:.3f} s of simulation time"
    if first_ns != second_ns:
        longer = "first" if first_ns > second_ns else "second"
        yield f"the {longer} run goes on for another {abs(first_ns - second_ns) * 1e-9:.3f} s"
    for which, lost in zip(("first", "second"), comparison.lost, strict=True):
        if lost:
            yield f"{lost} messages never came to the {which} run's recorder: not compared"


def _line(difference: Difference) -> str:
    tick = int(difference.time_ns * 1e-9 * _CONTROL_RATE_HZ)
    of = f" of {difference.source}" if difference.source else ""
    how = {None: "differs", 0: "is in the first run only", 1: "is in the second run only"}
    return (
        f"{difference.time_ns * 1e-9:.3f} s (control tick {tick}), {difference.topic}{of}: "
        f"message {difference.number} {how[difference.only_in]}"
    )
