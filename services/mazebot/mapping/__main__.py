"""Runs the service: `python -m mazebot.mapping`."""

from mazebot.common.garbage import collections_held_off

with collections_held_off():
    from mazebot.common.bus.serve import main
    from mazebot.mapping.config import MappingConfig
    from mazebot.mapping.node import MappingNode

    main(MappingConfig, MappingNode)
