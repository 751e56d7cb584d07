"""Compiled loops over arrays: the one place that knows Numba."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

_BLAS = "scipy.linalg.cython_blas"
if _BLAS not in sys.modules:
    # Numba loads SciPy's linear algebra in case a kernel calls np.cov: none does, and it is large.
    sys.modules[_BLAS] = None  # type: ignore[assignment]
    try:
        import numba.np.arraymath
    finally:
        del sys.modules[_BLAS]


def kernel(signature: str | None = None, **options: Any) -> Callable[[F], F]:
    """Have a function of numbers and arrays compiled: with its types in Numba's words where it is
    defined, else where it is first called. What was compiled is kept on the disk.

    It runs in one thread, and gives the same bits each time. It may call other kernels.
    """
    return cast("Callable[[F], F]", numba.njit(signature, cache=True, **options))


def shared_kernel(inline: bool = False) -> Callable[[F], F]:
    """As `kernel`, for what several threads do at once: it runs without the interpreter's lock, and
    counts no references, on which processors would wait for each other. It makes no arrays, returns
    none, and divides by zero as IEEE 754 has it. `inline` puts it into those that call it.
    """
    return kernel(nogil=True, error_model="numpy", _nrt=False, forceinline=inline)


def elementwise(*signatures: str) -> Callable[[F], F]:
    """Have a function of numbers compiled for each number of arrays, with its types in Numba's
    words.
    """
    return cast("Callable[[F], F]", numba.vectorize(signatures, cache=True))  # type: ignore[no-untyped-call]


def c_function(signature: str) -> Callable[[Callable[..., Any]], Any]:
    """Have a function compiled for callers in C, with its types in Numba's words; its address is
    the attribute `address`. It may call kernels.
    """
    return cast("Callable[[Callable[..., Any]], Any]", numba.cfunc(signature, cache=True))
