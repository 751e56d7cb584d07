"""Runs the service: `python -m mazebot.bringup`."""

from mazebot.common.garbage import collections_held_off

with collections_held_off():
    from mazebot.bringup.config import BringupConfig
    from mazebot.bringup.node import BringupNode
    from mazebot.common.bus.serve import main

    main(BringupConfig, BringupNode)
