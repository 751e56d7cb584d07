"""The scale of odometry's ways, as the scans show it."""

from __future__ import annotations

import math

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, PlanarCovariance
from mazebot.mapping.matching.refine import Refined

_STD, _MOST = 0.03, 0.15
"""Of the scale before any scan, and how far it can be from 1: wheels are worn, tyres soft."""
_WANDER = 3e-4
"""Standard deviation by which floor and load change it within a metre: 1 % within a kilometre."""
_LEAST_WAY_M = 0.02
"""Of a shorter step nothing is learned: a match errs by as much."""
_MATCH_STD_M = 0.02
"""Matches of one place share their errors, however many returns there are."""
_LEAST_KNOWN = 0.25
"""With less of the prediction's information along the way, the walls do not say how far it was."""
_MOST_SIGMAS = 2.0
"""One scan far off, as beside something that moves, is weak evidence."""


class OdometryScale:
    """A Kalman filter of one state, whose measurement is the innovation of the pose along the way.

    Where walls leave a direction open, a wrong scale would add up all along a corridor. What scans
    show elsewhere of it is known there.
    """

    def __init__(self) -> None:
        self.factor = 1.0
        """Of ways; one of 1.02 means that odometry has them 2 % too short."""
        self._variance = _STD * _STD
        self._way_m = (0.0, 0.0)

    def begin(self, pose: SE2, there: SE2) -> None:
        """A motion begins: from `pose` to `there`, by odometry with the factor so far."""
        self._way_m = there.x_m - pose.x_m, there.y_m - pose.y_m
        wandered = _WANDER * _WANDER * math.sqrt(_squares(self._way_m))
        self._variance = min(self._variance + wandered, _STD * _STD)

    def learn(self, predicted: SE2, covariance: PlanarCovariance, found: Refined) -> None:
        """The motion ended: the pose predicted with its covariance, and the pose with both."""
        far_m = math.sqrt(_squares(self._way_m))
        if far_m < _LEAST_WAY_M:
            return
        ux, uy = self._way_m[0] / far_m, self._way_m[1] / far_m
        along = np.array([[ux, uy, 0.0], [-uy, ux, 0.0], [0.0, 0.0, 1.0]])
        information = _marginal(portable.product(along, found.information, along.T))
        variance_m2 = float(portable.product(along, covariance.matrix(), along.T)[0, 0])
        known = information * variance_m2
        if not known >= _LEAST_KNOWN:
            return
        of_match_m2 = 1.0 / information + _MATCH_STD_M * _MATCH_STD_M
        shift_m = ux * (found.map_from_base.x_m - predicted.x_m) + uy * (
            found.map_from_base.y_m - predicted.y_m
        )
        # The shift is the gain times the innovation.
        innovation_m = shift_m * (1.0 + 1.0 / known)
        way_m = far_m / self.factor
        total_m2 = variance_m2 + of_match_m2 + way_m * way_m * self._variance
        most_m = _MOST_SIGMAS * math.sqrt(total_m2)
        gain = self._variance * way_m / total_m2
        factor = self.factor + gain * min(max(innovation_m, -most_m), most_m)
        self.factor = min(max(factor, 1.0 - _MOST), 1.0 + _MOST)
        self._variance *= 1.0 - gain * way_m


def _squares(way_m: tuple[float, float]) -> float:
    return way_m[0] * way_m[0] + way_m[1] * way_m[1]


def _marginal(information: Array) -> float:
    """Of the first of three coordinates, the others being unknown as well (Schur complement)."""
    (a, b, c), (_, d, e), (_, _, f) = information.tolist()
    determinant = d * f - e * e
    return (
        float(a - (b * b * f - 2.0 * b * c * e + c * c * d) / determinant) if determinant else 0.0
    )
