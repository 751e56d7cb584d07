"""A body of the world in PyBullet: as requested, as created, and its current state."""

from __future__ import annotations

from dataclasses import dataclass

from mazebot.common.maths import portable_kernels
from mazebot.common.maths.frames import Array, yaw_from_quaternion
from mazebot.common.messages.documents import Plane, Quaternion, Thing, Vector
from mazebot.physics.bodies.body_state import MoverState
from mazebot.physics.bodies.collision import Solid
from mazebot.physics.bodies.scripted_path import Floorplan, Route

_BODY_BYTES, _CORNER_BYTES, _TRIANGLE_BYTES = 4_000, 200, 150


@dataclass(eq=False)
class Placed:
    """A body as it was created, and its current state."""

    thing: Thing
    solids: tuple[Solid, ...]
    """In the body's frame"""
    seen: tuple[Solid, ...]
    """The same for the lidar: its true surface, also if it collides as convex parts or slabs."""
    com_from_body: Array
    """If the body moves freely; else the identity."""
    inertia_kg_m2: Vector
    level_xyzw: Quaternion
    """Its orientation without its heading"""
    route: Route | None
    floorplan: Floorplan
    """Bounding box, heading along x"""
    numbers: tuple[int, ...] = ()
    """PyBullet's body numbers: one if it moves, else one for each solid."""
    travelled_m: float = 0.0
    speed_m_s: float = 0.0
    """On the path, in the last step"""
    state: MoverState | None = None
    """Of a moving body"""

    @property
    def garbage_bytes(self) -> int:
        """Approximate memory that PyBullet keeps of it when it is removed."""
        corners = sum(len(one.vertices_m) for one in self.solids if one.vertices_m is not None)
        triangles = sum(len(one.triangles) for one in self.solids if one.triangles is not None)
        bodies = _BODY_BYTES * max(len(self.numbers), len(self.solids))
        return bodies + _CORNER_BYTES * corners + _TRIANGLE_BYTES * triangles

    def path_state(self) -> MoverState:
        """State of a body that follows a path."""
        assert self.route is not None
        pose = self.route.at(self.travelled_m)
        x, y, turn = self.route.velocity(self.travelled_m, self.speed_m_s)
        z = self.thing.position_m[2]
        # Its own tilt, with the path's heading instead of its own.
        ahead_xyzw = turned(self.level_xyzw, pose.heading_rad)
        return MoverState((pose.x_m, pose.y_m, z), ahead_xyzw, (x, y, 0.0), (0.0, 0.0, turn))


def differ_in_pose_only(old: Placed, new: Placed) -> bool:
    """Whether only the pose of a body has changed."""
    pose = ("position_m", "orientation_xyzw", "placed")
    moved = old.thing.model_copy(update={field: getattr(new.thing, field) for field in pose})
    # A level plane on the floor is the floor, and no solid itself.
    planes = any(isinstance(shape.geometry, Plane) for shape in new.thing.shapes)
    return moved == new.thing and not planes


def level(turn_xyzw: Quaternion) -> Quaternion:
    """The same tilt with no heading."""
    return turned(turn_xyzw, -yaw_from_quaternion(*turn_xyzw))


def turned(turn_xyzw: Quaternion, yaw_rad: float) -> Quaternion:
    """An orientation turned about the map's z axis."""
    x, y, z, w = turn_xyzw
    c, s = portable_kernels.cos_sin(yaw_rad / 2.0)
    return c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z
