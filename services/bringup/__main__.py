"""Runs the service: `python -m services.bringup`."""

from services.common.garbage import collections_held_off

with collections_held_off():
    from services.bringup.config import BringupConfig
    from services.bringup.node import BringupNode
    from services.common.bus.serve import main

    main(BringupConfig, BringupNode)
