"""PyBullet's sines: they are ours, and other libraries keep theirs."""

import ctypes
import logging
import math

import pytest

from mazebot.common.maths import portable
from mazebot.physics.bodies import bullet_math
from mazebot.physics.bodies.bullet import pybullet

ANGLES = [k / 37.0 for k in range(-400, 400)]


def test_pybullet_turns_by_our_sine_and_cosine() -> None:
    for angle in ANGLES:
        x, y, z, w = pybullet.getQuaternionFromEuler((0.0, 0.0, angle))
        cosine, sine = portable.cos_sin(angle / 2.0)
        length = math.sqrt(sine * sine + cosine * cosine)
        assert (x, y) == (0.0, 0.0)
        assert abs(z - sine / length) <= math.ulp(1.0) / 2
        assert abs(w - cosine / length) <= math.ulp(1.0) / 2


def test_each_entry_of_pybullets_table_is_one_of_ours() -> None:
    places = bullet_math._imports(pybullet.__file__)
    for name, function in bullet_math._FUNCTIONS.items():
        assert ctypes.c_size_t.from_address(places[name]).value == function.address, name


def test_what_replaces_them_has_the_bits_of_portable() -> None:
    sine, cosine = ctypes.c_double(), ctypes.c_double()
    for angle in ANGLES:
        bullet_math._sincos.ctypes(angle, ctypes.byref(sine), ctypes.byref(cosine))
        assert (cosine.value, sine.value) == portable.cos_sin(angle)
        assert bullet_math._sin.ctypes(angle) == sine.value
        assert bullet_math._cos.ctypes(angle) == cosine.value
        assert bullet_math._atan2.ctypes(sine, cosine) == portable.atan2(sine.value, cosine.value)
        assert bullet_math._acos.ctypes(cosine) == portable.acos(cosine.value)
        assert bullet_math._exp.ctypes(angle) == portable.exp(angle)


def test_the_c_library_itself_stays() -> None:
    library = ctypes.CDLL(None)
    library.sin.restype, library.sin.argtypes = ctypes.c_double, [ctypes.c_double]
    assert [library.sin(angle) for angle in ANGLES] == [math.sin(angle) for angle in ANGLES]


def test_a_library_built_otherwise_is_told_of(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bullet_math, "_imports", lambda _: {"cos": 0})
    with caplog.at_level(logging.WARNING):
        bullet_math.take_portable_math("pybullet.so")
    assert "states depend on this processor" in caplog.text
