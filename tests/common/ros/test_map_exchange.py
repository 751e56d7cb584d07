"""A map in the request that loads it."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.ros.map_exchange import MapDataError, document_of_map, map_of_document
from mazebot.common.world.map_files import MapFile

CELLS = np.array([[0, 100, -1], [50, 0, 0]], np.int8)
REQUEST = document_of_map(MapFile(CELLS, 0.05, SE2(-1.0, 2.0, 0.5)))


def packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data)).decode()


def test_a_map_comes_back_as_it_was() -> None:
    chart = map_of_document(REQUEST)
    assert (chart.cells == CELLS).all()
    assert (chart.resolution_m, chart.origin) == (0.05, SE2(-1.0, 2.0, 0.5))


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"rows": 3}, "must be 3 x 3 bytes"),
        ({"columns": 2}, "must be 2 x 2 bytes"),
        ({"rows": 10**6, "columns": 10**6}, "must be at most"),
        ({"cells_base64": "?"}, "zlib in base64"),
        ({"cells_base64": base64.b64encode(b"nothing").decode()}, "zlib in base64"),
        ({"cells_base64": packed(bytes(10**6))}, "must be 2 x 3 bytes"),
        ({"cells_base64": packed(bytes([101] * 6))}, "must be -1 to 100"),
    ],
)
def test_cells_that_are_none_are_refused(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(MapDataError, match=words) as caught:
        map_of_document(REQUEST.model_copy(update=changed))
    assert "\n" not in str(caught.value)
