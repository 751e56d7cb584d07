"""The battery, by itself and in the simulator."""

from __future__ import annotations

import math

import pytest

from mazebot.common.messages import wire
from mazebot.common.messages.topics import BATTERY_STATE
from mazebot.physics.battery import Battery
from tests.physics.driver import Driver, world
from tests.physics.test_run_control import answer

HOUR_NS = 3_600_000_000_000


def test_it_is_full_at_first_and_empty_after_its_time() -> None:
    battery = Battery(capacity_ah=1.8, current_a=0.9, charge_at_start=1.0)
    full, half, empty, later = (battery.message(int(h * HOUR_NS)) for h in (0, 1, 2, 3))
    assert (full.percentage, full.charge) == pytest.approx((1.0, 1.8))
    assert full.voltage == pytest.approx(12.6)
    assert (half.percentage, half.charge, half.current) == pytest.approx((0.5, 0.9, -0.9))
    assert half.voltage == pytest.approx(11.1)
    assert (empty.percentage, empty.charge, empty.current) == (0.0, 0.0, 0.0)
    assert empty.voltage == later.voltage == pytest.approx(9.6)
    assert math.isnan(full.temperature)
    for message in (full, half, empty):
        assert sum(message.cell_voltage) == pytest.approx(message.voltage)
        assert wire.decode(BATTERY_STATE, wire.encode(BATTERY_STATE, message)) is not None


def test_it_may_begin_low_and_last_longer() -> None:
    battery = Battery(capacity_ah=2.0, current_a=0.5, charge_at_start=0.5)
    assert battery.charge(0.0) == 0.5
    assert battery.charge(3600.0) == pytest.approx(0.25)
    assert battery.charge(7200.0) == 0.0
    assert Battery(2.0, 0.0, 0.5).charge(1e9) == 0.5


def test_the_simulator_empties_it_and_a_reset_fills_it() -> None:
    driver = Driver(battery_capacity_ah=0.01, battery_current_a=6.0).load(world())
    driver.wait(3.0)
    shares = [message.percentage for message in driver.all(BATTERY_STATE)]
    assert shares == pytest.approx([5 / 6, 4 / 6, 3 / 6])
    assert answer(driver, reset="all").error == ""
    driver.wait(1.0)
    assert driver.last(BATTERY_STATE).percentage == pytest.approx(5 / 6)
