"""Shapes of rigid bodies, in the terms of SDF."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mazebot.common.messages.documents.document import (
    Document,
    Point2,
    Positive,
    Quaternion,
    Vector,
)


class Box(Document):
    """Centred at its origin."""

    kind: Literal["box"] = "box"
    size_m: tuple[Positive, Positive, Positive]


class Cylinder(Document):
    """Along z, centred at its origin."""

    kind: Literal["cylinder"] = "cylinder"
    radius_m: Positive
    length_m: Positive


class Cone(Document):
    """Along z, centred at half its height, its tip at +z."""

    kind: Literal["cone"] = "cone"
    radius_m: Positive
    length_m: Positive


class Capsule(Document):
    """A cylinder along z with a half sphere on either end; `length_m` is the cylinder's."""

    kind: Literal["capsule"] = "capsule"
    radius_m: Positive
    length_m: Positive


class Sphere(Document):
    """Centred at its origin."""

    kind: Literal["sphere"] = "sphere"
    radius_m: Positive


class Ellipsoid(Document):
    """Centred at its origin."""

    kind: Literal["ellipsoid"] = "ellipsoid"
    radii_m: tuple[Positive, Positive, Positive]


class Plane(Document):
    """A flat rectangle at z = 0, visible and solid from +z only."""

    kind: Literal["plane"] = "plane"
    size_m: tuple[Positive, Positive]


class Polyline(Document):
    """Simple polygons in the plane z = 0, raised to `height_m`; one within another is a hole."""

    kind: Literal["polyline"] = "polyline"
    polygons_m: tuple[tuple[Point2, ...], ...]
    height_m: Positive


class Mesh(Document):
    """Triangles from an asset."""

    kind: Literal["mesh"] = "mesh"
    sha256: str = Field(description="asset of the triangles, as geometry.mesh_to_bytes writes them")
    name: str = Field("", description="file, and submesh, that it came from, for display")
    scale: Vector = Field((1.0, 1.0, 1.0), description="none is zero")


Geometry = Annotated[
    Box | Cylinder | Cone | Capsule | Sphere | Ellipsoid | Plane | Polyline | Mesh,
    Field(discriminator="kind"),
]


class Shape(Document):
    """A part of a body: visual, collision geometry, or both."""

    name: str
    geometry: Geometry
    position_m: Vector = Field((0.0, 0.0, 0.0), description="in the body's frame")
    orientation_xyzw: Quaternion = Field((0.0, 0.0, 0.0, 1.0), description="body_from_shape")
    material: str = Field("", description="name of a material of the world; empty: invisible")
    solid: bool = Field(True, description="the robot, the lidar and the map take it into account")
