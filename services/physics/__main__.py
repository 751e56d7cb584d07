"""Runs the service: `python -m services.physics`."""

from services.common.serve import main
from services.physics.config import PhysicsConfig
from services.physics.node import PhysicsNode

main(PhysicsConfig, PhysicsNode)
