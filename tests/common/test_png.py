"""Pictures are decoded once, and only whole ones."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mazebot.common.files import png


def _file(side_px: int, shade: int) -> bytes:
    picture = np.full((side_px, side_px, 3), (shade, 0, 200), np.uint8)
    return cv2.imencode(".png", picture)[1].tobytes()


def test_the_same_file_is_the_same_picture_in_rgb() -> None:
    data = _file(8, 10)
    picture = png.decode(data)
    assert picture[3, 4].tolist() == [200, 0, 10]
    assert png.decode(bytes(bytearray(data))) is picture
    with pytest.raises(ValueError, match="read-only"):
        picture[0, 0] = 0


def test_a_damaged_file_never_counts_as_the_whole_one() -> None:
    data = _file(8, 20)
    assert png.problem(data) == ""
    assert "corrupt" in png.problem(data[:-20])
    assert "corrupt" in png.problem(data[:-20])


def test_what_is_kept_is_bounded() -> None:
    first = png.decode(_file(1024, 0))
    others = [png.decode(_file(1024, 30 + number)) for number in range(12)]
    assert png.decode(_file(1024, 0)) is not first
    assert png.decode(_file(1024, 41)) is others[-1]
