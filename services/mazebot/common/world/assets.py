"""The files that documents refer to by their sha256: textures (PNG) and meshes (npz)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mazebot.common.messages.documents import Entity, MarkerEntity, Mesh, Thing, World
from mazebot.common.messages.messages import CompressedImage, header

_PNG_MAGIC = b"\x89PNG"


def assets_of(*named: World | Entity) -> dict[str, str]:
    """Format (`png`, `npz`) of each file that the documents refer to, by its sha256."""
    formats: dict[str, str] = {}
    for one in named:
        if isinstance(one, MarkerEntity):
            formats[one.texture_sha256] = "png"
            continue
        formats |= {material.texture_sha256: "png" for material in one.materials}
        formats |= dict.fromkeys(
            mesh_sha256s(one.bodies if isinstance(one, World) else [one]), "npz"
        )
    formats.pop("", None)
    return formats


def mesh_sha256s(things: Iterable[Thing]) -> list[str]:
    """The meshes of some bodies, without duplicates."""
    return list(
        dict.fromkeys(
            shape.geometry.sha256
            for thing in things
            for shape in thing.shapes
            if isinstance(shape.geometry, Mesh)
        )
    )


def asset_message(sha256: str, data: bytes) -> CompressedImage:
    """The message that carries a file, with its format detected from the first bytes."""
    kind = "png" if data.startswith(_PNG_MAGIC) else "npz"
    return CompressedImage(header(0, sha256), format=kind, data=np.frombuffer(data, np.uint8))
