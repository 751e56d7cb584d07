from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.navigation.control.mppi.rollouts import (
    SAVITZKY_GOLAY,
    Limits,
    Rollouts,
    correlated_noise,
    roll_out,
    smooth,
    softmax,
    weighted_mean,
)

F = np.float32
STEPS, BATCH = 56, 40
LIMITS = Limits(F(-0.2), F(0.46), F(1.9), F(0.05), F(0.05), F(0.1), F(0.05))


def rolled(
    start: tuple[float, float] = (0.3, -0.2), yaw_rad: float = 2.0, limits: Limits = LIMITS
) -> Rollouts:
    random = np.random.default_rng(3)
    rollouts = Rollouts.empty(STEPS, BATCH)
    for array, value in zip(
        rollouts, (*start, 0.0, 0.0, math.cos(yaw_rad), math.sin(yaw_rad)), strict=True
    ):
        array[0] = value
    linear = correlated_noise(random, STEPS, BATCH, 0.3, 0.8)
    angular = correlated_noise(random, STEPS, BATCH, 0.8, 0.8)
    constant = np.array([(0.46, 0.0), (0.0, 0.0), (0.3, 1.0)], F)
    mean = np.full(STEPS, 0.2, F)
    roll_out(mean, mean * F(0.5), linear, angular, 0, constant, limits, rollouts)
    return rollouts


def test_rollouts_keep_the_limits_of_speed_and_acceleration() -> None:
    v, w, *_ = rolled()
    assert v[1:].max() <= 0.46
    assert v[1:].min() >= -0.2
    assert np.abs(w[1:]).max() <= 1.9
    assert np.abs(np.diff(v, axis=0)).max() == pytest.approx(0.05, abs=1e-6)
    assert np.abs(np.diff(w, axis=0)).max() == pytest.approx(0.1, abs=1e-6)


def test_a_slower_acceleration_than_braking_is_kept_in_both_directions() -> None:
    v = rolled(limits=LIMITS._replace(linear_up_m_s=F(0.01)))[0]
    away = np.abs(v[1:]) - np.abs(v[:-1])
    assert away.max() <= 0.01 + 1e-6
    # A braking step may lead through 0.
    assert np.abs(np.diff(v, axis=0)).max() == pytest.approx(0.05, abs=1e-6)


def test_poses_are_the_integral_of_the_speeds() -> None:
    v, w, x, y, c, s = (array.astype(np.float64) for array in rolled())
    yaw = 2.0 + np.concatenate([np.zeros((1, BATCH)), np.cumsum(w[1:] * 0.05, axis=0)])
    assert np.abs(c - np.cos(yaw)).max() < 2e-5
    assert np.abs(s - np.sin(yaw)).max() < 2e-5
    middle = (yaw[1:] + yaw[:-1]) / 2.0
    # The chord of an arc, to the second order of a step's turn.
    assert np.abs(x[1:] - np.cumsum(v[1:] * 0.05 * np.cos(middle), axis=0)).max() < 2e-3
    assert np.abs(y[1:] - np.cumsum(v[1:] * 0.05 * np.sin(middle), axis=0)).max() < 2e-3


def test_constant_controls_are_reached_and_held() -> None:
    v, w, *_ = rolled()
    assert v[-1, :3] == pytest.approx([0.46, 0.0, 0.3])
    assert w[-1, :3] == pytest.approx([0.0, 0.0, 1.0])


def test_noise_has_the_spread_and_the_correlation_that_were_asked_for() -> None:
    noise = correlated_noise(np.random.default_rng(1), STEPS, 4000, 0.4, 0.8)
    assert noise.std(axis=1) == pytest.approx(np.full(STEPS, 0.4), rel=0.06)
    lag = np.corrcoef(noise[10], noise[11])[0, 1]
    assert lag == pytest.approx(0.8, abs=0.03)
    again = correlated_noise(np.random.default_rng(1), STEPS, 4000, 0.4, 0.8)
    assert noise.tobytes() == again.tobytes()


def test_weights_fall_with_cost_and_have_the_mean_as_their_sum() -> None:
    costs = np.array([3.0, 1.0, 1.3, 1e6], F)
    weights = np.empty(4)
    assert softmax(costs, 0.3, weights) == 1
    assert weights.sum() == pytest.approx(1.0)
    assert weights[2] / weights[1] == pytest.approx(math.exp(-1.0), rel=1e-5)
    assert weights[3] == 0.0
    values = np.arange(12, dtype=F).reshape(3, 4)
    mean = np.empty(2, F)
    assert weighted_mean(values, weights, mean, np.empty(4, np.int64)) == 3
    assert mean == pytest.approx(values[1:] @ weights, rel=1e-6)


def test_smoothing_keeps_a_parabola_and_flattens_noise() -> None:
    t = np.arange(-4, 20)
    parabola = (0.01 * t**2 - 0.1 * t).astype(F)
    sequence = parabola[4:].copy()
    smooth(sequence, parabola[:4].copy(), SAVITZKY_GOLAY)
    assert sequence[:-4] == pytest.approx(parabola[4:-4], abs=1e-5)
    noisy = np.random.default_rng(2).standard_normal(50).astype(F)
    flat = noisy.copy()
    smooth(flat, np.zeros(4, F), SAVITZKY_GOLAY)
    assert np.diff(flat).std() < 0.5 * np.diff(noisy).std()
