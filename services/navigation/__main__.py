"""Runs the service: `python -m services.navigation`."""

from services.common.garbage import collections_held_off

with collections_held_off():
    from services.common.bus.serve import main
    from services.navigation.config import NavigationConfig
    from services.navigation.node import NavigationNode

    main(NavigationConfig, NavigationNode)
