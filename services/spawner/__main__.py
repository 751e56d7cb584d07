"""Runs the service: `python -m services.spawner`."""

from services.common.serve import main
from services.spawner.config import SpawnerConfig
from services.spawner.node import SpawnerNode

main(SpawnerConfig, SpawnerNode)
