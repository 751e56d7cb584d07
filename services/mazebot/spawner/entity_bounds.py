"""The box around an entity."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mazebot.common.maths.frames import Array, pose_matrix
from mazebot.common.messages.documents import Entity, MarkerEntity
from mazebot.common.world.geometry import TriangleMesh, triangles_of


def bounds_m(entity: Entity, meshes: Mapping[str, TriangleMesh]) -> tuple[Array, Array]:
    """The least and the greatest x, y, z of an entity in its own frame, each (3,).

    `meshes` are by sha256, unscaled. Round surfaces count as the flat ones that are drawn. Raises
    KeyError where a mesh is missing.
    """
    if isinstance(entity, MarkerEntity):
        half = np.array([entity.panel_side_m / 2.0, entity.panel_side_m / 2.0, 0.0])
        return -half, half
    points = np.concatenate(
        [
            triangles_of(shape.geometry, meshes).moved(pose_matrix(shape)).vertices_m
            for shape in entity.shapes
        ]
    )
    return points.min(axis=0), points.max(axis=0)
