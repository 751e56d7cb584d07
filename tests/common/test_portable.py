"""Elementary functions and small matrices: how exact they are, and that their bits stay."""

import hashlib
import math
import struct
from collections.abc import Callable

import numpy as np
import pytest

from mazebot.common.maths import portable, portable_kernels

RANDOM = np.random.default_rng(4)
ANGLES = np.concatenate(
    [
        RANDOM.uniform(-1.0, 1.0, 4000),
        RANDOM.uniform(-10.0, 10.0, 4000),
        RANDOM.uniform(-8e5, 8e5, 4000),
        np.arange(-500, 500) * (math.pi / 2.0),
    ]
)
FUNCTIONS: dict[str, tuple[Callable[[float], float], Callable[[float], float], np.ndarray, int]] = {
    "sin": (portable.sin, math.sin, ANGLES, 1),
    "cos": (portable.cos, math.cos, ANGLES, 1),
    "tan": (portable.tan, math.tan, RANDOM.uniform(-5.0, 5.0, 4000), 3),
    "asin": (portable.asin, math.asin, RANDOM.uniform(-1.0, 1.0, 4000), 3),
    "acos": (portable.acos, math.acos, RANDOM.uniform(-1.0, 1.0, 4000), 3),
    "exp": (portable.exp, math.exp, RANDOM.uniform(-745.0, 709.0, 8000), 1),
    "log": (portable.log, math.log, 10.0 ** RANDOM.uniform(-320.0, 308.0, 8000), 1),
}
EDGES = [0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, 5e-324, -1e308, 0.4375, 2.4375]


def ulps(got: float, want: float) -> float:
    """How many units in the last place a number is off; the C library's own are within one."""
    return 0.0 if got == want else abs(got - want) / math.ulp(want)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_is_as_exact_as_it_says(name: str) -> None:
    ours, theirs, values, units = FUNCTIONS[name]
    for value in values.tolist():
        assert ulps(ours(value), theirs(value)) <= units, value


def test_the_arc_tangent_is_exact_in_every_quadrant_and_at_every_edge() -> None:
    scales = 10.0 ** RANDOM.uniform(-30.0, 30.0, (4000, 2))
    for y, x in (RANDOM.uniform(-1.0, 1.0, (4000, 2)) * scales).tolist():
        assert ulps(portable.atan2(y, x), math.atan2(y, x)) <= 1, (y, x)
    for y in EDGES:
        for x in EDGES:
            got, want = portable.atan2(y, x), math.atan2(y, x)
            assert ulps(got, want) <= 1, (y, x)
            assert math.copysign(1.0, got) == math.copysign(1.0, want), (y, x)
    assert math.isnan(portable.atan2(math.nan, 1.0))


def test_far_angles_keep_their_sine_and_what_is_not_finite_has_none() -> None:
    for angle in RANDOM.uniform(-8e11, 8e11, 4000).tolist():
        assert abs(portable.sin(angle) - math.sin(angle)) < 2e-16
    assert -1.0 <= portable.sin(1e300) <= 1.0
    for angle in (math.nan, math.inf, -math.inf):
        assert all(math.isnan(value) for value in portable.cos_sin(angle))


def test_exponentials_and_logarithms_end_as_they_do_in_c() -> None:
    assert (portable.exp(-1e3), portable.exp(1e3), portable.exp(-math.inf)) == (0.0, math.inf, 0.0)
    assert portable.log(0.0) == -math.inf
    assert portable.log(math.inf) == math.inf
    assert math.isnan(portable.log(-1.0))
    assert math.isnan(portable.exp(math.nan))


def test_the_bits_are_those_written_down() -> None:
    taken = hashlib.sha256()
    grid = [(k - 5000) / 977.0 for k in range(10_000)]
    for value in grid:
        pair = *portable.cos_sin(1e3 * value), portable.exp(value)
        taken.update(
            struct.pack("<5d", *pair, portable.log(abs(value) + 1e-9), portable.atan2(value, 1.7))
        )
    assert taken.hexdigest()[:16] == "9f96845acc136992"


def test_what_is_compiled_gives_the_same_bits() -> None:
    for ours, compiled in zip(
        portable.cos_sin_each(ANGLES), portable_kernels.cos_sin_each(ANGLES), strict=True
    ):
        assert np.array_equal(ours, compiled)
    values = RANDOM.uniform(-800.0, 800.0, 4000)
    assert np.array_equal(portable.each(portable.exp, values), portable_kernels.exp_each(values))
    values = np.abs(values)
    assert np.array_equal(portable.each(portable.log, values), portable_kernels.log_each(values))
    for y, x in RANDOM.uniform(-1.0, 1.0, (1000, 2)).tolist():
        assert portable_kernels.atan2(y, x) == portable.atan2(y, x)
        assert portable_kernels.asin(x) == portable.asin(x)


def test_normal_deviates_are_normal_and_follow_the_generator() -> None:
    drawn = portable_kernels.standard_normal(np.random.default_rng(1), (400_001,))
    assert abs(drawn.mean()) < 0.01
    assert abs(drawn.std() - 1.0) < 0.01
    assert abs((drawn**4).mean() - 3.0) < 0.1
    assert abs(np.corrcoef(drawn[:200_000], drawn[200_001:])[0, 1]) < 0.01
    again = portable_kernels.standard_normal(np.random.default_rng(1), (400_001,))
    assert np.array_equal(drawn, again)
    assert portable_kernels.standard_normal(np.random.default_rng(1), (3, 2)).shape == (3, 2)


@pytest.mark.parametrize(
    "shapes", [((4, 4), (4, 4)), ((7, 3), (3,)), ((3,), (3, 5)), ((6,), (6,)), ((9, 4, 4), (4, 4)),
               ((2, 4), (5, 4, 3))],
)  # fmt: skip
def test_a_product_is_what_numpy_makes_of_it(shapes: tuple[tuple[int, ...], ...]) -> None:
    a, b = (RANDOM.uniform(-1.0, 1.0, shape) for shape in shapes)
    got = portable.product(a, b)
    assert got.shape == (a @ b).shape
    assert np.allclose(got, a @ b, rtol=0.0, atol=1e-15 * 8)


def test_equations_inverses_and_determinants() -> None:
    matrix, given = RANDOM.uniform(-1.0, 1.0, (8, 8)), RANDOM.uniform(-1.0, 1.0, (8, 2))
    assert np.allclose(matrix @ portable.solve(matrix, given), given, atol=1e-12)
    assert np.allclose(portable.inverse(matrix) @ matrix, np.eye(8), atol=1e-12)
    stack = RANDOM.uniform(-1.0, 1.0, (20, 3, 3))
    assert np.allclose(portable.determinants(stack), np.linalg.det(stack), atol=1e-15)
    for singular in (np.zeros((3, 3)), np.ones((2, 2)), np.full((2, 2), math.nan)):
        with pytest.raises(np.linalg.LinAlgError):
            portable.solve(singular, np.ones(len(singular)))


def test_eigenvectors_and_the_nearest_rotation() -> None:
    for size in (1, 2, 3, 6):
        matrix = RANDOM.uniform(-1.0, 1.0, (size, size))
        matrix = matrix + matrix.T
        values, vectors = portable.eigh(matrix)
        assert np.allclose(values, np.linalg.eigvalsh(matrix), atol=1e-13)
        assert np.allclose(matrix @ vectors, vectors * values, atol=1e-13)
        assert np.allclose(vectors.T @ vectors, np.eye(size), atol=1e-14)
    assert portable.eigh(np.diag([3.0, 1.0, 2.0]))[0].tolist() == [1.0, 2.0, 3.0]
    for _ in range(20):
        matrix = RANDOM.uniform(-1.0, 1.0, (3, 3))
        matrix *= math.copysign(1.0, np.linalg.det(matrix))
        left, _, right = np.linalg.svd(matrix)
        assert np.allclose(portable.nearest_rotation(matrix), left @ right, atol=1e-12)
    with pytest.raises(np.linalg.LinAlgError):
        portable.nearest_rotation(np.zeros((3, 3)))
