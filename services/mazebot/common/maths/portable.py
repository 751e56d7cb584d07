"""Elementary functions and small matrices with the same bits on every processor.

The C library chooses its sine by the processor (with or without fused multiply-add), NumPy its
vector loops, and BLAS its kernels: their last bits differ. These functions use only +, -, *, / and
square roots in a fixed order, which IEEE 754 rounds identically everywhere. Functions of one number
are plain Python; `portable_kernels` compiles them, with the same bits, for loops over arrays.

The formulas of sine, cosine, arc tangent, exponential and logarithm are those of FreeBSD's msun
(k_sin.c, k_cos.c, e_rem_pio2.c, s_atan.c, e_exp.c, e_log.c; Sun Microsystems, 1993, "Permission to
use, copy, modify, and distribute this software is freely granted"): they are within one unit in the
last place. The functions derived from them (tangent, arc sine, arc cosine) are within three.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Number = TypeVar("Number", float, Array, NDArray[np.float32], NDArray[np.int64])


def square(x: Number) -> Number:
    """The square; for a number, `x ** 2` calls the C library's power function."""
    return x * x


def cos_sin(angle_rad: float) -> tuple[float, float]:
    """Cosine and sine; NaN if the angle is not finite. Beyond 8e5 rad, where one of them is close
    to 0, the error is within 1e-24 instead; beyond 8e11 rad a period of 53 bits limits it.
    """
    x, low, quadrant = float(angle_rad), 0.0, 0
    if not -0.7853981633974483 <= x <= 0.7853981633974483:
        if not -823549.0 < x < 823549.0:
            if not -8e11 < x < 8e11:
                if math.isinf(x) or math.isnan(x):
                    return math.nan, math.nan
                x = x % 6.283185307179586
            # Whole turns first, so that few quarters remain: pi / 2 in parts of 33 bits, whose
            # products with whole numbers up to 2 ** 20 are exact.
            quarters = math.floor(x * 1.2142514369522238e-06 + 0.5) * 524288.0
            rest = x - quarters * 1.5707963267341256
            part = quarters * 6.077100506303966e-11
            x = rest - part
            low = -(quarters * 2.0222662487959506e-21 - ((rest - x) - part))
        quarters = math.floor(x * 0.6366197723675814 + 0.5) * 1.0
        quadrant = int(quarters) & 3
        whole = x
        rest = x - quarters * 1.5707963267341256
        part = quarters * 6.077100506303966e-11
        x = rest - part
        correction = quarters * 2.0222662487959506e-21 - ((rest - x) - part)
        if abs(x) < abs(whole) * 1.7763568394002505e-15:
            rest = x
            part = quarters * 2.0222662487111665e-21
            x = rest - part
            correction = quarters * 8.4784276603689e-32 - ((rest - x) - part)
        low -= correction
        high = x + low
        low -= high - x
        x = high
    z = x * x
    w = z * z
    r = z * (0.0416666666666666019 + z * (-0.00138888888888741096 + z * 2.48015872894767294e-05))
    r += (
        w
        * w
        * (-2.75573143513906633e-07 + z * (2.0875723212981748e-09 + z * -1.13596475577881948e-11))
    )
    half = 0.5 * z
    one = 1.0 - half
    cosine = one + (((1.0 - one) - half) + (z * r - x * low))
    r = 0.00833333333332248946 + z * (-0.000198412698298579493 + z * 2.75573137070700677e-06)
    r += z * w * (-2.50507602534068634e-08 + z * 1.58969099521155010e-10)
    v = z * x
    sine = x - ((z * (0.5 * low - v * r) - low) - v * -0.166666666666666324)
    if quadrant == 0:
        return cosine, sine
    if quadrant == 1:
        return -sine, cosine
    if quadrant == 2:
        return -cosine, -sine
    return sine, -cosine


def sin(angle_rad: float) -> float:
    """Sine, as accurate as `cos_sin`."""
    return cos_sin(angle_rad)[1]


def cos(angle_rad: float) -> float:
    """Cosine, as accurate as `cos_sin`."""
    return cos_sin(angle_rad)[0]


def tan(angle_rad: float) -> float:
    """Tangent."""
    cosine, sine = cos_sin(angle_rad)
    return sine / cosine


def atan2(y: float, x: float) -> float:
    """Angle from the x axis to (x, y), in [-pi, pi]."""
    y, x = float(y), float(x)
    if math.isnan(x) or math.isnan(y):
        return math.nan
    up, right = abs(y), abs(x)
    backwards = math.copysign(1.0, x) < 0.0
    if up == 0.0:
        angle = 0.0
    elif right == 0.0 or (math.isinf(up) and not math.isinf(right)):
        return math.copysign(1.5707963267948966, y)
    elif math.isinf(right):
        angle = 0.7853981633974483 if math.isinf(up) else 0.0
    elif right < 1.0 and up > right * 1e300:
        return math.copysign(1.5707963267948966, y)
    else:
        t = up / right
        high, low = 0.0, 0.0
        if t >= 0.4375:
            if t < 0.6875:
                high, low = 0.463647609000806093515, 2.26987774529616870924e-17
                t = (2.0 * t - 1.0) / (2.0 + t)
            elif t < 1.1875:
                high, low = 0.785398163397448278999, 3.06161699786838301793e-17
                t = (t - 1.0) / (t + 1.0)
            elif t < 2.4375:
                high, low = 0.982793723247329054082, 1.39033110312309984516e-17
                t = (t - 1.5) / (1.0 + 1.5 * t)
            else:
                high, low = 1.57079632679489655800, 6.12323399573676603587e-17
                t = -1.0 / t
        z = t * t
        w = z * z
        odd = 4.97687799461593236017e-02 + w * 1.62858201153657823623e-02
        odd = 9.09088713343650656196e-02 + w * (6.66107313738753120669e-02 + w * odd)
        odd = z * (3.33333333333329318027e-01 + w * (1.42857142725034663711e-01 + w * odd))
        even = -5.83357013379057348645e-02 + w * -3.65315727442169155270e-02
        even = -1.11111104054623557880e-01 + w * (-7.69187620504482999495e-02 + w * even)
        even = w * (-1.99999999998764832476e-01 + w * even)
        angle = high - ((t * (odd + even) - low) - t)
    if backwards:
        angle = 3.141592653589793 - (angle - 1.2246467991473532e-16)
    return math.copysign(angle, y)


def asin(sine: float) -> float:
    """Arc sine, in [-pi / 2, pi / 2]. Raises ValueError beyond [-1, 1], as `math` does."""
    return atan2(sine, math.sqrt((1.0 - sine) * (1.0 + sine)))


def acos(cosine: float) -> float:
    """Arc cosine, in [0, pi]. Raises ValueError beyond [-1, 1], as `math` does."""
    return 2.0 * atan2(math.sqrt(1.0 - cosine), math.sqrt(1.0 + cosine))


def exp(x: float) -> float:
    """Exponential: infinite above 709.78, and 0 below -745.13."""
    x = float(x)
    if math.isnan(x):
        return math.nan
    if x > 709.782712893383973096:
        return math.inf
    if x < -745.133219101941108420:
        return 0.0
    twos = math.floor(x * 1.44269504088896338700 + 0.5)
    high = x - twos * 6.93147180369123816490e-01
    low = twos * 1.90821492927058770002e-10
    x = high - low
    t = x * x
    c = 4.13813679705723846039e-08
    c = 6.61375632143793436117e-05 + t * (-1.65339022054652515390e-06 + t * c)
    c = 1.66666666666666019037e-01 + t * (-2.77777777770155933842e-03 + t * c)
    c = x - t * c
    return math.ldexp(1.0 - ((low - (x * c) / (2.0 - c)) - high), twos)


def log(x: float) -> float:
    """Natural logarithm: minus infinity for 0, NaN for negative numbers."""
    x = float(x)
    if not 0.0 < x < math.inf:
        if x == 0.0:
            return -math.inf
        return x if x > 0.0 else math.nan
    x, twos = math.frexp(x)
    if x < 0.7071067811865476:
        x += x
        twos -= 1
    f = x - 1.0
    half = 0.5 * f * f
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    odd = w * (
        3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 0.1531383769920937332)
    )
    even = 1.818357216161805012e-01 + w * 1.479819860511658591e-01
    even = z * (6.666666666666735130e-01 + w * (2.857142874366239149e-01 + w * even))
    return (
        s * (half + (odd + even))
        + twos * 1.90821492927058770002e-10
        - half
        + f
        + (twos * 6.93147180369123816490e-01)
    )


def each(function: Callable[[float], float], values: ArrayLike) -> Array:
    """Apply a function of one number to each element: for the few hundred numbers of a shape."""
    array = np.asarray(values, np.float64)
    made = [function(value) for value in array.ravel().tolist()]
    return np.array(made, np.float64).reshape(array.shape)


def cos_sin_each(angles_rad: ArrayLike) -> tuple[Array, Array]:
    """`cos_sin` of each element."""
    angles = np.asarray(angles_rad, np.float64)
    both = np.array([cos_sin(angle) for angle in angles.ravel().tolist()], np.float64)
    both = both.reshape(*angles.shape, 2)
    return np.ascontiguousarray(both[..., 0]), np.ascontiguousarray(both[..., 1])


def atan2_each(y: ArrayLike, x: ArrayLike) -> Array:
    """`atan2` of each pair of elements of two arrays of the same shape."""
    ups, rights = np.asarray(y, np.float64), np.asarray(x, np.float64)
    pairs = zip(ups.ravel().tolist(), rights.ravel().tolist(), strict=True)
    return np.array([atan2(*pair) for pair in pairs], np.float64).reshape(ups.shape)


def hypot_each(x: ArrayLike, y: ArrayLike) -> Array:
    """Lengths of vectors, given as two arrays of coordinates."""
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    return np.asarray(np.sqrt(x * x + y * y))


def lengths(vectors: ArrayLike) -> Array:
    """(...,) lengths of vectors (..., n)."""
    vectors = np.asarray(vectors, np.float64)
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))


def product(a: ArrayLike, b: ArrayLike, *others: ArrayLike) -> Array:
    """`a @ b @ ...` without BLAS, for matrices (..., n, k) and (..., k, m), stacked or not, and
    vectors (k,) at either end.
    """
    if others:
        return product(product(a, b), *others)
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    left = "i" if a.ndim > 1 else ""
    right = "k" if b.ndim > 1 else ""
    return (
        np.asarray(np.einsum(f"...{left}j,...j{right}->...{left}{right}", a, b))
        if (a.ndim > 2 or b.ndim > 2)
        else np.asarray(np.einsum(f"{left}j,j{right}->{left}{right}", a, b))
    )


def determinants(matrices: ArrayLike) -> Array:
    """(...,) determinants of matrices (..., 3, 3)."""
    a, b, c = np.moveaxis(np.asarray(matrices, np.float64), -2, 0)
    return np.asarray(np.einsum("...i,...i->...", a, np.cross(b, c)))


def solve(matrix: ArrayLike, given: ArrayLike) -> Array:
    """Solve `matrix` x = `given`, (n, n) and (n,) or (n, m), by elimination with row pivots.

    Raises np.linalg.LinAlgError where the matrix is singular.
    """
    rows = [list(row) for row in np.asarray(matrix, np.float64).tolist()]
    wanted = np.asarray(given, np.float64)
    size = len(rows)
    for row, values in zip(rows, wanted.reshape(size, -1).tolist(), strict=True):
        row.extend(values)
    for i in range(size):
        best = max(range(i, size), key=lambda k: abs(rows[k][i]))
        pivot = rows[best]
        rows[best] = rows[i]
        rows[i] = pivot
        if not abs(pivot[i]) > 0.0:
            raise np.linalg.LinAlgError("Singular matrix")
        for row in rows[i + 1 :]:
            factor = row[i] / pivot[i]
            if factor:
                row[i:] = [
                    value - factor * other for value, other in zip(row[i:], pivot[i:], strict=True)
                ]
    for i in range(size - 1, -1, -1):
        row = rows[i]
        for j in range(size, len(row)):
            value = row[j]
            for k in range(i + 1, size):
                value -= row[k] * rows[k][j]
            row[j] = value / row[i]
    return np.array([row[size:] for row in rows], np.float64).reshape(wanted.shape)


def inverse(matrix: ArrayLike) -> Array:
    """Inverse of an (n, n) matrix. Raises np.linalg.LinAlgError where it is singular."""
    return solve(matrix, np.eye(len(np.asarray(matrix))))


def eigh(matrix: ArrayLike) -> tuple[Array, Array]:
    """(n,) eigenvalues of a symmetric (n, n) matrix in ascending order, and its eigenvectors, as
    the columns of (n, n), by Jacobi's rotations.
    """
    a = np.array(matrix, np.float64).tolist()
    size = len(a)
    vectors = np.eye(size).tolist()
    for _ in range(_MOST_SWEEPS):
        off = sum(a[i][j] * a[i][j] for i in range(size) for j in range(i))
        if not off > 0.0:
            break
        for p in range(size - 1):
            for q in range(p + 1, size):
                _rotate(a, vectors, p, q)
    values = np.array([a[i][i] for i in range(size)], np.float64)
    order = np.argsort(values, kind="stable")
    return values[order], np.array(vectors, np.float64)[:, order]


_MOST_SWEEPS = 50
"""Sweeps of Jacobi's method; after five to ten the off-diagonal elements are 0."""


def _rotate(a: list[list[float]], vectors: list[list[float]], p: int, q: int) -> None:
    """Make a[p][q] of a symmetric matrix 0 (Golub and Van Loan, Matrix Computations, 8.5)."""
    if not abs(a[p][q]) > 0.0:
        return
    if abs(a[p][q]) < 1e-18 * (abs(a[p][p]) + abs(a[q][q])):
        a[p][q] = a[q][p] = 0.0
        return
    ratio = (a[q][q] - a[p][p]) / (2.0 * a[p][q])
    t = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(1.0 + ratio * ratio))
    c = 1.0 / math.sqrt(1.0 + t * t)
    s = t * c
    for row in a:
        row[p], row[q] = c * row[p] - s * row[q], s * row[p] + c * row[q]
    for row in vectors:
        row[p], row[q] = c * row[p] - s * row[q], s * row[p] + c * row[q]
    for k in range(len(a)):
        a[p][k], a[q][k] = c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]
    a[p][q] = a[q][p] = 0.0


def nearest_rotation(matrix: ArrayLike) -> Array:
    """The (3, 3) rotation nearest to a (3, 3) matrix, in the sum of squared differences: its polar
    factor, by Higham's iteration (1986).

    Raises np.linalg.LinAlgError where the matrix is singular or not finite.
    """
    turn = np.array(matrix, np.float64)
    for _ in range(_MOST_SWEEPS):
        opposite = inverse(turn).T
        scale = math.sqrt(math.sqrt(float((opposite * opposite).sum() / (turn * turn).sum())))
        if not math.isfinite(scale):
            raise np.linalg.LinAlgError("not finite")
        following = (turn * scale + opposite / scale) / 2.0
        change = float(np.abs(following - turn).max())
        turn = following
        if change < 1e-15:
            break
    return turn
