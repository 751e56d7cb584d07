"""Reads and checks geometry and material of collisions and visuals."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn, TypeVar

import numpy as np
from lxml import etree
from pydantic import ValidationError

from mazebot.common.maths.frames import Array, transform_matrix
from mazebot.common.messages import documents as doc
from mazebot.common.messages.documents import Rgba
from mazebot.worldgen.recipe_model import MAX_COORDINATE_M, GeometryRecipe, MeshGeometry
from mazebot.worldgen.sdf.files.locate import LocateError, Locator
from mazebot.worldgen.sdf.files.xml_text import UnreadableError, bytes_of
from mazebot.worldgen.sdf.model import SdfMaterial
from mazebot.worldgen.sdf.reading import values
from mazebot.worldgen.sdf.reading.findings import Findings, Place
from mazebot.worldgen.sdf.reading.gazebo_colours import GAZEBO_COLOURS
from mazebot.worldgen.sdf.reading.material_script import (
    MAX_SCRIPT_BYTES,
    ScriptMaterial,
    material_in,
)
from mazebot.worldgen.sdf.reading.vocabulary import list_unread

T = TypeVar("T")
Scale = tuple[float, float, float]

MESH_SUFFIXES = (".dae", ".obj", ".stl", ".glb")
INFINITE_PLANE_M = 100.0
"""Side of a solid plane without a size: Gazebo's solid planes are infinite."""

MAX_SCRIPT_URIS, MAX_SCRIPTS = 8, 32

_REFUSED = ("image", "heightmap")
_NAMES = (
    *("box", "capsule", "cone", "cylinder", "ellipsoid", "empty", "heightmap", "image", "mesh"),
    *("plane", "polyline", "sphere"),
)
_FILE_NAME = re.compile(r"[^A-Za-z0-9_.-]")


@dataclass(frozen=True, eq=False)
class ReadGeometry:
    """The content of a <geometry>."""

    geometry: GeometryRecipe
    shape_from_geometry: Array
    """(4, 4): rotated by a plane's normal."""
    mesh_file: Path | None = None


LACKING = ReadGeometry(doc.Box(size_m=(1.0, 1.0, 1.0)), np.eye(4))
"""In place of the mesh of a visual that cannot be had."""


class ShapeReader:
    """Reads the contents of collisions and visuals."""

    def __init__(self, findings: Findings, locator: Locator) -> None:
        self._findings = findings
        self._locator = locator
        self._picture_cache: dict[tuple[str, Path], Path | None] = {}
        self._script_cache: dict[
            tuple[str, tuple[str, ...], Path], tuple[ScriptMaterial | None, Path | None]
        ] = {}

    def geometry(
        self, place: Place, role: str, scale: Scale = (1.0, 1.0, 1.0)
    ) -> ReadGeometry | None:
        """Of a <collision> or <visual>, scaled along its own axes; None if it is empty, LACKING if
        it is a mesh that is only seen and cannot be had.
        """
        element = place.element.find("geometry")
        if element is None:
            self._findings.error("ELEMENT_MISSING", place, f"<{role}> must have a <geometry>")
            return None
        list_unread(place.at(element), self._findings)
        kinds = [child for child in element if str(child.tag) in _NAMES]
        if not kinds:
            self._findings.shape(role, "empty")
            return None
        first = kinds[0]
        kind = str(first.tag)
        self._findings.shape(role, kind)
        if any(str(other.tag) != kind for other in kinds):
            self._findings.error(
                "ELEMENT_INVALID", place.at(element), "<geometry> must have one shape, has more"
            )
            return None
        at = place.at(first)
        if kind in _REFUSED:
            self._findings.error(
                "GEOMETRY_UNSUPPORTED", at, f"<{kind}> is not supported: make it a mesh"
            )
            return None
        if kind == "empty":
            return None
        for one in kinds if kind == "polyline" else (first,):
            list_unread(place.at(one), self._findings)
        try:
            read = self._shape(kind, at, kinds, role)
            return read if scale == (1.0, 1.0, 1.0) else self._scaled(read, scale, at, role)
        except ValidationError as error:
            message = error.errors()[0]["msg"]
            self._findings.error("ELEMENT_INVALID", at, f"<{kind}> {message}")
        except _LackingError:
            return LACKING
        except _FoundError:
            pass
        return None

    def _shape(
        self, kind: str, at: Place, all_of_it: list[etree._Element], role: str
    ) -> ReadGeometry:
        same = np.eye(4)
        if kind == "box":
            x, y, z = self._needed(at, "size", lambda text: _lengths(text, 3))
            return ReadGeometry(doc.Box(size_m=(x, y, z)), same)
        if kind == "sphere":
            return ReadGeometry(doc.Sphere(radius_m=self._needed(at, "radius", _length)), same)
        if kind == "ellipsoid":
            x, y, z = self._needed(at, "radii", lambda text: _lengths(text, 3))
            return ReadGeometry(doc.Ellipsoid(radii_m=(x, y, z)), same)
        if kind == "plane":
            return self._plane(at, role)
        if kind == "polyline":
            return self._polyline(at, all_of_it)
        if kind == "mesh":
            return self._mesh(at, role)
        radius = self._needed(at, "radius", _length)
        length = self._needed(at, "length", _length)
        if kind == "cylinder":
            return ReadGeometry(doc.Cylinder(radius_m=radius, length_m=length), same)
        if kind == "cone":
            return ReadGeometry(doc.Cone(radius_m=radius, length_m=length), same)
        return ReadGeometry(doc.Capsule(radius_m=radius, length_m=length), same)

    def _scaled(self, read: ReadGeometry, scale: Scale, at: Place, role: str) -> ReadGeometry:
        """The same, scaled as Gazebo Classic does it. Raises ValidationError."""
        geometry = scaled(read.geometry, scale)
        if geometry is None:
            factors = " ".join(f"{factor:g}" for factor in scale)
            what = f"scale {factors} of a {read.geometry.kind}, which is not scaled"
            # A plane that is solid has no end.
            solid = role == "collision" and read.geometry.kind != "plane"
            self._findings.ignore(what, at, solid=solid)
            return read
        return replace(read, geometry=geometry)

    def _plane(self, at: Place, role: str) -> ReadGeometry:
        x, y, z = self.optional(at, "normal", values.vector, (0.0, 0.0, 1.0))
        length = math.sqrt(x * x + y * y + z * z)
        if length < 1e-9:
            self._fail(at, "ELEMENT_INVALID", "<normal> must not be zero")
        default = 1.0 if role == "visual" else INFINITE_PLANE_M
        sizes = self.optional(at, "size", _flat_size, (default, default))
        turn = _rotation_to(np.array([x, y, z]) / length)
        return ReadGeometry(
            doc.Plane(size_m=(sizes[0], sizes[1])), transform_matrix(turn, (0.0, 0.0, 0.0))
        )

    def _polyline(self, at: Place, all_of_it: list[etree._Element]) -> ReadGeometry:
        heights = [self._needed(at.at(element), "height", _length) for element in all_of_it]
        for element, height in zip(all_of_it, heights, strict=True):
            if height != heights[0]:
                self._findings.ignore("height of a second <polyline>", at.at(element), solid=True)
        polygons = []
        for element in all_of_it:
            points = []
            for point in element.findall("point"):
                x, y = self._value(at.at(point), "point", lambda text: _within(text, 2))
                points.append((x, y))
            if len(points) > 1 and points[0] == points[-1]:
                points.pop()
            if len(points) < 3:
                self._fail(at.at(element), "ELEMENT_INVALID", "<polyline> must have 3 <point>s")
            polygons.append(tuple(points))
        return ReadGeometry(
            doc.Polyline(polygons_m=tuple(polygons), height_m=heights[0]), np.eye(4)
        )

    def _mesh(self, at: Place, role: str) -> ReadGeometry:
        uri = at.element.find("uri")
        if uri is None or not (uri.text or "").strip():
            self._fail(at, "ELEMENT_MISSING", "<mesh> must have a <uri>")
        scale = self.optional(at, "scale", _scale, (1.0, 1.0, 1.0))
        if not all(scale):
            self._fail(at, "ELEMENT_INVALID", "<scale> must not be zero")
        submesh, center = None, False
        inner = at.element.find("submesh")
        if inner is not None:
            list_unread(at.at(inner), self._findings)
            submesh = (inner.findtext("name") or "").strip()[:128]
            if not submesh:
                self._fail(at.at(inner), "ELEMENT_MISSING", "<submesh> must have a <name>")
            center = self.optional(at.at(inner), "center", values.truth, False)
        words = (uri.text or "").strip()
        try:
            file = self._locator.file(words, at.source.file.parent)
        except LocateError as error:
            self._lack(at.at(uri), role, error.kind, str(error))
        if file.suffix.lower() not in MESH_SUFFIXES:
            must = f"`{words[:100]}` must be DAE, OBJ, STL or GLB"
            self._lack(at.at(uri), role, "GEOMETRY_UNSUPPORTED", must)
        name = _FILE_NAME.sub("_", file.name).lstrip("_.-")[-128:] or f"mesh{file.suffix}"
        x, y, z = scale
        geometry = MeshGeometry(
            file=name.lstrip("_.-"), submesh=submesh, center=center, scale=(x, y, z)
        )
        return ReadGeometry(geometry, np.eye(4), file)

    def material(self, place: Place) -> SdfMaterial | None:
        """Of a <visual>; None if it has none."""
        element = place.element.find("material")
        if element is None:
            return None
        at = place.at(element)
        list_unread(at, self._findings)
        ambient = self._colour(at, "ambient")
        diffuse = self._colour(at, "diffuse")
        albedo = self._albedo(at)
        script = self._script(at)
        if script in GAZEBO_COLOURS:
            ambient = ambient or GAZEBO_COLOURS[script][0]
            diffuse = diffuse or GAZEBO_COLOURS[script][1]
        elif script:
            found, picture = self._scripted(at, script)
            if found is None:
                self._findings.ignore(f"material script {script}", at)
            else:
                ambient, diffuse = ambient or found.ambient, diffuse or found.diffuse
                albedo = albedo or picture
        read = SdfMaterial(ambient=ambient, diffuse=diffuse, script=script, albedo_map=albedo)
        self._findings.material(_described(read))
        return read

    def _script(self, at: Place) -> str:
        script = at.element.find("script")
        if script is None:
            return ""
        list_unread(at.at(script), self._findings)
        name = (script.findtext("name") or script.text or "").strip()
        if not name:
            self._findings.error("ELEMENT_MISSING", at.at(script), "<script> must have a <name>")
        return name[:200]

    def _scripted(self, at: Place, name: str) -> tuple[ScriptMaterial | None, Path | None]:
        """A material from the scripts of a <script>'s URIs, and the file of its texture."""
        script = at.element.find("script")
        uris = [] if script is None else [(uri.text or "").strip() for uri in script.findall("uri")]
        folder = at.source.file.parent
        key = name, tuple(uris), folder
        if key not in self._script_cache:
            places = []
            for uri in uris[:MAX_SCRIPT_URIS]:
                try:
                    places.append(self._locator.model(uri, folder))
                except LocateError:
                    continue
            self._script_cache[key] = self._search(name, places)
        found, picture = self._script_cache[key]
        if found is not None and found.picture and picture is None:
            self._findings.missing(
                "URI_LOOKUP",
                at,
                f"image `{found.picture[:100]}` of {name} was not found on the path",
            )
        return found, picture

    def _search(self, name: str, places: list[Path]) -> tuple[ScriptMaterial | None, Path | None]:
        folders = [place if place.is_dir() else place.parent for place in places]
        folders += [folder.parent / "textures" for folder in folders]
        for place in places:
            files = sorted(place.glob("*.material"))[:MAX_SCRIPTS] if place.is_dir() else [place]
            for file in files:
                if not self._locator.may_read(file):
                    continue
                try:
                    data = bytes_of(file, MAX_SCRIPT_BYTES)
                except UnreadableError:
                    continue
                found = material_in(data.decode("utf-8", "replace"), name)
                if found is None:
                    continue
                pictures = (folder / Path(found.picture).name for folder in folders)
                readable = (p for p in pictures if p.is_file() and self._locator.may_read(p))
                return found, next((p.resolve() for p in readable), None)
        return None, None

    def _albedo(self, at: Place) -> Path | None:
        pbr = at.element.find("pbr")
        if pbr is None:
            return None
        list_unread(at.at(pbr), self._findings)
        for workflow in ("metal", "specular"):
            element = pbr.find(workflow)
            if element is None:
                continue
            list_unread(at.at(element), self._findings)
            map_element = element.find("albedo_map")
            uri = "" if map_element is None else (map_element.text or "").strip()
            if map_element is None or not uri:
                continue
            key = uri, at.source.file.parent
            if key not in self._picture_cache:
                self._picture_cache[key] = None
                try:
                    self._picture_cache[key] = self._locator.file(*key)
                except LocateError as error:
                    self._findings.missing(error.kind, at.at(map_element), str(error))
            return self._picture_cache[key]
        return None

    def _colour(self, at: Place, tag: str) -> Rgba | None:
        return self.optional(at, tag, values.colour, None)

    def optional(self, at: Place, tag: str, parse: Callable[[str | None], T], default: T) -> T:
        """The value of a child; the default if it is missing, empty, or invalid."""
        element = at.element.find(tag)
        if element is None or not (element.text or "").strip():
            return default
        try:
            return self._value(at.at(element), tag, parse)
        except _FoundError:
            return default

    def _needed(self, at: Place, tag: str, parse: Callable[[str | None], T]) -> T:
        element = at.element.find(tag)
        if element is None:
            self._fail(at, "ELEMENT_MISSING", f"<{at.element.tag}> must have a <{tag}>")
        return self._value(at.at(element), tag, parse)

    def _value(self, at: Place, tag: str, parse: Callable[[str | None], T]) -> T:
        try:
            return parse(at.element.text)
        except ValueError as error:
            self._fail(at, "ELEMENT_INVALID", f"<{tag}> {error}")

    def _lack(self, at: Place, role: str, kind: str, message: str) -> NoReturn:
        """A mesh cannot be had: an error, unless it is only seen."""
        if role != "visual":
            self._fail(at, kind, message)
        self._findings.missing(kind, at, message)
        raise _LackingError

    def _fail(self, at: Place, kind: str, message: str) -> NoReturn:
        self._findings.error(kind, at, message)
        raise _FoundError


class _FoundError(Exception):
    """An error that has been reported already."""


class _LackingError(Exception):
    """A mesh that is only seen cannot be had, which has been reported already."""


def scaled(geometry: GeometryRecipe, scale: Scale) -> GeometryRecipe | None:
    """A shape scaled as Gazebo Classic scales one: what is round stays so, with the larger factor.
    None for a shape that it does not scale. Raises ValidationError.
    """
    x, y, z = scale
    if isinstance(geometry, doc.Box):
        a, b, c = geometry.size_m
        return doc.Box(size_m=(a * x, b * y, c * z))
    if isinstance(geometry, doc.Sphere):
        return doc.Sphere(radius_m=geometry.radius_m * max(scale))
    if isinstance(geometry, doc.Cylinder):
        return doc.Cylinder(radius_m=geometry.radius_m * max(x, y), length_m=geometry.length_m * z)
    if isinstance(geometry, MeshGeometry):
        a, b, c = geometry.scale
        return MeshGeometry(**{**geometry.model_dump(), "scale": (a * x, b * y, c * z)})
    return None


def volume_m3(geometry: GeometryRecipe) -> float | None:
    """Volume of a shape; None for a mesh or a plane."""
    if isinstance(geometry, doc.Box):
        return math.prod(geometry.size_m)
    if isinstance(geometry, doc.Cylinder):
        return math.pi * geometry.radius_m**2 * geometry.length_m
    if isinstance(geometry, doc.Cone):
        return math.pi * geometry.radius_m**2 * geometry.length_m / 3.0
    if isinstance(geometry, doc.Sphere):
        return 4.0 / 3.0 * math.pi * geometry.radius_m**3
    if isinstance(geometry, doc.Capsule):
        r = geometry.radius_m
        return math.pi * r**2 * (geometry.length_m + 4.0 / 3.0 * r)
    if isinstance(geometry, doc.Ellipsoid):
        return 4.0 / 3.0 * math.pi * math.prod(geometry.radii_m)
    return None


def _length(text: str | None) -> float:
    return _lengths(text, 1)[0]


def _lengths(text: str | None, count: int) -> tuple[float, ...]:
    lengths = values.positives(text, count)
    if max(lengths) > 10.0 * MAX_COORDINATE_M:
        raise ValueError(f"must be at most {10.0 * MAX_COORDINATE_M:g} m")
    return lengths


def _within(text: str | None, count: int) -> tuple[float, ...]:
    coordinates = values.numbers(text, count)
    if max(abs(value) for value in coordinates) > MAX_COORDINATE_M:
        raise ValueError(f"must be at most {MAX_COORDINATE_M:g}")
    return coordinates


def _flat_size(text: str | None) -> tuple[float, float]:
    x, y = _lengths(text, 2)
    return x, y


def _scale(text: str | None) -> tuple[float, float, float]:
    x, y, z = _within(text, 3)
    return x, y, z


def _rotation_to(normal: Array) -> Array:
    """(3, 3) shortest rotation from +z to a unit vector, by Rodrigues' formula."""
    x, y, z = (float(value) for value in normal)
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])
    rotation: Array = np.eye(3) + cross + cross @ cross / (1.0 + z)
    return rotation


def _described(material: SdfMaterial) -> str:
    """A material in short text form."""
    if material.albedo_map is not None:
        return f"albedo {material.albedo_map.name}"
    if material.script:
        return f"script {material.script}"
    colour = material.diffuse or material.ambient
    if colour is None:
        return "plain"
    return "rgba " + " ".join(f"{part:g}" for part in colour)
