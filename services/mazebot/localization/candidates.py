"""Poses on the map that a scan fits, and those of them that are the estimate's own."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import SE2, Array
from mazebot.localization import particle_filter as pf
from mazebot.localization.beam_model import (
    HIT,
    MISFIT,
    MISS_COST,
    MISSING,
    NOWHERE_COST,
    SHORT,
    THROUGH,
    ScanView,
)
from mazebot.localization.global_search.hypotheses import BEAM_WEIGHT

CERTAIN_QUALITY = 0.75
"""From this quality on, a pose fits."""
RIVAL = 6.0
"""Advantage in log-likelihood from which on another pose speaks against the estimate."""
GATE = 16.27
"""99.9 % of chi squared with three degrees of freedom."""
_FOUND_STD_M, _FOUND_STD_RAD = 0.06, 0.04
FOUND_VARIANCES = (
    _FOUND_STD_M * _FOUND_STD_M, _FOUND_STD_M * _FOUND_STD_M, _FOUND_STD_RAD * _FOUND_STD_RAD
)  # fmt: skip
"""Of x, y and yaw of a pose that was found on the map."""
BESIDE_M, _BESIDE_RAD = 0.6, 0.4
"""Where a robot is that slipped or was pushed, or that turned far between two scans."""
_NEARLY_ALL, _FAR_LIKELIER = 0.9, 12.0
"""Of a robot with boxes all around, 3 of 4 beams and 13 were the most at any pose elsewhere; of one
that was carried to another corner of a maze, all beams and 17 to 19 at its own.
"""
WIDE_M = 0.3
"""From this standard deviation on, particles are too few: hardly one is at the right pose."""


class Candidates(NamedTuple):
    """Poses on the map that a scan fits."""

    poses: Array
    """(n, 3)"""
    counts: Array
    """(n, 7), as `judge` gives them"""
    likelihoods: Array
    """(n,) logarithms, as `judge` gives them"""
    quality: Array
    """(n,)"""


class Beside(NamedTuple):
    """Where the robot is, by a scan and the estimate before it."""

    poses: Array
    """(n, 3)"""
    weights: Array
    """(n,) how likely each is, 1 in all"""
    quality: float
    """Of the likeliest."""


def poses_beside(
    found: Candidates, view: ScanView, pose: SE2, covariance: Array, likelihood: float
) -> Beside | None:
    """The candidates beside an estimate, if the best of all is there, and far likelier than the
    estimate or less spread: it is not lost, but wrong or wide.

    Args:
        found: where the map may fit the scan; those elsewhere only if the robot may be there.
        view: the scan.
        pose: the estimate.
        covariance: (3, 3) of the estimate.
        likelihood: logarithm, of the scan at the estimate, as `judge` gives it.
    """
    if not len(found.poses):
        return None
    best = int(np.argmax(found.likelihoods))
    # What hides the walls is as well explained at a place that is not on the map.
    is_hidden = found.quality[best] >= CERTAIN_QUALITY
    if not is_hidden and found.likelihoods[best] < nowhere(found.counts[best], view):
        return None
    included = np.array([_includes(pose, covariance, SE2(*one)) for one in found.poses.tolist()])
    if not included[best]:
        return None
    poses = found.poses[included]
    behind = BEAM_WEIGHT * (found.likelihoods[best] - found.likelihoods[included])
    weights = portable_kernels.exp_each(-behind)
    weights /= float(weights.sum())
    is_likelier = BEAM_WEIGHT * float(found.likelihoods[best] - likelihood) >= RIVAL
    _, of_poses = pf.mean_and_covariance(poses, weights)
    if not (is_likelier or std_m(of_poses) < WIDE_M < std_m(covariance)):
        return None
    return Beside(poses, weights, float(found.quality[best]))


def explains_all(found: Candidates, view: ScanView, likelihood: float) -> bool:
    """Whether one of some candidates ends nearly each beam of a scan on the map's walls, and is far
    likelier than the estimate, with this log-likelihood.

    Where things that are not on the map stand around the robot, they end most of the beams of a
    right pose, and no other pose has walls just there.
    """
    share = found.counts[:, HIT] / max(view.returns, 1)
    likelier = BEAM_WEIGHT * (found.likelihoods - likelihood)
    return bool(((share >= _NEARLY_ALL) & (likelier >= _FAR_LIKELIER)).any())


def _includes(pose: SE2, covariance: Array, other: SE2) -> bool:
    """Whether another pose is beside an estimate, or the estimate's covariance includes it."""
    if pose.is_near(other, BESIDE_M, _BESIDE_RAD):
        return True
    wider = covariance + np.diag(FOUND_VARIANCES)
    return pf.squared_mahalanobis(other, pose, wider) <= GATE


def std_m(covariance: Array) -> float:
    """Standard deviation along the axis of the map where it is larger, of a (3, 3) covariance."""
    return math.sqrt(max(float(covariance[0, 0]), float(covariance[1, 1])))


def nowhere(counts: Array, view: ScanView) -> float:
    """Log-likelihood of a scan at a place that is not on the map, by the counts (7,) of beams at a
    pose on it. Rays that are lost are lost at each place.
    """
    returns = float(counts[[HIT, SHORT, MISFIT, THROUGH]].sum())
    cost = NOWHERE_COST * returns + MISS_COST * float(counts[MISSING])
    return -cost * view.likelihood_weight
