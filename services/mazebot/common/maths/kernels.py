"""Compiled loops over arrays: the only module that uses Numba directly, with `kernel_types` and
`kernel_loading`.
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, cast

import llvmlite.binding  # type: ignore[import-untyped]
import numba
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import typeof_impl

from mazebot.common.maths.kernel_loading import load_less

F = TypeVar("F", bound=Callable[..., Any])

load_less()
_LOCK = global_compiler_lock
"""Held while a kernel gets its machine code, as several threads may call it first: Numba's own,
since another one would be taken in the other order where a kernel calls a kernel.
"""
Types = tuple[Any, ...]
"""Numba's types of the arguments of a call."""


class Kernel(ABC):
    """A function that is compiled, or loaded from the disk, when it is first used."""

    is_signed = True
    """Whether it has a signature at its definition."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.__doc__ = function.__doc__
        self.module, self.name = function.__module__, function.__name__
        self._function = function
        KERNELS[self.module, self.name] = self

    @abstractmethod
    def compile(self, types: Types = ()) -> None:
        """Get its machine code: for the signature at its definition, or if it has none for these
        types of arguments.
        """

    def _is_used(self) -> None:
        """To be called before Python uses it for the first time."""
        for listener in USE_LISTENERS:
            listener(self)


KERNELS: dict[tuple[str, str], Kernel] = {}
"""Every kernel of the modules that are imported, by module and name."""
USE_LISTENERS: list[Callable[[Kernel], None]] = []
"""Called with a kernel before Python uses it for the first time. Kernels that only others call are
part of the machine code of these, and are not loaded.
"""
CALL_LISTENERS: list[Callable[[Kernel, Types], None]] = []
"""Called with a kernel without signature and the types of arguments at each of its calls from
Python, if it was not used before there were any listeners.
"""


class _Loop(Kernel):
    """A function of numbers and arrays."""

    def __init__(self, function: Callable[..., Any], signature: str | None, options: Any) -> None:
        super().__init__(function)
        self._signature, self.is_signed = signature, signature is not None
        self._dispatcher = numba.njit(cache=True, **options)(function)
        self._run = self._first

    def __call__(self, *arguments: Any) -> Any:
        """Run it."""
        return self._run(*arguments)

    @property
    def signatures(self) -> list[Types]:
        """The types of arguments that it has machine code for."""
        return list(self._dispatcher.signatures)

    def compile(self, types: Types = ()) -> None:
        """See Kernel."""
        if self._signature is None:
            self._dispatcher.compile(types)
        else:
            self.compiled()

    def compiled(self) -> Any:
        """Numba's own object, with machine code for the signature at the definition."""
        with _LOCK:
            if self._signature is not None and not self._dispatcher.signatures:
                self._dispatcher.compile(self._signature)
                self._dispatcher.disable_compile()
        return self._dispatcher

    def _first(self, *arguments: Any) -> Any:
        self._is_used()
        run = self.compiled()
        self._run = self._heard if CALL_LISTENERS and self._signature is None else run
        return self._run(*arguments)

    def _heard(self, *arguments: Any) -> Any:
        types = tuple(numba.typeof(argument) for argument in arguments)  # type: ignore[no-untyped-call]
        for listener in CALL_LISTENERS:
            listener(self, types)
        return self._dispatcher(*arguments)


@typeof_impl.register(_Loop)
def _typeof_loop(kernel: _Loop, context: Any) -> Any:
    """The type of a kernel that another one calls."""
    return typeof_impl(kernel.compiled(), context)


class _Elementwise(Kernel):
    """A function of numbers that is applied to arrays."""

    def __init__(self, function: Callable[..., Any], signatures: tuple[str, ...]) -> None:
        super().__init__(function)
        self._signatures = signatures

    def __call__(self, *arrays: Any) -> Any:
        """Apply it."""
        return self._ufunc(*arrays)

    def compile(self, types: Types = ()) -> None:
        """See Kernel."""
        _ = self._ufunc

    @cached_property
    def _ufunc(self) -> Any:
        self._is_used()
        with _LOCK:
            return numba.vectorize(self._signatures, cache=True)(self._function)  # type: ignore[no-untyped-call]


class CFunction(Kernel):
    """A function for callers in C."""

    def __init__(self, function: Callable[..., Any], signature: str) -> None:
        super().__init__(function)
        self._signature = signature

    @property
    def address(self) -> int:
        """The address of its machine code."""
        return int(self._compiled.address)

    @property
    def ctypes(self) -> Any:
        """The same function for callers in Python."""
        return self._compiled.ctypes

    def compile(self, types: Types = ()) -> None:
        """See Kernel."""
        _ = self._compiled

    @cached_property
    def _compiled(self) -> Any:
        self._is_used()
        with _LOCK:
            return numba.cfunc(self._signature, cache=True)(self._function)


def environment() -> str:
    """What machine code depends on beside its source: Numba, Python and the processor."""
    config, host = numba.config, llvmlite.binding
    name = config.CPU_NAME or host.get_host_cpu_name()  # type: ignore[attr-defined]
    features = config.CPU_FEATURES  # type: ignore[attr-defined]
    if features is None:
        features = host.get_host_cpu_features().flatten()
    return f"{numba.__version__} {sys.version.split()[0]} {name} {features}"


def cache_folder(kernel: Callable[..., Any]) -> Path:
    """The folder of the machine code of a kernel, and of all in the same folder of sources."""
    return Path(cast("_Loop", kernel).compiled().stats.cache_path)


def kernel(signature: str | None = None, **options: Any) -> Callable[[F], F]:
    """Compile a function of numbers and arrays: for the Numba signature at its definition, or
    without one for the types of arguments that it is called with. This happens at its first call.
    The machine code is cached on disk.

    It runs in one thread, and gives the same bits each time. It may call other kernels.
    """

    def made(function: F) -> F:
        return cast("F", _Loop(function, signature, options))

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
