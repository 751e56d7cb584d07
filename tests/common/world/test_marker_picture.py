from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.world import marker_picture
from tests.common.house import marker


def picture(data: bytes) -> NDArray[np.uint8]:
    grey = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert grey is not None
    return np.asarray(grey, np.uint8)


@pytest.mark.parametrize(
    ("dictionary", "id_", "modules"),
    [("DICT_4X4_100", 60, 6), ("DICT_4X4_100", 80, 6), ("DICT_6X6_250", 249, 8),
     ("DICT_ARUCO_ORIGINAL", 1, 7), ("DICT_APRILTAG_36h11", 5, 8)],
)  # fmt: skip
@pytest.mark.parametrize("quiet_zone_modules", [1, 2])
def test_a_detector_finds_the_marker_in_its_texture(
    dictionary: str, id_: int, modules: int, quiet_zone_modules: int
) -> None:
    one = marker(dictionary=dictionary, id=id_, quiet_zone_modules=quiet_zone_modules)
    grey = picture(marker_picture.draw(one, 64))
    side = modules + 2 * quiet_zone_modules
    assert grey.shape == (side * 64, side * 64)
    assert set(np.unique(grey)) == {0, 255}
    found = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    corners, ids, _ = cv2.aruco.ArucoDetector(found).detectMarkers(grey)
    assert ids is not None
    assert ids.ravel().tolist() == [id_]
    first, last = quiet_zone_modules * 64, (side - quiet_zone_modules) * 64 - 1
    # Upright, and as large as the panel says.
    expected = [[first, first], [last, first], [last, last], [first, last]]
    assert corners[0].reshape(4, 2) == pytest.approx(np.array(expected), abs=1.5)
    assert marker_picture.panel_side_m(one) == pytest.approx(one.size_m * side / modules)


def test_the_black_square_has_the_size_of_the_marker() -> None:
    grey = picture(marker_picture.draw(marker(), 64))
    black = np.flatnonzero((grey == 0).any(0))
    metres_a_pixel = marker_picture.panel_side_m(marker()) / grey.shape[1]
    assert (black[-1] - black[0] + 1) * metres_a_pixel == pytest.approx(0.3, abs=1e-12)


def test_every_module_is_of_one_colour() -> None:
    grey = picture(marker_picture.draw(marker(), 16))
    cells = grey.reshape(8, 16, 8, 16)
    assert (cells.min((1, 3)) == cells.max((1, 3))).all()


def test_a_wide_quiet_zone_takes_smaller_modules() -> None:
    one = marker(quiet_zone_modules=16)
    assert picture(marker_picture.draw(one, 64)).shape == (38 * 53, 38 * 53)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"id": 99}, ""),
        ({"id": 100}, "id: 100: must be less than 100 in DICT_4X4_100"),
        ({"dictionary": "DICT_4X4_7"}, "dictionary: 'DICT_4X4_7': must be one of DICT_4X4_100, "),
        ({"dictionary": "__class__"}, "dictionary: '__class__': must be one of"),
    ],
)
def test_a_marker_that_does_not_exist_is_named(changes: dict[str, object], said: str) -> None:
    found = marker_picture.identity_problem(marker(**changes))
    assert found.startswith(said) if said else found == ""
