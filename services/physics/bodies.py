"""The world's bodies in PyBullet: floor, walls, things and robot, stepped at 240 Hz.

Contact figures. Bullet multiplies the two surfaces' friction: floor and walls have 1.0, so that the
model's own coefficients hold: 1.0 for a tyre, 0 for a caster, which glides, 0.3 for the hull, which
scrapes along a wall. Bullet's damping of bodies, 4 % a second, is off: a robot has none. Rolling
straight or in a curve, it covers the distance of its wheels within 0.3 %. It turns 0.35 % less than
the wheels say, since they stand 288 mm apart, while drive and odometry assume 287 mm as in the
reference robot.

Where the robot alone moves, its contacts are solved exactly, by Dantzig's pivoting: the wheels have
the speed that they are given to 1e-9 m/s, the standing robot stays where it is to the last bits,
and a step takes half as long as with PyBullet's 50 iterations of Gauss-Seidel, with which the robot
creeps by 0.01 mm a second. The effort of the exact way grows with the cube of the points of
contact, and it does not know what bodies of the kind that moves do to each other: where there are
any, Gauss-Seidel it is.

What moves is a plain rigid body, which Bullet steps four times as fast as a multibody; Bullet's own
damping is left on for it, since nothing else brings a rolling ball to rest.

What follows a path is a rigid body too, so heavy that nothing stops it, that is set on its way anew
before each step: of a body without mass Bullet's contacts do not know the speed, and let it sink
into what it pushes.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from services.common.documents import BodyEntity, Plane, Quaternion, Thing, Vector, World
from services.common.frames import (
    BASE_FOOTPRINT_FRAME,
    BASE_LINK_FRAME,
    MAP_FRAME,
    ODOM_FRAME,
    SE3,
    Array,
    inverse_matrix,
    pose_matrix,
    position_and_quaternion,
    quaternion_from_rotation,
    rotation_from_quaternion,
    transform_matrix,
    yaw_from_quaternion,
)
from services.common.geometry import TriangleMesh
from services.physics.body_state import BodyState, MoverState
from services.physics.bullet import lent, pybullet, quiet
from services.physics.collision import Solid, as_obj, extent_of, inertia_of, solids_of
from services.physics.config import STEPS_PER_SECOND
from services.physics.robot_model import ModelError, RobotModel, Shape
from services.physics.scripted_path import Floorplan, PathPose, Route, meets
from services.physics.world_limits import PENETRATION_M, check

GRAVITY_M_S2 = 9.8
MAX_PIECES = 200
"""Of an entity that moves: PyBullet takes a second for the hulls of so many."""
FLOOR = "floor"
WHEELS = ("wheel_left_joint", "wheel_right_joint")

_SURFACE_FRICTION = 1.0
_NEAR_M = 0.1
"""Around the robot: farther than it, and what comes towards it, moves in a step. For as long as it
has not come so far, and nothing else moves, it touches nothing where nothing was so near to it.
"""
_FLOOR_CONTACT_M = 1e-4
"""How near to the floor a point must be for the solver to look at it: of the four points that
Bullet keeps of each rolling wheel, three have left the floor, and would cost a third of a step.
"""
_ITERATIVE = pybullet.CONSTRAINT_SOLVER_LCP_SI
"""PyBullet's own choice"""
_EXACT = pybullet.CONSTRAINT_SOLVER_LCP_DANTZIG
_EXACT_CFM = 1e-9
"""Softness of its constraints: two wheels and two casters touch the floor in more points than it
takes to hold a robot, and without any softness every second step has no one solution.
"""
_STATIC_GROUP, _ROBOT_GROUP, _MOVER_GROUP, _SCRIPTED_GROUP = 1, 2, 4, 8
_MEETS = {
    _STATIC_GROUP: _ROBOT_GROUP | _MOVER_GROUP,
    _ROBOT_GROUP: _STATIC_GROUP | _MOVER_GROUP | _SCRIPTED_GROUP,
    _MOVER_GROUP: _STATIC_GROUP | _ROBOT_GROUP | _MOVER_GROUP | _SCRIPTED_GROUP,
    _SCRIPTED_GROUP: _ROBOT_GROUP | _MOVER_GROUP,
}
_SCRIPTED_MASS_KG = 1e5
_YIELD_M = 0.3
"""How far ahead on its way a body looks for the robot; at these steps."""
_YIELD_STEP_M = 0.05
_WAY_STEP_M = 0.1
"""Between the places on a path at which it is looked for walls; these are thicker."""
_MAX_GARBAGE_BYTES = 8_000_000
"""PyBullet never gives back the shape of a body that is removed: from so much on, everything is
made anew, as it moves.
"""
_BODY_BYTES, _CORNER_BYTES, _TRIANGLE_BYTES = 4_000, 200, 150
_NOWHERE: Vector = (0.0, 0.0, 0.0)
_UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)

_KINDS = {
    "box": pybullet.GEOM_BOX,
    "cylinder": pybullet.GEOM_CYLINDER,
    "sphere": pybullet.GEOM_SPHERE,
    "capsule": pybullet.GEOM_CAPSULE,
    "hull": pybullet.GEOM_MESH,
    "triangles": pybullet.GEOM_MESH,
}


@dataclass(eq=False)
class _Placed:
    """A thing, as it was made and as it is."""

    thing: Thing
    solids: tuple[Solid, ...]
    """In the body's frame"""
    com_from_body: Array
    """Where the body moves freely; else the same frame."""
    inertia_kg_m2: Vector
    level_xyzw: Quaternion
    """Its orientation without its heading"""
    route: Route | None
    floorplan: Floorplan
    """Of what follows a path, as it looks ahead"""
    numbers: tuple[int, ...] = ()
    """PyBullet's: one where it moves, else one a solid."""
    travelled_m: float = 0.0
    speed_m_s: float = 0.0
    """On the path, in the last step"""
    state: MoverState | None = None
    """Of what moves"""

    @property
    def garbage_bytes(self) -> int:
        """About what PyBullet keeps of it when it is removed."""
        corners = sum(len(one.vertices_m) for one in self.solids if one.vertices_m is not None)
        triangles = sum(len(one.triangles) for one in self.solids if one.triangles is not None)
        bodies = _BODY_BYTES * max(len(self.numbers), len(self.solids))
        return bodies + _CORNER_BYTES * corners + _TRIANGLE_BYTES * triangles

    def path_state(self) -> MoverState:
        """Of what follows a path."""
        assert self.route is not None
        pose = self.route.at(self.travelled_m)
        x, y, turn = self.route.velocity(self.travelled_m, self.speed_m_s)
        z = self.thing.position_m[2]
        # Its own tilt, and ahead instead of its own heading.
        ahead_xyzw = _turned(self.level_xyzw, pose.heading_rad)
        return MoverState((pose.x_m, pose.y_m, z), ahead_xyzw, (x, y, 0.0), (0.0, 0.0, turn))


class Touch(NamedTuple):
    """A point in which the robot presses against something."""

    robot_link: str
    body: str
    position_m: Vector
    force_n: float


class Motion(NamedTuple):
    """Where a frame of the robot is, and how it moves, along the map's axes."""

    map_from_frame: SE3
    velocity_m_s: Vector
    angular_velocity_rad_s: Vector


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
        self.frames = (MAP_FRAME, ODOM_FRAME, *model.links)
        """The robot's: nothing else that moves may have such a name."""
        self.fixed_names = {FLOOR, *(wall.name for wall in world.walls)}
        self.fixed_names |= {thing.name for thing in world.bodies}
        """Of what the world itself holds."""
        check(world, meshes, self.frames)
        self._torques = [wheel_torque_n_m, wheel_torque_n_m]
        self.solid_groups: tuple[tuple[Solid, ...], ...] = ()
        """Solids that stand or move together, with `body_from_solid` seen from the group's frame.

        What stands in the world comes first, in the map's frame, then what moves, then what people
        have put there to stand. Another tuple takes its place when
        a group comes, goes or changes; a group that stays is the same object in it.
        """
        self._world, self._model = world, model
        self._things: dict[str, _Placed] = {}
        self._entities: dict[str, _Placed] = {}
        self._movers: list[_Placed] = []
        self._scripted: list[_Placed] = []
        self._garbage_bytes = 0
        self._wheel_speeds = (0.0, 0.0)
        self._alone_at_m: Vector | None = None
        """Where nothing but the floor was near to the robot, for as long as that tells anything."""
        self._client: int = pybullet.connect(pybullet.DIRECT)
        try:
            for thing in world.bodies:
                self._things[thing.name] = self._made(thing, meshes)
            self._fill()
        except (pybullet.error, ValueError) as error:
            self.close()
            raise ValueError(" ".join(str(error).split())) from error
        self.set_wheel_speeds(0.0, 0.0)
        self.state = self._read()
        self._arrange()

    def _fill(self) -> None:
        """Put the world and the robot, at its start, into the empty client."""
        client, world = self._client, self._world
        pybullet.setGravity(0.0, 0.0, -GRAVITY_M_S2, physicsClientId=client)
        pybullet.setTimeStep(1.0 / STEPS_PER_SECOND, physicsClientId=client)
        pybullet.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1,
            # It would keep every hull's file.
            enableFileCaching=0,
            physicsClientId=client,
        )
        self._solver: int | None = None
        self._names: dict[int, str] = {}
        still: list[Solid] = []
        floor = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        self._floor = self._add_rigid(FLOOR, 0.0, floor, _NOWHERE, _UPRIGHT, _STATIC_GROUP)
        pybullet.changeDynamics(
            self._floor, -1, contactProcessingThreshold=_FLOOR_CONTACT_M, physicsClientId=client
        )
        for wall in world.walls:
            half = wall.length_m / 2.0, wall.thickness_m / 2.0, wall.height_m / 2.0
            middle = wall.map_from_wall().matrix(wall.height_m / 2.0)
            self._add_solid(wall.name, Solid("box", middle, half_extents_m=half), np.eye(4))
            still.append(Solid("box", middle, half_extents_m=half))
        for placed in self._things.values():
            self._insert(placed)
            if not placed.thing.moves:
                map_from_body = pose_matrix(placed.thing)
                still += [
                    replace(one, body_from_solid=map_from_body @ one.body_from_solid)
                    for one in placed.solids
                ]
        self._world_solids = tuple(still)
        self._add_robot(world, self._model)

    def close(self) -> None:
        """Remove everything. Calling it again does nothing."""
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1

    def set_wheel_speeds(self, left_rad_s: float, right_rad_s: float) -> None:
        """What the wheels' motors hold from now on."""
        self._wheel_speeds = left_rad_s, right_rad_s
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
        for placed in self._scripted:
            self._set_on_its_way(placed)
        pybullet.stepSimulation(physicsClientId=self._client)
        self.state = self._read()
        for placed in self._movers:
            placed.state = self._read_mover(placed)
        return self.state

    @property
    def mover_names(self) -> list[str]:
        """What moves: bodies of the world in its order, then entities in theirs."""
        return [placed.thing.name for placed in self._movers]

    @property
    def mover_states(self) -> list[MoverState]:
        """Of what moves, in the order of the names."""
        return [placed.state for placed in self._movers if placed.state is not None]

    def map_from_movers(self) -> Array:
        """(k, 4, 4) true poses of what moves."""
        poses = [
            pose_matrix(placed.state) @ placed.com_from_body
            for placed in self._movers
            if placed.state is not None
        ]
        return np.array(poses).reshape(-1, 4, 4)

    @property
    def entities(self) -> dict[str, BodyEntity]:
        """What people have put into the world, by name, each as it was asked for."""
        entities = (placed.thing for placed in self._entities.values())
        return {one.name: one for one in entities if isinstance(one, BodyEntity)}

    def put(self, entity: BodyEntity, meshes: Mapping[str, TriangleMesh]) -> str:
        """Have an entity stand where it says, at rest; empty, or the reason why it cannot.

        One of the same name is moved, or replaced where it is another thing; where that cannot be,
        it stays as it was. What is looked at here is what is in the way; `world_limits` must have
        let the entity through.
        """
        old = self._entities.get(entity.name)
        try:
            new = self._made(entity, meshes)
        except ValueError as error:
            return f"shapes: {error}"
        if entity.moves and len(new.solids) > MAX_PIECES:
            pieces = f"{len(new.solids)} convex pieces"
            return f"shapes: make {pieces}: at most {MAX_PIECES} in a body that moves"
        if old is not None and _differ_in_pose_only(old, new):
            new = replace(new, solids=old.solids, numbers=old.numbers)
            self._place(new)
        else:
            try:
                self._insert(new)
            except (pybullet.error, ValueError) as error:
                self._remove(new)
                return " ".join(str(error).split())
        reason = self._in_the_way(new, old)
        if not reason:
            if old is not None and old.numbers != new.numbers:
                self._remove(old)
            self._entities[entity.name] = new
        elif old is not None and old.numbers == new.numbers:
            self._place(old)
        else:
            self._remove(new)
        return reason

    def remove(self, name: str) -> None:
        """Have an entity be gone."""
        self._remove(self._entities.pop(name))

    def arrange(self, names: Iterable[str]) -> None:
        """Take the entities in this order from now on. Called after any of them has changed."""
        self._entities = {name: self._entities[name] for name in names if name in self._entities}
        self._arrange()
        if self._garbage_bytes > _MAX_GARBAGE_BYTES:
            self._renew()

    def touches(self) -> list[Touch]:
        """Where the robot presses against anything that is not the floor, after the last step."""
        client, (x, y, z) = self._client, self.state.position_m
        if self._alone_at_m is not None and math.dist(self._alone_at_m, (x, y, z)) < _NEAR_M:
            return []
        reach_m = self._reach_m
        near = pybullet.getOverlappingObjects(
            (x - reach_m, y - reach_m, z - reach_m),
            (x + reach_m, y + reach_m, z + reach_m),
            physicsClientId=client,
        )
        # Found in a quarter of the time that the contacts take: the floor is always among those.
        if {number for number, _ in near or ()} <= self._floor_and_robot:
            self._alone_at_m = None if self._movers else (x, y, z)
            return []
        self._alone_at_m = None
        points = pybullet.getContactPoints(self._robot, physicsClientId=client)
        # Bullet also lists points up to 2 cm apart: only where there is a force do the two touch.
        return [
            Touch(self._link_names[point[3]], self._names[point[2]], point[6], point[9])
            for point in points
            if point[2] != self._floor and point[9] > 0.0
        ]

    def map_from_groups(self) -> Array:
        """(g, 4, 4) true poses of `solid_groups`."""
        return np.concatenate((np.eye(4)[None], self.map_from_movers(), self._map_from_standing))

    def map_from_footprint(self) -> Array:
        """True (4, 4) pose of base_footprint."""
        return pose_matrix(self.state) @ self._com_from_footprint

    def footprint_motion(self) -> Motion:
        """True motion of base_footprint."""
        return self.motion_at(self._footprint_on_com)

    def motion_at(self, com_from_frame: SE3) -> Motion:
        """The true motion of a frame fixed to the base."""
        state = self.state
        map_from_com = SE3(state.position_m, state.orientation_xyzw)
        ax, ay, az = map_from_com.rotate(*com_from_frame.position_m)
        vx, vy, vz = state.velocity_m_s
        wx, wy, wz = state.angular_velocity_rad_s
        # Velocity of the centre of mass plus spin x arm.
        velocity = (vx + wy * az - wz * ay, vy + wz * ax - wx * az, vz + wx * ay - wy * ax)
        return Motion(map_from_com @ com_from_frame, velocity, state.angular_velocity_rad_s)

    def com_from(self, footprint_from_frame: Array) -> SE3:
        """Pose of a frame of the robot, (4, 4) seen from base_footprint, seen from the base's
        centre of mass.
        """
        return SE3.from_matrix(self._com_from_footprint @ footprint_from_frame)

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

    def _read_mover(self, placed: _Placed) -> MoverState:
        if placed.route is not None or not placed.numbers:
            return placed.path_state()
        number, client = placed.numbers[0], self._client
        return MoverState(
            *pybullet.getBasePositionAndOrientation(number, physicsClientId=client),
            *pybullet.getBaseVelocity(number, physicsClientId=client),
        )

    def _set_on_its_way(self, placed: _Placed) -> None:
        """Put what follows a path where it is, with the speed that takes it on in this step."""
        path = placed.thing.path if isinstance(placed.thing, BodyEntity) else None
        assert path is not None
        placed.speed_m_s = 0.0 if path.yields and self._robot_ahead(placed) else path.speed_m_s
        if placed.numbers:
            state = placed.path_state()
            x, y, _ = state.velocity_m_s
            self._set_state(
                placed.numbers[0],
                # Gravity takes away what is added to its speed upwards.
                state._replace(velocity_m_s=(x, y, GRAVITY_M_S2 / STEPS_PER_SECOND)),
            )
        placed.travelled_m += placed.speed_m_s / STEPS_PER_SECOND

    def _robot_ahead(self, placed: _Placed) -> bool:
        """Whether the robot stands where a body on its path will be soon."""
        route, own, robot = placed.route, placed.floorplan, self._robot_floorplan
        if route is None or placed.thing.position_m[2] + own.low_z_m > robot.high_z_m:
            return False
        here, (x, y, _) = route.at(placed.travelled_m), self.state.position_m
        if math.hypot(here.x_m - x, here.y_m - y) > own.reach_m + robot.reach_m + 2.0 * _YIELD_M:
            return False
        pose = self.map_from_footprint()
        heading = math.atan2(pose[1, 0], pose[0, 0])
        stands = PathPose(float(pose[0, 3]), float(pose[1, 3]), heading)
        steps = round(_YIELD_M / _YIELD_STEP_M)
        return any(
            meets(route.at(placed.travelled_m + step * _YIELD_STEP_M), own, stands, robot)
            for step in range(1, steps + 1)
        )

    def _made(self, thing: Thing, meshes: Mapping[str, TriangleMesh]) -> _Placed:
        """A thing before it is in PyBullet. Raises ValueError, in a phrase, where it cannot be."""
        try:
            solids = tuple(solids_of(thing, meshes))
            com_from_body, moments, route = np.eye(4), (1.0, 1.0, 1.0), None
            if isinstance(thing, BodyEntity) and thing.path is not None:
                route = Route(thing.position_m[:2], thing.path)
                moments = (_SCRIPTED_MASS_KG,) * 3
            elif thing.moves:
                inertia = inertia_of(thing, meshes)
                com_from_body = inverse_matrix(inertia.body_from_com)
                moments = inertia.diagonal_kg_m2
        except ValueError as error:
            if isinstance(thing, BodyEntity):
                raise
            raise ValueError(f"body {thing.name!r:.60}: shapes: {error}") from error
        level_xyzw = _level(thing.orientation_xyzw)
        ahead = transform_matrix(rotation_from_quaternion(*level_xyzw), _NOWHERE)
        plan = Floorplan.of(*extent_of(solids, ahead))
        return _Placed(thing, solids, com_from_body, moments, level_xyzw, route, plan)

    def _insert(self, placed: _Placed) -> None:
        """Make PyBullet's bodies of a thing: one where it moves, else one of each piece."""
        thing, solids = placed.thing, placed.solids
        if not thing.moves:
            placed.numbers = ()
            for solid in solids:
                number = self._add_solid(thing.name, solid, pose_matrix(thing))
                placed.numbers = *placed.numbers, number
            return
        if solids:
            scripted = placed.route is not None
            mass_kg = _SCRIPTED_MASS_KG if scripted else thing.mass_kg
            group = _SCRIPTED_GROUP if scripted else _MOVER_GROUP
            with self._compound(solids, placed.com_from_body) as shape:
                number = self._add_rigid(thing.name, mass_kg, shape, _NOWHERE, _UPRIGHT, group)
            pybullet.changeDynamics(
                number,
                -1,
                # Without the mass, PyBullet takes one that it has never set.
                mass=mass_kg,
                localInertiaDiagonal=placed.inertia_kg_m2,
                physicsClientId=self._client,
            )
            if scripted:
                pybullet.changeDynamics(
                    number,
                    -1,
                    linearDamping=0.0,
                    angularDamping=0.0,
                    activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
                    physicsClientId=self._client,
                )
            placed.numbers = (number,)
        self._place(placed)

    def _place(self, placed: _Placed) -> None:
        """Put a thing that is in PyBullet where its state has it, or at first its document."""
        thing = placed.thing
        if not thing.moves:
            for number, solid in zip(placed.numbers, placed.solids, strict=True):
                pose = position_and_quaternion(pose_matrix(thing) @ solid.body_from_solid)
                pybullet.resetBasePositionAndOrientation(
                    number, *pose, physicsClientId=self._client
                )
            return
        if placed.route is not None:
            placed.state = placed.path_state()
        elif placed.state is None:
            pose = position_and_quaternion(
                pose_matrix(thing) @ inverse_matrix(placed.com_from_body)
            )
            placed.state = MoverState(*pose, _NOWHERE, _NOWHERE)
        if placed.numbers:
            self._set_state(placed.numbers[0], placed.state)

    def _set_state(self, number: int, state: MoverState) -> None:
        position_m, turn_xyzw, velocity_m_s, spin_rad_s = state
        client = self._client
        pybullet.resetBasePositionAndOrientation(
            number, position_m, turn_xyzw, physicsClientId=client
        )
        pybullet.resetBaseVelocity(number, velocity_m_s, spin_rad_s, physicsClientId=client)

    def _remove(self, placed: _Placed) -> None:
        for number in placed.numbers:
            pybullet.removeBody(number, physicsClientId=self._client)
            del self._names[number]
        self._garbage_bytes += placed.garbage_bytes

    def _arrange(self) -> None:
        """Bring what depends on what there is up to date."""
        everything = [*self._things.values(), *self._entities.values()]
        self._movers = [placed for placed in everything if placed.thing.moves]
        self._scripted = [placed for placed in self._movers if placed.route is not None]
        self._standing = [one for one in self._entities.values() if not one.thing.moves]
        self._map_from_standing = np.array(
            [pose_matrix(one.thing) for one in self._standing]
        ).reshape(-1, 4, 4)
        groups = (placed.solids for placed in (*self._movers, *self._standing))
        self.solid_groups = (self._world_solids, *groups)
        self._alone_at_m = None
        self._choose_solver()

    def _choose_solver(self) -> None:
        """Solve exactly where nothing but the robot has moved since the client was filled.

        Not exactly again when the last thing that moves is gone: PyBullet keeps 13 KB of each
        solver that it had.
        """
        solver = _ITERATIVE if self._movers else self._solver or _EXACT
        if solver != (self._solver or _ITERATIVE):
            # It tells so on standard output.
            with quiet(1):
                pybullet.setPhysicsEngineParameter(
                    constraintSolverType=solver,
                    globalCFM=_EXACT_CFM if solver == _EXACT else 0.0,
                    physicsClientId=self._client,
                )
        self._solver = solver

    def _renew(self) -> None:
        """Make everything anew as it is, so that PyBullet lets go of what was removed."""
        pybullet.resetSimulation(physicsClientId=self._client)
        self._garbage_bytes = 0
        state = self.state
        self._fill()
        for placed in self._entities.values():
            self._insert(placed)
        self._set_state(self._robot, MoverState(*state[:4]))
        for wheel, angle, speed in zip(
            self._wheels, state.wheel_angles_rad, state.wheel_speeds_rad_s, strict=True
        ):
            pybullet.resetJointState(self._robot, wheel, angle, speed, physicsClientId=self._client)
        self.set_wheel_speeds(*self._wheel_speeds)
        self._choose_solver()

    def _in_the_way(self, placed: _Placed, old: _Placed | None) -> str:
        """What an entity reaches into, where it stands and on its path; empty: nothing."""
        ignored = {*placed.numbers, *(old.numbers if old is not None else ())}
        reason = self._reaches_into(placed, ignored, standing_only=False)
        if reason or placed.route is None or not placed.numbers:
            return f"position_m: {reason}" if reason else ""
        steps = math.ceil(placed.route.length_m / _WAY_STEP_M)
        for step in range(1, steps):
            placed.travelled_m = step * placed.route.length_m / steps
            self._place(placed)
            reason = self._reaches_into(placed, ignored, standing_only=True)
            if reason:
                x, y, _ = placed.route.at(placed.travelled_m)
                return f"path: waypoints_m: at ({x:.2f}, {y:.2f}) it {reason}"
        placed.travelled_m = 0.0
        self._place(placed)
        return ""

    def _reaches_into(self, placed: _Placed, ignored: set[int], standing_only: bool) -> str:
        client = self._client
        sinks = placed.thing.mass_kg > 0.0
        moving = {number for one in self._movers for number in one.numbers} | {self._robot}
        for number in placed.numbers:
            ends = pybullet.getAABB(number, physicsClientId=client)
            near = pybullet.getOverlappingObjects(*ends, physicsClientId=client) or ()
            for other in sorted({body for body, _ in near} - ignored):
                if other == self._floor and not sinks:
                    continue
                if standing_only and other in moving:
                    continue
                points = pybullet.getClosestPoints(number, other, 0.0, physicsClientId=client)
                depth_m = -min((point[8] for point in points), default=0.0)
                if depth_m > PENETRATION_M:
                    return f"reaches {depth_m:.3f} m into {self._called(other)}"
        return ""

    def _called(self, number: int) -> str:
        if number in (self._robot, self._floor):
            return "the robot" if number == self._robot else "the floor"
        return self._names[number]

    def _add_solid(self, name: str, solid: Solid, map_from_body: Array) -> int:
        """A piece of what stands."""
        pose = map_from_body @ solid.body_from_solid
        shape = self._shape_of(solid, (_NOWHERE, _UPRIGHT))
        return self._add_rigid(name, 0.0, shape, *position_and_quaternion(pose), _STATIC_GROUP)

    def _add_rigid(
        self,
        name: str,
        mass_kg: float,
        shape: int,
        position_m: Vector,
        turn_xyzw: Quaternion,
        group: int,
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
        pybullet.setCollisionFilterGroupMask(body, -1, group, _MEETS[group], physicsClientId=client)
        self._names[body] = name
        return body

    def _shape_of(self, solid: Solid, frame: tuple[Vector, Quaternion]) -> int:
        options: dict[str, Any] = {}
        if solid.vertices_m is not None:
            options["vertices"] = lent("vertices", solid.vertices_m)
        if solid.triangles is not None:
            options["indices"] = lent("indices", solid.triangles.ravel())
            options["flags"] = pybullet.GEOM_FORCE_CONCAVE_TRIMESH
        index: int = pybullet.createCollisionShape(
            _KINDS[solid.kind],
            halfExtents=list(solid.half_extents_m),
            radius=solid.radius_m,
            height=solid.length_m,
            collisionFramePosition=frame[0],
            collisionFrameOrientation=frame[1],
            physicsClientId=self._client,
            **options,
        )
        return index

    @contextlib.contextmanager
    def _compound(self, solids: Sequence[Solid], com_from_body: Array) -> Iterator[int]:
        """One PyBullet shape of several convex pieces, seen from the centre of mass; to be used
        before the context ends.
        """
        poses = [position_and_quaternion(com_from_body @ solid.body_from_solid) for solid in solids]
        if len(solids) == 1:
            yield self._shape_of(solids[0], poses[0])
            return
        files = [""] * len(solids)
        with contextlib.ExitStack() as stack:
            if any(solid.vertices_m is not None for solid in solids):
                # Of several pieces PyBullet takes corners from files only, and reads them twice.
                folder = tempfile.TemporaryDirectory(prefix="mazebot-hulls-")
                path = Path(stack.enter_context(folder))
                for number, solid in enumerate(solids):
                    if solid.vertices_m is not None:
                        files[number] = str(path / f"{number}.obj")
                        obj = as_obj(solid.vertices_m)
                        Path(files[number]).write_text(obj, encoding="ascii")
            yield pybullet.createCollisionShapeArray(
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

    def _add_robot(self, world: World, model: RobotModel) -> None:
        """The robot at the world's start; its base's frame in PyBullet is its centre of mass."""
        client = self._client
        base = model.body(BASE_LINK_FRAME)
        parts = model.separate_links(BASE_LINK_FRAME)
        footprint_from_base = model.transform(BASE_FOOTPRINT_FRAME, BASE_LINK_FRAME)
        base_from_com = transform_matrix(np.eye(3), base.centre_of_mass_m)
        self._com_from_footprint = inverse_matrix(footprint_from_base @ base_from_com)
        self._footprint_on_com = SE3.from_matrix(self._com_from_footprint)
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
                _MEETS[_ROBOT_GROUP],
                physicsClientId=client,
            )
        members = [(base, footprint_from_base)] + [
            (body, footprint_from_base @ joint.parent_from_child)
            for joint, body in zip(parts, bodies, strict=True)
        ]
        solids = [
            _solid(shape, footprint_from_body @ shape.link_from_shape)
            for body, footprint_from_body in members
            for shape in body.shapes
        ]
        self._robot_floorplan = Floorplan.of(*extent_of(solids, np.eye(4)))
        farthest_m = np.abs(extent_of(solids, self._com_from_footprint)).max(0)
        self._floor_and_robot = {self._floor, self._robot}
        self._reach_m = float(np.linalg.norm(farthest_m)) + _NEAR_M
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


def _solid(shape: Shape, a_from_shape: Array) -> Solid:
    x, y, z = shape.sides_m
    half = x / 2.0, y / 2.0, z / 2.0
    return Solid(shape.kind, a_from_shape, half, shape.radius_m, shape.length_m)


def _differ_in_pose_only(old: _Placed, new: _Placed) -> bool:
    """Whether a thing is another only by being moved."""
    pose = ("position_m", "orientation_xyzw", "placed")
    moved = old.thing.model_copy(update={field: getattr(new.thing, field) for field in pose})
    # A level plane on the floor is the floor, and no solid of its own.
    planes = any(isinstance(shape.geometry, Plane) for shape in new.thing.shapes)
    return moved == new.thing and not planes


def _level(turn_xyzw: Quaternion) -> Quaternion:
    """The same tilt with no heading."""
    return _turned(turn_xyzw, -yaw_from_quaternion(*turn_xyzw))


def _turned(turn_xyzw: Quaternion, yaw_rad: float) -> Quaternion:
    """An orientation turned about the map's z axis."""
    x, y, z, w = turn_xyzw
    s, c = math.sin(yaw_rad / 2.0), math.cos(yaw_rad / 2.0)
    return c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z


def _moved(shape: Shape, a_from_link: Array) -> Shape:
    return Shape(
        shape.kind,
        shape.sides_m,
        shape.radius_m,
        shape.length_m,
        a_from_link @ shape.link_from_shape,
    )
