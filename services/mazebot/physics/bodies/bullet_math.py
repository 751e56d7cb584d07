"""Makes PyBullet use the sine and the like of `portable` instead of the C library's.

Bullet rotates the robot's base, its wheels and all moving bodies in each step by quaternions of
sine and cosine, and computes angles from them by arc tangents: glibc has these with and without
fused multiply-add, so the last bits of a robot's state would depend on the processor. Such a call
goes through the table of addresses that the dynamic linker fills for each shared library (System V
ABI, AMD64 supplement, "Procedure Linkage Table"); here the linker's entries are replaced in
PyBullet's table, and in no other library's.

Single precision (sinf and the like) is used by PyBullet's own renderers only, and pow by its file
importers: they are left alone.
"""

from __future__ import annotations

import ctypes
import logging
import math
from collections.abc import Mapping
from typing import Any

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.kernels import c_function

_DT_NULL, _DT_PLTRELSZ, _DT_STRTAB, _DT_SYMTAB, _DT_PLTREL = 0, 2, 5, 6, 20
_DT_JMPREL, _DT_BIND_NOW, _DT_FLAGS, _DT_FLAGS_1 = 23, 24, 30, 0x6FFFFFFB
_DT_RELA, _DF_BIND_NOW, _DF_1_NOW = 7, 8, 1
"""Of elf.h"""
_LOG = logging.getLogger("physics")


class _LinkMap(ctypes.Structure):
    """What dlopen(3) returns a pointer to (link.h)."""

    _fields_ = (
        ("base", ctypes.c_size_t),
        ("name", ctypes.c_char_p),
        ("dynamic", ctypes.c_size_t),
    )


class _Dynamic(ctypes.Structure):
    _fields_ = (("tag", ctypes.c_int64), ("value", ctypes.c_uint64))


class _Relocation(ctypes.Structure):
    _fields_ = (("offset", ctypes.c_uint64), ("info", ctypes.c_uint64), ("addend", ctypes.c_int64))


class _Symbol(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_uint32),
        ("rest", ctypes.c_uint8 * 20),
    )


@c_function("float64(float64)")
def _sin(angle_rad: float) -> float:
    return portable_kernels.cos_sin(angle_rad)[1]


@c_function("float64(float64)")
def _cos(angle_rad: float) -> float:
    return portable_kernels.cos_sin(angle_rad)[0]


@c_function("float64(float64)")
def _tan(angle_rad: float) -> float:
    cosine, sine = portable_kernels.cos_sin(angle_rad)
    return sine / cosine


@c_function("void(float64, CPointer(float64), CPointer(float64))")
def _sincos(angle_rad: float, sine: Any, cosine: Any) -> None:
    cosine[0], sine[0] = portable_kernels.cos_sin(angle_rad)


@c_function("float64(float64, float64)")
def _atan2(y: float, x: float) -> float:
    return portable_kernels.atan2(y, x)


@c_function("float64(float64)")
def _asin(sine: float) -> float:
    return portable_kernels.asin(sine)


@c_function("float64(float64)")
def _acos(cosine: float) -> float:
    return 2.0 * portable_kernels.atan2(math.sqrt(1.0 - cosine), math.sqrt(1.0 + cosine))


@c_function("float64(float64)")
def _exp(x: float) -> float:
    return portable_kernels.exp(x)


@c_function("float64(float64)")
def _log(x: float) -> float:
    return portable_kernels.log(x)


_FUNCTIONS = {
    "sin": _sin,
    "cos": _cos,
    "tan": _tan,
    "sincos": _sincos,
    "atan2": _atan2,
    "asin": _asin,
    "acos": _acos,
    "exp": _exp,
    "log": _log,
}
"""By the C library's names; their types have not changed since 1989."""


def take_portable_math(library: str) -> None:
    """Make a loaded shared library, given by its path, call these functions from now on.

    If it was built differently from the wheels, a warning is logged that states depend on the
    processor.
    """
    places = _imports(library)
    missing = {"sin", "cos", "sincos", "atan2"} - set(places)
    if missing:
        names = ", ".join(sorted(missing))
        _LOG.warning("%s: no table entry of %s: states depend on this processor", library, names)
        return
    for name, function in _FUNCTIONS.items():
        if name in places:
            ctypes.c_size_t.from_address(places[name]).value = function.address


def _imports(library: str) -> Mapping[str, int]:
    """Addresses of a library's table entries for the functions that it imports, by name; empty if
    they cannot be written.
    """
    handle = ctypes.CDLL(library)
    loaded = _LinkMap.from_address(handle._handle)
    entries: dict[int, int] = {}
    at = loaded.dynamic
    while (entry := _Dynamic.from_address(at)).tag != _DT_NULL:
        entries[entry.tag] = entry.value
        at += ctypes.sizeof(_Dynamic)
    fixed = (
        _DT_BIND_NOW in entries
        or entries.get(_DT_FLAGS, 0) & _DF_BIND_NOW
        or entries.get(_DT_FLAGS_1, 0) & _DF_1_NOW
    )
    if fixed or entries.get(_DT_PLTREL) != _DT_RELA:
        return {}
    relocations, symbols, texts = (
        # Some linkers have turned these offsets into addresses, others have not.
        entries[tag] + (loaded.base if entries[tag] < loaded.base else 0)
        for tag in (_DT_JMPREL, _DT_SYMTAB, _DT_STRTAB)
    )
    places: dict[str, int] = {}
    for at in range(0, entries[_DT_PLTRELSZ], ctypes.sizeof(_Relocation)):
        relocation = _Relocation.from_address(relocations + at)
        number = relocation.info >> 32
        symbol = _Symbol.from_address(symbols + number * ctypes.sizeof(_Symbol))
        name = ctypes.string_at(texts + symbol.name).decode()
        places[name] = loaded.base + relocation.offset
    return places
