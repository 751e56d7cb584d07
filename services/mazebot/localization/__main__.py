"""Runs the service: `python -m mazebot.localization`."""

from mazebot.common.garbage import collections_held_off

with collections_held_off():
    from mazebot.common.bus.serve import main
    from mazebot.localization.config import LocalizationConfig
    from mazebot.localization.node import LocalizationNode

    main(LocalizationConfig, LocalizationNode)
