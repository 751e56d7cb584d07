"""Decodes and checks the textures and meshes of a request."""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Container, Mapping

from mazebot.common.files import png
from mazebot.common.messages.documents import Entity
from mazebot.common.world.assets import assets_of
from mazebot.common.world.geometry import mesh_from_bytes


def decoded(assets: Mapping[str, str], entity: Entity, known: Container[str]) -> dict[str, bytes]:
    """The files of a request, base64 by sha256, that the entity needs and that are not `known`.

    Raises ValueError, in one line, if one is missing, does not match its sha256, or is not a
    complete image or mesh.
    """
    wanted = assets_of(entity)
    for sha256 in assets:
        if sha256 not in wanted:
            raise ValueError(f"assets: {sha256!r:.20}: is not used by the entity")
    files: dict[str, bytes] = {}
    for sha256, form in wanted.items():
        if sha256 in known:
            continue
        if sha256 not in assets:
            raise ValueError(f"assets: {sha256!r:.20}: must be given: used by the entity")
        try:
            data = base64.b64decode(assets[sha256], validate=True)
        except (binascii.Error, ValueError):
            raise ValueError(f"assets: {sha256:.16}: must be base64") from None
        if hashlib.sha256(data).hexdigest() != sha256:
            raise ValueError(f"assets: {sha256:.16}: does not match the sha256 of the file")
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
