"""Compiled loops over arrays: the only module that uses Numba directly."""

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
    """Compile a function of numbers and arrays: with a Numba signature at its definition, else at
    its first call. The machine code is cached on disk.

    It runs in one thread, and gives the same bits each time. It may call other kernels.
    """
    return cast("Callable[[F], F]", numba.njit(signature, cache=True, **options))


def shared_kernel(inline: bool = False) -> Callable[[F], F]:
    """As `kernel`, for functions run by several threads at once: it runs without the GIL and counts
    no references, on which processors would contend. It must not create or return arrays, and
    divides by zero as IEEE 754 defines. `inline` inlines it into its callers.
    """
    return kernel(nogil=True, error_model="numpy", _nrt=False, forceinline=inline)


def elementwise(*signatures: str) -> Callable[[F], F]:
    """Compile a function of numbers that is applied elementwise to arrays; Numba signatures."""
    return cast("Callable[[F], F]", numba.vectorize(signatures, cache=True))  # type: ignore[no-untyped-call]


def c_function(signature: str) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function for callers in C, with a Numba signature; its address is the attribute
    `address`. It may call kernels.
    """
    return cast("Callable[[Callable[..., Any]], Any]", numba.cfunc(signature, cache=True))
