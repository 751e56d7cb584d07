"""Runs the service: `python -m mazebot.physics`."""

from mazebot.common.garbage import collections_held_off

with collections_held_off():
    from mazebot.common.bus.serve import main
    from mazebot.physics.config import PhysicsConfig
    from mazebot.physics.node import PhysicsNode

    main(PhysicsConfig, PhysicsNode)
