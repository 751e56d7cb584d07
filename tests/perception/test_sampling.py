"""Brightness between pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mazebot.perception.sampling import brightness_at

RANDOM = np.random.default_rng(5)
GREY = RANDOM.integers(0, 256, (40, 60), np.uint8)


def test_it_is_that_of_opencv_to_a_step_of_its_fractions() -> None:
    x, y = RANDOM.uniform(-3.0, 62.0, (50, 20)), RANDOM.uniform(-3.0, 42.0, (50, 20))
    theirs = cv2.remap(
        GREY, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    # OpenCV may round a place to a thirty-second of a pixel.
    assert np.abs(brightness_at(GREY, x, y) - theirs).max() <= 255.0 / 32.0


def test_a_pixel_s_centre_has_its_brightness_and_the_middle_of_four_their_mean() -> None:
    rows, columns = np.indices(GREY.shape).astype(float)
    assert (brightness_at(GREY, columns, rows) == GREY).all()
    mean = GREY.astype(float)[:2, :2].mean()
    half = np.array([[0.5]])
    assert brightness_at(GREY, half, half) == np.rint(mean)


@pytest.mark.parametrize(("x", "y", "pixel"), [(-9.0, -9.0, (0, 0)), (1e9, 20.0, (20, 59))])
def test_outside_it_is_that_of_the_border(x: float, y: float, pixel: tuple[int, int]) -> None:
    assert brightness_at(GREY, np.array([[x]]), np.array([[y]])) == GREY[pixel]


def test_a_picture_that_may_not_be_written_is_read_and_left_as_it_was() -> None:
    locked = GREY.copy()
    locked.setflags(write=False)
    at = np.array([[1.0]])
    assert brightness_at(locked[:, ::2], at, at) == GREY[1, 2]
