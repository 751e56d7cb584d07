from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import Body, Box, Marker, Shape, Wall, World
from mazebot.common.world.costmap import FREE, OCCUPIED
from mazebot.common.world.marker_entities import marker_entities
from mazebot.common.world.placement import panel_of
from mazebot.worldgen.markers.visibility import Bits, covered_share, reachable, seen_from
from tests.common.house import marker, wall, world

ORIGIN = SE2(-6.0, -6.0, 0.0)
OPEN = np.full((240, 240), FREE, np.int8)
"""Of 5 cm; the walls are not on this map."""
LOW, HIGH = 0.1, 0.4


def body(
    x_m: float, y_m: float, z_m: float, size_m: tuple[float, float, float], material: str = "plain"
) -> Body:
    shape = Shape(name="box", geometry=Box(size_m=size_m), material=material)
    return Body(name="thing", position_m=(x_m, y_m, z_m), shapes=(shape,))


def place(*bodies: Body, walls: Sequence[Wall] = (), markers: Sequence[Marker] = ()) -> World:
    one = world([wall(), *walls], markers or [marker(height_m=0.25)])
    return one.model_copy(update={"bodies": bodies})


def seen(one: World, cells: np.ndarray[tuple[int, ...], np.dtype[np.int8]] = OPEN) -> Bits:
    hanging = marker_entities(one.model_copy(update={"bodies": ()}))[0].markers
    return seen_from(one, [panel_of(entity) for entity in hanging], cells, ORIGIN)


def at(cells: Bits, x_m: float, y_m: float) -> bool:
    """The marker hangs at (0, 0.1) and looks to +y."""
    row, column = math.floor((y_m + 6.0) / 0.05), math.floor((x_m + 6.0) / 0.05)
    return bool(cells[0, row, column])


def test_a_marker_is_read_from_near_enough_and_not_too_much_from_the_side() -> None:
    cells = seen(place())
    y, x = np.meshgrid(*[(np.arange(240) + 0.5) * 0.05 - 6.0] * 2, indexing="ij")
    distance = np.hypot(x, y - 0.102)
    angle = np.arctan2(np.abs(x), y - 0.102)
    inside = (distance > 0.62) & (distance < 4.98) & (angle < math.radians(59.5))
    outside = (distance < 0.58) | (distance > 5.02) | (angle > math.radians(60.5))
    assert cells[0][inside].all()
    assert not cells[0][outside].any()


@pytest.mark.parametrize(
    ("z_m", "height_m", "hides"),
    [
        (0.05, 0.1, False),  # lower than camera and panel
        (0.25, 0.5, True),
        (0.8, 0.6, False),  # hangs above
        (0.3, 0.1, True),  # before the upper half of the panel
    ],
)
def test_what_is_neither_below_nor_above_the_look_hides_the_marker(
    z_m: float, height_m: float, hides: bool
) -> None:
    cells = seen(place(body(0.0, 1.5, z_m, (0.6, 0.2, height_m))))
    assert at(cells, 0.0, 1.0)
    assert at(cells, 0.0, 3.0) is not hides
    assert at(cells, 2.5, 2.5)


def test_a_marker_of_which_an_edge_is_hidden_is_not_read() -> None:
    # The panel is 0.4 m wide; the post hides a strip at its right.
    cells = seen(place(body(0.16, 0.8, 0.25, (0.02, 0.02, 0.5))))
    assert not at(cells, 0.0, 3.0)
    assert at(cells, -2.0, 2.0)


def test_what_cannot_be_seen_hides_nothing() -> None:
    assert at(seen(place(body(0.0, 1.5, 0.25, (0.6, 0.2, 0.5), material=""))), 0.0, 3.0)


def test_a_low_wall_hides_only_what_is_lower() -> None:
    for height_m, hides in ((0.04, False), (0.3, True)):
        low = wall("low", SE2(0.0, 1.5, 0.0), height_m=height_m)
        assert at(seen(place(walls=[low])), 0.0, 3.0) is not hides


def test_only_floor_that_the_robot_can_reach_counts() -> None:
    cells = OPEN.copy()
    cells[:, 140] = OCCUPIED  # x = 1.0
    one = place()
    found = seen(one, cells)
    assert at(found, 0.6, 2.0)
    assert not at(found, 0.9, 2.0), "too near for the robot"
    assert not at(found, 1.5, 2.0), "beyond"
    free = reachable(cells, 0.05, ORIGIN, one.start)
    share = covered_share(
        one, [panel_of(e) for e in marker_entities(one)[0].markers], cells, ORIGIN
    )
    assert share == pytest.approx(found[0].sum() / free.sum())


def test_a_robot_passes_where_it_fits() -> None:
    for gap_cells, passes in ((8, False), (9, True), (12, True)):
        cells = OPEN.copy()
        cells[120] = OCCUPIED
        cells[120, 100 : 100 + gap_cells] = FREE
        free = reachable(cells, 0.05, ORIGIN, world([wall()], []).start)
        assert bool(free[20:100].any()) is passes


def test_the_map_may_be_turned() -> None:
    one = place()
    panels = [panel_of(entity) for entity in marker_entities(one)[0].markers]
    turned = SE2(6.0, -6.0, math.pi / 2)
    cells = seen_from(one, panels, OPEN, turned)
    assert cells.sum() == pytest.approx(seen(one).sum(), rel=0.01)
    # (0, 2) in the map is 8 m along the map's x axis and 6 m along its y axis.
    assert cells[0, math.floor(6.01 / 0.05), math.floor(8.01 / 0.05)]


def test_a_finer_map_tells_the_same() -> None:
    fine = place().model_copy(update={"map_resolution_m": 0.0125})
    cells = np.full((960, 960), FREE, np.int8)
    found = seen(fine, cells)
    assert found.sum() / 16.0 == pytest.approx(seen(place()).sum(), rel=0.01)


def test_what_hangs_high_is_read_from_afar_alone() -> None:
    """The upper edge leaves the picture of a camera that looks level."""

    def at_height(height_m: float) -> Bits:
        one = world([wall(height_m=4.0)], [marker(height_m=height_m)])
        return seen(one)

    # 1.5 m + 0.2 m - 0.21 m above the axis, which must be at most 0.433 of the distance.
    assert not at(at_height(1.5), 0.0, 3.3)
    assert at(at_height(1.5), 0.0, 3.8)
    assert not at_height(3.0).any()
