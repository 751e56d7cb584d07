"""Things that the map has and the world has no more: a table that was carried away.

Beams pass through them, as through walls at a wrong pose. There, though, they end anywhere; where
something is gone, nearly all end on what the map has behind it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mazebot.common.maths.frames import Array
from mazebot.localization.beam_model import (
    HIT,
    MISFIT,
    MISS_COST,
    MISSING,
    OPEN,
    SHORT,
    THROUGH,
    RayMap,
    ScanView,
    judge,
)

_ENDS_ON_WALLS = 0.95
"""Least share of the returns that end on walls, whatever is before these."""


def seen_through(rays: RayMap) -> RayMap:
    """A map in whose walls beams end, and which hold none back."""
    return replace(rays, occupied=np.where(rays.occupied == 1, np.uint8(0), rays.occupied))


def without_gone(
    through: RayMap, poses: Array, view: ScanView, counts: Array, log_likelihoods: Array
) -> tuple[Array, Array]:
    """The (n, 7) counts and (n,) log-likelihoods of a scan at poses (n, 3), as `judge` gives them,
    as if what beams pass through were gone, at the poses where that explains them: nearly all
    returns end on walls, and more of them before the first wall's back than behind it.

    `through` is the map as `seen_through` gives it.
    """
    if not counts[:, THROUGH].any():
        return counts, log_likelihoods
    ends, of_ends = judge(through, poses, view)
    ends[:, [MISSING, OPEN]] = counts[:, [MISSING, OPEN]]
    of_ends -= MISS_COST * counts[:, MISSING] * view.likelihood_weight
    returns = counts[:, HIT] + counts[:, SHORT] + counts[:, MISFIT] + counts[:, THROUGH]
    is_gone = (ends[:, HIT] >= _ENDS_ON_WALLS * returns) & (counts[:, HIT] >= counts[:, THROUGH])
    return (
        np.where(is_gone[:, None], ends, counts),
        np.where(is_gone, of_ends, log_likelihoods),
    )
