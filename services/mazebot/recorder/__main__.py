"""Runs the service: `python -m mazebot.recorder`."""

from mazebot.common.garbage import collections_held_off

with collections_held_off():
    from mazebot.common.bus.serve import main
    from mazebot.recorder.config import RecorderConfig
    from mazebot.recorder.on_bus import RecorderOnBus

    main(RecorderConfig, RecorderOnBus)
