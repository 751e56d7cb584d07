"""Shell completion of names."""

from __future__ import annotations

import contextlib
import glob
import os
from pathlib import Path

import typer

from mazebot.common.config import ConfigError

SIMULATOR, NAVIGATION = "simulator", "navigation-only"
"""Halves of a stack: names that stand for several services."""


def world_names(incomplete: str) -> list[str]:
    """The worlds' names and their short names."""
    from mazebot.common.files.root import ROOT  # noqa: PLC0415 - on TAB alone
    from mazebot.worldgen.recipe.sources import SHORT_NAMES, known_worlds  # noqa: PLC0415

    folder = os.environ.get("MAZEBOT_WORLDGEN_WORLDS_DIR")
    try:
        known = known_worlds(Path(folder) if folder else ROOT / "worlds")
    except ConfigError:
        return []
    short = [name for name, stem in SHORT_NAMES.items() if stem in known]
    return [name for name in (*short, *known) if name.startswith(incomplete)]


def topic_names(incomplete: str) -> list[str]:
    """All topics, with their slashes."""
    from mazebot.common.messages.topics import TOPICS  # noqa: PLC0415 - loads the messages

    return sorted(topic.name for topic in TOPICS if topic.name.startswith(incomplete))


def written_topic_names(incomplete: str) -> list[str]:
    """The topics that the user's tools may publish."""
    from mazebot.common.messages.topics import EDGE, owned_by  # noqa: PLC0415

    mine = {topic.name for topic in owned_by(EDGE)}
    return [name for name in topic_names(incomplete) if name in mine]


def run_names(context: typer.Context, incomplete: str) -> list[str]:
    """The runs in --dir or ./recordings, newest first."""
    folders = _recordings(context).glob(f"{glob.escape(incomplete)}*/config.yaml")
    return sorted((file.parent.name for file in folders), reverse=True)


def tag_names(context: typer.Context, incomplete: str) -> list[str]:
    """The tags of all runs in --dir or ./recordings, and `keep`."""
    from mazebot.common.recordings.labels import KEEP, read_labels  # noqa: PLC0415

    tags = {KEEP}
    for file in _recordings(context).glob("*/labels.json"):
        with contextlib.suppress(ConfigError):
            tags.update(read_labels(file.parent).tags)
    return sorted(tag for tag in tags if tag.startswith(incomplete))


def _recordings(context: typer.Context) -> Path:
    return Path(context.params.get("directory") or "recordings")


def service_names(incomplete: str) -> list[str]:
    """The services, in the order in which they step."""
    from mazebot.common.messages.topics import SERVICES  # noqa: PLC0415

    return [name for name in SERVICES if name.startswith(incomplete)]


def stack_service_names(incomplete: str) -> list[str]:
    """The services of a stack, of a list the last."""
    done, comma, last = incomplete.rpartition(",")
    return [
        f"{done}{comma}{name}" for name in ("router", *service_names("")) if name.startswith(last)
    ]


def stack_part_names(incomplete: str) -> list[str]:
    """The services of a stack and its halves, of a list the last."""
    done, comma, last = incomplete.rpartition(",")
    halves = [f"{done}{comma}{name}" for name in (SIMULATOR, NAVIGATION) if name.startswith(last)]
    return halves + stack_service_names(incomplete)
