"""Makes bytes out of valid messages that hardly anybody would send."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Sequence
from typing import Final

MOST_BYTES: Final = 50_000_000
_RANDOM_BYTES = 512
_HEAD = 4
"""Of CDR: the encapsulation."""
_COUNTS = (0xFFFFFFFF, 0x7FFFFFFF, 0x80000000, 1_000_000_000, 65_536, 0)
_NUMBERS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, -0.0, 1e18)
_WORDS = (
    b"",
    b"null",
    b"NaN",
    b"1e999",
    b"-1",
    b"[" * 2000,
    b'{"a":' * 2000,
    b"\xff\xfe",
    b'"\\ud800"',
)

Mutation = Callable[[bytes, Sequence[bytes], random.Random], bytes]
"""Of a valid message, with others of any type at hand."""


def mutated(valid: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """The bytes of one malformed, or extreme, message; some are still valid."""
    data = rng.choice(MUTATIONS)(valid, others, rng)
    # One change in four comes with another one.
    return rng.choice(MUTATIONS)(data, others, rng) if rng.random() < 0.25 else data


def oversize(valid: bytes, rng: random.Random) -> bytes:
    """A message of 50 MB."""
    return valid + bytes([rng.randrange(256)]) * (MOST_BYTES - len(valid))


def _noise(_: bytes, __: Sequence[bytes], rng: random.Random) -> bytes:
    return rng.randbytes(rng.randrange(_RANDOM_BYTES))


def _cut(data: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _longer(data: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    return data + rng.randbytes(rng.randrange(1, 64))


def _flip(data: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _one in range(rng.randrange(1, 9)):
        if changed:
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _overwrite(data: bytes, value: bytes, rng: random.Random) -> bytes:
    """Put a value where one of its size may stand."""
    places = (len(data) - _HEAD) // len(value)
    if places < 1:
        return data
    at = _HEAD + len(value) * rng.randrange(places)
    return data[:at] + value + data[at + len(value) :]


def _count(data: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    return _overwrite(data, struct.pack("<I", rng.choice(_COUNTS)), rng)


def _number(data: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    form = rng.choice(("<d", "<f"))
    value = rng.choice(_NUMBERS)
    if form == "<f" and abs(value) > 3e38:
        value = float("inf")
    return _overwrite(data, struct.pack(form, value), rng)


def _piece_again(data: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    start, end = sorted((rng.randrange(len(data) + 1), rng.randrange(len(data) + 1)))
    return data[:end] + data[start:end] + data[end:]


def _piece_out(data: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    start, end = sorted((rng.randrange(len(data) + 1), rng.randrange(len(data) + 1)))
    return data[:start] + data[end:]


def _another(_: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    return rng.choice(others)


def _word(data: bytes, _: Sequence[bytes], rng: random.Random) -> bytes:
    """In the text of a document, with the length that it then has."""
    text = data[2 * _HEAD :].rstrip(b"\0")
    start, end = sorted((rng.randrange(len(text) + 1), rng.randrange(len(text) + 1)))
    text = text[:start] + rng.choice(_WORDS) + text[end:]
    return b"\0\1\0\0" + struct.pack("<I", len(text) + 1) + text + b"\0"


MUTATIONS: Final[tuple[Mutation, ...]] = (
    _noise, _cut, _longer, _flip, _count, _number, _piece_again, _piece_out, _another, _word,
)  # fmt: skip
