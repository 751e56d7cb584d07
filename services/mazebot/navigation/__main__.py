"""Runs the service: `python -m mazebot.navigation`."""

from mazebot.common.garbage import collections_held_off

with collections_held_off():
    from mazebot.common.bus.serve import main
    from mazebot.navigation.config import NavigationConfig
    from mazebot.navigation.node import NavigationNode

    main(NavigationConfig, NavigationNode)
