"""What RViz2 and Foxglove draw the robot and the entities from."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import MAP_FRAME, Array, pose_matrix
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Entities, Entity, MarkerEntity, World
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.surfaces import body_surfaces
from mazebot.physics.bodies.robot_body import WHEELS
from mazebot.physics.bodies.robot_model import RobotModel

MOST_TRIANGLES = 20_000
"""Of an entity; a larger one is drawn as a box around it."""
_PANEL_THICKNESS_M = 0.005
_WHITE, _GREY = (1.0, 1.0, 1.0, 1.0), (0.7, 0.7, 0.7, 1.0)
_CORNERS = np.array(
    [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64
)  # fmt: skip


@dataclass(frozen=True)
class WheelFrames:
    """The frames of the wheels, as robot_state_publisher makes them of /joint_states."""

    parents: tuple[str, ...]
    children: tuple[str, ...]
    places: tuple[msg.Vector3, ...]
    rotations: tuple[tuple[float, float, float, float], ...]
    """(x, y, z, w) of each at angle 0."""
    axes: tuple[tuple[float, float, float], ...]

    @classmethod
    def of(cls, model: RobotModel) -> WheelFrames:
        """Those of a model. Raises ModelError where it lacks one."""
        joints = [model.joint(name) for name in WHEELS]
        poses = [msg.pose_from_matrix(joint.parent_from_child) for joint in joints]
        return cls(
            tuple(joint.parent for joint in joints),
            tuple(joint.child for joint in joints),
            tuple(msg.Vector3(*_xyz(pose.position)) for pose in poses),
            tuple((*_xyz(pose.orientation), float(pose.orientation.w)) for pose in poses),
            tuple(joint.axis for joint in joints),
        )

    def transforms(
        self, angles_rad: tuple[float, float], stamp_ns: int
    ) -> list[msg.TransformStamped]:
        """TF entries of the wheels, left and right."""
        found = []
        for parent, child, place, (x, y, z, w), axis, angle_rad in zip(
            self.parents, self.children, self.places, self.rotations, self.axes, angles_rad,
            strict=True,
        ):  # fmt: skip
            c, s = portable.cos_sin(angle_rad / 2.0)
            a, b, d = (s * one for one in axis)
            turned = msg.Quaternion(
                w * a + x * c + y * d - z * b,
                w * b - x * d + y * c + z * a,
                w * d + x * b - y * a + z * c,
                w * c - x * a - y * b - z * d,
            )
            header = msg.header(stamp_ns, parent)
            found.append(msg.TransformStamped(header, child, msg.Transform(place, turned)))
        return found


def _xyz(of: Any) -> tuple[float, float, float]:
    return float(of.x), float(of.y), float(of.z)


class EntityMarkers:
    """Triangles of each entity's materials, and of each ArUco marker a panel with its number."""

    def __init__(self) -> None:
        self._world: World | None = None
        self._drawn: dict[str, tuple[Entity, str, list[msg.Marker]]] = {}

    def array(
        self,
        entities: Entities,
        world: World,
        meshes: Mapping[str, TriangleMesh],
        movers: Collection[str],
        stamp_ns: int,
    ) -> msg.MarkerArray:
        """All of them in one message, whose first marker deletes all before. What moves is in the
        frame of its name, which /tf has.
        """
        clear = msg.line_strip(stamp_ns, MAP_FRAME, "", 0, np.zeros((0, 3)), 0.0, _WHITE)
        markers = [replace(clear, action=msg.Marker.DELETEALL)]
        # Of a set of many, most are as they were.
        before = self._drawn if world is self._world else {}
        self._world, self._drawn = world, {}
        for entity in entities.entities:
            frame = entity.name if entity.name in movers else MAP_FRAME
            drawn = before.get(entity.name)
            if drawn is None or drawn[:2] != (entity, frame):
                drawn = entity, frame, list(_of(entity, world, meshes, frame, stamp_ns))
            self._drawn[entity.name] = drawn
            header = msg.header(stamp_ns, frame)
            markers += [
                replace(one, header=header, ns=entity.name, id=number)
                for number, one in enumerate(drawn[2])
            ]
        return msg.marker_array(markers)


def _of(
    entity: Entity, world: World, meshes: Mapping[str, TriangleMesh], frame: str, stamp_ns: int
) -> Iterator[msg.Marker]:
    if isinstance(entity, MarkerEntity):
        pose = msg.pose_from_matrix(pose_matrix(entity))
        side_m = entity.panel_side_m
        blank = _blank(stamp_ns, frame, _WHITE)
        size = msg.Vector3(side_m, side_m, _PANEL_THICKNESS_M)
        yield replace(blank, type=msg.Marker.CUBE, pose=pose, scale=size)
        text = replace(_blank(stamp_ns, frame, (0.0, 0.0, 0.0, 1.0)), text=str(entity.marker_id))
        size = msg.Vector3(0.0, 0.0, side_m / 2.0)
        yield replace(text, type=msg.Marker.TEXT_VIEW_FACING, pose=pose, scale=size)
        return
    colors = {one.name: one.diffuse for one in (*world.materials, *entity.materials)}
    moves = frame != MAP_FRAME
    for surface in body_surfaces(entity, meshes, {}, moves):
        color = colors.get(surface.material, _GREY)
        points_m = surface.mesh.vertices_m[surface.mesh.triangles.reshape(-1)]
        if len(surface.mesh.triangles) > MOST_TRIANGLES:
            points_m = _box_around(points_m)
        line = msg.line_strip(stamp_ns, frame, "", 0, points_m, 1.0, color)
        yield replace(
            line, type=msg.Marker.TRIANGLE_LIST, scale=msg.Vector3(1.0, 1.0, 1.0),
            frame_locked=moves,
        )  # fmt: skip


def _blank(stamp_ns: int, frame: str, color: tuple[float, float, float, float]) -> msg.Marker:
    line = msg.line_strip(stamp_ns, frame, "", 0, np.zeros((0, 3)), 0.0, color)
    return replace(line, frame_locked=frame != MAP_FRAME)


def _box_around(points_m: Array) -> Array:
    """Corners of 12 triangles around some points."""
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    corners = low + _CORNERS * (high - low)
    faces: Sequence[tuple[int, int, int, int]] = (
        (0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3),
    )  # fmt: skip
    triangles = [corner for a, b, c, d in faces for corner in (a, b, c, a, c, d)]
    return np.asarray(corners[triangles])
