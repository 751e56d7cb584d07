from __future__ import annotations

import math
from typing import Any

import pytest
from pydantic import ValidationError

from mazebot.common.config import one_line
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.controller import RobotLimits
from mazebot.navigation.control.safety.velocity_smoother import (
    VelocitySmoother,
    VelocitySmootherParams,
)

PERIOD_NS = 50_000_000

LIMITS = RobotLimits()


def smoothed(params: VelocitySmootherParams, *commands: Velocity | None) -> list[Velocity | None]:
    """One command, or none, each period."""
    smoother = VelocitySmoother(params, LIMITS)
    out = []
    for i, command in enumerate(commands):
        if command is not None:
            smoother.take(i * PERIOD_NS, command)
        out.append(smoother.step(i * PERIOD_NS, 0.05))
    return out


def test_it_accelerates_and_brakes_within_the_limits_and_arrives() -> None:
    params = VelocitySmootherParams(max_accel=(1.0, 0.0, 2.0), max_decel=(-2.0, 0.0, -4.0))
    up = smoothed(params, *[Velocity(0.2, 0.5)] * 6)
    assert [v for v, _ in filter(None, up)] == pytest.approx([0.05, 0.1, 0.15, 0.2, 0.2, 0.2])
    assert [w for _, w in filter(None, up)] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.5])
    down = smoothed(params, *[Velocity(0.2, 0.0)] * 5, STOP, STOP, STOP)
    assert [v for v, _ in filter(None, down[5:])] == pytest.approx([0.1, 0.0, 0.0])
    # The other way round: as braking.
    back = smoothed(params, *[Velocity(0.2, 0.0)] * 5, Velocity(-0.4, 0.0))
    assert back[5] == pytest.approx((0.1, 0.0))


def test_speeds_stay_within_their_limits() -> None:
    out = smoothed(VelocitySmootherParams(), *[Velocity(2.0, -9.0)] * 40)
    assert out[-1] == Velocity(0.46, -1.9)


def test_one_factor_for_both_axes_keeps_the_curvature() -> None:
    params = VelocitySmootherParams(scale_velocities=True)
    for command in (Velocity(0.4, 0.2), Velocity(0.1, 1.5), Velocity(0.9, 0.9)):
        for v, w in filter(None, smoothed(params, *[command] * 20)):
            assert w / v == pytest.approx(command.angular_rad_s / command.linear_m_s)
    assert smoothed(params, *[Velocity(0.92, 0.4)] * 20)[-1] == pytest.approx((0.46, 0.2))


def test_without_commands_it_ramps_to_zero_and_falls_silent() -> None:
    params = VelocitySmootherParams(velocity_timeout=0.2)
    out = smoothed(params, *[Velocity(0.1, 0.0)] * 3, *[None] * 12)
    assert out[6] == Velocity(0.1, 0.0)
    assert out[7] == pytest.approx((0.05, 0.0))
    assert out[8] == STOP
    assert out[9] is None
    assert smoothed(params, None, None) == [None, None]


def test_a_command_that_is_no_number_is_ignored() -> None:
    smoother = VelocitySmoother(VelocitySmootherParams(), LIMITS)
    assert smoother.take(0, Velocity(0.05, 0.0))
    assert not smoother.take(0, Velocity(math.nan, 0.0))
    assert not smoother.take(0, Velocity(0.0, math.inf))
    assert smoother.step(0, 0.05) == Velocity(0.05, 0.0)


def test_the_dead_band_hides_small_speeds_and_does_not_stick() -> None:
    params = VelocitySmootherParams(deadband_velocity=(0.08, 0.0, 0.0))
    out = smoothed(params, *[Velocity(0.2, 0.0)] * 3)
    assert [v for v, _ in filter(None, out)] == pytest.approx([0.0, 0.1, 0.15])


def test_closed_loop_goes_on_from_what_is_measured() -> None:
    smoother = VelocitySmoother(VelocitySmootherParams(feedback="CLOSED_LOOP"), LIMITS)
    smoother.take(0, Velocity(0.4, 0.0))
    assert smoother.step(0, 0.05, Velocity(0.3, 0.0)) == pytest.approx((0.35, 0.0))
    assert smoother.step(0, 0.05, Velocity(0.0, 0.0)) == pytest.approx((0.05, 0.0))


def test_after_a_stop_of_others_it_begins_from_zero() -> None:
    smoother = VelocitySmoother(VelocitySmootherParams(), LIMITS)
    for i in range(10):
        smoother.take(i, Velocity(0.4, 0.0))
        smoother.step(i, 0.05)
    smoother.reset()
    assert smoother.step(11, 0.05) is None
    smoother.take(12, Velocity(0.4, 0.0))
    assert smoother.step(12, 0.05) == pytest.approx((0.05, 0.0))


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"max_velocity": (-1.0, 0.0, 1.0)}, "max_velocity.0"),
        ({"min_velocity": (-1.0, 0.0, 1.0)}, "min_velocity.2"),
        ({"max_accel": (0.0, 0.0, 1.0)}, "max_accel.0"),
        ({"max_decel": (-1.0, 0.0, 1.0)}, "max_decel.2"),
        ({"deadband_velocity": (0.0, 0.0, math.nan)}, "deadband_velocity.2"),
        ({"velocity_timeout": -1.0}, "velocity_timeout"),
    ],
)
def test_a_limit_that_is_none_is_refused_by_its_field(wrong: dict[str, Any], field: str) -> None:
    with pytest.raises(ValidationError) as caught:
        VelocitySmootherParams(**wrong)
    said = one_line(caught.value)
    assert said.startswith(f"{field}: ")
    assert "must be" in said
