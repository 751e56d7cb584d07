"""Which runs of a folder a command is about."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Literal

from mazebot.common.config import ConfigError
from mazebot.common.recordings.catalog import RecordingInfo, list_recordings

DEFAULT = Path("recordings")
SortKey = Literal["started", "name", "world", "goals", "time", "error", "size"]

_AGE = re.compile(r"(\d+(?:\.\d+)?) ?(min|h|d|w)")
_UNITS = {"min": "minutes", "h": "hours", "d": "days", "w": "weeks"}
_KEYS: dict[str, Callable[[RecordingInfo], Any]] = {
    "started": lambda run: run.started or datetime.min,  # noqa: DTZ901
    "name": lambda run: run.name,
    "world": lambda run: run.world,
    "goals": lambda run: (run.goals_reached, run.goals_total),
    "time": lambda run: run.sim_time_s or 0.0,
    "error": lambda run: run.error_mean_m or 0.0,
    "size": lambda run: run.size_bytes,
}
_FIRST_IS_LEAST = ("name", "world")


def folder_of(directory: Path | None) -> Path:
    """The folder of recordings. Raises ConfigError where the given path is not a folder."""
    if directory is not None and not directory.is_dir():
        raise ConfigError(f"--dir: {directory}: must be a folder of recordings")
    return directory or DEFAULT


def chosen_runs(
    directory: Path,
    world: str | None = None,
    tags: Sequence[str] = (),
    failed: bool = False,
    since: str | None = None,
    sort: SortKey = "started",
    reverse: bool = False,
) -> list[RecordingInfo]:
    """The runs that fit all that is given, sorted: by name and world from A on, by anything else
    from the newest or greatest on; `reverse`: the other way round.

    Raises ConfigError where `since` is no time.
    """
    after = None if since is None else time_of(since, datetime.now())  # noqa: DTZ005 - local
    fits = None if world is None else _world_filter(world)
    runs = [
        run
        for run in list_recordings(directory)
        if (fits is None or fits(run.world))
        and all(tag in run.tags for tag in tags)
        and (not failed or run.failed)
        and (after is None or (run.started is not None and run.started >= after))
    ]
    return sorted(runs, key=_KEYS[sort], reverse=reverse != (sort not in _FIRST_IS_LEAST))


def _world_filter(text: str) -> Callable[[str], bool]:
    """Whether a world's name contains a text, or is the one that this is short for."""
    from mazebot.worldgen.recipe.sources import SHORT_NAMES  # noqa: PLC0415 - only where it is asked

    name = SHORT_NAMES.get(text)
    return lambda world: text.lower() in world.lower() if name is None else world == name


def time_of(text: str, now: datetime) -> datetime:
    """A local time from a date and time, or from an age such as `90min`, `12h`, `7d`, `2w`.

    Raises ConfigError where the text is neither.
    """
    try:
        age = _AGE.fullmatch(text)
        if age is not None:
            return now - timedelta(**{_UNITS[age[2]]: float(age[1])})
        moment = datetime.fromisoformat(text)
        return moment.astimezone().replace(tzinfo=None) if moment.tzinfo else moment
    except (ValueError, OverflowError) as error:
        expected = (
            "must be a date such as 2026-11-20 or 2026-11-20T14:30, or an age such as 7d or 12h"
        )
        raise ConfigError(f"--since: {text!r:.80}: {expected}") from error
