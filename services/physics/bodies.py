"""The world's bodies in PyBullet: floor, walls, things and robot, stepped at 240 Hz.

Contact figures. Bullet multiplies the two surfaces' friction: floor and walls have 1.0, so that the
model's own coefficients hold: 1.0 for a tyre, 0 for a caster, which glides, 0.3 for the hull, which
scrapes along a wall. Bullet's damping of bodies, 4 % a second, is off: a robot has none. With
PyBullet's 50 solver iterations the standing robot creeps by 0.01 mm a second, with 20 by 0.1 mm.
Rolling straight or in a curve, it covers the distance of its wheels within 0.2 %. It turns 0.35 %
less than the wheels say, since they stand 288 mm apart, while drive and odometry assume 287 mm as
in the reference robot.

What moves is a plain rigid body, which Bullet steps four times as fast as a multibody; Bullet's own
damping is left on for it, since nothing else brings a rolling ball to rest.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from services.common.documents import Body, World
from services.common.frames import (
    BASE_FOOTPRINT_FRAME,
    BASE_LINK_FRAME,
    MAP_FRAME,
    ODOM_FRAME,
    Array,
    inverse_matrix,
    pose_matrix,
    quaternion_from_rotation,
    rotation_from_quaternion,
    transform_matrix,
)
from services.common.geometry import TriangleMesh
from services.physics.bullet import pybullet
from services.physics.collision import Solid, as_obj, inertia_of, solids_of
from services.physics.config import STEPS_PER_SECOND
from services.physics.robot_model import ModelError, RobotModel, Shape, Vector
from services.physics.world_limits import check

GRAVITY_M_S2 = 9.8
FLOOR = "floor"
WHEELS = ("wheel_left_joint", "wheel_right_joint")

_SURFACE_FRICTION = 1.0
_STATIC_GROUP, _ROBOT_GROUP, _MOVER_GROUP = 1, 2, 4
_FAR_M = 10_000.0
_LOWEST_M, _HIGHEST_M = -0.05, 0.5
_MAX_SPEED_M_S = 20.0
_DEEPEST_M = -1.0
_MAX_MOVER_SPEED_M_S = 200.0

Quaternion = tuple[float, float, float, float]

_KINDS = {
    "box": pybullet.GEOM_BOX,
    "cylinder": pybullet.GEOM_CYLINDER,
    "sphere": pybullet.GEOM_SPHERE,
    "capsule": pybullet.GEOM_CAPSULE,
    "hull": pybullet.GEOM_MESH,
    "triangles": pybullet.GEOM_MESH,
}


class BodyState(NamedTuple):
    """The robot after a step, exactly as PyBullet has it, in the map frame."""

    position_m: Vector
    """Of the base's centre of mass."""
    orientation_xyzw: Quaternion
    velocity_m_s: Vector
    """Of the base's centre of mass."""
    angular_velocity_rad_s: Vector
    wheel_angles_rad: tuple[float, float]
    """Left, right; turning forwards is positive; not wrapped."""
    wheel_speeds_rad_s: tuple[float, float]

    def is_sane(self) -> bool:
        """Whether a robot can be so: PyBullet keeps what is not finite without a word."""
        x, y, z = self.position_m
        fast = max(map(abs, self.velocity_m_s))
        turn = math.fsum(self.angular_velocity_rad_s) + math.fsum(self.orientation_xyzw)
        # A comparison with what is not a number is False.
        return (
            -_FAR_M < x < _FAR_M
            and -_FAR_M < y < _FAR_M
            and _LOWEST_M < z < _HIGHEST_M
            and fast < _MAX_SPEED_M_S
            and -_FAR_M < turn < _FAR_M
        )


class MoverState(NamedTuple):
    """A body that moves after a step, exactly as PyBullet has it, in the map frame."""

    position_m: Vector
    """Of its centre of mass."""
    orientation_xyzw: Quaternion
    """Of its principal axes."""
    velocity_m_s: Vector
    angular_velocity_rad_s: Vector

    def is_sane(self) -> bool:
        """Whether a thing can be so."""
        x, y, z = self.position_m
        turn = math.fsum(self.angular_velocity_rad_s) + math.fsum(self.orientation_xyzw)
        return (
            -_FAR_M < x < _FAR_M
            and -_FAR_M < y < _FAR_M
            and _DEEPEST_M < z < _FAR_M
            and max(map(abs, self.velocity_m_s)) < _MAX_MOVER_SPEED_M_S
            and -_FAR_M < turn < _FAR_M
        )


class _Mover(NamedTuple):
    name: str
    number: int
    """PyBullet's."""
    com_from_body: Array


class Touch(NamedTuple):
    """A point in which the robot presses against something."""

    robot_link: str
    body: str
    position_m: Vector
    force_n: float


class Bodies:
    """One world in a PyBullet client of its own: nothing of an earlier world is left in it."""

    def __init__(
        self,
        world: World,
        model: RobotModel,
        wheel_torque_n_m: float,
        meshes: Mapping[str, TriangleMesh] | None = None,
    ) -> None:
        """Raises ValueError, in one line, where world or model cannot be built."""
        meshes = meshes or {}
        check(world, meshes, (MAP_FRAME, ODOM_FRAME, *model.links))
        self._torques = [wheel_torque_n_m, wheel_torque_n_m]
        self.solid_groups: tuple[tuple[Solid, ...], ...] = ()
        """Solids that stand or move together, with `body_from_solid` seen from the group's frame.

        What stands in the world comes first, in the map's frame. Another tuple takes its place when
        a group comes, goes or changes; a group that stays is the same object in it.
        """
        self._client: int = pybullet.connect(pybullet.DIRECT)
        try:
            pybullet.setGravity(0.0, 0.0, -GRAVITY_M_S2, physicsClientId=self._client)
            pybullet.setTimeStep(1.0 / STEPS_PER_SECOND, physicsClientId=self._client)
            pybullet.setPhysicsEngineParameter(
                deterministicOverlappingPairs=1, physicsClientId=self._client
            )
            self._names: dict[int, str] = {}
            self._floor = self._add_static(FLOOR, pybullet.GEOM_PLANE, (0.0, 0.0, 0.0), 0.0)
            self._still: list[Solid] = []
            self._moving: list[tuple[Solid, ...]] = []
            for wall in world.walls:
                self._add_static(
                    wall.name,
                    pybullet.GEOM_BOX,
                    (wall.x_m, wall.y_m, wall.height_m / 2.0),
                    wall.yaw_rad,
                    halfExtents=[wall.length_m / 2.0, wall.thickness_m / 2.0, wall.height_m / 2.0],
                )
                middle = wall.map_from_wall().matrix(wall.height_m / 2.0)
                half = wall.length_m / 2.0, wall.thickness_m / 2.0, wall.height_m / 2.0
                self._still.append(Solid("box", middle, half_extents_m=half))
            self._movers: list[_Mover] = []
            for thing in world.bodies:
                self._add_body(thing, meshes)
            self._add_robot(world, model)
            self.solid_groups = (tuple(self._still), *self._moving)
        except (pybullet.error, ValueError) as error:
            self.close()
            raise ValueError(" ".join(str(error).split())) from error
        self.set_wheel_speeds(0.0, 0.0)
        self.state = self._read()
        self.mover_states = self._read_movers()

    def close(self) -> None:
        """Remove everything. Calling it again does nothing."""
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1

    def set_wheel_speeds(self, left_rad_s: float, right_rad_s: float) -> None:
        """What the wheels' motors hold from now on."""
        pybullet.setJointMotorControlArray(
            self._robot,
            self._wheels,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=[left_rad_s, right_rad_s],
            forces=self._torques,
            physicsClientId=self._client,
        )

    def step(self) -> BodyState:
        """Advance by one step."""
        pybullet.stepSimulation(physicsClientId=self._client)
        self.state = self._read()
        if self._movers:
            self.mover_states = self._read_movers()
        return self.state

    @property
    def mover_names(self) -> list[str]:
        """The bodies that move, in the order of the world."""
        return [mover.name for mover in self._movers]

    def map_from_movers(self) -> Array:
        """(k, 4, 4) true poses of the bodies that move."""
        poses = [
            pose_matrix(state) @ mover.com_from_body
            for mover, state in zip(self._movers, self.mover_states, strict=True)
        ]
        return np.array(poses).reshape(-1, 4, 4)

    def touches(self) -> list[Touch]:
        """Where the robot presses against anything that is not the floor, after the last step."""
        points = pybullet.getContactPoints(self._robot, physicsClientId=self._client)
        # Bullet also lists points up to 2 cm apart: only where there is a force do the two touch.
        return [
            Touch(self._link_names[point[3]], self._names[point[2]], point[6], point[9])
            for point in points
            if point[2] != self._floor and point[9] > 0.0
        ]

    def map_from_groups(self) -> Array:
        """(g, 4, 4) true poses of `solid_groups`."""
        return np.concatenate((np.eye(4)[None], self.map_from_movers()))

    def map_from_footprint(self) -> Array:
        """True (4, 4) pose of base_footprint."""
        return self._map_from_com() @ self._com_from_footprint

    def footprint_velocity(self) -> tuple[Array, Array]:
        """True linear and angular velocity, (3,) each, of base_footprint in its own axes."""
        turn, velocity, spin = self.motion_at(self._com_from_footprint)
        return velocity @ turn, spin @ turn

    def motion_at(self, com_from_frame: Array) -> tuple[Array, Array, Array]:
        """Of a frame fixed to the base: rotation map_from_frame, and velocity and angular velocity.

        (3, 3), (3,) and (3,), the last two in the map's axes.
        """
        state = self.state
        turn = rotation_from_quaternion(*state.orientation_xyzw)
        ax, ay, az = (turn @ com_from_frame[:3, 3]).tolist()
        vx, vy, vz = state.velocity_m_s
        wx, wy, wz = state.angular_velocity_rad_s
        # Velocity of the centre of mass plus spin x arm; np.cross is slow on single vectors.
        velocity = np.array(
            [vx + wy * az - wz * ay, vy + wz * ax - wx * az, vz + wx * ay - wy * ax]
        )
        return turn @ com_from_frame[:3, :3], velocity, np.array([wx, wy, wz])

    def com_from(self, footprint_from_frame: Array) -> Array:
        """(4, 4) pose of a frame of the robot seen from the base's centre of mass."""
        return self._com_from_footprint @ footprint_from_frame

    def _map_from_com(self) -> Array:
        return pose_matrix(self.state)

    def _read(self) -> BodyState:
        client, robot = self._client, self._robot
        position, orientation = pybullet.getBasePositionAndOrientation(
            robot, physicsClientId=client
        )
        velocity, spin = pybullet.getBaseVelocity(robot, physicsClientId=client)
        left, right = pybullet.getJointStates(robot, self._wheels, physicsClientId=client)
        return BodyState(
            position, orientation, velocity, spin, (left[0], right[0]), (left[1], right[1])
        )

    def _read_movers(self) -> list[MoverState]:
        client = self._client
        return [
            MoverState(
                *pybullet.getBasePositionAndOrientation(mover.number, physicsClientId=client),
                *pybullet.getBaseVelocity(mover.number, physicsClientId=client),
            )
            for mover in self._movers
        ]

    def _add_static(
        self, name: str, kind: int, position_m: Vector, yaw_rad: float, **shape: Any
    ) -> int:
        turn = 0.0, 0.0, math.sin(yaw_rad / 2.0), math.cos(yaw_rad / 2.0)
        index = pybullet.createCollisionShape(kind, physicsClientId=self._client, **shape)
        body = self._add_rigid(name, 0.0, index, position_m, turn)
        meets = _ROBOT_GROUP | _MOVER_GROUP
        pybullet.setCollisionFilterGroupMask(
            body, -1, _STATIC_GROUP, meets, physicsClientId=self._client
        )
        return body

    def _add_rigid(
        self, name: str, mass_kg: float, shape: int, position_m: Vector, turn_xyzw: Quaternion
    ) -> int:
        """A plain rigid body: where it does not move, Bullet does not look at it in every step."""
        client = self._client
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
        self._names[body] = name
        return body

    def _add_body(self, thing: Body, meshes: Mapping[str, TriangleMesh]) -> None:
        """A body of the world: one that moves is one in PyBullet, else each of its pieces is."""
        try:
            solids = solids_of(thing, meshes)
            if thing.mass_kg > 0.0:
                self._add_mover(thing, solids, meshes)
                return
        except ValueError as error:
            raise ValueError(f"body {thing.name!r:.60}: shapes: {error}") from error
        for solid in solids:
            pose = pose_matrix(thing) @ solid.body_from_solid
            body = self._add_rigid(thing.name, 0.0, self._shape_of(solid), *_placed(pose))
            meets = _ROBOT_GROUP | _MOVER_GROUP
            self._still.append(replace(solid, body_from_solid=pose))
            pybullet.setCollisionFilterGroupMask(
                body, -1, _STATIC_GROUP, meets, physicsClientId=self._client
            )

    def _add_mover(
        self, thing: Body, solids: list[Solid], meshes: Mapping[str, TriangleMesh]
    ) -> None:
        inertia = inertia_of(thing, meshes)
        com_from_body = inverse_matrix(inertia.body_from_com)
        pose = pose_matrix(thing) @ inertia.body_from_com
        body = self._add_rigid(
            thing.name, thing.mass_kg, self._compound(solids, com_from_body), *_placed(pose)
        )
        pybullet.changeDynamics(
            body,
            -1,
            # Without the mass, PyBullet takes one that it has never set.
            mass=thing.mass_kg,
            localInertiaDiagonal=inertia.diagonal_kg_m2,
            physicsClientId=self._client,
        )
        meets = _STATIC_GROUP | _ROBOT_GROUP | _MOVER_GROUP
        pybullet.setCollisionFilterGroupMask(
            body, -1, _MOVER_GROUP, meets, physicsClientId=self._client
        )
        self._movers.append(_Mover(thing.name, body, com_from_body))
        self._moving.append(tuple(solids))

    def _shape_of(self, solid: Solid) -> int:
        options: dict[str, Any] = {}
        if solid.vertices_m is not None:
            options["vertices"] = solid.vertices_m.tolist()
        if solid.triangles is not None:
            options["indices"] = solid.triangles.ravel().tolist()
            options["flags"] = pybullet.GEOM_FORCE_CONCAVE_TRIMESH
        index: int = pybullet.createCollisionShape(
            _KINDS[solid.kind],
            halfExtents=list(solid.half_extents_m),
            radius=solid.radius_m,
            height=solid.length_m,
            physicsClientId=self._client,
            **options,
        )
        return index

    def _compound(self, solids: list[Solid], com_from_body: Array) -> int:
        """One PyBullet shape of several convex pieces, seen from the centre of mass."""
        poses = [_placed(com_from_body @ solid.body_from_solid) for solid in solids]
        with tempfile.TemporaryDirectory(prefix="mazebot-hulls-") as folder:
            # Of several pieces PyBullet takes corners from files only.
            files = [""] * len(solids)
            for number, solid in enumerate(solids):
                if solid.vertices_m is not None:
                    path = Path(folder) / f"{number}.obj"
                    path.write_text(as_obj(solid.vertices_m), encoding="ascii")
                    files[number] = str(path)
            index: int = pybullet.createCollisionShapeArray(
                shapeTypes=[_KINDS[solid.kind] for solid in solids],
                halfExtents=[list(solid.half_extents_m) for solid in solids],
                radii=[solid.radius_m for solid in solids],
                lengths=[solid.length_m for solid in solids],
                fileNames=files,
                meshScales=[[1.0, 1.0, 1.0]] * len(solids),
                collisionFramePositions=[list(position) for position, _ in poses],
                collisionFrameOrientations=[list(turn) for _, turn in poses],
                physicsClientId=self._client,
            )
        return index

    def _add_robot(self, world: World, model: RobotModel) -> None:
        """The robot at the world's start; its base's frame in PyBullet is its centre of mass."""
        client = self._client
        base = model.body(BASE_LINK_FRAME)
        parts = model.separate_links(BASE_LINK_FRAME)
        footprint_from_base = model.transform(BASE_FOOTPRINT_FRAME, BASE_LINK_FRAME)
        base_from_com = transform_matrix(np.eye(3), base.centre_of_mass_m)
        self._com_from_footprint = inverse_matrix(footprint_from_base @ base_from_com)
        map_from_com = world.start.se2().matrix() @ footprint_from_base @ base_from_com
        com_from_base = inverse_matrix(base_from_com)
        bodies = [model.body(joint.child) for joint in parts]
        for joint, body in zip(parts, bodies, strict=True):
            if np.abs(body.centre_of_mass_m).max() > 1e-9:
                raise ModelError(f"link {joint.child!r}: its centre of mass must be its origin")
        poses = [com_from_base @ joint.parent_from_child for joint in parts]
        count = len(parts)
        self._robot: int = pybullet.createMultiBody(
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
        self._link_names = {-1: BASE_LINK_FRAME}
        inertias = [base.inertia_diagonal_kg_m2, *(b.inertia_diagonal_kg_m2 for b in bodies)]
        for index, inertia in enumerate(inertias, start=-1):
            if index >= 0:
                self._link_names[index] = parts[index].child
            pybullet.changeDynamics(
                self._robot,
                index,
                localInertiaDiagonal=list(inertia),
                lateralFriction=model.links[self._link_names[index]].lateral_friction or 0.0,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                physicsClientId=client,
            )
            pybullet.setCollisionFilterGroupMask(
                self._robot,
                index,
                _ROBOT_GROUP,
                _STATIC_GROUP | _MOVER_GROUP,
                physicsClientId=client,
            )
        names = [joint.name for joint in parts]
        for wheel in WHEELS:
            if model.joint(wheel).kind != "continuous" or wheel not in names:
                raise ModelError(f"joint {wheel!r}: must turn, on {BASE_LINK_FRAME}")
        self._wheels = [names.index(wheel) for wheel in WHEELS]

    def _collision(self, shapes: tuple[Shape, ...]) -> int:
        """One PyBullet shape of several."""
        if not shapes:
            return -1
        poses = [shape.link_from_shape for shape in shapes]
        index: int = pybullet.createCollisionShapeArray(
            shapeTypes=[_KINDS[shape.kind] for shape in shapes],
            halfExtents=[[side / 2.0 for side in shape.sides_m] for shape in shapes],
            radii=[shape.radius_m for shape in shapes],
            lengths=[shape.length_m for shape in shapes],
            collisionFramePositions=[pose[:3, 3].tolist() for pose in poses],
            collisionFrameOrientations=[quaternion_from_rotation(pose[:3, :3]) for pose in poses],
            physicsClientId=self._client,
        )
        return index


def _moved(shape: Shape, a_from_link: Array) -> Shape:
    return Shape(
        shape.kind,
        shape.sides_m,
        shape.radius_m,
        shape.length_m,
        a_from_link @ shape.link_from_shape,
    )


def _placed(a_from_b: Array) -> tuple[Vector, Quaternion]:
    """Position and orientation, as PyBullet takes them."""
    x, y, z = a_from_b[:3, 3].tolist()
    return (x, y, z), quaternion_from_rotation(a_from_b[:3, :3])
