"""Runs the service: `python -m services.mapping`."""

from services.common.garbage import collections_held_off

with collections_held_off():
    from services.common.bus.serve import main
    from services.mapping.config import MappingConfig
    from services.mapping.node import MappingNode

    main(MappingConfig, MappingNode)
