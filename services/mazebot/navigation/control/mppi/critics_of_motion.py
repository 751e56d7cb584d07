"""MPPI's critics of the speeds alone."""

from __future__ import annotations

import numpy as np

from mazebot.common.maths.kernels import kernel
from mazebot.navigation.control.mppi.critic_params import (
    ConstraintCriticParams,
    PreferForwardCriticParams,
    TwirlingCriticParams,
    VelocityDeadbandCriticParams,
)
from mazebot.navigation.control.mppi.critics import Scene
from mazebot.navigation.control.mppi.rollouts import Floats


@kernel(error_model="numpy")
def add_powered(costs: Floats, values: Floats, weight: np.float32, power: int) -> None:
    """Add (weight * value) to the power of `power` to each cost."""
    if power == 1:
        for i in range(costs.size):
            costs[i] += weight * values[i]
        return
    for i in range(costs.size):
        weighted = weight * values[i]
        made = weighted
        for _ in range(power - 1):
            made *= weighted
        costs[i] += made


@kernel(error_model="numpy")
def _excess(speeds: Floats, low: np.float32, high: np.float32, out: Floats) -> None:
    """Sum over the steps of how far speeds are outside a range."""
    zero = np.float32(0.0)
    out[:] = zero
    for k in range(1, speeds.shape[0]):
        row = speeds[k]
        for i in range(out.size):
            over, under = row[i] - high, low - row[i]
            over = over if over > zero else zero
            out[i] += over + (under if under > zero else zero)


@kernel(error_model="numpy")
def _inside(speeds: Floats, band: np.float32, out: Floats) -> None:
    """Add over the steps how far speeds are within -band to band."""
    zero = np.float32(0.0)
    for k in range(1, speeds.shape[0]):
        row = speeds[k]
        for i in range(out.size):
            missing = band - abs(row[i])
            out[i] += missing if missing > zero else zero


@kernel(error_model="numpy")
def _absolute(speeds: Floats, out: Floats) -> None:
    out[:] = np.float32(0.0)
    for k in range(1, speeds.shape[0]):
        row = speeds[k]
        for i in range(out.size):
            out[i] += abs(row[i])


class ConstraintCritic:
    """Speeds outside vx_min to vx_max, which rollouts only have where they begin there."""

    def __init__(self, params: ConstraintCriticParams, vx_min: float, vx_max: float) -> None:
        self._params = params
        self._low, self._high = np.float32(vx_min), np.float32(vx_max)

    def score(self, scene: Scene) -> None:
        """See Critic."""
        p, values = self._params, np.empty_like(scene.costs)
        _excess(scene.rollouts.linear_m_s, self._low, self._high, values)
        add_powered(scene.costs, values, np.float32(p.cost_weight * scene.step_s), p.cost_power)


class PreferForwardCritic:
    """The way driven backwards."""

    def __init__(self, params: PreferForwardCriticParams) -> None:
        self._params = params

    def score(self, scene: Scene) -> None:
        """See Critic."""
        p, values = self._params, np.empty_like(scene.costs)
        if scene.remaining_m <= p.threshold_to_consider:
            return
        _excess(scene.rollouts.linear_m_s, np.float32(0.0), np.float32(1e9), values)
        add_powered(scene.costs, values, np.float32(p.cost_weight * scene.step_s), p.cost_power)


class TwirlingCritic:
    """The mean turning speed."""

    def __init__(self, params: TwirlingCriticParams) -> None:
        self._params = params

    def score(self, scene: Scene) -> None:
        """See Critic."""
        p, values = self._params, np.empty_like(scene.costs)
        rates = scene.rollouts.angular_rad_s
        _absolute(rates, values)
        add_powered(scene.costs, values, np.float32(p.cost_weight / (len(rates) - 1)), p.cost_power)


class VelocityDeadbandCritic:
    """Speeds too low for the motors; a differential drive has no speed to the side."""

    def __init__(self, params: VelocityDeadbandCriticParams) -> None:
        self._params = params

    def score(self, scene: Scene) -> None:
        """See Critic."""
        p, values = self._params, np.zeros_like(scene.costs)
        linear, _, angular = p.deadband_velocities
        _inside(scene.rollouts.linear_m_s, np.float32(linear), values)
        _inside(scene.rollouts.angular_rad_s, np.float32(angular), values)
        add_powered(scene.costs, values, np.float32(p.cost_weight * scene.step_s), p.cost_power)
