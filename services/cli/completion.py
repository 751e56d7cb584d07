"""Shell completion of names."""

from __future__ import annotations

import os
from pathlib import Path

from services.common.config import ConfigError


def world_names(incomplete: str) -> list[str]:
    """The worlds' names and their short names."""
    from services.common.root import ROOT  # noqa: PLC0415 - on TAB alone
    from services.worldgen.recipe.loader import SHORT_NAMES, known_worlds  # noqa: PLC0415

    folder = os.environ.get("MAZEBOT_WORLDGEN_WORLDS_DIR")
    try:
        known = known_worlds(Path(folder) if folder else ROOT / "worlds")
    except ConfigError:
        return []
    short = [name for name, stem in SHORT_NAMES.items() if stem in known]
    return [name for name in (*short, *known) if name.startswith(incomplete)]


def topic_names(incomplete: str) -> list[str]:
    """All topics, with their slashes."""
    from services.common.node.topics import TOPICS  # noqa: PLC0415 - loads the messages

    return sorted(topic.name for topic in TOPICS if topic.name.startswith(incomplete))


def written_topic_names(incomplete: str) -> list[str]:
    """The topics that the user's tools may publish."""
    from services.common.node.topics import EDGE, owned_by  # noqa: PLC0415

    mine = {topic.name for topic in owned_by(EDGE)}
    return [name for name in topic_names(incomplete) if name in mine]


def run_names(incomplete: str) -> list[str]:
    """The runs in ./recordings, newest first."""
    folders = Path("recordings").glob(f"{incomplete}*/config.yaml")
    return sorted((file.parent.name for file in folders), reverse=True)


def service_names(incomplete: str) -> list[str]:
    """The services, in the order in which they step."""
    from services.common.node.topics import SERVICES  # noqa: PLC0415

    return [name for name in SERVICES if name.startswith(incomplete)]
