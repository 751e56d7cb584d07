"""Services of Nav2: costmaps, maps, global localisation; and the state of each node."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Literal
from urllib.parse import unquote, urlsplit

from mazebot.common.config import ConfigError
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import (
    CLEAR_COSTMAP,
    LOAD_MAP,
    REINITIALIZE_GLOBAL_LOCALIZATION,
    SAVE_MAP,
)
from mazebot.common.node.node import Node
from mazebot.common.ros.call import Handle, Response, Service, Steps, answered

_MAP_DOES_NOT_EXIST, _INVALID_MAP_METADATA = 1, 3
_FAILED_TO_WRITE_FILE = 255
_INACTIVE, _ACTIVE = 2, 3


def _clear(costmap: Literal["local", "global"]) -> Handle:
    def handle(request: Any, _: Node) -> Steps:
        plugins = tuple(getattr(request, "plugins", ()))
        reply = yield CLEAR_COSTMAP, act.ClearCostmap(costmap=costmap, plugins=plugins)
        # Until Kilted, the response says nothing.
        return {"success": not reply.error} if hasattr(request, "plugins") else {}

    return handle


def _reinitialize(_: Any, __: Node) -> Steps:
    yield REINITIALIZE_GLOBAL_LOCALIZATION, act.Empty()
    return {}


def _load_map(request: Any, _: Node) -> Steps:
    """The file is one of the machine, or the container, of worldgen, as with Nav2's map_server."""
    # They load the libraries of images and grids, which few services need.
    from mazebot.common.ros.map_exchange import document_of_map  # noqa: PLC0415
    from mazebot.common.world.map_files import read_map  # noqa: PLC0415

    url = urlsplit(request.map_url)
    path = Path(unquote(url.path))
    if url.scheme not in ("", "file") or not path.is_absolute() or not path.is_file():
        return {"result": _MAP_DOES_NOT_EXIST}
    try:
        chart = read_map(path)
    except ConfigError:
        return {"result": _INVALID_MAP_METADATA}
    reply = yield LOAD_MAP, document_of_map(chart)
    if reply.result:
        return {"result": reply.result}
    grid = msg.occupancy_grid(0, chart.resolution_m, chart.origin, chart.cells)
    return {"result": 0, "map": grid}


def _save_map(request: Any, _: Node) -> Steps:
    """What is empty or 0 has the value that Nav2's map_saver takes then."""
    given = {
        "topic": request.map_topic,
        "image_format": request.image_format,
        "mode": request.map_mode,
        "free_thresh": request.free_thresh,
        "occupied_thresh": request.occupied_thresh,
    }
    reply = yield (
        SAVE_MAP,
        act.SaveMap(
            name=request.map_url.removesuffix(".yaml"),
            **{field: value for field, value in given.items() if value},
        ),
    )
    return {"result": not reply.error}


def _save_slam_map(request: Any, _: Node) -> Steps:
    reply = yield SAVE_MAP, act.SaveMap(name=request.name.data)
    return {"result": reply.result}


def _serialize_map(request: Any, _: Node) -> Steps:
    reply = yield SAVE_MAP, act.SaveMap(name=request.filename, needs_pose_graph=True)
    return {"result": _FAILED_TO_WRITE_FILE if reply.result else 0}


def _get_state(_: Any, node: Node) -> Response:
    active = node.waiting_for() is None
    label = "active" if active else "inactive"
    return {"current_state": {"id": _ACTIVE if active else _INACTIVE, "label": label}}


def _is_active(_: Any, node: Node) -> Response:
    waiting_for = node.waiting_for()
    message = "" if waiting_for is None else f"waiting for {waiting_for}"
    return {"success": waiting_for is None, "message": message}


_STATE_TYPE = "lifecycle_msgs/srv/GetState"
_NAV2_NODES = {
    "bt_navigator": "navigation", "controller_server": "navigation",
    "planner_server": "navigation", "amcl": "localization", "slam_toolbox": "mapping",
    "map_server": "worldgen",
}  # fmt: skip
"""Nodes of Nav2 whose state its tools ask for, and who does their work here."""
_COSTMAP = "forget the obstacles of the costmap; the map and what the lidar sees now stay"
NAVIGATION_SERVICES: Final = (
    *(
        Service(
            f"/{name}_costmap/clear_entirely_{name}_costmap", "nav2_msgs/srv/ClearEntireCostmap",
            "navigation", _clear(name), _COSTMAP,
        )
        for name in ("global", "local")
    ),
    Service(
        "/map_server/load_map", "nav2_msgs/srv/LoadMap", "worldgen", _load_map,
        "load a map of a file and publish it on `/map`",
    ),
    Service(
        "/map_saver/save_map", "nav2_msgs/srv/SaveMap", "recorder", _save_map,
        "write `/map` to the folder of the run",
    ),
    Service(
        "/slam_toolbox/save_map", "slam_toolbox/srv/SaveMap", "recorder", _save_slam_map,
        "the same",
    ),
    Service(
        "/slam_toolbox/serialize_map", "slam_toolbox/srv/SerializePoseGraph", "recorder",
        _serialize_map, "the same, where there is a pose graph",
    ),
    Service(
        "/reinitialize_global_localization", "std_srvs/srv/Empty", "localization", _reinitialize,
        "search for the robot on the whole map",
    ),
    *(
        Service(
            f"/{name}/get_state", _STATE_TYPE, owner, answered(_get_state),
            "as of the node that does its work, for tools of Nav2",
        )
        for name, owner in _NAV2_NODES.items()
    ),
    *(
        Service(
            f"/lifecycle_manager_{owner}/is_active", "std_srvs/srv/Trigger", owner,
            answered(_is_active), "whether it waits for no input, for tools of Nav2",
        )
        for owner in ("navigation", "localization")
    ),
)  # fmt: skip

_PerNode = tuple[str, str, Callable[..., Any], str]
STATE_SERVICES: Final[tuple[_PerNode, ...]] = (
    (
        "get_state", _STATE_TYPE, answered(_get_state),
        "active, or inactive while it waits for an input",
    ),
)  # fmt: skip
