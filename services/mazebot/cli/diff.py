"""`mazebot diff`: the settings of two runs, and their first differences."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mazebot.cli.parsing.options import print_json
from mazebot.common.config import ConfigError
from mazebot.common.recordings.catalog import LATEST, find_run, run_at
from mazebot.common.recordings.comparing.compare_runs import comparison_lines, read_run_digests
from mazebot.common.recordings.comparing.run_comparison import compare
from mazebot.common.recordings.comparing.wholeness import faults
from mazebot.common.recordings.run_folder import DIGESTS, SUMMARY
from mazebot.common.recordings.run_settings import settings_of


def diff_runs(directory: Path, first: str, second: str, as_json: bool = False) -> int:
    """Print the differences of two runs, by folder, name or `latest`, in settings and messages;
    return 0 if all messages are the same, else 1; also where the files of a run are cut, missing or
    another run's.

    Raises ConfigError where one of them is not a run, or has no digests.
    """
    folders = _find(directory, first), _find(directory, second)
    try:
        comparison = compare(*map(read_run_digests, folders))
        settings = [settings_of(folder) for folder in folders]
    except ConfigError as error:
        raise ConfigError(f"diff: {error}") from error
    of_runs = [faults(folder) for folder in folders]
    code = 1 if comparison.differences or any(of_runs) else 0
    runs = [run_at(folder) for folder in folders]
    still = [run is not None and run.state != "ended" for run in runs]
    if as_json:
        one, other = settings
        differing = {
            name: [one.get(name), other.get(name)]
            for name in dict.fromkeys((*one, *other))
            if one.get(name) != other.get(name)
        }
        summary = {"same": not code, "settings": differing, "not_ended": still, "faults": of_runs}
        print_json(summary | dataclasses.asdict(comparison))
        return code
    lines = [*_setting_lines(*settings), *comparison_lines(comparison)]
    for which, open_still in zip(("first", "second"), still, strict=True):
        if open_still:
            lines.append(f"the {which} run has not ended, or its recorder was killed")
    for which, of_run in zip(("first", "second"), of_runs, strict=True):
        lines += [f"the {which} run is not whole: {fault}" for fault in of_run]
    sys.stdout.write("\n".join(lines) + "\n")
    return code


def _find(directory: Path, name: str) -> Path:
    if name == LATEST:
        return find_run("diff", directory, name, DIGESTS).path
    for folder in (Path(name), directory / name):
        if any((folder / file).is_file() for file in (DIGESTS, SUMMARY)):
            return folder
    raise ConfigError(f"diff: {name!r}: no such run in {directory}, and not a folder of a run")


def _setting_lines(one: dict[str, Any], other: dict[str, Any]) -> Iterator[str]:
    """The differences in the runs' settings."""
    same = True
    for name in dict.fromkeys((*one, *other)):
        if one.get(name) != other.get(name):
            same = False
            yield f"{name}: {_text(one, name)} | {_text(other, name)}"
    if same:
        world, seed = one.get("world", "?"), one.get("seed", "?")
        yield f"same world ({world}), seed ({seed}), configuration and versions"


def _text(settings: dict[str, Any], name: str) -> str:
    return str(settings[name]) if name in settings else "-"
