"""Numba with less to load: most of the start of a process is loading Numba and kernels.

Beside its machine code Numba's cache holds a kernel's LLVM bitcode, of which a kernel that calls it
is compiled. Numba parses it each time that a kernel is loaded, which takes two thirds of the time
and 20 MB; here it is parsed when a caller is compiled: never, where all machine code is there.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

import numba
from llvmlite import binding  # type: ignore[import-untyped]
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen

TRIED_WITH = "0.68."
_NEEDLESS = (
    ("numba.np.arraymath", "scipy.linalg.cython_blas"),
    ("numba.core.typing.cffi_utils", "cffi"),
)
"""Modules of Numba, and what each loads if it is installed: no kernel calls np.cov or C by cffi."""


class _Library(JITCodeLibrary):
    """The machine code of a kernel, loaded or compiled."""

    _unparsed: bytes | None = None
    _code = b""

    @property
    def is_parsed(self) -> bool:
        """Whether its bitcode is at hand."""
        return self._unparsed is None

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> Any:
        name, kind, data = state
        if kind != "object":
            return super()._unserialize(codegen, state)  # type: ignore[no-untyped-call]
        library = codegen.create_library(name)
        library._code, library._unparsed = data
        library.enable_object_caching()
        library._set_compiled_object(library._code)
        library._finalize_final_module()
        return library

    def get_pointer_to_function(self, name: str) -> int:
        """See JITCodeLibrary. LLVM ends the process when it looks for what is not there."""
        if self._unparsed is not None and b"\0%b\0" % name.encode() in self._code:
            return int(self._codegen._engine.get_function_address(name))
        return int(super().get_pointer_to_function(name))  # type: ignore[no-untyped-call]

    def _get_module_for_linking(self) -> Any:
        if self._unparsed is not None:
            engine: Any = self._codegen._engine
            self._shared_module = binding.parse_bitcode(self._unparsed)
            engine._load_defined_symbols(self._shared_module)
            self._unparsed = None
        return super()._get_module_for_linking()  # type: ignore[no-untyped-call]


def load_less() -> None:
    """Leave out what no kernel needs. To be called before Numba is used."""
    for name, needless in _NEEDLESS:
        if needless in sys.modules:
            continue
        sys.modules[needless] = None  # type: ignore[assignment]
        try:
            importlib.import_module(name)
        finally:
            del sys.modules[needless]
    # What it changes is no interface of Numba's: another version loads kernels in its own way.
    if numba.__version__.startswith(TRIED_WITH):
        JITCPUCodegen._library_class = _Library
