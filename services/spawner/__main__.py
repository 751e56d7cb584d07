"""Runs the service: `python -m services.spawner`."""

from services.common.garbage import collections_held_off

with collections_held_off():
    from services.common.bus.serve import main
    from services.spawner.config import SpawnerConfig
    from services.spawner.node import SpawnerNode

    main(SpawnerConfig, SpawnerNode)
