"""How good odometry is, as the scans show: the better it is, the more scans count together."""

from __future__ import annotations

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, PlanarCovariance, wrap_angle
from mazebot.mapping.graph.pose_graph import information_of
from mazebot.mapping.matching.refine import Refined

_MEMORY = 0.98
"""Of what was learned, so much is left after each scan in motion."""
_LEAST, _MOST_SHIFT, _MOST_TURN = 0.02, 1.0, 16.0
"""Factors of the variance that the parameters give. What moves along with the robot passes for bad
odometry of its ways, so that they never count for less than the parameters give.
"""
_MOST_EXCESS = 10.0
"""Of the variance by the parameters, what one scan can show at most."""
_LEAST_MOTION_M2, _LEAST_MOTION_RAD2 = 1e-7, 1e-7
"""Of a scan with less expected variance nothing is learned: the robot stood."""


class OdometryQuality:
    """Factors of odometry's variance, from how far scans correct what odometry predicts.

    The expected square of the difference between the pose by a scan alone and the predicted one is
    the sum of their variances (the innovation of a Kalman filter); what of it is neither the scan's
    nor the last pose's is odometry's.
    """

    def __init__(self) -> None:
        self.shift = 1.0
        """Factor of the variance of moves."""
        self.turn = _LEAST
        """Factor of the variance of turns. It begins low: the error of the first scans, which have
        little around them to be matched with, would turn the whole map.
        """
        self._before = PlanarCovariance()
        self._expected = (0.0, 0.0)
        self._shift_sums = (_LEAST_MOTION_M2 * 100.0, _LEAST_MOTION_M2 * 100.0)
        self._turn_sums = (_LEAST * _LEAST_MOTION_RAD2 * 100.0, _LEAST_MOTION_RAD2 * 100.0)

    def begin(self, before: PlanarCovariance, shift_m2: float, turn_rad2: float) -> None:
        """A motion begins: covariance of the pose before it, and variances by the parameters."""
        self._before = before
        self._expected = (shift_m2, turn_rad2)

    def learn(self, predicted: SE2, covariance: PlanarCovariance, found: Refined) -> None:
        """The motion ended: the pose predicted with its covariance, and the pose with both."""
        corrected = np.array(
            [
                found.map_from_base.x_m - predicted.x_m,
                found.map_from_base.y_m - predicted.y_m,
                wrap_angle(found.map_from_base.yaw_rad - predicted.yaw_rad),
            ]
        )
        try:
            of_scan = information_of(found.information)
        except ValueError:
            return
        prior = information_of(covariance.matrix())
        # The correction is the gain times the innovation; the gain's inverse is 1 + R P^-1.
        innovation = corrected + portable.product(of_scan, portable.product(prior, corrected))
        shift_m2, turn_rad2 = self._expected
        before = self._before
        if shift_m2 > _LEAST_MOTION_M2:
            excess = (
                portable.square(float(innovation[0]))
                + portable.square(float(innovation[1]))
                - float(of_scan[0, 0] + of_scan[1, 1])
                - before.x_x
                - before.y_y
            )
            self._shift_sums, self.shift = _learnt(
                self._shift_sums, excess, 2.0 * shift_m2, _MOST_SHIFT
            )
        if turn_rad2 > _LEAST_MOTION_RAD2:
            excess = portable.square(float(innovation[2])) - float(of_scan[2, 2]) - before.yaw_yaw
            self._turn_sums, self.turn = _learnt(self._turn_sums, excess, turn_rad2, _MOST_TURN)


def _learnt(
    sums: tuple[float, float], excess: float, expected: float, most: float
) -> tuple[tuple[float, float], float]:
    found, by_parameters = sums
    # One scan far off, as beside something that moves, is weak evidence.
    found = _MEMORY * found + min(excess, _MOST_EXCESS * expected)
    by_parameters = _MEMORY * by_parameters + expected
    return (found, by_parameters), min(max(found / by_parameters, _LEAST), most)
