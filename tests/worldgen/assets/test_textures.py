from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.files.png import problem
from mazebot.common.files.root import ROOT
from mazebot.common.messages.documents import Marker
from mazebot.common.world.marker_picture import draw
from mazebot.perception.config import PerceptionConfig
from mazebot.perception.detect import Detector
from mazebot.worldgen.assets.textures import COARSE_STEP, TEXTURES, png_bytes

FOLDER = ROOT / "worlds" / "textures"
MEAN_RGB = {
    "bricks.png": (143, 96, 94), "concrete.png": (161, 159, 156), "wood_.png": (220, 162, 84),
}  # fmt: skip
SMALL = [name for name in TEXTURES if name not in MEAN_RGB]


def rgb(data: bytes) -> NDArray[np.float64]:
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert bgr is not None
    return np.asarray(bgr[..., ::-1], np.float64)


@pytest.mark.slow
@pytest.mark.parametrize("name", TEXTURES)
def test_the_texture_at_hand_is_what_the_script_draws(name: str) -> None:
    at_hand = rgb((FOLDER / name).read_bytes())
    side_px = TEXTURES[name].side_px
    drawn = np.rint(TEXTURES[name].draw(side_px))
    assert at_hand.shape == drawn.shape == (side_px, side_px, 3)
    # Another processor may round a pixel the other way.
    assert np.abs(at_hand - drawn).max() <= COARSE_STEP
    assert np.abs(at_hand - drawn).mean() < 0.01


@pytest.mark.parametrize("name", MEAN_RGB)
def test_a_texture_is_a_small_png_of_its_mean_colour(name: str) -> None:
    data = (FOLDER / name).read_bytes()
    assert problem(data) == ""
    assert len(data) < 3_000_000
    assert rgb(data).mean((0, 1)) == pytest.approx(MEAN_RGB[name], abs=1.0)


@pytest.mark.parametrize("name", SMALL)
def test_a_small_texture_is_a_small_file(name: str) -> None:
    data = (FOLDER / name).read_bytes()
    assert problem(data) == ""
    assert len(data) < 200_000
    assert TEXTURES[name].side_px <= 512


def test_the_folder_holds_no_other_texture() -> None:
    assert {path.name for path in FOLDER.iterdir()} == set(TEXTURES)


def test_no_two_textures_have_one_mean_colour() -> None:
    means = np.array([rgb((FOLDER / name).read_bytes()).mean((0, 1)) for name in TEXTURES])
    apart = np.linalg.norm(means[:, None] - means, axis=-1) + 999.0 * np.eye(len(means))
    assert apart.min() > 15.0


def views(name: str) -> list[NDArray[np.uint8]]:
    """A surface of 3 m of a texture from far to near, and from aside, in grey."""
    tile = cv2.imdecode(np.frombuffer((FOLDER / name).read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert tile is not None
    surface = np.tile(cv2.resize(tile, (512, 512), interpolation=cv2.INTER_AREA), (3, 3))
    seen = [
        cv2.resize(surface, (side, side), interpolation=cv2.INTER_AREA)
        for side in (240, 340, 480, 700, 1000)
    ]
    source = np.array([[0, 0], [1535, 0], [1535, 1535], [0, 1535]], np.float32)
    for far in (150, 250):
        target = np.array([[320 - far, 40], [320 + far, 40], [1100, 479], [-460, 479]], np.float32)
        matrix = cv2.getPerspectiveTransform(source, target)
        seen.append(cv2.warpPerspective(surface, matrix, (640, 480), flags=cv2.INTER_AREA))
    return [np.asarray(picture, np.uint8) for picture in seen]


@pytest.mark.parametrize("name", TEXTURES)
def test_no_pattern_is_taken_for_a_marker_and_a_marker_shows_on_it(name: str) -> None:
    config = PerceptionConfig()
    detector = Detector("DICT_4X4_100", config.threshold_window_px, config.threshold_contrast)
    marker = Marker(id=60, wall="w", side="left", height_m=0.25)
    paper = cv2.imdecode(np.frombuffer(draw(marker, 8), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert paper is not None
    for view in views(name):
        assert detector.detect(view, 40.0) == []
        view[20:84, 30:94] = paper
        assert [sighting.marker_id for sighting in detector.detect(view, 40.0)] == [60]


def seam(tile: NDArray[np.float64], axis: int) -> float:
    """The step across the tile's edges, in the largest of the steps just beside them."""
    lines = tile.take(range(-3, 3), axis)
    steps = np.abs(np.diff(lines, axis=axis)).mean((1 - axis, 2))
    return float(steps[2] / max(*steps[[0, 1, 3, 4]], 0.5))


@pytest.mark.parametrize("name", TEXTURES)
def test_a_texture_repeats_without_a_seam(name: str) -> None:
    picture = rgb((FOLDER / name).read_bytes())
    for axis in (0, 1):
        assert seam(picture, axis) < 1.2
        # Where a joint runs along the tile's edge, steps are large on either side of it as well.
        if name in MEAN_RGB:
            tile = picture[:937, :937]
            assert seam(tile, axis) > 1.2, "a tile that does not repeat is found"


def test_a_smaller_picture_is_of_the_same_tile() -> None:
    small = TEXTURES["wood_.png"].draw(128)
    large = cv2.resize(rgb((FOLDER / "wood_.png").read_bytes()), (128, 128), None, 0, 0, 3)
    assert np.corrcoef(small.ravel(), large.ravel())[0, 1] > 0.9


def test_what_is_written_is_what_was_drawn() -> None:
    picture = TEXTURES["wood_.png"].draw(32)
    assert np.abs(rgb(png_bytes(picture)) - picture).max() <= 0.5
