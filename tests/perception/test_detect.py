"""Which markers are found in a picture."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.perception.config import PerceptionConfig
from mazebot.perception.detect import (
    Detector,
    Sighting,
    Threshold,
    dictionary_names,
    grey_from_rgb,
    smallest_perimeter_px,
)
from tests.perception.scene import (
    FOCAL_PX,
    HEIGHT,
    MARKER_ID,
    MARKER_SIDE_M,
    WIDTH,
    brick_wall,
    camera_from_marker,
    project,
    render,
)

CONFIG = PerceptionConfig(seed=7)


def grey_from(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return grey_from_rgb(rgb.reshape(-1), HEIGHT, WIDTH, 3 * WIDTH)


def detect(rgb: NDArray[np.uint8], dictionary: str = "DICT_4X4_100") -> list[Sighting]:
    detector = Detector(dictionary, CONFIG.threshold_window_px, CONFIG.threshold_contrast)
    perimeter_px = smallest_perimeter_px(
        MARKER_SIDE_M, FOCAL_PX, CONFIG.max_range_m, CONFIG.max_view_angle_rad
    )
    return detector.detect(grey_from(rgb), perimeter_px)


@pytest.mark.parametrize("distance_m", [0.7, 1.0, 2.0, 3.0, 4.0, 5.0])
@pytest.mark.parametrize("turn_deg", [0, 60])
def test_a_marker_on_a_brick_wall_is_found(distance_m: float, turn_deg: float) -> None:
    pose = camera_from_marker(distance_m, math.radians(turn_deg))
    (sighting,) = detect(render(pose, "bricks"))
    assert sighting.marker_id == MARKER_ID
    assert np.abs(sighting.corners - project(pose)).max() < 0.15


@pytest.mark.parametrize("background", ["plain", "noise"])
@pytest.mark.parametrize(
    ("distance_m", "turn_deg", "bearing_rad"), [(1.0, -60, 0.2), (2.5, 45, -0.3), (4.5, -60, 0.1)]
)
def test_a_marker_on_any_wall_is_found(
    background: str, distance_m: float, turn_deg: float, bearing_rad: float
) -> None:
    pose = camera_from_marker(distance_m, math.radians(turn_deg), 0.05, bearing_rad)
    assert [s.marker_id for s in detect(render(pose, background))] == [MARKER_ID]


def test_a_marker_with_a_third_of_the_contrast_is_found() -> None:
    pose = camera_from_marker(3.0, math.radians(30))
    dim = (0.35 * render(pose, "bricks").astype(np.float64) + 60).astype(np.uint8)
    assert [s.marker_id for s in detect(dim)] == [MARKER_ID]


def test_a_wall_alone_holds_no_marker() -> None:
    wall = brick_wall(np.random.default_rng(3))[:HEIGHT, :WIDTH]
    assert detect(np.ascontiguousarray(wall)) == []


def test_a_marker_upside_down_keeps_its_own_top_left() -> None:
    upright = detect(render(camera_from_marker(2.0)))[0].corners
    turned = detect(np.ascontiguousarray(render(camera_from_marker(2.0))[::-1, ::-1]))[0].corners
    far_corner = np.array([WIDTH - 1, HEIGHT - 1])
    assert np.abs(far_corner - turned - upright).max() < 0.05


def test_each_marker_is_found_from_left_to_right_by_id() -> None:
    left, right = render(camera_from_marker(1.5), marker_id=80), render(camera_from_marker(1.5))
    middle = slice(WIDTH // 4, 3 * WIDTH // 4)
    rgb = np.concatenate([left[:, middle], right[:, middle]], axis=1)
    assert [s.marker_id for s in detect(rgb)] == [60, 80]
    rgb = np.concatenate([right[:, middle], right[:, middle]], axis=1)
    first, second = detect(rgb)
    assert first.corners[0, 0] < second.corners[0, 0]


def test_the_same_picture_gives_the_same_bits() -> None:
    rgb = render(camera_from_marker(3.0, 0.5), "noise")
    first, second = detect(rgb)[0], detect(rgb)[0]
    assert first.corners.tobytes() == second.corners.tobytes()


def test_one_detector_forgets_the_picture_before() -> None:
    detector = Detector("DICT_4X4_100", 13, 25.0)
    near, far = (grey_from(render(camera_from_marker(d))) for d in (1.0, 4.0))
    assert len(detector.detect(far, 400.0)) == 0
    once = detector.detect(near, 100.0)[0].corners
    assert len(detector.detect(far, 100.0)) == 1
    assert detector.detect(near, 100.0)[0].corners.tobytes() == once.tobytes()


def test_the_perimeter_shrinks_with_range_and_angle_down_to_what_is_readable() -> None:
    assert smallest_perimeter_px(0.3, 500.0, 3.0, 0.0) == pytest.approx(200.0)
    assert smallest_perimeter_px(0.3, 500.0, 3.0, math.pi / 3) == pytest.approx(150.0)
    assert smallest_perimeter_px(0.3, 500.0, 1000.0, 0.0) == pytest.approx(48.0)


def test_a_dictionary_opencv_does_not_have_is_named() -> None:
    with pytest.raises(ValueError, match="dictionary: 'DICT_9X9': unknown to OpenCV"):
        Detector("DICT_9X9", 13, 25.0)
    with pytest.raises(ValueError, match="ArucoDetector"):
        Detector("ArucoDetector", 13, 25.0)


@pytest.mark.parametrize("module_px", [10, 30])
@pytest.mark.parametrize("left_px", [1, 3, 5])
def test_a_panel_at_the_pictures_edge_is_found(module_px: int, left_px: int) -> None:
    """The panel's own outline must not be taken for its black square's."""
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    code = np.asarray(cv2.aruco.generateImageMarker(book, 18, 6 * module_px), np.uint8)
    panel = np.pad(code, module_px, constant_values=255)
    picture = np.full((HEIGHT, WIDTH), 100, np.uint8)
    picture[100 : 100 + len(panel), left_px : left_px + len(panel)] = panel
    (one,) = Detector("DICT_4X4_100", 13, 25.0).detect(picture, 70.0)
    assert one.marker_id == 18
    first = left_px + module_px - 0.5, 100 + module_px - 0.5
    assert np.abs(one.corners[0] - first).max() < 0.1


def test_the_second_pass_looks_for_what_is_wanted_or_expected() -> None:
    bright = grey_from(render(camera_from_marker(2.0)))
    dim = np.rint(0.12 * grey_from(render(camera_from_marker(2.0), marker_id=80)) + 40)
    both = np.concatenate([bright[:, 160:480], dim[:, 160:480].astype(np.uint8)], axis=1)
    detector = Detector("DICT_4X4_100", 13, 25.0, Threshold(23, 7.0))

    def ids(wanted: tuple[int, ...] | None, expected: tuple[int, ...] = ()) -> list[int]:
        return [one.marker_id for one in detector.detect(both, 100.0, wanted, expected)]

    assert ids(None) == [60]
    assert ids((60,)) == [60]
    assert ids((80,)) == [60, 80]
    assert ids((60,), (80,)) == [60, 80]
    assert [one.marker_id for one in detector.detect(both, 100.0, (80,), twice=False)] == [60]


def test_a_weak_code_is_taken_for_texture() -> None:
    """Blotches that OpenCV reads as a frame and the bits of id 17."""
    code = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100), 17, 6
    )
    shades = np.random.default_rng(0).integers(20, 110, (6, 6))
    blotches = np.where(code > 0, 170, shades).astype(np.uint8)
    wall = np.full((HEIGHT, WIDTH), 200, np.uint8)
    wall[100:160, 100:160] = np.kron(blotches, np.ones((10, 10), np.uint8))
    (read,) = Detector("DICT_4X4_100", 13, 25.0, min_clarity=0.0).detect(wall, 80.0)
    assert read.marker_id == 17
    assert Detector("DICT_4X4_100", 13, 25.0).detect(wall, 80.0) == []


@pytest.mark.parametrize(
    "name", ["DICT_4X4_50", "DICT_5X5_100", "DICT_7X7_1000", "DICT_APRILTAG_36h11",
             "DICT_APRILTAG_16h5", "DICT_ARUCO_ORIGINAL"],
)  # fmt: skip
def test_each_dictionary_of_opencv_can_be_detected(name: str) -> None:
    assert name in dictionary_names()
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    modules = int(book.markerSize) + 2
    page = np.full((HEIGHT, WIDTH), 220, np.uint8)
    page[100 : 100 + 20 * modules, 200 : 200 + 20 * modules] = cv2.aruco.generateImageMarker(
        book, 7, 20 * modules
    )
    (one,) = Detector(name, 13, 25.0).detect(page, 100.0)
    assert one.marker_id == 7
    assert np.abs(one.corners[0] - (199.5, 99.5)).max() < 0.1


def test_a_dictionary_of_ones_own_can_be_detected() -> None:
    codes = np.array([[1, 0, 1, 1, 0, 1, 0, 0, 1], [1, 1, 0, 0, 1, 0, 0, 0, 0]], np.uint8)
    rows = [cv2.aruco.Dictionary.getByteListFromBits(code.reshape(3, 3)) for code in codes]
    book = cv2.aruco.Dictionary(np.concatenate(rows), 3, 0)
    page = np.full((HEIGHT, WIDTH), 220, np.uint8)
    page[100:200, 200:300] = cv2.aruco.generateImageMarker(book, 1, 100)
    assert [one.marker_id for one in Detector(book, 13, 25.0).detect(page, 100.0)] == [1]


def test_markers_of_more_modules_must_be_larger() -> None:
    assert smallest_perimeter_px(0.3, 500.0, 1000.0, 0.0, 10) == pytest.approx(80.0)


def test_padded_rows_are_cut() -> None:
    rgb = np.arange(2 * 4 * 3, dtype=np.uint8).reshape(2, 4, 3)
    padded = np.pad(rgb.reshape(2, 12), ((0, 0), (0, 5)), constant_values=255)
    assert (
        grey_from_rgb(padded.reshape(-1), 2, 4, 17) == grey_from_rgb(rgb.ravel(), 2, 4, 12)
    ).all()
