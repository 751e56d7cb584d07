"""The pictures of docs/navigation.md."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from mazebot.cli.pages.navigation_sheet import Panel, pictures, tree_panel
from mazebot.common.files.root import ROOT
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import BehaviorTreeLog, BehaviorTreeNode


def black(cells: Array) -> Array:
    return np.column_stack([np.zeros((len(cells), 3)), cells / 100.0])


def test_a_grid_in_a_turned_frame_lies_where_its_cells_are() -> None:
    cells = np.array([[0, 0, 100]], np.int8)
    grid = msg.occupancy_grid(0, 1.0, SE2(0.0, 0.0, 0.0), cells)
    panel = Panel("", (0.0, 0.0), 8.0)
    # Along y: the cell from 2 to 3 m lies above the middle, half a metre to its left.
    panel.grid(grid, SE2(0.0, 0.0, math.pi / 2.0), black)
    picture = panel.done()[-520:]
    dark = np.argwhere(picture[..., 0] < 128)
    row, column = dark.mean(axis=0)
    assert len(dark) == pytest.approx(65**2, rel=0.05)
    assert (260.0 - row, column - 260.0) == pytest.approx((2.5 * 65.0, -0.5 * 65.0), abs=1.0)


def test_a_tree_has_a_line_for_each_node_in_the_colour_of_its_answer() -> None:
    nodes = tuple(
        BehaviorTreeNode(name="Wait", kind="Wait", status=status, depth=depth)
        for depth, status in enumerate(("RUNNING", "FAILURE"))
    )
    picture = tree_panel("", BehaviorTreeLog(action="wait", nodes=nodes), 16.0)[-520:]
    assert picture[14, 18].tolist() == [20, 90, 220]
    assert picture[30, 34].tolist() == [214, 39, 40]


@pytest.mark.slow
def test_the_pictures_of_the_page_can_be_drawn() -> None:
    page = (ROOT / "docs" / "navigation.md").read_text(encoding="utf-8")
    drawn = pictures()
    assert sorted(drawn) == sorted(re.findall(r"\(images/([\w-]+\.png)\)", page))
    assert all(picture.std() > 20.0 for picture in drawn.values())
