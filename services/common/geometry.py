"""Shapes as triangles: one description for what is seen, what is solid and what is on the map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.common.documents import Geometry
from services.common.frames import Array

MAX_TRIANGLES = 2_000_000


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles, counter-clockwise from outside; read-only."""

    vertices_m: Array
    """(n, 3)"""
    normals: Array
    """(n, 3), of unit length"""
    uvs: Array
    """(n, 2): (0, 0) is a texture's top left, (1, 1) its bottom right; it repeats beyond."""
    triangles: NDArray[np.int32]
    """(m, 3)"""

    def moved(self, a_from_b: Array) -> TriangleMesh:
        """The same in another frame, by a rigid (4, 4) transform."""
        raise NotImplementedError


def triangles_of(
    geometry: Geometry, meshes: Mapping[str, TriangleMesh], tile_side_m: float = 1.0
) -> TriangleMesh:
    """The surface of a shape in its own frame.

    `meshes` are by sha256, unscaled. `tile_side_m` is Material.texture_side_m. Closed for every
    kind but planes and meshes. Raises KeyError where a mesh is not there.
    """
    raise NotImplementedError


def mesh_to_bytes(mesh: TriangleMesh) -> bytes:
    """As an asset: a numpy .npz, the same bytes for the same mesh."""
    raise NotImplementedError


def mesh_from_bytes(data: bytes) -> TriangleMesh:
    """The mesh in an asset.

    Raises ValueError with a short phrase where the data is not one: wrong shapes or types, an index
    out of range, what is not finite, more than MAX_TRIANGLES.
    """
    raise NotImplementedError


def clipped(mesh: TriangleMesh, low_z_m: float, high_z_m: float) -> TriangleMesh:
    """The part of a surface between two heights; cut triangles keep normals and texture."""
    raise NotImplementedError
