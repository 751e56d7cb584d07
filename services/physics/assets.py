"""The textures and meshes that have come, by the sha256 of their files."""

from __future__ import annotations

import functools
import hashlib
import struct
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from services.common import messages as msg
from services.common.documents import Entities, Mesh, Thing
from services.common.geometry import TriangleMesh, mesh_from_bytes

MAX_ASSETS = 512
MAX_BYTES = 256_000_000
"""Of all assets together"""
MAX_TEXTURE_SIDE_PX = 2048

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


class Assets:
    """Files that were looked at before they were taken in."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        """The files by their sha256."""

    def add(
        self, message: msg.CompressedImage, in_use: Callable[[], Collection[str]] = tuple
    ) -> str:
        """Take in a file; an empty string, or the reason why not, as a short phrase.

        Where there are too many, the oldest that is not in use makes room.
        """
        sha256 = message.header.frame_id
        if sha256 in self.files:
            return ""
        if not self._has_room(message.data.nbytes, in_use):
            return "too many assets"
        data = message.data.tobytes()
        if hashlib.sha256(data).hexdigest() != sha256:
            return "not the file its sha256 names"
        if message.format == "png":
            try:
                decode_png(data)
            except ValueError:
                return "not a PNG of at most 2048 x 2048"
        elif message.format == "npz":
            try:
                decoded_mesh(sha256, data)
            except ValueError:
                return "not a mesh"
        else:
            return "neither png nor npz"
        self.files[sha256] = data
        return ""

    def _has_room(self, size_bytes: int, in_use: Callable[[], Collection[str]]) -> bool:
        taken = sum(map(len, self.files.values())) + size_bytes
        if len(self.files) < MAX_ASSETS and taken <= MAX_BYTES:
            return True
        kept = set(in_use())
        for sha256 in [sha256 for sha256 in self.files if sha256 not in kept]:
            taken -= len(self.files.pop(sha256))
            if len(self.files) < MAX_ASSETS and taken <= MAX_BYTES:
                return True
        return False

    def missing(self, wanted: Iterable[str]) -> list[str]:
        """Those of some sha256 that have not come, each once; an empty one names no file."""
        return [sha for sha in dict.fromkeys(wanted) if sha and sha not in self.files]


def mesh_sha256s(things: Iterable[Thing]) -> list[str]:
    """The meshes of some things, each once."""
    return list(
        dict.fromkeys(
            shape.geometry.sha256
            for thing in things
            for shape in thing.shapes
            if isinstance(shape.geometry, Mesh)
        )
    )


def texture_sha256s(entities: Entities) -> list[str]:
    """The textures of some entities, each once."""
    of_markers = [marker.texture_sha256 for marker in entities.markers]
    of_bodies = [one.texture_sha256 for body in entities.bodies for one in body.materials]
    return [sha256 for sha256 in dict.fromkeys((*of_markers, *of_bodies)) if sha256]


def meshes_of(things: Iterable[Thing], files: Mapping[str, bytes]) -> dict[str, TriangleMesh]:
    """The things' meshes by sha256. Raises ValueError, in one line, where one cannot be had."""
    meshes = {}
    for sha256 in mesh_sha256s(things):
        if sha256 not in files:
            raise ValueError(f"mesh {sha256:.12} is not there")
        try:
            meshes[sha256] = decoded_mesh(sha256, files[sha256])
        except ValueError as error:
            raise ValueError(f"mesh {sha256:.12} {error}") from error
    return meshes


@functools.lru_cache(maxsize=128)
def decoded_mesh(sha256: str, data: bytes) -> TriangleMesh:
    """The mesh in a file, made once. Raises ValueError as `mesh_from_bytes` does."""
    if hashlib.sha256(data).hexdigest() != sha256:
        raise ValueError("does not have that sha256")
    return mesh_from_bytes(data)


@functools.lru_cache(maxsize=64)
def decoded_png(sha256: str, data: bytes) -> NDArray[np.uint8] | str:
    """The picture, or what is wrong; made once: each entity that comes or goes asks again."""
    if hashlib.sha256(data).hexdigest() != sha256:
        return "does not have that sha256"
    try:
        return decode_png(data)
    except ValueError as error:
        return str(error)


def decode_png(data: bytes) -> NDArray[np.uint8]:
    """The picture in a PNG file: (h, w, 3) uint8 RGB, read-only.

    Raises ValueError, with a phrase that says what is wrong, where it is no whole PNG of at most
    2048 x 2048. Decoders fill in for a damaged file silently: so every chunk's checksum is looked
    at first.
    """
    _check_png(data)
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if bgr is None:
        raise ValueError("cannot be decoded")
    rgb = np.ascontiguousarray(bgr[:, :, ::-1], np.uint8)
    rgb.setflags(write=False)
    return rgb


def _check_png(data: bytes) -> None:
    if not data.startswith(_PNG_SIGNATURE):
        raise ValueError("is no PNG")
    at, kind = len(_PNG_SIGNATURE), b""
    while kind != b"IEND":
        if at + 12 > len(data):
            raise ValueError("is cut short")
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 8 + length
        if end + 4 > len(data):
            raise ValueError("is cut short")
        if zlib.crc32(data[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            raise ValueError("is damaged")
        if at == len(_PNG_SIGNATURE):
            if kind != b"IHDR" or length != 13:
                raise ValueError("is no PNG")
            width, height = struct.unpack_from(">II", data, at + 8)
            if not (0 < width <= MAX_TEXTURE_SIDE_PX and 0 < height <= MAX_TEXTURE_SIDE_PX):
                limit = MAX_TEXTURE_SIDE_PX
                raise ValueError(f"is {width} x {height}: at most {limit} x {limit}")
        at = end + 4


def png_pixels(data: bytes) -> int:
    """How many pixels a PNG file that was looked at has."""
    width, height = struct.unpack_from(">II", data, len(_PNG_SIGNATURE) + 8)
    return int(width * height)
