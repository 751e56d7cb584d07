"""Runs the service: `python -m services.localization`."""

from services.common.garbage import collections_held_off

with collections_held_off():
    from services.common.bus.serve import main
    from services.localization.config import LocalizationConfig
    from services.localization.node import LocalizationNode

    main(LocalizationConfig, LocalizationNode)
