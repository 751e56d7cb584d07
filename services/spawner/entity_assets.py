"""The textures and meshes of things that people ask for: which they need, and whether they are
whole.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Container, Iterator, Mapping

from services.common import png
from services.common.documents import Entity, MarkerEntity, Mesh, World
from services.common.geometry import mesh_from_bytes

_PNG_MAGIC = b"\x89PNG"


def needed(entity: Entity) -> Iterator[tuple[str, str]]:
    """Format (`png`, `npz`) and sha256 of each asset that an entity names, some more than once."""
    if isinstance(entity, MarkerEntity):
        yield "png", entity.texture_sha256
        return
    for material in entity.materials:
        if material.texture_sha256:
            yield "png", material.texture_sha256
    for shape in entity.shapes:
        if isinstance(shape.geometry, Mesh):
            yield "npz", shape.geometry.sha256


def mesh_sha256s(world: World) -> list[str]:
    """The meshes of a world, each once."""
    return list(
        dict.fromkeys(
            shape.geometry.sha256
            for body in world.bodies
            for shape in body.shapes
            if isinstance(shape.geometry, Mesh)
        )
    )


def file_format(data: bytes) -> str:
    """`png` or `npz`, by its first bytes."""
    return "png" if data.startswith(_PNG_MAGIC) else "npz"


def decoded(assets: Mapping[str, str], entity: Entity, known: Container[str]) -> dict[str, bytes]:
    """The files of a request, base64 by sha256, that the entity needs and that are not `known`.

    Raises ValueError, in one line, where one is missing, is not what its sha256 names, or is no
    whole picture or mesh.
    """
    wanted = {sha256: form for form, sha256 in needed(entity)}
    for sha256 in assets:
        if sha256 not in wanted:
            raise ValueError(f"assets: {sha256!r:.20}: is named by nothing in the entity")
    files: dict[str, bytes] = {}
    for sha256, form in wanted.items():
        if sha256 in known:
            continue
        if sha256 not in assets:
            raise ValueError(f"assets: {sha256!r:.20}: must be among them: the entity names it")
        try:
            data = base64.b64decode(assets[sha256], validate=True)
        except (binascii.Error, ValueError):
            raise ValueError(f"assets: {sha256:.16}: must be base64") from None
        if hashlib.sha256(data).hexdigest() != sha256:
            raise ValueError(f"assets: {sha256:.16}: is not the file that its sha256 names")
        problem = png.problem(data) if form == "png" else _mesh_problem(data)
        if problem:
            raise ValueError(f"assets: {sha256:.16}: {problem}")
        files[sha256] = data
    return files


def _mesh_problem(data: bytes) -> str:
    try:
        mesh = mesh_from_bytes(data)
    except ValueError as error:
        return str(error)
    return "" if len(mesh.triangles) else "has no triangles"
