"""Spawner: hangs the world's ArUco markers on their walls, or says why it does not."""

from __future__ import annotations

import logging

import numpy as np

from services.common.furnish import PanelStyle, furnish
from services.common.messages import CompressedImage, header
from services.common.node import Inbox, Node, Outbox
from services.common.topics import ASSETS, DESIRED_ENTITIES, WORLD
from services.spawner.config import SpawnerConfig

_log = logging.getLogger("spawner")


class SpawnerNode(Node):
    """Latches, for the world that runs, the set of entities that should stand in it."""

    name = "spawner"
    _config: SpawnerConfig
    wakes = (WORLD,)

    def __init__(self, config: SpawnerConfig) -> None:
        self._config = config
        self._style = PanelStyle(config.panel_gap_m, config.module_px, config.clear_view_m)

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Furnish the newest world."""
        world = inbox.latest(WORLD)
        if world is None:
            return
        self.world_hash = world.hash
        entities, textures = furnish(world, self._style)
        for sha256, data in textures.items():
            picture = np.frombuffer(data, np.uint8)
            outbox.put(ASSETS, CompressedImage(header(0, sha256), format="png", data=picture))
        outbox.put(DESIRED_ENTITIES, entities)
        for refusal in entities.refused:
            _log.error("%s refused: %s", refusal.name, refusal.reason)
        _log.info("Spawned %d of %d markers", len(entities.entities), len(world.markers))

    def waiting_for(self) -> str | None:
        """A world."""
        return None if self.world_hash else "a world"
