"""Runs the service: `python -m mazebot.spawner`."""

from mazebot.common.garbage import collections_held_off

with collections_held_off():
    from mazebot.common.bus.serve import main
    from mazebot.spawner.config import SpawnerConfig
    from mazebot.spawner.node import SpawnerNode

    main(SpawnerConfig, SpawnerNode)
