"""Runs the service: `python -m services.physics`."""

from services.common.garbage import collections_held_off

with collections_held_off():
    from services.common.bus.serve import main
    from services.physics.config import PhysicsConfig
    from services.physics.node import PhysicsNode

    main(PhysicsConfig, PhysicsNode)
