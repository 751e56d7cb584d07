"""The functions of `portable`, compiled for kernels and arrays, with the same bits; and normal
deviates, because NumPy's use the C library's logarithm for the tails.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mazebot.common.maths import portable
from mazebot.common.maths.kernels import elementwise, kernel, shared_kernel
from mazebot.common.maths.portable import Array

cos_sin = shared_kernel()(portable.cos_sin)
atan2 = shared_kernel()(portable.atan2)
exp = shared_kernel()(portable.exp)
log = shared_kernel()(portable.log)


@shared_kernel()
def sin(angle_rad: float) -> float:
    """As `portable.sin`."""
    return cos_sin(angle_rad)[1]


@shared_kernel()
def cos(angle_rad: float) -> float:
    """As `portable.cos`."""
    return cos_sin(angle_rad)[0]


@shared_kernel()
def asin(sine: float) -> float:
    """As `portable.asin`, and NaN beyond [-1, 1]."""
    return atan2(sine, math.sqrt((1.0 - sine) * (1.0 + sine)))


@elementwise("float64(float64)")
def _exp_each(x: float) -> float:
    return exp(x)


@elementwise("float64(float64)")
def _log_each(x: float) -> float:
    return log(x)


@kernel("void(float64[::1], float64[:, ::1])")
def _cos_sin_each(angles_rad: Array, both: Array) -> None:
    for i in range(angles_rad.size):
        both[0, i], both[1, i] = cos_sin(angles_rad[i])


@kernel("void(float64[:, ::1], float64[::1])")
def _normal(uniform: Array, normal: Array) -> None:
    half = normal.size // 2
    for i in range(normal.size - half):
        radius = math.sqrt(-2.0 * log(1.0 - uniform[i, 0]))
        cosine, sine = cos_sin(2.0 * math.pi * uniform[i, 1])
        normal[i] = radius * cosine
        if i < half:
            normal[normal.size - half + i] = radius * sine


def exp_each(values: ArrayLike) -> Array:
    """`exp` of each element."""
    return np.asarray(_exp_each(values), np.float64)  # type: ignore[arg-type]


def log_each(values: ArrayLike) -> Array:
    """`log` of each element."""
    return np.asarray(_log_each(values), np.float64)  # type: ignore[arg-type]


def cos_sin_each(angles_rad: ArrayLike) -> tuple[Array, Array]:
    """`cos_sin` of each element."""
    angles = np.ascontiguousarray(angles_rad, np.float64)
    both = np.empty((2, angles.size))
    _cos_sin_each(angles.reshape(-1), both)
    return both[0].reshape(angles.shape), both[1].reshape(angles.shape)


def standard_normal(random: np.random.Generator, shape: int | tuple[int, ...]) -> Array:
    """Independent normal deviates of variance 1, by Box and Muller (1958)."""
    normal = np.empty(shape)
    _normal(random.random(((normal.size + 1) // 2, 2)), normal.reshape(-1))
    return normal
