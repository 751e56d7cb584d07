"""MPPI's rollouts: many control sequences, limited by what the robot can do, and where they lead.

All arrays are float32, (steps + 1, batch); row 0 is the present. Loops run over the batch, whose
elements are independent, so that they compile to vector instructions without changing a bit.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.kernels import kernel

Floats = NDArray[np.float32]

_HALF: Final = np.float32(0.5)
_ONE: Final = np.float32(1.0)
_SIXTH: Final = np.float32(1.0 / 6.0)
_24TH: Final = np.float32(1.0 / 24.0)


class Rollouts(NamedTuple):
    """Speeds and poses; x and y from where the robot is now, along the axes of the map."""

    linear_m_s: Floats
    angular_rad_s: Floats
    x_m: Floats
    y_m: Floats
    cos_yaw: Floats
    sin_yaw: Floats

    @staticmethod
    def empty(steps: int, batch: int) -> Rollouts:
        """Arrays of zeros."""
        return Rollouts(*(np.zeros((steps + 1, batch), np.float32) for _ in range(6)))


class Limits(NamedTuple):
    """What the robot can do in one step, as float32."""

    linear_min_m_s: np.float32
    linear_max_m_s: np.float32
    angular_max_rad_s: np.float32
    linear_up_m_s: np.float32
    """Greatest change of speed away from 0 within a step."""
    linear_down_m_s: np.float32
    """The same towards 0."""
    angular_step_rad_s: np.float32
    step_s: np.float32


def correlated_noise(
    random: np.random.Generator, steps: int, columns: int, std: float, correlation: float
) -> Floats:
    """(steps, columns) float32 normal deviates; those of successive steps are correlated.

    With independent deviates a robot that accelerates slowly follows none of them.

    Args:
        random: the source.
        steps: of a sequence.
        columns: number of sequences.
        std: standard deviation of each element.
        correlation: between successive elements, 0 to below 1.
    """
    noise = portable_kernels.standard_normal(random, (steps, columns))
    fresh = np.sqrt(1.0 - correlation * correlation)
    for k in range(1, steps):
        noise[k] = correlation * noise[k - 1] + fresh * noise[k]
    return np.asarray(noise * std, np.float32)


@kernel(error_model="numpy")
def _limited(
    mean: np.float32,
    noise: Floats,
    low: np.float32,
    high: np.float32,
    before: Floats,
    up: np.float32,
    down: np.float32,
    out: Floats,
) -> None:
    zero = np.float32(0.0)
    for i in range(out.size):
        wanted = mean + noise[i]
        wanted = wanted if wanted > low else low
        wanted = wanted if wanted < high else high
        last = before[i]
        # Beyond 0 a brake becomes an acceleration.
        slower, faster = last - down, last + down
        slower = slower if slower > -up else -up
        faster = faster if faster < up else up
        least = slower if last > zero else last - up
        most = faster if last < zero else last + up
        wanted = wanted if wanted > least else least
        out[i] = wanted if wanted < most else most


@kernel(error_model="numpy")
def _step_to(wanted: np.float32, last: np.float32, up: np.float32, down: np.float32) -> np.float32:
    zero = np.float32(0.0)
    least = max(last - down, -up) if last > zero else last - up
    most = min(last + down, up) if last < zero else last + up
    return min(max(wanted, least), most)


@kernel(error_model="numpy")
def _turned(
    rate: Floats,
    step_s: np.float32,
    cos_before: Floats,
    sin_before: Floats,
    cos_after: Floats,
    sin_after: Floats,
) -> None:
    """Sine and cosine of a sum; those of a step's turn, under 0.2 rad, by their series."""
    for i in range(rate.size):
        turn = rate[i] * step_s
        square = turn * turn
        sine = turn * (_ONE - square * _SIXTH)
        cosine = _ONE - square * (_HALF - square * _24TH)
        cos_after[i] = cos_before[i] * cosine - sin_before[i] * sine
        sin_after[i] = cos_before[i] * sine + sin_before[i] * cosine


@kernel(error_model="numpy")
def _moved(
    speed: Floats,
    half_step_s: np.float32,
    along_before: Floats,
    along_after: Floats,
    before: Floats,
    after: Floats,
) -> None:
    for i in range(speed.size):
        after[i] = before[i] + speed[i] * half_step_s * (along_before[i] + along_after[i])


@kernel(error_model="numpy")
def roll_out(
    linear_mean_m_s: Floats,
    angular_mean_rad_s: Floats,
    linear_noise: Floats,
    angular_noise: Floats,
    first: int,
    constant: Floats,
    limits: Limits,
    rollouts: Rollouts,
) -> None:
    """Fill rows 1 to the last of the rollouts from row 0, which the caller has set.

    Speeds within the limits, yaw before position, position by the mean of the headings before and
    after.

    Args:
        linear_mean_m_s: (steps,), the sequence around which is searched.
        angular_mean_rad_s: (steps,).
        linear_noise: (steps, columns).
        angular_noise: (steps, columns).
        first: column of the noise that the first rollout takes; the others follow.
        constant: (n, 2) float32, speeds that the first n rollouts want instead at all times.
        limits: of the robot.
        rollouts: (steps + 1, batch) each.
    """
    v, w, x, y, c, s = rollouts
    half_s = limits.step_s * _HALF
    end = first + v.shape[1]
    for k in range(linear_mean_m_s.size):
        _limited(
            linear_mean_m_s[k],
            # Of a row, so that it counts as contiguous and compiles to vector instructions.
            linear_noise[k][first:end],
            limits.linear_min_m_s,
            limits.linear_max_m_s,
            v[k],
            limits.linear_up_m_s,
            limits.linear_down_m_s,
            v[k + 1],
        )
        _limited(
            angular_mean_rad_s[k],
            angular_noise[k][first:end],
            -limits.angular_max_rad_s,
            limits.angular_max_rad_s,
            w[k],
            limits.angular_step_rad_s,
            limits.angular_step_rad_s,
            w[k + 1],
        )
        for i in range(len(constant)):
            wanted = max(min(constant[i, 0], limits.linear_max_m_s), limits.linear_min_m_s)
            v[k + 1, i] = _step_to(wanted, v[k, i], limits.linear_up_m_s, limits.linear_down_m_s)
            w[k + 1, i] = _step_to(
                constant[i, 1], w[k, i], limits.angular_step_rad_s, limits.angular_step_rad_s
            )
        _turned(w[k + 1], limits.step_s, c[k], s[k], c[k + 1], s[k + 1])
        _moved(v[k + 1], half_s, c[k], c[k + 1], x[k], x[k + 1])
        _moved(v[k + 1], half_s, s[k], s[k + 1], y[k], y[k + 1])


@kernel(error_model="numpy")
def add_control_cost(costs: Floats, values: Floats, mean: Floats, weight: np.float32) -> None:
    """Add weight * sum((value - mean) * mean) over the steps (Williams et al., ICRA 2017)."""
    for k in range(mean.size):
        row, factor, at = values[k + 1], weight * mean[k], mean[k]
        for i in range(costs.size):
            costs[i] += factor * (row[i] - at)


@kernel(error_model="numpy")
def softmax(costs: Floats, temperature: float, weights: NDArray[np.float64]) -> int:
    """Weights exp(-(cost - least) / temperature), of sum 1, and the index of the least cost.

    Weights under 5e-5 of the greatest are 0.
    """
    best = 0
    for i in range(costs.size):
        if costs[i] < costs[best]:
            best = i
    total = 0.0
    for i in range(costs.size):
        above = (np.float64(costs[i]) - np.float64(costs[best])) / temperature
        weights[i] = portable_kernels.exp(-above) if above < 10.0 else 0.0
        total += weights[i]
    for i in range(costs.size):
        weights[i] /= total
    return best


@kernel(error_model="numpy")
def weighted_mean(
    values: Floats, weights: NDArray[np.float64], mean: Floats, chosen: NDArray[np.int64]
) -> int:
    """(steps,) mean of rows 1 to the last of (steps + 1, batch); the number of weights above 0.

    `chosen` is (batch,), memory for their indices.
    """
    count = 0
    for i in range(weights.size):
        if weights[i] > 0.0:
            chosen[count] = i
            count += 1
    # Four steps at once: their sums do not wait for one another.
    whole = mean.size - mean.size % 4
    for k in range(0, whole, 4):
        first, second, third, fourth = values[k + 1], values[k + 2], values[k + 3], values[k + 4]
        a = b = c = d = 0.0
        for j in range(count):
            i = chosen[j]
            weight = weights[i]
            a += weight * np.float64(first[i])
            b += weight * np.float64(second[i])
            c += weight * np.float64(third[i])
            d += weight * np.float64(fourth[i])
        mean[k], mean[k + 1] = np.float32(a), np.float32(b)
        mean[k + 2], mean[k + 3] = np.float32(c), np.float32(d)
    for k in range(whole, mean.size):
        total = 0.0
        for j in range(count):
            total += weights[chosen[j]] * np.float64(values[k + 1, chosen[j]])
        mean[k] = np.float32(total)
    return count


SAVITZKY_GOLAY: Final = np.array([-21, 14, 39, 54, 59, 54, 39, 14, -21], np.float64) / 231.0
"""Coefficients of a smoothing quadratic over nine points (Savitzky and Golay, 1964)."""
HISTORY: Final = 4


@kernel(error_model="numpy")
def smooth(sequence: Floats, history: Floats, coefficients: NDArray[np.float64]) -> None:
    """Smooth a sequence of commands in place, with the four past ones before it (oldest first) and
    its last one repeated after it.
    """
    steps = sequence.size
    around = np.empty(steps + 8, np.float64)
    for i in range(4):
        around[i] = history[i]
        around[steps + 4 + i] = sequence[steps - 1]
    for i in range(steps):
        around[4 + i] = sequence[i]
    for i in range(steps):
        total = 0.0
        for j in range(9):
            total += coefficients[j] * around[i + j]
        sequence[i] = np.float32(total)
