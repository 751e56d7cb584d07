"""simulation_interfaces: the services that tell of worlds, and load one in another's place."""

from __future__ import annotations

from typing import Any, Final

from mazebot.common.maths.frames import quaternion_from_yaw
from mazebot.common.messages import action_documents as act
from mazebot.common.messages.documents import Planar
from mazebot.common.messages.topics import GET_MODELS, GET_WORLDS, LOAD_WORLD
from mazebot.common.node.node import Node
from mazebot.common.ros.call import Service, Steps
from mazebot.common.ros.entity_filters import has_tags
from mazebot.common.ros.interfaces import Versioned
from mazebot.common.ros.simulation import FEATURE_UNSUPPORTED, NOT_FOUND, OPERATION_FAILED, result

_UNSUPPORTED_FORMAT, _NO_RESOURCE, _RESOURCE_PARSE_ERROR = 101, 102, 103
_NO_WORLD_LOADED = 101
_START_TAG, _PLACE_TAG = "spawn", "navigation_goal"
"""As the comments of NamedPose.msg suggest."""


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


def _named_poses(request: Any, _: Node) -> Steps:
    """Where the robot begins, and the world's named places."""
    reply = yield GET_WORLDS, act.Empty()
    if not reply.running:
        return result(OPERATION_FAILED, "no world is loaded yet")
    places = [(place.name, _PLACE_TAG, place) for place in reply.locations]
    if reply.start is not None:
        taken = {name for name, *_ in places}
        # A name must be one place's alone.
        name = "robot_start" if "start" in taken else "start"
        places.insert(0, (name, _START_TAG, reply.start))
    poses = [
        {"name": name, "tags": [tag], "pose": _pose(place)}
        for name, tag, place in places
        if has_tags((tag,), request.tags)
    ]
    return {"poses": poses, **result()}


def _pose(place: Planar) -> dict[str, Any]:
    x, y, z, w = quaternion_from_yaw(place.yaw_rad)
    return {
        "position": {"x": place.x_m, "y": place.y_m, "z": 0.0},
        "orientation": {"x": x, "y": y, "z": z, "w": w},
    }


def _spawnables(request: Any, _: Node) -> Steps:
    """The models by name, in both forms: that of 1.x, and that of 2.x with a Resource."""
    if request.sources:
        return result(
            FEATURE_UNSUPPORTED, "sources: must be empty: models come from the worlds' folder"
        )
    reply = yield GET_MODELS, act.Empty()
    if reply.error:
        return result(OPERATION_FAILED, reply.error)
    uris = [f"model://{name}" for name in reply.names]
    return {
        "spawnables": [Versioned(uri=uri, entity_resource={"uri": uri}) for uri in uris],
        **result(),
    }


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
    _service(
        "/get_named_poses", "GetNamedPoses", _named_poses,
        "where the robot begins, tagged `spawn`, and the world's named places, `navigation_goal`",
    ),
    _service(
        "/get_spawnables", "GetSpawnables", _spawnables,
        "the models by name, as `uri` for SpawnEntity",
    ),
)  # fmt: skip
