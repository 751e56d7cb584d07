from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from services.common.config import ROOT
from services.worldgen.png import problem
from services.worldgen.textures import SIDE_PX, TEXTURES, png_bytes

FOLDER = ROOT / "worlds" / "textures"
MEAN_RGB = {
    "bricks.png": (143, 96, 94), "concrete.png": (161, 159, 156), "wood_.png": (220, 162, 84),
}  # fmt: skip


def rgb(data: bytes) -> NDArray[np.float64]:
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert bgr is not None
    return np.asarray(bgr[..., ::-1], np.float64)


@pytest.mark.parametrize("name", TEXTURES)
def test_the_texture_at_hand_is_what_the_script_draws(name: str) -> None:
    at_hand = rgb((FOLDER / name).read_bytes())
    drawn = np.rint(TEXTURES[name](SIDE_PX))
    assert at_hand.shape == drawn.shape == (1024, 1024, 3)
    # Another processor may round a pixel the other way.
    assert np.abs(at_hand - drawn).max() <= 2
    assert np.abs(at_hand - drawn).mean() < 0.01


@pytest.mark.parametrize("name", TEXTURES)
def test_a_texture_is_a_small_png_of_its_mean_colour(name: str) -> None:
    data = (FOLDER / name).read_bytes()
    assert problem(data) == ""
    assert len(data) < 3_000_000
    assert rgb(data).mean((0, 1)) == pytest.approx(MEAN_RGB[name], abs=1.0)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("name", TEXTURES)
def test_a_texture_repeats_without_a_seam(name: str, axis: int) -> None:
    picture = rgb((FOLDER / name).read_bytes())

    def seam(tile: NDArray[np.float64]) -> float:
        """The step across the tile's edges, in the largest of the steps just beside them."""
        steps = np.abs(np.roll(tile, -1, axis) - tile).mean((1 - axis, 2))
        return float(steps[-1] / max(steps[[-3, -2, 0, 1]]))

    assert seam(picture) < 1.2
    assert seam(picture[:937, :937]) > 1.2, "a tile that does not repeat is found"


def test_a_smaller_picture_is_of_the_same_tile() -> None:
    small = TEXTURES["wood_.png"](128)
    large = cv2.resize(rgb((FOLDER / "wood_.png").read_bytes()), (128, 128), None, 0, 0, 3)
    assert np.corrcoef(small.ravel(), large.ravel())[0, 1] > 0.9


def test_what_is_written_is_what_was_drawn() -> None:
    picture = TEXTURES["wood_.png"](32)
    assert np.abs(rgb(png_bytes(picture)) - picture).max() <= 0.5
