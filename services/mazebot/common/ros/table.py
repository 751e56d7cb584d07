"""The table of services: all of ROS 2's services that a running stack answers."""

from __future__ import annotations

from typing import Final

from mazebot.common.messages.topics import SERVICES
from mazebot.common.ros.call import Service
from mazebot.common.ros.navigation import NAVIGATION_SERVICES, STATE_SERVICES
from mazebot.common.ros.own_services import OWN_SERVICES
from mazebot.common.ros.parameters import PARAMETER_SERVICES
from mazebot.common.ros.simulation import SIMULATION_SERVICES
from mazebot.common.ros.worlds import WORLD_SERVICES

OF_EACH_NODE: Final = (*STATE_SERVICES, *PARAMETER_SERVICES)
"""Name below the node's, type, handler and meaning."""

ROS_SERVICES: Final[tuple[Service, ...]] = (
    *SIMULATION_SERVICES,
    *WORLD_SERVICES,
    *NAVIGATION_SERVICES,
    *OWN_SERVICES,
    *(
        Service(f"/{node}/{name}", kind, node, handle, about)
        for node in SERVICES
        for name, kind, handle, about in OF_EACH_NODE
    ),
)


def services_of(node: str) -> list[Service]:
    """The services that a node answers."""
    return [service for service in ROS_SERVICES if service.owner == node]
