"""The textures and meshes received, by the sha256 of their files."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Collection, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from mazebot.common.files import png
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Thing
from mazebot.common.world.assets import mesh_sha256s
from mazebot.common.world.geometry import TriangleMesh, mesh_from_bytes

MAX_ASSETS = 512
MAX_BYTES = 256_000_000
"""Of all assets together"""


class Assets:
    """Asset files, each validated before it is stored."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        """The files by their sha256."""

    def add(
        self, message: msg.CompressedImage, in_use: Callable[[], Collection[str]] = tuple
    ) -> str:
        """Store a file; returns an empty string, or a short phrase why it is rejected.

        If there are too many, the oldest ones that are not in use are removed.
        """
        sha256 = message.header.frame_id
        if sha256 in self.files:
            return ""
        if not self._has_room(message.data.nbytes, in_use):
            return "too many assets"
        data = message.data.tobytes()
        if hashlib.sha256(data).hexdigest() != sha256:
            return "does not match its sha256"
        if message.format == "png":
            try:
                png.decode(data)
            except ValueError:
                return f"not a PNG of at most {png.MAX_SIDE_PX} x {png.MAX_SIDE_PX}"
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
        """The sha256s among those wanted whose files are missing, each once."""
        return [sha256 for sha256 in dict.fromkeys(wanted) if sha256 not in self.files]


def meshes_of(things: Iterable[Thing], files: Mapping[str, bytes]) -> dict[str, TriangleMesh]:
    """The bodies' meshes by sha256. Raises ValueError, in one line, if one is missing or bad."""
    meshes = {}
    for sha256 in mesh_sha256s(things):
        if sha256 not in files:
            raise ValueError(f"mesh {sha256:.12} is missing")
        try:
            meshes[sha256] = decoded_mesh(sha256, files[sha256])
        except ValueError as error:
            raise ValueError(f"mesh {sha256:.12} {error}") from error
    return meshes


@functools.lru_cache(maxsize=128)
def decoded_mesh(sha256: str, data: bytes) -> TriangleMesh:
    """The mesh in a file, cached. Raises ValueError as `mesh_from_bytes` does."""
    if hashlib.sha256(data).hexdigest() != sha256:
        raise ValueError("does not match its sha256")
    return mesh_from_bytes(data)


@functools.lru_cache(maxsize=64)
def decoded_png(sha256: str, data: bytes) -> NDArray[np.uint8] | str:
    """The image, or the error; cached, since each entity added or removed needs it again."""
    if hashlib.sha256(data).hexdigest() != sha256:
        return "does not match its sha256"
    try:
        return png.decode(data)
    except ValueError as error:
        return str(error)
