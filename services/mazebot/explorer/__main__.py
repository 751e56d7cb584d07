"""Runs the service: `python -m mazebot.explorer`."""

from mazebot.common.garbage import collections_held_off

with collections_held_off():
    from mazebot.common.bus.serve import main
    from mazebot.explorer.config import ExplorerConfig
    from mazebot.explorer.node import ExplorerNode

    main(ExplorerConfig, ExplorerNode)
