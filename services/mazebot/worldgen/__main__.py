"""Runs the service: `python -m mazebot.worldgen`."""

from mazebot.common.garbage import collections_held_off

with collections_held_off():
    from mazebot.common.bus.serve import main
    from mazebot.worldgen.config import WorldgenConfig
    from mazebot.worldgen.node import WorldgenNode

    main(WorldgenConfig, WorldgenNode)
