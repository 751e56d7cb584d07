"""Runs the service: `python -m services.worldgen`."""

from services.common.garbage import collections_held_off

with collections_held_off():
    from services.common.bus.serve import main
    from services.worldgen.config import WorldgenConfig
    from services.worldgen.node import WorldgenNode

    main(WorldgenConfig, WorldgenNode)
