"""The smaller levels of a texture."""

from __future__ import annotations

import numpy as np
import pytest

from mazebot.physics.camera.mipmaps import smaller_levels


@pytest.mark.parametrize(
    ("height", "width", "sizes"),
    [
        (4, 4, [(2, 2), (1, 1)]),
        (1, 1, []),
        (5, 3, [(2, 1), (1, 1)]),
        (2, 9, [(1, 4), (1, 2), (1, 1)]),
        (1024, 16, [(2**k, max(2**k // 64, 1)) for k in range(9, -1, -1)]),
    ],
)
def test_levels_halve_to_a_single_texel(
    height: int, width: int, sizes: list[tuple[int, int]]
) -> None:
    levels = list(smaller_levels(np.zeros((height, width, 4), np.uint8)))
    assert [level.shape for level in levels] == [(*size, 4) for size in sizes]


def test_a_texel_is_the_mean_of_those_below_it() -> None:
    rgba = np.random.default_rng(3).integers(0, 256, (8, 16, 4)).astype(np.uint8)
    first, *_, last = smaller_levels(rgba)
    means = rgba.astype(float).reshape(4, 2, 8, 2, 4).mean((1, 3))
    assert np.abs(first - means).max() <= 0.5
    assert np.abs(last[0, 0] - rgba.mean((0, 1))).max() <= 2.0
