"""PyBullet's shapes, and the plain rigid bodies that are made of them."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array, position_and_quaternion
from mazebot.common.messages.documents import Quaternion, Vector
from mazebot.physics.bodies.bullet import lent, pybullet
from mazebot.physics.bodies.collision import Solid, as_obj

STATIC_GROUP, ROBOT_GROUP, MOVER_GROUP, SCRIPTED_GROUP = 1, 2, 4, 8
"""Static bodies, the robot, bodies that move freely, and bodies that follow a path"""
MEETS = {
    STATIC_GROUP: ROBOT_GROUP | MOVER_GROUP,
    ROBOT_GROUP: STATIC_GROUP | MOVER_GROUP | SCRIPTED_GROUP,
    MOVER_GROUP: STATIC_GROUP | ROBOT_GROUP | MOVER_GROUP | SCRIPTED_GROUP,
    SCRIPTED_GROUP: ROBOT_GROUP | MOVER_GROUP,
}
NOWHERE: Vector = (0.0, 0.0, 0.0)
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)

KINDS = {
    "box": pybullet.GEOM_BOX,
    "cylinder": pybullet.GEOM_CYLINDER,
    "sphere": pybullet.GEOM_SPHERE,
    "capsule": pybullet.GEOM_CAPSULE,
    "ellipsoid": pybullet.GEOM_MESH,
    "hull": pybullet.GEOM_MESH,
    "triangles": pybullet.GEOM_MESH,
}
"""PyBullet's shape types of the solids"""

_SURFACE_FRICTION = 1.0


def rigid_body(
    client: int,
    name: str,
    mass_kg: float,
    shape: int,
    position_m: Vector,
    turn_xyzw: Quaternion,
    group: int,
) -> int:
    """Create a plain rigid body: if it is static, Bullet does not process it in every step.

    Returns PyBullet's body number. Raises ValueError if `shape` is not valid.
    """
    if shape < 0:
        raise ValueError(f"body {name!r:.60}: PyBullet cannot make its shape")
    body: int = pybullet.createMultiBody(
        mass_kg,
        shape,
        basePosition=position_m,
        baseOrientation=list(turn_xyzw),
        useMaximalCoordinates=1,
        physicsClientId=client,
    )
    pybullet.changeDynamics(body, -1, lateralFriction=_SURFACE_FRICTION, physicsClientId=client)
    pybullet.setCollisionFilterGroupMask(body, -1, group, MEETS[group], physicsClientId=client)
    return body


def shape_of(client: int, solid: Solid, frame: tuple[Vector, Quaternion]) -> int:
    """Create a shape at a pose in its body; returns PyBullet's number of it."""
    options: dict[str, Any] = {}
    if solid.vertices_m is not None:
        options["vertices"] = lent("vertices", solid.vertices_m)
    if solid.triangles is not None:
        options["indices"] = lent("indices", solid.triangles.ravel())
        options["flags"] = pybullet.GEOM_FORCE_CONCAVE_TRIMESH
    index: int = pybullet.createCollisionShape(
        KINDS[solid.kind],
        halfExtents=list(solid.half_extents_m),
        radius=solid.radius_m,
        height=solid.length_m,
        collisionFramePosition=frame[0],
        collisionFrameOrientation=frame[1],
        physicsClientId=client,
        **options,
    )
    return index


@contextlib.contextmanager
def compound_shape(client: int, solids: Sequence[Solid], com_from_body: Array) -> Iterator[int]:
    """One PyBullet shape of several convex pieces, seen from the centre of mass; to be used
    before the context ends.
    """
    poses = [
        position_and_quaternion(portable.product(com_from_body, solid.body_from_solid))
        for solid in solids
    ]
    if len(solids) == 1:
        yield shape_of(client, solids[0], poses[0])
        return
    files = [""] * len(solids)
    with contextlib.ExitStack() as stack:
        if any(solid.vertices_m is not None for solid in solids):
            # For several pieces PyBullet reads corners from files only, and reads them twice.
            folder = tempfile.TemporaryDirectory(prefix="mazebot-hulls-")
            path = Path(stack.enter_context(folder))
            for number, solid in enumerate(solids):
                if solid.vertices_m is not None:
                    files[number] = str(path / f"{number}.obj")
                    obj = as_obj(solid.vertices_m)
                    Path(files[number]).write_text(obj, encoding="ascii")
        yield pybullet.createCollisionShapeArray(
            shapeTypes=[KINDS[solid.kind] for solid in solids],
            halfExtents=[list(solid.half_extents_m) for solid in solids],
            radii=[solid.radius_m for solid in solids],
            lengths=[solid.length_m for solid in solids],
            fileNames=files,
            meshScales=[[1.0, 1.0, 1.0]] * len(solids),
            collisionFramePositions=[list(position) for position, _ in poses],
            collisionFrameOrientations=[list(turn) for _, turn in poses],
            physicsClientId=client,
        )
