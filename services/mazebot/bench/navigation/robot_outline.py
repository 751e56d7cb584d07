"""The robot's true outline on the floor, for distances to things around it."""

from __future__ import annotations

import functools

import numpy as np
import shapely
from numpy.typing import NDArray

from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, BASE_LINK_FRAME, Array
from mazebot.common.messages import documents as doc
from mazebot.common.world.footprint import footprint
from mazebot.physics.bodies.robot_model import RobotModel, Shape, robot_model_from_urdf
from mazebot.physics.config import PhysicsConfig


@functools.cache
def robot_parts() -> tuple[Array, ...]:
    """Convex polygons, (k, 2) each in base_footprint, whose union is the floor under everything of
    the robot that can collide (hull, wheels, casters, lidar) by its model's collision shapes.
    """
    model = robot_model_from_urdf(PhysicsConfig().robot_urdf())
    parts: list[Array] = []
    for shape, pose in _shapes(model):
        for polygons in footprint(_geometry(shape), pose, {}).polygons_m:
            parts += [np.asarray(shapely.get_coordinates(shapely.Polygon(one))) for one in polygons]
    whole = shapely.union_all([shapely.Polygon(part) for part in parts])
    pieces = shapely.get_parts(whole)
    return tuple(np.asarray(shapely.get_coordinates(shapely.convex_hull(one))) for one in pieces)


def outlines(poses: Array) -> list[NDArray[np.object_]]:
    """The polygons of each part at (n, 3) poses x, y, yaw: a list of (n,) arrays."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turn = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], 1)
    return [
        np.asarray(shapely.polygons(np.einsum("nij,kj->nki", turn, part) + poses[:, None, :2]))
        for part in robot_parts()
    ]


def _shapes(model: RobotModel) -> list[tuple[Shape, Array]]:
    """Every collision shape of the robot, and its pose in base_footprint."""
    footprint_from_base = model.transform(BASE_FOOTPRINT_FRAME, BASE_LINK_FRAME)
    bodies = [(model.body(BASE_LINK_FRAME), footprint_from_base)]
    for joint in model.separate_links(BASE_LINK_FRAME):
        bodies.append((model.body(joint.child), footprint_from_base @ joint.parent_from_child))
    return [(shape, pose @ shape.link_from_shape) for body, pose in bodies for shape in body.shapes]


def _geometry(shape: Shape) -> doc.Geometry:
    if shape.kind == "box":
        return doc.Box(size_m=shape.sides_m)
    if shape.kind == "cylinder":
        return doc.Cylinder(radius_m=shape.radius_m, length_m=shape.length_m)
    return doc.Sphere(radius_m=shape.radius_m)
