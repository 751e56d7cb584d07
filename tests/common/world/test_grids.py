"""Grids are transformed exactly, to the last bit."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import ndimage

from mazebot.common.world.grids import MAX_CELLS, connected_regions, distance_cells


@pytest.mark.parametrize("share", [0.0005, 0.01, 0.3, 0.95])
@pytest.mark.parametrize("shape", [(1, 7), (90, 61), (311, 400)])
def test_it_is_the_exact_one(shape: tuple[int, int], share: float) -> None:
    generator = np.random.default_rng([*shape, int(share * 1e4)])
    solid = generator.random(shape) < share
    solid[shape[0] // 2, shape[1] // 3] = True
    assert np.array_equal(distance_cells(solid), ndimage.distance_transform_edt(~solid))


def test_it_does_not_depend_on_threads_or_memory() -> None:
    solid = np.random.default_rng(1).random((300, 417)) < 0.002
    threads = cv2.getNumThreads()
    try:
        found = []
        for count in (1, 2):
            cv2.setNumThreads(count)
            found += [distance_cells(solid.copy())[:, 20:].tobytes() for _ in range(3)]
            found.append(distance_cells(np.asfortranarray(solid))[:, 20:].tobytes())
    finally:
        cv2.setNumThreads(threads)
    assert len(set(found)) == 1


def test_nothing_solid_is_infinitely_far_and_far_is_bounded() -> None:
    assert np.isinf(distance_cells(np.zeros((3, 4), np.bool_))).all()
    solid = np.zeros((1, 3000), np.bool_)
    solid[0, 0] = True
    assert distance_cells(solid)[0, [5, 2000, 2999]].tolist() == [5.0, 2000.0, MAX_CELLS]


@pytest.mark.parametrize("share", [0.0, 0.4, 0.6, 1.0])
def test_regions_hang_together_over_sides_and_not_corners(share: float) -> None:
    where = np.random.default_rng(int(share * 10)).random((61, 90)) < share
    regions, expected = connected_regions(where), ndimage.label(where)[0]
    assert np.array_equal(regions == 0, ~where)
    # The same regions, whatever their numbers.
    pairs = np.unique(np.stack([regions.ravel(), expected.ravel()]), axis=1).T
    assert len(pairs) == len(np.unique(pairs[:, 0])) == len(np.unique(pairs[:, 1]))
    strided = connected_regions(where[:, ::2])
    assert np.array_equal(strided, connected_regions(where[:, ::2].copy()))
