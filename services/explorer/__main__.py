"""Runs the service: `python -m services.explorer`."""

from services.common.garbage import collections_held_off

with collections_held_off():
    from services.common.bus.serve import main
    from services.explorer.config import ExplorerConfig
    from services.explorer.node import ExplorerNode

    main(ExplorerConfig, ExplorerNode)
