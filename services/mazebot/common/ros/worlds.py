"""simulation_interfaces: the services that tell of worlds, and load one in another's place."""

from __future__ import annotations

from typing import Any, Final

from mazebot.common.messages import action_documents as act
from mazebot.common.messages.topics import GET_WORLDS, LOAD_WORLD
from mazebot.common.node.node import Node
from mazebot.common.ros.call import Service, Steps
from mazebot.common.ros.simulation import FEATURE_UNSUPPORTED, NOT_FOUND, result

_UNSUPPORTED_FORMAT, _NO_RESOURCE, _RESOURCE_PARSE_ERROR = 101, 102, 103
_NO_WORLD_LOADED = 101


def _resource(name: str, world_hash: str = "") -> dict[str, Any]:
    """A world by its name, which LoadWorld takes as its uri."""
    description = f"hash {world_hash}" if world_hash else ""
    return {"name": name, "world_resource": {"uri": name}, "description": description}


def _load(request: Any, _: Node) -> Steps:
    """Both forms of the request: that of 1.x, and that of 2.x with a Resource."""
    resource = getattr(request, "world_resource", request)
    if resource.resource_string:
        return result(
            _UNSUPPORTED_FORMAT,
            "resource_string: must be empty: give the name of a world in uri; import other formats "
            "with `mazebot world import`",
        )
    if not resource.uri:
        return result(_NO_RESOURCE, "uri: must be the name of a world")
    known = yield GET_WORLDS, act.Empty()
    reply = yield LOAD_WORLD, act.LoadWorld(world_name=resource.uri)
    if reply.error:
        code = _RESOURCE_PARSE_ERROR if resource.uri in known.names else NOT_FOUND
        return result(code, reply.error)
    return {"world": _resource(reply.world_name, reply.world_hash), **result()}


def _current(_: Any, __: Node) -> Steps:
    reply = yield GET_WORLDS, act.Empty()
    if not reply.running:
        return result(_NO_WORLD_LOADED, "no world is loaded yet")
    return {"world": _resource(reply.running, reply.running_hash), **result()}


def _available(request: Any, _: Node) -> Steps:
    if request.additional_sources:
        return result(
            FEATURE_UNSUPPORTED, "additional_sources: must be empty: worlds come from one folder"
        )
    if request.filter.tags:
        return result(FEATURE_UNSUPPORTED, "filter: must be empty: worlds have no tags")
    reply = yield GET_WORLDS, act.Empty()
    return {"worlds": [_resource(name) for name in reply.names], **result()}


def _service(name: str, kind: str, handle: Any, about: str) -> Service:
    return Service(name, f"simulation_interfaces/srv/{kind}", "worldgen", handle, about)


WORLD_SERVICES: Final = (
    _service(
        "/load_world", "LoadWorld", _load,
        "load another world in place of the one that is running; `uri` is its name",
    ),
    _service("/get_current_world", "GetCurrentWorld", _current, "the world that is running"),
    _service(
        "/get_available_worlds", "GetAvailableWorlds", _available, "the worlds that can be loaded"
    ),
)  # fmt: skip
