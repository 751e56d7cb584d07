"""Runs the service: `python -m services.recorder`."""

from services.common.garbage import collections_held_off

with collections_held_off():
    from services.common.bus.serve import main
    from services.recorder.config import RecorderConfig
    from services.recorder.node import RecorderNode

    main(RecorderConfig, RecorderNode)
