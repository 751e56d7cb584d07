"""Configuration of the explorer. Names are explore_lite's; lengths are in metres."""

from __future__ import annotations

from mazebot.common.config import ServiceConfig
from mazebot.explorer.params import ExplorerParams

STEP_PERIOD_NS = 100_000_000
"""10 Hz: the node's period."""


class ExplorerConfig(ExplorerParams, ServiceConfig):
    """Frontiers, the choice among them, and the end."""
