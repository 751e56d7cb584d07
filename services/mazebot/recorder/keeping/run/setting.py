"""What all runs of a recorder share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from mazebot.common.messages import documents as doc
from mazebot.common.messages.topics import Topic
from mazebot.common.recordings.summary import Hardware
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.stream.latched import Latched

if TYPE_CHECKING:
    from mazebot.recorder.foxglove.server import FoxgloveServer
    from mazebot.recorder.stream.live_feed import LiveFeed


@dataclass(frozen=True)
class Setting:
    """State that all runs of a recorder share."""

    config: RecorderConfig
    wall_clock_s: Callable[[], float]
    versions: Mapping[str, str]
    hardware: Hardware | None = None
    live: LiveFeed | None = None
    foxglove: FoxgloveServer | None = None
    resumable: bool = False
    """Whether a recorder resumes a run whose recorder died."""
    assets: dict[str, bytes] = field(default_factory=dict)
    """Textures (PNG) and meshes (npz) by their sha256."""
    parameters: dict[str, doc.Parameters] = field(default_factory=dict)
    """The parameters of each service, by its name."""
    fixed: dict[Topic[Any], Any] = field(default_factory=dict)
    """The newest message of each latched topic that is drawn or judged in every run."""
    latched: Latched = field(default_factory=Latched)
    """Those of all latched topics, for the head of `run.mcap`."""
