"""Where in a room its name is shown."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from mazebot.recorder.drawing.room_names import name_places_m

NONE = np.empty((0, 2))
SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
ANGLE = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 1.0], [1.0, 1.0], [1.0, 6.0], [0.0, 6.0]])
SLIVER = np.array([[0.0, 0.0], [1.0, 1.0], [1.0, 1.0 + 1e-9]])


def test_a_name_stands_in_the_middle_where_nothing_is_in_the_way() -> None:
    assert name_places_m([SQUARE], NONE)[0] == pytest.approx([2.0, 2.0])


def test_it_gives_way_to_a_place_with_a_name() -> None:
    middle = np.array([[2.0, 2.0]])
    (place,) = name_places_m([SQUARE], middle)
    assert np.linalg.norm(place - middle[0]) > 1.0
    assert shapely.Polygon(SQUARE).buffer(-0.5).contains(shapely.Point(place))


def test_names_of_two_rooms_in_one_place_do_not_lie_on_each_other() -> None:
    one, other = name_places_m([SQUARE, SQUARE], NONE)
    assert np.linalg.norm(one - other) > 1.0


@pytest.mark.parametrize("polygon_m", [ANGLE, ANGLE[::-1], SLIVER])
def test_a_name_stands_in_its_room_whatever_its_shape(polygon_m: np.ndarray) -> None:
    (place,) = name_places_m([polygon_m], NONE)
    assert shapely.Polygon(polygon_m).buffer(1e-6).contains(shapely.Point(place))


def test_no_rooms_have_no_names() -> None:
    assert name_places_m([], NONE).shape == (0, 2)
