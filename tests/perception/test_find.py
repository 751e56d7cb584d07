"""What the register of markers makes of a picture."""

from __future__ import annotations

import functools
import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.maths.frames import LINK_FROM_OPTICAL, transform_matrix
from mazebot.common.world.placement import upright
from mazebot.perception.config import PerceptionConfig
from mazebot.perception.detect import Detector
from mazebot.perception.find import MarkerFinder
from mazebot.perception.pose import Camera
from tests.perception.scene import CAMERA, MARKER_ID, camera_from_marker, render

BOOK = "DICT_4X4_100"
PINHOLE = Camera(CAMERA, np.zeros(5))


def finder(*ids: int, **config: float) -> MarkerFinder:
    made = MarkerFinder(PerceptionConfig.model_validate(config))
    for one in ids or (MARKER_ID,):
        made.register(BOOK, one, 0.3)
    return made


@functools.cache
def picture(distance_m: float = 2.0, turn_deg: float = 30.0) -> NDArray[np.uint8]:
    rgb = render(camera_from_marker(distance_m, math.radians(turn_deg)), "bricks")
    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8)


def dimmed(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(np.rint(0.15 * grey + 30.0), np.uint8)


def test_a_registered_marker_has_its_size_and_pose() -> None:
    (one,) = finder().find(picture(), PINHOLE).found
    assert (one.dictionary, one.marker_id, one.side_m) == (BOOK, MARKER_ID, 0.3)
    assert one.solutions[0].camera_from_marker[2, 3] == pytest.approx(2.0, abs=0.01)


def test_a_marker_that_is_not_registered_is_reported_alone() -> None:
    findings = finder(80).find(picture(), PINHOLE)
    assert (findings.found, findings.unknown) == ([], [(BOOK, MARKER_ID)])


def test_nothing_is_looked_for_after_clear() -> None:
    cleared = finder()
    cleared.clear()
    assert not cleared.registered
    assert cleared.find(picture(), PINHOLE).found == []


def test_a_dim_marker_is_found_by_the_second_pass_alone() -> None:
    dim = dimmed(picture())
    assert finder(second_pass=False).find(dim, PINHOLE).found == []
    (one,) = finder().find(dim, PINHOLE).found
    assert one.solutions[0].camera_from_marker[2, 3] == pytest.approx(2.0, abs=0.02)


@functools.cache
def half_dim() -> NDArray[np.uint8]:
    """Marker 60 in good light on the left, 80 in the shade on the right."""
    left = render(camera_from_marker(2.0), "bricks")
    right = render(camera_from_marker(2.0), "bricks", marker_id=80)
    both = np.concatenate([left[:, 160:480], dimmed(right)[:, 160:480]], axis=1)
    return np.asarray(cv2.cvtColor(both, cv2.COLOR_RGB2GRAY), np.uint8)


def test_what_the_picture_before_showed_is_looked_for_twice() -> None:
    seeing = finder(60, 80)
    assert [one.marker_id for one in seeing.find(half_dim(), PINHOLE).found] == [60]
    right = half_dim().copy()
    right[:, :320] = 128
    assert [one.marker_id for one in seeing.find(right, PINHOLE).found] == [80]
    assert [one.marker_id for one in seeing.find(half_dim(), PINHOLE).found] == [60, 80]
    seeing.forget_picture()
    assert [one.marker_id for one in seeing.find(half_dim(), PINHOLE).found] == [60]


def test_height_and_tilt_are_those_registered() -> None:
    floor_from_camera = transform_matrix(np.eye(3), (0.0, 0.0, 0.2)) @ LINK_FROM_OPTICAL
    for height_m, there in ((0.2, True), (0.25, True), (0.8, False)):
        seeing = MarkerFinder(PerceptionConfig())
        # Its heading is the world's: any one will do.
        for_heading = transform_matrix(upright(1.0), (7.0, -3.0, height_m))
        seeing.register(BOOK, MARKER_ID, 0.3, for_heading)
        findings = seeing.find(picture(), PINHOLE, floor_from_camera)
        assert len(findings.found) == there, height_m
        assert findings.misplaced == ([] if there else [(BOOK, MARKER_ID)])


def test_a_dictionary_opencv_does_not_have_is_refused() -> None:
    with pytest.raises(ValueError, match="DICT_9X9"):
        finder().register("DICT_9X9", 1, 0.3)


def test_the_second_pass_is_saved_where_the_first_is_enough(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    passes: list[object] = []
    inner = Detector._sightings

    def counted(self: Detector, step: object, *rest: object) -> object:
        passes.append(step)
        return inner(self, step, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(Detector, "_sightings", counted)
    seeing = finder(second_pass_every=3)

    def count(grey: NDArray[np.uint8]) -> int:
        passes.clear()
        seeing.find(grey, PINHOLE)
        return len(passes)

    bare = np.full((480, 640), 128, np.uint8)
    assert [count(picture()) for _ in range(2)] == [1, 1]
    # The marker that has just left is looked for; then every third picture.
    assert [count(bare) for _ in range(7)] == [2, 1, 1, 2, 1, 1, 2]
    # What the second pass finds is looked for again in the next picture.
    seeing.forget_picture()
    assert [count(dimmed(picture())) for _ in range(4)] == [2, 2, 2, 2]
