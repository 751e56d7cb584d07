"""The world's bodies in PyBullet: floor, walls, bodies, entities and robot, stepped at 240 Hz.

Contact figures. Bullet multiplies the two surfaces' friction: floor and walls have 1.0, so that the
model's own coefficients apply: 1.0 for a tyre, 0 for a caster, which glides, 0.3 for the hull,
which scrapes along a wall. Bullet's damping of bodies, 4 % a second, is off for the robot. Rolling
straight or in a curve, it covers the distance of its wheels within 0.3 %. It turns 0.35 % less than
its wheels, since they are 288 mm apart, while drive and odometry assume 287 mm as in the reference
robot.

Where only the robot moves, its contacts are solved exactly, by Dantzig's pivoting: the wheels reach
the commanded speed to 1e-9 m/s, a standing robot keeps its position to the last bits, and a step
takes half as long as with PyBullet's 50 iterations of Gauss-Seidel, with which the robot creeps by
0.01 mm a second. The effort of the exact solver grows with the cube of the number of contact
points, and it does not handle contacts between moving rigid bodies: where there are any,
Gauss-Seidel is used.

A moving body is a plain rigid body, which Bullet steps four times as fast as a multibody; Bullet's
own damping is left on for it, since nothing else brings a rolling ball to rest.

A body that follows a path is a rigid body too, so heavy that nothing stops it, and its pose and
velocity are set before each step: of a body without mass Bullet's contacts ignore the velocity, and
let it sink into what it pushes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import (
    MAP_FRAME,
    ODOM_FRAME,
    SE2,
    SE3,
    Array,
    inverse_matrix,
    pose_matrix,
    position_and_quaternion,
    rotation_from_quaternion,
    transform_matrix,
)
from mazebot.common.messages.documents import (
    BodyCheckpoint,
    BodyEntity,
    Quaternion,
    Thing,
    Vector,
    World,
)
from mazebot.common.world.convex.convex_parts import MAX_PIECES
from mazebot.common.world.geometry import TriangleMesh
from mazebot.physics.bodies.body_state import BodyState, MoverState
from mazebot.physics.bodies.bullet import pybullet, quiet
from mazebot.physics.bodies.collision import (
    Solid,
    extent_of,
    inertia_of,
    seen_solids_of,
    solids_of,
)
from mazebot.physics.bodies.placed import Placed, differ_in_pose_only, level
from mazebot.physics.bodies.rigid_bodies import (
    MOVER_GROUP,
    NOWHERE,
    SCRIPTED_GROUP,
    STATIC_GROUP,
    UPRIGHT,
    compound_shape,
    rigid_body,
    shape_of,
)
from mazebot.physics.bodies.robot_body import RobotBody
from mazebot.physics.bodies.robot_model import RobotModel
from mazebot.physics.bodies.scripted_path import Floorplan, PathPose, Route, meets
from mazebot.physics.bodies.world_limits import PENETRATION_M, check
from mazebot.physics.config import STEPS_PER_SECOND

GRAVITY_M_S2 = 9.8
FLOOR = "floor"
ROBOT = "robot"
_NEAR_M = 0.1
"""Margin around the robot, larger than it and an approaching body move in one step. If nothing was
within it and nothing else moves, the robot has no contacts until it has moved this far.
"""
_FLOOR_CONTACT_M = 1e-4
"""How near to the floor a contact point must be for the solver to use it: of the four points that
Bullet keeps of each rolling wheel, three have left the floor, and would cost a third of a step.
"""
_ITERATIVE = pybullet.CONSTRAINT_SOLVER_LCP_SI
"""PyBullet's default"""
_EXACT = pybullet.CONSTRAINT_SOLVER_LCP_DANTZIG
_EXACT_CFM = 1e-9
"""Softness of its constraints: two wheels and two casters have more contact points than are needed
to support a robot, and without any softness every second step has no unique solution.
"""
_SCRIPTED_MASS_KG = 1e5
_YIELD_M = 0.3
"""How far ahead on its path a body checks for the robot; in these steps."""
_YIELD_STEP_M = 0.05
_WAY_STEP_M = 0.1
"""Distance between the poses on a path that are checked for walls; walls are thicker."""
_ASIDE_M = 1000.0
_MAX_GARBAGE_BYTES = 8_000_000
"""PyBullet never frees the shape of a removed body: beyond this amount, all bodies are rebuilt in
their current state.
"""


class Touch(NamedTuple):
    """A contact point with a force between the robot and a body."""

    robot_link: str
    body: str
    position_m: Vector
    force_n: float


class Motion(NamedTuple):
    """Pose and velocity of a frame of the robot, along the map's axes."""

    map_from_frame: SE3
    velocity_m_s: Vector
    angular_velocity_rad_s: Vector


class Bodies:
    """One world in its own PyBullet client, with nothing left from an earlier world."""

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
        """The robot's frames: no other moving body may have such a name."""
        self.fixed_names = {FLOOR, *(wall.name for wall in world.walls)}
        self.fixed_names |= {thing.name for thing in world.bodies}
        """Names of the world's floor, walls and bodies."""
        check(world, meshes, self.frames)
        self._wheel_torque_n_m = wheel_torque_n_m
        self.solid_groups: tuple[tuple[Solid, ...], ...] = ()
        """Groups of the solids that the lidar sees and that share a frame, with `body_from_solid`
        seen from that frame.

        The static solids of the world come first, in the map's frame, then the moving bodies, then
        the static entities. The tuple is replaced when a group is added, removed or changed; an
        unchanged group is the same object in it.
        """
        self._world, self._model = world, model
        self._things: dict[str, Placed] = {}
        self._entities: dict[str, Placed] = {}
        self._movers: list[Placed] = []
        self._scripted: list[Placed] = []
        self._garbage_bytes = 0
        self._wheel_speeds = (0.0, 0.0)
        self._alone_at_m: Vector | None = None
        """Position where only the floor was near to the robot; None while that is not valid."""
        self._client: int = pybullet.connect(pybullet.DIRECT)
        try:
            for thing in world.bodies:
                self._things[thing.name] = self._made(thing, meshes)
            self._fill()
        except (pybullet.error, ValueError) as error:
            self.close()
            raise ValueError(" ".join(str(error).split())) from error
        self.set_wheel_speeds(0.0, 0.0)
        self.state = self._robot.state()
        self._arrange()

    def _fill(self) -> None:
        """Put the world and the robot, at its start, into the empty client."""
        client, world = self._client, self._world
        pybullet.setGravity(0.0, 0.0, -GRAVITY_M_S2, physicsClientId=client)
        pybullet.setTimeStep(1.0 / STEPS_PER_SECOND, physicsClientId=client)
        pybullet.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1,
            # The cache would keep every hull's file.
            enableFileCaching=0,
            physicsClientId=client,
        )
        self._solver: int | None = None
        self._names: dict[int, str] = {}
        still: list[Solid] = []
        floor = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        self._floor = self._add_rigid(FLOOR, 0.0, floor, NOWHERE, UPRIGHT, STATIC_GROUP)
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
                    replace(
                        one, body_from_solid=portable.product(map_from_body, one.body_from_solid)
                    )
                    for one in placed.seen
                ]
        self._world_solids = tuple(still)
        self._robot = RobotBody(client, self._model, world.start.se2().matrix())
        self._floor_and_robot = {self._floor, self._robot.number}
        self._reach_m = self._robot.reach_m + _NEAR_M

    def close(self) -> None:
        """Remove everything. Calling it again does nothing."""
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1

    def set_wheel_speeds(self, left_rad_s: float, right_rad_s: float) -> None:
        """Set the target speeds of the wheels' motors."""
        self._wheel_speeds = left_rad_s, right_rad_s
        self._robot.drive_wheels(left_rad_s, right_rad_s, self._wheel_torque_n_m)

    def step(self) -> BodyState:
        """Advance by one step."""
        for placed in self._scripted:
            self._set_on_its_way(placed)
        pybullet.stepSimulation(physicsClientId=self._client)
        self.state = self._robot.state()
        for placed in self._movers:
            placed.state = self._read_mover(placed)
        return self.state

    def move_robot(self, map_from_footprint: SE2) -> str:
        """Put the robot down at rest at another pose, as level and as high above the map's floor as
        it is now; returns empty, or the reason why it stays where it is.
        """
        before, stands = self.state, self.footprint_pose()
        moved = portable.product(
            (map_from_footprint @ stands.inverse()).matrix(), pose_matrix(before)
        )
        self._put_robot(MoverState(*position_and_quaternion(moved), NOWHERE, NOWHERE), (0.0, 0.0))
        reason = self._robot_reaches_into()
        if reason:
            self._put_robot(MoverState(*before[:4]), before.wheel_speeds_rad_s)
        self._alone_at_m = None
        return reason

    def _put_robot(self, state: MoverState, wheel_speeds_rad_s: tuple[float, float]) -> None:
        self._set_state(self._robot.number, state)
        self._robot.turn_wheels_to(self.state.wheel_angles_rad, wheel_speeds_rad_s)
        self.set_wheel_speeds(*self._wheel_speeds)
        self.state = self._robot.state()

    def set_robot_aside(self) -> None:
        """Take the robot out of the way of what is spawned, until `restore`."""
        x, y, z = self.state.position_m
        aside = MoverState((x, y, z + _ASIDE_M), self.state.orientation_xyzw, NOWHERE, NOWHERE)
        self._set_state(self._robot.number, aside)

    def checkpoints(self) -> tuple[BodyCheckpoint, list[BodyCheckpoint]]:
        """The robot and the moving bodies as they are, to be restored by `restore`."""
        robot = BodyCheckpoint(**_fields(ROBOT, MoverState(*self.state[:4])))
        return robot, [
            BodyCheckpoint(**_fields(one.thing.name, one.state), travelled_m=one.travelled_m)
            for one in self._movers
            if one.state is not None
        ]

    def restore(
        self,
        robot: BodyCheckpoint,
        wheel_angles_rad: tuple[float, float],
        movers: Iterable[BodyCheckpoint],
    ) -> None:
        """Put robot and moving bodies where they were: the robot at rest, its wheels turned to
        these angles. Bodies that there are no more are left out.
        """
        placed = {one.thing.name: one for one in self._movers}
        for kept in movers:
            mover = placed.get(kept.name)
            if mover is None:
                continue
            mover.travelled_m = kept.travelled_m
            mover.state = _state_of(kept)
            self._place(mover)
        self._set_state(
            self._robot.number,
            _state_of(robot)._replace(velocity_m_s=NOWHERE, angular_velocity_rad_s=NOWHERE),
        )
        self._robot.turn_wheels_to(wheel_angles_rad, (0.0, 0.0))
        self.set_wheel_speeds(0.0, 0.0)
        self.state = self._robot.state()
        self._alone_at_m = None

    def _robot_reaches_into(self) -> str:
        """What the robot overlaps at its pose, other than the floor; empty: nothing."""
        client, (x, y, z), reach_m = self._client, self.state.position_m, self._reach_m
        near = pybullet.getOverlappingObjects(
            (x - reach_m, y - reach_m, z - reach_m),
            (x + reach_m, y + reach_m, z + reach_m),
            physicsClientId=client,
        )
        for other in sorted({body for body, _ in near or ()} - self._floor_and_robot):
            points = pybullet.getClosestPoints(
                self._robot.number, other, 0.0, physicsClientId=client
            )
            depth_m = -min((point[8] for point in points), default=0.0)
            if depth_m > PENETRATION_M:
                return f"penetrates {self._called(other)} by {depth_m:.3f} m"
        return ""

    @property
    def follows_paths(self) -> bool:
        """Whether any body follows a scripted path."""
        return bool(self._scripted)

    @property
    def mover_names(self) -> list[str]:
        """Names of the moving bodies: those of the world in its order, then entities in theirs."""
        return [placed.thing.name for placed in self._movers]

    @property
    def mover_states(self) -> list[MoverState]:
        """States of the moving bodies, in the order of the names."""
        return [placed.state for placed in self._movers if placed.state is not None]

    def map_from_movers(self) -> Array:
        """(k, 4, 4) true poses of the moving bodies."""
        poses = [
            portable.product(pose_matrix(placed.state), placed.com_from_body)
            for placed in self._movers
            if placed.state is not None
        ]
        return np.array(poses).reshape(-1, 4, 4)

    @property
    def entities(self) -> dict[str, BodyEntity]:
        """The entities spawned into the world, by name, each as requested."""
        entities = (placed.thing for placed in self._entities.values())
        return {one.name: one for one in entities if isinstance(one, BodyEntity)}

    def put(self, entity: BodyEntity, meshes: Mapping[str, TriangleMesh]) -> str:
        """Spawn an entity at its pose, at rest; returns empty, or the reason why it cannot be.

        One of the same name is moved, or replaced if more than its pose differs; if that fails, it
        stays as it was. Only collisions are checked here; `world_limits` must have accepted the
        entity before.
        """
        old = self._entities.get(entity.name)
        try:
            new = self._made(entity, meshes)
        except ValueError as error:
            return f"shapes: {error}"
        if entity.moves and len(new.solids) > MAX_PIECES:
            pieces = f"{len(new.solids)} convex pieces"
            return f"shapes: make {pieces}: at most {MAX_PIECES} in a body that moves"
        if old is not None and differ_in_pose_only(old, new):
            new = replace(new, solids=old.solids, seen=old.seen, numbers=old.numbers)
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
        """Remove an entity."""
        self._remove(self._entities.pop(name))

    def arrange(self, names: Iterable[str]) -> None:
        """Set the order of the entities. Called after any of them has changed."""
        self._entities = {name: self._entities[name] for name in names if name in self._entities}
        self._arrange()
        if self._garbage_bytes > _MAX_GARBAGE_BYTES:
            self._renew()

    def touches(self) -> list[Touch]:
        """The robot's contact points with anything that is not floor, after the last step.

        Floor is anything that a wheel or caster stands on, be it a plane, a mesh, a box or a ramp.
        """
        client, (x, y, z) = self._client, self.state.position_m
        if self._alone_at_m is not None and math.dist(self._alone_at_m, (x, y, z)) < _NEAR_M:
            return []
        reach_m = self._reach_m
        near = pybullet.getOverlappingObjects(
            (x - reach_m, y - reach_m, z - reach_m),
            (x + reach_m, y + reach_m, z + reach_m),
            physicsClientId=client,
        )
        # Takes a quarter of the time of the contacts, which always include the floor's.
        if {number for number, _ in near or ()} <= self._floor_and_robot:
            self._alone_at_m = None if self._movers else (x, y, z)
            return []
        self._alone_at_m = None
        points = pybullet.getContactPoints(self._robot.number, physicsClientId=client)
        # Bullet also lists points up to 2 cm apart: only those with a force are contacts.
        return [
            Touch(self._robot.link_names[point[3]], self._names[point[2]], point[6], point[9])
            for point in points
            if point[2] != self._floor and point[9] > 0.0 and not self._robot.stands_on(point)
        ]

    def map_from_groups(self) -> Array:
        """(g, 4, 4) true poses of `solid_groups`."""
        return np.concatenate((np.eye(4)[None], self.map_from_movers(), self._map_from_standing))

    def map_from_footprint(self) -> Array:
        """True (4, 4) pose of base_footprint."""
        return portable.product(pose_matrix(self.state), self._robot.com_from_footprint)

    def footprint_pose(self) -> SE2:
        """True pose of base_footprint on the floor."""
        here = self.map_from_footprint()
        heading = portable_kernels.atan2(float(here[1, 0]), float(here[0, 0]))
        return SE2(float(here[0, 3]), float(here[1, 3]), heading)

    def footprint_motion(self) -> Motion:
        """True motion of base_footprint."""
        return self.motion_at(self._robot.footprint_on_com)

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
        return SE3.from_matrix(
            portable.product(self._robot.com_from_footprint, footprint_from_frame)
        )

    def _read_mover(self, placed: Placed) -> MoverState:
        if placed.route is not None or not placed.numbers:
            return placed.path_state()
        number, client = placed.numbers[0], self._client
        return MoverState(
            *pybullet.getBasePositionAndOrientation(number, physicsClientId=client),
            *pybullet.getBaseVelocity(number, physicsClientId=client),
        )

    def _set_on_its_way(self, placed: Placed) -> None:
        """Set pose and velocity of a body that follows a path, for this step."""
        path = placed.thing.path if isinstance(placed.thing, BodyEntity) else None
        assert path is not None
        placed.speed_m_s = 0.0 if path.yields and self._robot_ahead(placed) else path.speed_m_s
        if placed.numbers:
            state = placed.path_state()
            x, y, _ = state.velocity_m_s
            self._set_state(
                placed.numbers[0],
                # The added upward speed cancels gravity in this step.
                state._replace(velocity_m_s=(x, y, GRAVITY_M_S2 / STEPS_PER_SECOND)),
            )
        placed.travelled_m += placed.speed_m_s / STEPS_PER_SECOND

    def _robot_ahead(self, placed: Placed) -> bool:
        """Whether the robot is where a body on its path will be soon."""
        route, own, robot = placed.route, placed.floorplan, self._robot.floorplan
        if route is None or placed.thing.position_m[2] + own.low_z_m > robot.high_z_m:
            return False
        here, (x, y, _) = route.at(placed.travelled_m), self.state.position_m
        if math.hypot(here.x_m - x, here.y_m - y) > own.reach_m + robot.reach_m + 2.0 * _YIELD_M:
            return False
        pose = self.map_from_footprint()
        heading = portable_kernels.atan2(pose[1, 0], pose[0, 0])
        stands = PathPose(float(pose[0, 3]), float(pose[1, 3]), heading)
        steps = round(_YIELD_M / _YIELD_STEP_M)
        return any(
            meets(route.at(placed.travelled_m + step * _YIELD_STEP_M), own, stands, robot)
            for step in range(1, steps + 1)
        )

    def _made(self, thing: Thing, meshes: Mapping[str, TriangleMesh]) -> Placed:
        """A body before it is in PyBullet. Raises ValueError, in a phrase, if it is not valid."""
        try:
            solids = tuple(solids_of(thing, meshes))
            seen = tuple(seen_solids_of(thing, meshes, solids))
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
        level_xyzw = level(thing.orientation_xyzw)
        ahead = transform_matrix(rotation_from_quaternion(*level_xyzw), NOWHERE)
        plan = Floorplan.of(*extent_of(solids, ahead))
        return Placed(thing, solids, seen, com_from_body, moments, level_xyzw, route, plan)

    def _insert(self, placed: Placed) -> None:
        """Create the PyBullet bodies of a body: one if it moves, else one for each solid."""
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
            group = SCRIPTED_GROUP if scripted else MOVER_GROUP
            with compound_shape(self._client, solids, placed.com_from_body) as shape:
                number = self._add_rigid(thing.name, mass_kg, shape, NOWHERE, UPRIGHT, group)
            pybullet.changeDynamics(
                number,
                -1,
                # Without the mass given here, PyBullet uses an uninitialised one.
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

    def _place(self, placed: Placed) -> None:
        """Set a body's pose in PyBullet to that of its state, or at first of its document."""
        thing = placed.thing
        if not thing.moves:
            for number, solid in zip(placed.numbers, placed.solids, strict=True):
                pose = position_and_quaternion(
                    portable.product(pose_matrix(thing), solid.body_from_solid)
                )
                pybullet.resetBasePositionAndOrientation(
                    number, *pose, physicsClientId=self._client
                )
            return
        if placed.route is not None:
            placed.state = placed.path_state()
        elif placed.state is None:
            pose = position_and_quaternion(
                portable.product(pose_matrix(thing), inverse_matrix(placed.com_from_body))
            )
            placed.state = MoverState(*pose, NOWHERE, NOWHERE)
        if placed.numbers:
            self._set_state(placed.numbers[0], placed.state)

    def _set_state(self, number: int, state: MoverState) -> None:
        position_m, turn_xyzw, velocity_m_s, spin_rad_s = state
        client = self._client
        pybullet.resetBasePositionAndOrientation(
            number, position_m, turn_xyzw, physicsClientId=client
        )
        pybullet.resetBaseVelocity(number, velocity_m_s, spin_rad_s, physicsClientId=client)

    def _remove(self, placed: Placed) -> None:
        for number in placed.numbers:
            pybullet.removeBody(number, physicsClientId=self._client)
            del self._names[number]
        self._garbage_bytes += placed.garbage_bytes

    def _arrange(self) -> None:
        """Update everything that depends on which bodies there are."""
        everything = [*self._things.values(), *self._entities.values()]
        self._movers = [placed for placed in everything if placed.thing.moves]
        self._scripted = [placed for placed in self._movers if placed.route is not None]
        self._standing = [one for one in self._entities.values() if not one.thing.moves]
        self._map_from_standing = np.array(
            [pose_matrix(one.thing) for one in self._standing]
        ).reshape(-1, 4, 4)
        groups = (placed.seen for placed in (*self._movers, *self._standing))
        self.solid_groups = (self._world_solids, *groups)
        self._alone_at_m = None
        self._choose_solver()

    def _choose_solver(self) -> None:
        """Use the exact solver if nothing but the robot has moved since the client was filled.

        It is not chosen again when the last moving body is gone: PyBullet keeps 13 KB of each
        solver that it had.
        """
        solver = _ITERATIVE if self._movers else self._solver or _EXACT
        if solver != (self._solver or _ITERATIVE):
            # PyBullet prints the change on standard output.
            with quiet(1):
                pybullet.setPhysicsEngineParameter(
                    constraintSolverType=solver,
                    globalCFM=_EXACT_CFM if solver == _EXACT else 0.0,
                    physicsClientId=self._client,
                )
        self._solver = solver

    def _renew(self) -> None:
        """Rebuild everything in its current state, so that PyBullet frees the removed shapes."""
        pybullet.resetSimulation(physicsClientId=self._client)
        self._garbage_bytes = 0
        state = self.state
        self._fill()
        for placed in self._entities.values():
            self._insert(placed)
        self._set_state(self._robot.number, MoverState(*state[:4]))
        self._robot.turn_wheels_to(state.wheel_angles_rad, state.wheel_speeds_rad_s)
        self.set_wheel_speeds(*self._wheel_speeds)
        self._choose_solver()

    def _in_the_way(self, placed: Placed, old: Placed | None) -> str:
        """What an entity collides with at its pose and on its path; empty: nothing."""
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

    def _reaches_into(self, placed: Placed, ignored: set[int], standing_only: bool) -> str:
        client = self._client
        sinks = placed.thing.mass_kg > 0.0
        moving = {number for one in self._movers for number in one.numbers} | {self._robot.number}
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
                    return f"penetrates {self._called(other)} by {depth_m:.3f} m"
        return ""

    def _called(self, number: int) -> str:
        if number in self._floor_and_robot:
            return "the floor" if number == self._floor else "the robot"
        return self._names[number]

    def _add_solid(self, name: str, solid: Solid, map_from_body: Array) -> int:
        """Add a static solid."""
        pose = portable.product(map_from_body, solid.body_from_solid)
        shape = shape_of(self._client, solid, (NOWHERE, UPRIGHT))
        return self._add_rigid(name, 0.0, shape, *position_and_quaternion(pose), STATIC_GROUP)

    def _add_rigid(
        self,
        name: str,
        mass_kg: float,
        shape: int,
        position_m: Vector,
        turn_xyzw: Quaternion,
        group: int,
    ) -> int:
        number = rigid_body(self._client, name, mass_kg, shape, position_m, turn_xyzw, group)
        self._names[number] = name
        return number


def _fields(name: str, state: MoverState) -> dict[str, Any]:
    return {"name": name, **state._asdict()}


def _state_of(kept: BodyCheckpoint) -> MoverState:
    return MoverState(
        kept.position_m, kept.orientation_xyzw, kept.velocity_m_s, kept.angular_velocity_rad_s
    )
