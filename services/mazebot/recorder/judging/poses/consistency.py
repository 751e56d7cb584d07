"""Whether an estimated pose's covariance is consistent with its true error."""

from __future__ import annotations

import numpy as np

from mazebot.common.maths.frames import Array

CHI2_3_95 = 7.815
"""95 % quantile of the chi-square distribution with three degrees of freedom: x, y, yaw."""


def inside_95_percent(error: Array, covariance: Array) -> bool:
    """Whether the truth lies inside the 95 % ellipsoid of an estimate, heading included: of
    consistent estimates, 95 of 100 do.

    Args:
        error: (3,) estimate minus truth: x, y (m), yaw (rad, wrapped).
        covariance: (3, 3) of these. One that is singular or not positive holds nothing.
    """
    try:
        square = float(error @ np.linalg.solve(covariance, error))
    except np.linalg.LinAlgError:
        return False
    return 0.0 <= square <= CHI2_3_95
