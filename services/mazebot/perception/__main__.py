"""Runs the service: `python -m mazebot.perception`."""

from mazebot.common.garbage import collections_held_off

with collections_held_off():
    from mazebot.common.bus.serve import main
    from mazebot.perception.config import PerceptionConfig
    from mazebot.perception.node import PerceptionNode

    main(PerceptionConfig, PerceptionNode)
