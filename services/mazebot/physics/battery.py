"""The robot's battery: a lithium polymer pack that the robot empties evenly, as Gazebo's linear
battery with a constant load.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mazebot.common.messages import messages as msg

CELLS = 3
FULL_V, EMPTY_V = 4.2, 3.2
"""Of a cell without a load: at their mean, three have the 11.1 V of TurtleBot3's pack."""
_DISCHARGING, _GOOD, _LITHIUM_POLYMER = 2, 1, 3


@dataclass(frozen=True)
class Battery:
    """A pack that was full, or as full as it is said to have been, when the run began."""

    capacity_ah: float
    current_a: float
    charge_at_start: float
    """0 to 1."""

    def charge(self, time_s: float) -> float:
        """What is left of the capacity after a time, 0 to 1."""
        used = time_s / 3600.0 * self.current_a / self.capacity_ah
        return max(self.charge_at_start - used, 0.0)

    def message(self, stamp_ns: int) -> msg.BatteryState:
        """Its state after that time."""
        charge = self.charge(stamp_ns * 1e-9)
        cell_v = EMPTY_V + charge * (FULL_V - EMPTY_V)
        cells = np.full(CELLS, cell_v, np.float32)
        return msg.BatteryState(
            header=msg.header(stamp_ns, "base_link"),
            voltage=msg.float32(CELLS * cell_v),
            temperature=math.nan,
            current=msg.float32(-self.current_a if charge else 0.0),
            charge=msg.float32(charge * self.capacity_ah),
            capacity=msg.float32(self.capacity_ah),
            design_capacity=msg.float32(self.capacity_ah),
            percentage=msg.float32(charge),
            power_supply_status=_DISCHARGING,
            power_supply_health=_GOOD,
            power_supply_technology=_LITHIUM_POLYMER,
            present=True,
            cell_voltage=cells,
            cell_temperature=np.full(CELLS, np.nan, np.float32),
            location="",
            serial_number="",
        )
