"""Services of the package `mazebot_msgs`: queries that no service of ROS 2, Nav2 or the simulators
has, with requests and responses made from their documents.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, Final

from mazebot.common.messages import document_types, wire
from mazebot.common.messages.action_documents import Empty
from mazebot.common.messages.documents import EmergencyStop
from mazebot.common.messages.topics import (
    CLEAR_COSTMAP,
    EMERGENCY_STOP,
    INPUT_AT_WAYPOINT,
    PAUSE_GOAL,
    SIMULATION_CONTROL,
    SMOOTH_PATH,
    TOGGLE_COLLISION_MONITOR,
    Query,
)
from mazebot.common.node.node import Node
from mazebot.common.ros.call import Handle, Service, Steps

OWN_QUERIES: Final[tuple[Query[Any, Any], ...]] = (
    SIMULATION_CONTROL, PAUSE_GOAL, TOGGLE_COLLISION_MONITOR, CLEAR_COSTMAP, SMOOTH_PATH,
)  # fmt: skip
"""Each is also a service of the same name, whose type is named as the document of its request."""


def type_of(query: Query[Any, Any]) -> str:
    """The type of the service that asks a query."""
    return f"{document_types.PACKAGE}/srv/{query.request.__name__}"


@functools.cache
def own_definitions() -> Mapping[str, str]:
    """The fields of the types of these services, by name."""
    return {
        type_of(query): document_types.service_text(query.request, query.response, about=False)
        for query in OWN_QUERIES
    }


def _asking(query: Query[Any, Any]) -> Handle:
    def handle(request: Any, _: Node) -> Steps:
        reply = yield query, wire.document_of(query.request, request)
        message = document_types.pack(reply)
        return {name: getattr(message, name) for name in document_types.names_of(query.response)}

    return handle


def _input(_: Any, __: Node) -> Steps:
    reply = yield INPUT_AT_WAYPOINT, Empty()
    return {"success": not reply.error, "message": reply.error}


def _emergency_stop(request: Any, _: Node) -> Steps:
    reply = yield EMERGENCY_STOP, EmergencyStop(stop=bool(request.data))
    return {"success": not reply.error, "message": reply.error}


OWN_SERVICES: Final = (
    *(
        Service(query.name, type_of(query), query.owner, _asking(query), query.about)
        for query in OWN_QUERIES
    ),
    Service(
        INPUT_AT_WAYPOINT.name, "std_srvs/srv/Trigger", INPUT_AT_WAYPOINT.owner, _input,
        INPUT_AT_WAYPOINT.about,
    ),
    Service(
        EMERGENCY_STOP.name, "std_srvs/srv/SetBool", EMERGENCY_STOP.owner, _emergency_stop,
        EMERGENCY_STOP.about,
    ),
)  # fmt: skip
