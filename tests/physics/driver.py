"""Runs the physics node by hand, and holds the worlds that its tests drive in."""

from __future__ import annotations

import hashlib
import math
import weakref
from collections.abc import Iterable
from dataclasses import replace
from typing import TypeVar, cast

import cv2
import numpy as np
from numpy.typing import ArrayLike

from mazebot.common.maths.frames import SE2, Array, inverse_matrix, transform_matrix
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.documents import (
    Box,
    Entities,
    MarkerEntity,
    Material,
    Planar,
    Sphere,
    Vector,
    Wall,
    World,
)
from mazebot.common.messages.topics import (
    ASSETS,
    CMD_VEL,
    DESIRED_ENTITIES,
    GROUND_TRUTH_ODOM,
    WORLD,
    Topic,
)
from mazebot.common.node.node import Envelope, Inbox, Outbox
from mazebot.common.world import geometry
from mazebot.common.world.geometry import TriangleMesh, triangles_of
from mazebot.physics.bodies.bodies import Bodies
from mazebot.physics.config import PhysicsConfig
from mazebot.physics.node import PhysicsNode
from mazebot.physics.sensors.raycast import cast_scan, joined, ray_directions, targets_of

M = TypeVar("M")

HOUSE_WALLS = (
    ("Wall_0", 2.5, -1.21419, -2.03381, 0.0),
    ("Wall_1", 0.75, -0.03919, -1.73381, math.pi / 2),
    ("Wall_10", 3.5, -1.31184, 3.14354, -3 * math.pi / 4),
    ("Wall_11", 4.153, -2.49619, -0.04231, -math.pi / 2),
    ("Wall_13", 0.75, -2.17851, 1.234169, 0.0),
    ("Wall_14", 1.76432, -1.87851, 0.427012, -math.pi / 2),
    ("Wall_15", 0.75, -2.17851, -0.36003, math.pi),
    ("Near", 1.0, 1.3, 0.4, 0.3),
)
"""The south-west of the house, and a wall of the tests' own: name, length, x, y, yaw."""


def world(
    walls: Iterable[tuple[str, float, float, float, float]] = HOUSE_WALLS,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    texture_sha256: str = "",
    name: str = "test",
) -> World:
    draft = World(
        name=name,
        recipe="test.yaml",
        hash="",
        walls=tuple(
            Wall(
                name=wall,
                length_m=length,
                thickness_m=0.15,
                height_m=1.0,
                x_m=x,
                y_m=y,
                yaw_rad=yaw,
                material="plain",
            )
            for wall, length, x, y, yaw in walls
        ),
        materials=(Material(name="plain", texture_sha256=texture_sha256),),
        start=Planar(x_m=start[0], y_m=start[1], yaw_rad=start[2]),
    )
    return draft.model_copy(update={"hash": draft.content_hash()})


def texture(shade: int = 200) -> msg.CompressedImage:
    ok, png = cv2.imencode(".png", np.full((16, 16, 3), shade, np.uint8))
    assert ok
    return asset(png.tobytes())


def asset(data: bytes) -> msg.CompressedImage:
    return msg.CompressedImage(
        header=msg.header(0, hashlib.sha256(data).hexdigest()),
        format="png",
        data=np.frombuffer(data, np.uint8),
    )


def panel(name: str, texture_sha256: str, **changes: object) -> MarkerEntity:
    """A panel on the left face of HOUSE_WALLS' first wall."""
    entity = MarkerEntity(
        name=name,
        position_m=(-1.2, -1.957, 0.3),
        orientation_xyzw=(0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0),
        panel_side_m=0.4,
        texture_sha256=texture_sha256,
        marker_id=7,
        marker_size_m=0.3,
        dictionary="DICT_4X4_100",
    )
    return entity.model_copy(update=changes)


class Driver:
    """A physics node with its boxes; remembers all it has sent."""

    def __init__(self, **config: object) -> None:
        settings = {"renderer": "none", **config}
        self.node = PhysicsNode(PhysicsConfig.model_validate(settings))
        # PyBullet and the renderer keep their memory until they are closed.
        weakref.finalize(self, self.node.close)
        self.inbox = Inbox(self.node)
        self.outbox = Outbox(self.node, self._collect)
        self.now_ns = 0
        self.sent: list[tuple[Topic[object], object]] = []
        self.revision = 0
        """Of the last set of entities that a test has asked for."""
        self._sequence = 0

    def _collect(self, topic: Topic[object], message: object, _: Envelope) -> None:
        self.sent.append((topic, message))

    def deliver(
        self, topic: Topic[M], message: M | bytes, world_hash: str = "", source: str = "test"
    ) -> None:
        self._sequence += 1
        self.inbox.deliver(topic, message, Envelope(source, self._sequence, 0, world_hash))

    def turn(self) -> None:
        """One step of the node: of time where there is a world, else only of what waits."""
        next_ns = self.node.next_step_ns()
        if next_ns is not None:
            self.now_ns = next_ns
        self.outbox.now_ns = self.now_ns
        self.node.step(self.now_ns, self.inbox, self.outbox)

    def load(self, in_world: World) -> Driver:
        self.deliver(WORLD, in_world)
        self.deliver(DESIRED_ENTITIES, Entities(world_hash=in_world.hash))
        self.turn()
        return self

    def command(self, linear_m_s: float, angular_rad_s: float = 0.0, source: str = "test") -> None:
        """A velocity command as it comes over the wire, whatever its numbers."""
        twist = msg.Twist(
            linear=msg.Vector3(x=linear_m_s, y=0.0, z=0.0),
            angular=msg.Vector3(x=0.0, y=0.0, z=angular_rad_s),
        )
        header = msg.header(self.now_ns, "base_footprint")
        command = msg.TwistStamped(header=header, twist=twist)
        self.deliver(CMD_VEL, wire.encode(CMD_VEL, command), source=source)

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds * 240)):
            self.turn()

    def drive(self, linear_m_s: float, angular_rad_s: float, seconds: float) -> None:
        """Command at 20 Hz for so long."""
        for step in range(round(seconds * 240)):
            if step % 12 == 0:
                self.command(linear_m_s, angular_rad_s)
            self.turn()

    def all(self, topic: Topic[M]) -> list[M]:
        return [cast("M", message) for of, message in self.sent if of is topic]

    def last(self, topic: Topic[M]) -> M:
        return self.all(topic)[-1]

    @property
    def pose(self) -> SE2:
        return msg.se2_from_pose(self.last(GROUND_TRUTH_ODOM).pose.pose)

    @property
    def speeds(self) -> tuple[float, float]:
        """True linear (m/s) and angular (rad/s) speed, at this very step."""
        simulation = self.node._simulation
        assert simulation is not None
        map_from_footprint, velocity, spin = simulation.bodies.footprint_motion()
        return map_from_footprint.rotate_back(*velocity)[0], spin[2]

    def send_asset(self, image: msg.CompressedImage) -> None:
        self.deliver(ASSETS, image)


def _board(size_m: Vector, middle_m: Vector) -> TriangleMesh:
    pose = transform_matrix(np.eye(3), middle_m)
    return triangles_of(Box(size_m=size_m), {}).moved(pose)


TABLE = geometry.joined(
    (
        _board((1.2, 1.2, 0.04), (0.0, 0.0, 0.7)),
        *(_board((0.06, 0.06, 0.66), (x, y, 0.33)) for x in (-0.55, 0.55) for y in (-0.55, 0.55)),
    )
)
"""A top on four legs, in one mesh: 1.2 m wide and long, 0.72 m high"""


def _urchin() -> TriangleMesh:
    ball = triangles_of(Sphere(radius_m=0.1), {})
    tips = np.random.default_rng(2).choice((0.3, 1.0), (len(ball.vertices_m), 1))
    return replace(ball, vertices_m=ball.vertices_m * tips)


URCHIN = _urchin()
"""A ball of spikes, which few convex parts cannot follow"""


def hit_distances_m(bodies: Bodies, starts: ArrayLike, ends: ArrayLike) -> Array:
    """(n,) how far from its start each ray, from (n, 3) to (n, 3), meets something; inf: nowhere.

    Each ray is the only one of a scan that looks along it.
    """
    groups = enumerate(bodies.solid_groups)
    targets = joined((targets_of(group), index) for index, group in groups)
    poses = bodies.map_from_groups()
    distances = []
    for start, end in zip(np.asarray(starts, float), np.asarray(ends, float), strict=True):
        way = end - start
        length_m = float(np.linalg.norm(way))
        # Any frame with its x axis along the ray.
        axes = np.linalg.qr(np.column_stack((way, np.eye(3)[:, np.argsort(np.abs(way))[:2]])))[0]
        axes[:, 0] = way / length_m
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
        scan_from_map = inverse_matrix(transform_matrix(axes, (start[0], start[1], start[2])))
        ray = ray_directions(1)
        distances += cast_scan(targets, scan_from_map @ poses, ray, length_m).tolist()
    return np.array(distances)
