"""Runs the service: `python -m services.perception`."""

from services.common.garbage import collections_held_off

with collections_held_off():
    from services.common.bus.serve import main
    from services.perception.config import PerceptionConfig
    from services.perception.node import PerceptionNode

    main(PerceptionConfig, PerceptionNode)
