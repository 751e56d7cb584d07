"""Requests of Nav2's services as the queries that answer them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from mazebot.common.messages.action_documents import SaveMap, SaveMapReply
from mazebot.common.messages.topics import SAVE_MAP
from mazebot.common.node.node import Node
from mazebot.common.ros.table import services_of

EMPTY = {
    "map_topic": "", "map_url": "", "image_format": "", "map_mode": "",
    "free_thresh": 0.0, "occupied_thresh": 0.0,
}  # fmt: skip


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
    (service,) = (one for one in services_of("recorder") if one.type.endswith("/SaveMap"))
    assert service.name == "/map_saver/save_map"
    steps = service.handle(SimpleNamespace(**EMPTY | given), cast("Node", None))
    assert next(steps) == (SAVE_MAP, asked)
    with pytest.raises(StopIteration) as ended:
        steps.send(SaveMapReply(error=error))
    assert ended.value.value == {"result": result}
