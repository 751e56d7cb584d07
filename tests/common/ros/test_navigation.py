"""Requests of Nav2's services as the queries that answer them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from mazebot.common.messages.action_documents import SaveMap, SaveMapReply
from mazebot.common.messages.topics import SAVE_MAP
from mazebot.common.node.node import Node
from mazebot.common.ros.call import Steps
from mazebot.common.ros.table import services_of

EMPTY = {
    "map_topic": "", "map_url": "", "image_format": "", "map_mode": "",
    "free_thresh": 0.0, "occupied_thresh": 0.0,
}  # fmt: skip


def asked_for(service_name: str, **fields: Any) -> Steps:
    """How the recorder's service answers a request."""
    (service,) = (one for one in services_of("recorder") if one.name == service_name)
    return service.handle(SimpleNamespace(**fields), cast("Node", None))


def response(steps: Steps, reply: SaveMapReply) -> object:
    """The result after the query's reply."""
    with pytest.raises(StopIteration) as ended:
        steps.send(reply)
    return ended.value.value["result"]


@pytest.mark.parametrize(
    ("given", "asked"),
    [
        ({"map_url": "kitchen"}, SaveMap(name="kitchen")),
        ({"map_url": "kitchen.yaml", "map_topic": "map"}, SaveMap(name="kitchen", topic="map")),
        (
            {"map_url": "a", "image_format": "png", "map_mode": "scale", "free_thresh": 0.1,
             "occupied_thresh": 0.9},
            SaveMap(name="a", image_format="png", mode="scale", free_thresh=0.1,
                    occupied_thresh=0.9),
        ),
    ],
)  # fmt: skip
@pytest.mark.parametrize(("error", "result"), [("", True), ("no space", False)])
def test_a_map_is_saved_with_map_saver_s_values(
    given: dict[str, Any], asked: SaveMap, error: str, result: bool
) -> None:
    steps = asked_for("/map_saver/save_map", **EMPTY | given)
    assert next(steps) == (SAVE_MAP, asked)
    assert response(steps, SaveMapReply(result=255 if error else 0, error=error)) == result


@pytest.mark.parametrize(("code", "result"), [(0, 0), (1, 1), (255, 255)])
def test_a_map_is_saved_with_slam_toolbox_s_codes(code: Any, result: int) -> None:
    steps = asked_for("/slam_toolbox/save_map", name=SimpleNamespace(data="kitchen"))
    assert next(steps) == (SAVE_MAP, SaveMap(name="kitchen"))
    assert response(steps, SaveMapReply(result=code)) == result


@pytest.mark.parametrize(("code", "result"), [(0, 0), (1, 255), (255, 255)])
def test_a_pose_graph_is_saved_where_there_is_one(code: Any, result: int) -> None:
    steps = asked_for("/slam_toolbox/serialize_map", filename="kitchen")
    assert next(steps) == (SAVE_MAP, SaveMap(name="kitchen", needs_pose_graph=True))
    assert response(steps, SaveMapReply(result=code)) == result
