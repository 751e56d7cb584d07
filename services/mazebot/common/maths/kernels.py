"""Compiled loops over arrays: the only module that uses Numba directly."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar, cast

import numba
from numba.extending import typeof_impl

F = TypeVar("F", bound=Callable[..., Any])

_BLAS = "scipy.linalg.cython_blas"
if _BLAS not in sys.modules:
    # Numba loads SciPy's linear algebra in case a kernel calls np.cov: none does, and it is large.
    sys.modules[_BLAS] = None  # type: ignore[assignment]
    try:
        import numba.np.arraymath
    finally:
        del sys.modules[_BLAS]

_LOCK = threading.RLock()
"""Held while a kernel gets its machine code: several threads may call it first."""
KERNELS: dict[tuple[str, str], Kernel] = {}
"""Every kernel of the modules that are imported, by module and name."""


class Kernel:
    """A function that is compiled, or loaded from the disk, when it is first called. Kernels that
    only other kernels call are part of the machine code of these, and never loaded.
    """

    def __init__(self, function: Callable[..., Any], signature: str | None, options: Any) -> None:
        self.__doc__, self.__wrapped__ = function.__doc__, function
        self._signature = signature
        self._dispatcher = numba.njit(cache=True, **options)(function)
        self._run = self._first
        self.is_called = False
        """Whether it was called from Python."""
        KERNELS[function.__module__, function.__name__] = self

    def __call__(self, *arguments: Any) -> Any:
        """Run it."""
        return self._run(*arguments)

    @property
    def signatures(self) -> list[Any]:
        """The types of arguments that it has machine code for."""
        return list(self._dispatcher.signatures)

    def compiled(self) -> Any:
        """Numba's own object, with machine code for the signature at the definition."""
        with _LOCK:
            if self._signature is not None and not self._dispatcher.signatures:
                self._dispatcher.compile(self._signature)
                self._dispatcher.disable_compile()
        return self._dispatcher

    def compile(self, types: Any) -> None:
        """Compile it for types of arguments, unless it has machine code for them."""
        if self._signature is None:
            self._dispatcher.compile(types)
        self.compiled()

    def _first(self, *arguments: Any) -> Any:
        self.is_called = True
        self._run = self.compiled()
        return self._run(*arguments)


@typeof_impl.register(Kernel)
def _typeof_kernel(kernel: Kernel, context: Any) -> Any:
    """The type of a kernel that another one calls."""
    return typeof_impl(kernel.compiled(), context)


class _Elementwise:
    """A function of numbers, compiled or loaded when it is first applied to arrays."""

    def __init__(self, function: Callable[..., Any], signatures: tuple[str, ...]) -> None:
        self.__doc__ = function.__doc__
        self._function, self._signatures = function, signatures

    @cached_property
    def _ufunc(self) -> Any:
        with _LOCK:
            return numba.vectorize(self._signatures, cache=True)(self._function)  # type: ignore[no-untyped-call]

    def __call__(self, *arrays: Any) -> Any:
        return self._ufunc(*arrays)


class CFunction:
    """A function for callers in C, compiled or loaded when its address is asked for."""

    def __init__(self, function: Callable[..., Any], signature: str) -> None:
        self.__doc__ = function.__doc__
        self._function, self._signature = function, signature

    @cached_property
    def _compiled(self) -> Any:
        return numba.cfunc(self._signature, cache=True)(self._function)

    @property
    def address(self) -> int:
        """The address of its machine code."""
        return int(self._compiled.address)

    @property
    def ctypes(self) -> Any:
        """The same function for callers in Python."""
        return self._compiled.ctypes


def kernel(signature: str | None = None, **options: Any) -> Callable[[F], F]:
    """Compile a function of numbers and arrays: for the Numba signature at its definition, or
    without one for the types of arguments that it is called with. This happens at its first call.
    The machine code is cached on disk.

    It runs in one thread, and gives the same bits each time. It may call other kernels.
    """

    def made(function: F) -> F:
        return cast("F", Kernel(function, signature, options))

    return made


def shared_kernel(inline: bool = False) -> Callable[[F], F]:
    """As `kernel`, for functions run by several threads at once: it runs without the GIL and counts
    no references, on which processors would contend. It must not create or return arrays, and
    divides by zero as IEEE 754 defines. `inline` inlines it into its callers.
    """
    return kernel(nogil=True, error_model="numpy", _nrt=False, forceinline=inline)


def elementwise(*signatures: str) -> Callable[[F], F]:
    """Compile a function of numbers that is applied elementwise to arrays; Numba signatures."""

    def made(function: F) -> F:
        return cast("F", _Elementwise(function, signatures))

    return made


def c_function(signature: str) -> Callable[[Callable[..., Any]], CFunction]:
    """Compile a function for callers in C, with a Numba signature; its address is the attribute
    `address`. It may call kernels.
    """
    return lambda function: CFunction(function, signature)
