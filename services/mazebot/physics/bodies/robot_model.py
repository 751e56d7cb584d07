"""A robot's links, joints and frames, from its URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array, rotation_from_rpy, transform_matrix

Vector = tuple[float, float, float]


class ModelError(ValueError):
    """A URDF that cannot be used: the message is the reason, in one line."""


@dataclass(frozen=True)
class Shape:
    """A collision shape: a box of full sides, a cylinder along z, or a sphere."""

    kind: Literal["box", "cylinder", "sphere"]
    sides_m: Vector
    radius_m: float
    length_m: float
    link_from_shape: Array


@dataclass(frozen=True)
class Link:
    """A rigid part. Without mass it is a frame only."""

    name: str
    mass_kg: float
    link_from_inertial: Array
    inertia_kg_m2: Array
    """(3, 3), about the centre of mass, in the inertial frame's axes."""
    shapes: tuple[Shape, ...]
    lateral_friction: float | None
    """Its own coefficient; None: that of the link it is fixed to."""


@dataclass(frozen=True)
class Joint:
    """A joint between two links."""

    name: str
    kind: Literal["fixed", "continuous"]
    parent: str
    child: str
    parent_from_child: Array
    axis: Vector


@dataclass(frozen=True)
class Body:
    """Links that move as one, in the frame of one of them."""

    mass_kg: float
    centre_of_mass_m: Vector
    inertia_diagonal_kg_m2: Vector
    """About the centre of mass; products of inertia, small in a waffle, are left out."""
    shapes: tuple[Shape, ...]
    """With `link_from_shape` seen from the body's frame."""


@dataclass(frozen=True)
class RobotModel:
    """A tree of links."""

    name: str
    links: dict[str, Link]
    joints: tuple[Joint, ...]

    def joint(self, name: str) -> Joint:
        """The joint of that name. Raises ModelError where there is none."""
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise ModelError(f"{self.name}: has no joint {name!r}")

    def fixed_joints(self) -> tuple[Joint, ...]:
        """The joints that never move, in the order of the file."""
        return tuple(joint for joint in self.joints if joint.kind == "fixed")

    def transform(self, parent: str, child: str) -> Array:
        """(4, 4) `parent_from_child` through fixed joints, downwards in the tree.

        Raises ModelError if no fixed joints lead there.
        """
        joint_to = {joint.child: joint for joint in self.fixed_joints()}
        parent_from_child = np.eye(4)
        frame = child
        while frame != parent:
            if frame not in joint_to:
                raise ModelError(f"{self.name}: no fixed joints lead from {parent!r} to {child!r}")
            parent_from_child = portable.product(
                joint_to[frame].parent_from_child, parent_from_child
            )
            frame = joint_to[frame].parent
        return parent_from_child

    def body(self, root: str) -> Body:
        """The link `root` and links fixed to it without their own friction, in root's frame."""
        members = [(root, np.eye(4))]
        for parent, root_from_parent in members:
            members += [
                (joint.child, portable.product(root_from_parent, joint.parent_from_child))
                for joint in self.fixed_joints()
                if joint.parent == parent and self.links[joint.child].lateral_friction is None
            ]
        masses = [(self.links[name], pose) for name, pose in members if self.links[name].mass_kg]
        mass = sum(link.mass_kg for link, _ in masses)
        if mass <= 0.0:
            raise ModelError(f"{self.name}: link {root!r}: has no mass")
        centres = [
            (portable.product(pose, link.link_from_inertial))[:3, 3] for link, pose in masses
        ]
        centre = sum(
            (link.mass_kg * c for (link, _), c in zip(masses, centres, strict=True)), np.zeros(3)
        )
        centre = centre / mass
        inertia = np.zeros((3, 3))
        for (link, pose), link_centre in zip(masses, centres, strict=True):
            turn = (portable.product(pose, link.link_from_inertial))[:3, :3]
            arm = link_centre - centre
            inertia += portable.product(turn, link.inertia_kg_m2, turn.T)
            inertia += link.mass_kg * (
                float(portable.product(arm, arm)) * np.eye(3) - np.outer(arm, arm)
            )
        shapes = tuple(
            Shape(
                s.kind, s.sides_m, s.radius_m, s.length_m, portable.product(pose, s.link_from_shape)
            )
            for name, pose in members
            for s in self.links[name].shapes
        )
        return Body(mass, _vector(centre), _vector(np.diagonal(inertia)), shapes)

    def separate_links(self, root: str) -> tuple[Joint, ...]:
        """The joints from root to links that turn or have their own friction."""
        return tuple(
            joint
            for joint in self.joints
            if joint.parent == root
            and (joint.kind != "fixed" or self.links[joint.child].lateral_friction is not None)
        )


def robot_model_from_urdf(text: str) -> RobotModel:
    """Read the part of a URDF that the simulation needs; visuals are for the viewer.

    Raises ModelError, in one line, if the text is no URDF or has unsupported elements.
    """
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ModelError(f"not XML: {error}") from error
    if root.tag != "robot":
        raise ModelError(f"not a URDF: its root is <{root.tag}>")
    links = {link.name: link for link in map(_link, root.findall("link"))}
    joints = tuple(_joint(element) for element in root.findall("joint"))
    for joint in joints:
        for end in (joint.parent, joint.child):
            if end not in links:
                raise ModelError(f"joint {joint.name!r}: no such link: {end!r}")
    children = [joint.child for joint in joints]
    if len(set(children)) != len(children) or len(children) != len(links) - 1:
        raise ModelError("the links are not one tree")
    return RobotModel(root.get("name", "robot"), links, joints)


def _link(element: ET.Element) -> Link:
    name = _attribute(element, "name", "link")
    mass, inertial, inertia = 0.0, np.eye(4), np.zeros((3, 3))
    found = element.find("inertial")
    if found is not None:
        mass = _numbers(_child(found, "mass", name).get("value"), 1, name)[0]
        inertial = _origin(found, name)
        of = _child(found, "inertia", name)
        xx, xy, xz, yy, yz, zz = (
            _numbers(of.get(key), 1, name)[0] for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if mass <= 0.0 or portable.eigh(inertia)[0][0] <= 0.0:
            raise ModelError(f"link {name!r}: mass and inertia must be positive")
    friction = element.find("contact/lateral_friction")
    return Link(
        name,
        mass,
        inertial,
        inertia,
        tuple(_shape(collision, name) for collision in element.findall("collision")),
        None if friction is None else _numbers(friction.get("value"), 1, name)[0],
    )


def _shape(collision: ET.Element, link: str) -> Shape:
    geometry = _child(collision, "geometry", link)
    pose = _origin(collision, link)
    box, cylinder, sphere = (geometry.find(kind) for kind in ("box", "cylinder", "sphere"))
    if box is not None:
        x, y, z = _positive(box.get("size"), 3, link)
        return Shape("box", (x, y, z), 0.0, 0.0, pose)
    if cylinder is not None:
        radius = _positive(cylinder.get("radius"), 1, link)[0]
        length = _positive(cylinder.get("length"), 1, link)[0]
        return Shape("cylinder", (0.0, 0.0, 0.0), radius, length, pose)
    if sphere is not None:
        radius = _positive(sphere.get("radius"), 1, link)[0]
        return Shape("sphere", (0.0, 0.0, 0.0), radius, 0.0, pose)
    raise ModelError(f"link {link!r}: a collision must be a box, a cylinder or a sphere")


def _joint(element: ET.Element) -> Joint:
    name = _attribute(element, "name", "joint")
    kind = _attribute(element, "type", name)
    axis = element.find("axis")
    x, y, z = _numbers("1 0 0" if axis is None else axis.get("xyz"), 3, name)
    parent, child = (
        _attribute(_child(element, end, name), "link", name) for end in ("parent", "child")
    )
    if kind == "fixed":
        return Joint(name, "fixed", parent, child, _origin(element, name), (x, y, z))
    if kind == "continuous":
        return Joint(name, "continuous", parent, child, _origin(element, name), (x, y, z))
    raise ModelError(f"joint {name!r}: type {kind!r} is neither fixed nor continuous")


def _origin(element: ET.Element, name: str) -> Array:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    x, y, z = _numbers(origin.get("xyz", "0 0 0"), 3, name)
    roll, pitch, yaw = _numbers(origin.get("rpy", "0 0 0"), 3, name)
    return transform_matrix(rotation_from_rpy(roll, pitch, yaw), (x, y, z))


def _child(element: ET.Element, tag: str, name: str) -> ET.Element:
    child = element.find(tag)
    if child is None:
        raise ModelError(f"{name!r}: <{element.tag}> has no <{tag}>")
    return child


def _attribute(element: ET.Element, key: str, name: str) -> str:
    value = element.get(key)
    if not value:
        raise ModelError(f"{name!r}: <{element.tag}> has no {key!r}")
    return value


def _numbers(text: str | None, count: int, name: str) -> list[float]:
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise ModelError(f"{name!r}: {text!r} is not {count} finite number{'s'[: count - 1]}")
    return values


def _positive(text: str | None, count: int, name: str) -> list[float]:
    values = _numbers(text, count, name)
    if min(values) <= 0.0:
        raise ModelError(f"{name!r}: {text!r} must be positive")
    return values


def _vector(values: Array) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
