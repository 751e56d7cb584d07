"""PNG images, and the check that bytes are a complete PNG that every reader can decode."""

from __future__ import annotations

import hashlib
import struct
import threading
import zlib

import cv2
import numpy as np
from numpy.typing import NDArray

MAX_SIDE_PX = 2048
MAX_BYTES = 16 * 1024 * 1024
_MOST_KEPT_BYTES = 32 * 1024 * 1024
"""Cache size for decoded images: fits all images of a common world."""

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_OTHERS = {b"\xff\xd8\xff": "a JPEG", b"GIF8": "a GIF", b"BM": "a BMP", b"RIFF": "a WebP"}


def problem(data: bytes) -> str:
    """The problem of a texture's bytes, as the rest of a sentence; empty: none."""
    try:
        decode(data)
    except ValueError as error:
        return str(error)
    return ""


def decode(data: bytes) -> NDArray[np.uint8]:
    """The image: (h, w, 3) uint8 RGB, read-only.

    The newest ones are cached, and shared by validation, simulation and rendering.
    Raises ValueError, with the text of `problem`, where the bytes are not a complete image.
    """
    key = hashlib.sha256(data).digest()
    with _LOCK:
        rgb = _kept.pop(key, None)
    if rgb is None:
        rgb = _decoded_rgb(data)
        rgb.setflags(write=False)
    with _LOCK:
        _kept[key] = rgb
        while sum(one.nbytes for one in _kept.values()) > _MOST_KEPT_BYTES:
            del _kept[next(iter(_kept))]
    return rgb


_kept: dict[bytes, NDArray[np.uint8]] = {}
"""Images by the sha256 of their files, the newest last."""
_LOCK = threading.Lock()
"""Held while these are looked at: several images are decoded at once."""


def size_px(data: bytes) -> tuple[int, int]:
    """Width and height of a valid image."""
    width, height = struct.unpack_from(">II", data, len(_SIGNATURE) + 8)
    return int(width), int(height)


def _decoded_rgb(data: bytes) -> NDArray[np.uint8]:
    """The chunks are checked before decoding: the decoder silently fills in damaged files, and
    would allocate the size that the header claims.
    """
    if not data.startswith(_SIGNATURE):
        other = next((name for start, name in _OTHERS.items() if data.startswith(start)), "")
        raise ValueError(f"is {other or 'not an image'}, must be a PNG")
    if len(data) > MAX_BYTES:
        raise ValueError(f"has {len(data)} bytes, must have at most {MAX_BYTES}")
    if not is_whole(data):
        raise ValueError("is corrupt or truncated, must be a complete PNG")
    width, height = size_px(data)
    if not (0 < width <= MAX_SIDE_PX and 0 < height <= MAX_SIDE_PX):
        raise ValueError(f"is {width} x {height} pixels, must be at most {MAX_SIDE_PX} a side")
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB)
    except cv2.error:
        picture = None
    if picture is None or picture.shape[:2] != (height, width):
        raise ValueError("cannot be decoded, must be a PNG image")
    return np.asarray(picture, np.uint8)


def is_whole(data: bytes) -> bool:
    """Whether PNG chunks with valid checksums run from IHDR to IEND (section 5 of its standard)."""
    at, first = len(_SIGNATURE), True
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        kind, end = data[at + 4 : at + 8], at + 8 + length
        if end + 4 > len(data) or first != (kind == b"IHDR") or (first and length != 13):
            return False
        if zlib.crc32(data[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            return False
        if kind == b"IEND":
            return True
        at, first = end + 4, False
    return False
