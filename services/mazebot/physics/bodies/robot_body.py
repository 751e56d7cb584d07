"""The robot in a PyBullet client."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    BASE_LINK_FRAME,
    SE3,
    Array,
    inverse_matrix,
    quaternion_from_rotation,
    transform_matrix,
)
from mazebot.physics.bodies.body_state import BodyState
from mazebot.physics.bodies.bullet import pybullet
from mazebot.physics.bodies.collision import Solid, extent_of
from mazebot.physics.bodies.rigid_bodies import KINDS, MEETS, ROBOT_GROUP
from mazebot.physics.bodies.robot_model import Body, ModelError, RobotModel, Shape
from mazebot.physics.bodies.scripted_path import Floorplan

WHEELS = ("wheel_left_joint", "wheel_right_joint")

_FLOOR_LEAST_UP = math.sqrt(0.5)
"""Least upward component of a contact normal for a wheel or caster to stand on a body instead of
being stopped by it: a tyre with a friction of 1 holds on a slope of up to 45 degrees.
"""
_STANDS_WITHIN_M = 1e-3
"""A link that reaches this near to the plane of base_footprint is a wheel or caster."""


class RobotBody:
    """One multibody, whose base frame in PyBullet is at its centre of mass."""

    def __init__(self, client: int, model: RobotModel, map_from_footprint: Array) -> None:
        """Create it at the pose of base_footprint, (4, 4) in the map. Raises ModelError."""
        self._client = client
        base = model.body(BASE_LINK_FRAME)
        parts = model.separate_links(BASE_LINK_FRAME)
        footprint_from_base = model.transform(BASE_FOOTPRINT_FRAME, BASE_LINK_FRAME)
        base_from_com = transform_matrix(np.eye(3), base.centre_of_mass_m)
        self.com_from_footprint = inverse_matrix(
            portable.product(footprint_from_base, base_from_com)
        )
        map_from_com = portable.product(
            portable.product(map_from_footprint, footprint_from_base), base_from_com
        )
        com_from_base = inverse_matrix(base_from_com)
        bodies = [model.body(joint.child) for joint in parts]
        for joint, body in zip(parts, bodies, strict=True):
            if np.abs(body.centre_of_mass_m).max() > 1e-9:
                raise ModelError(f"link {joint.child!r}: its centre of mass must be its origin")
        poses = [portable.product(com_from_base, joint.parent_from_child) for joint in parts]
        count = len(parts)
        self.number: int = pybullet.createMultiBody(
            base.mass_kg,
            self._collision(tuple(_moved(shape, com_from_base) for shape in base.shapes)),
            basePosition=map_from_com[:3, 3].tolist(),
            baseOrientation=quaternion_from_rotation(map_from_com[:3, :3]),
            linkMasses=[body.mass_kg for body in bodies],
            linkCollisionShapeIndices=[self._collision(body.shapes) for body in bodies],
            linkVisualShapeIndices=[-1] * count,
            linkPositions=[pose[:3, 3].tolist() for pose in poses],
            linkOrientations=[quaternion_from_rotation(pose[:3, :3]) for pose in poses],
            linkInertialFramePositions=[[0.0, 0.0, 0.0]] * count,
            linkInertialFrameOrientations=[[0.0, 0.0, 0.0, 1.0]] * count,
            linkParentIndices=[0] * count,
            linkJointTypes=[
                pybullet.JOINT_FIXED if joint.kind == "fixed" else pybullet.JOINT_REVOLUTE
                for joint in parts
            ],
            linkJointAxis=[list(joint.axis) for joint in parts],
            physicsClientId=client,
        )
        self.link_names = {-1: BASE_LINK_FRAME}
        """By PyBullet's index."""
        inertias = [base.inertia_diagonal_kg_m2, *(b.inertia_diagonal_kg_m2 for b in bodies)]
        for index, inertia in enumerate(inertias, start=-1):
            if index >= 0:
                self.link_names[index] = parts[index].child
            pybullet.changeDynamics(
                self.number,
                index,
                localInertiaDiagonal=list(inertia),
                lateralFriction=model.links[self.link_names[index]].lateral_friction or 0.0,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                physicsClientId=client,
            )
            pybullet.setCollisionFilterGroupMask(
                self.number, index, ROBOT_GROUP, MEETS[ROBOT_GROUP], physicsClientId=client
            )
        members = [(base, footprint_from_base)] + [
            (body, portable.product(footprint_from_base, joint.parent_from_child))
            for joint, body in zip(parts, bodies, strict=True)
        ]
        solids = [solid for member in members for solid in _solids(*member)]
        self.floorplan = Floorplan.of(*extent_of(solids, np.eye(4)))
        farthest_m = np.abs(extent_of(solids, self.com_from_footprint)).max(0)
        self.reach_m = float(portable.lengths(farthest_m))
        """No part is farther from the centre of mass."""
        self._standing_links = {
            index
            for index, member in enumerate(members, start=-1)
            if index >= 0 and _stands(_solids(*member))
        }
        names = [joint.name for joint in parts]
        for wheel in WHEELS:
            if model.joint(wheel).kind != "continuous" or wheel not in names:
                raise ModelError(f"joint {wheel!r}: must turn, on {BASE_LINK_FRAME}")
        self._wheels = [names.index(wheel) for wheel in WHEELS]
        self.footprint_on_com = SE3.from_matrix(self.com_from_footprint)

    def state(self) -> BodyState:
        """Its pose, velocities and wheel angles."""
        client = self._client
        position, orientation = pybullet.getBasePositionAndOrientation(
            self.number, physicsClientId=client
        )
        velocity, spin = pybullet.getBaseVelocity(self.number, physicsClientId=client)
        left, right = pybullet.getJointStates(self.number, self._wheels, physicsClientId=client)
        return BodyState(
            position, orientation, velocity, spin, (left[0], right[0]), (left[1], right[1])
        )

    def drive_wheels(self, left_rad_s: float, right_rad_s: float, torque_n_m: float) -> None:
        """Set the target speeds of the wheels' motors, with at most that torque each."""
        pybullet.setJointMotorControlArray(
            self.number,
            self._wheels,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=[left_rad_s, right_rad_s],
            forces=[torque_n_m, torque_n_m],
            physicsClientId=self._client,
        )

    def turn_wheels_to(
        self, angles_rad: tuple[float, float], speeds_rad_s: tuple[float, float]
    ) -> None:
        """Set angles and speeds of the wheels, left and right, at once."""
        for wheel, angle, speed in zip(self._wheels, angles_rad, speeds_rad_s, strict=True):
            pybullet.resetJointState(self.number, wheel, angle, speed, physicsClientId=self._client)

    def stands_on(self, point: tuple[Any, ...]) -> bool:
        """Whether a contact point is that of a wheel or caster standing on something."""
        link, normal_towards_robot = point[3], point[7]
        return link in self._standing_links and normal_towards_robot[2] >= _FLOOR_LEAST_UP

    def _collision(self, shapes: tuple[Shape, ...]) -> int:
        """Create one PyBullet shape of several."""
        if not shapes:
            return -1
        poses = [shape.link_from_shape for shape in shapes]
        index: int = pybullet.createCollisionShapeArray(
            shapeTypes=[KINDS[shape.kind] for shape in shapes],
            halfExtents=[[side / 2.0 for side in shape.sides_m] for shape in shapes],
            radii=[shape.radius_m for shape in shapes],
            lengths=[shape.length_m for shape in shapes],
            collisionFramePositions=[pose[:3, 3].tolist() for pose in poses],
            collisionFrameOrientations=[quaternion_from_rotation(pose[:3, :3]) for pose in poses],
            physicsClientId=self._client,
        )
        return index


def _solids(body: Body, a_from_body: Array) -> list[Solid]:
    """Solids of a body in another frame."""
    return [
        _solid(shape, portable.product(a_from_body, shape.link_from_shape)) for shape in body.shapes
    ]


def _solid(shape: Shape, a_from_shape: Array) -> Solid:
    x, y, z = shape.sides_m
    half = x / 2.0, y / 2.0, z / 2.0
    return Solid(shape.kind, a_from_shape, half, shape.radius_m, shape.length_m)


def _stands(solids: list[Solid]) -> bool:
    """Whether solids in the frame of base_footprint reach down to the floor."""
    lowest_m, _ = extent_of(solids, np.eye(4))
    return bool(solids) and abs(float(lowest_m[2])) <= _STANDS_WITHIN_M


def _moved(shape: Shape, a_from_link: Array) -> Shape:
    return Shape(
        shape.kind,
        shape.sides_m,
        shape.radius_m,
        shape.length_m,
        portable.product(a_from_link, shape.link_from_shape),
    )
