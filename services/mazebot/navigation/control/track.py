"""A tracked obstacle."""

from __future__ import annotations

import math
from typing import NamedTuple


class Track(NamedTuple):
    """A disc that moves at a constant velocity."""

    number: int
    """Of the track; it keeps it for as long as it lives."""
    x_m: float
    y_m: float
    velocity_x_m_s: float
    velocity_y_m_s: float
    radius_m: float

    @property
    def speed_m_s(self) -> float:
        """Speed over the floor."""
        square = self.velocity_x_m_s * self.velocity_x_m_s
        return math.sqrt(square + self.velocity_y_m_s * self.velocity_y_m_s)
