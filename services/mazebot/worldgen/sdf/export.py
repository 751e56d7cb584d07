"""Exports a world as SDF 1.9 for Gazebo, with everything it needs in one folder.

SDF's own elements contain all poses, sizes and materials. Data that SDF cannot express is added in
the namespace of model.MAZEBOT_NAMESPACE, which Gazebo ignores: see `_notes` and the calls of
`annotate`. Where a pose is rounded by sines and cosines, the exact number is noted too: on import
it is used only if the two agree to 1e-9, so that edits of the file's poses take effect.
"""

from __future__ import annotations

import json
import math
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from lxml import etree

from mazebot.common.files.folder_writing import write_folder
from mazebot.common.maths.frames import Array, rotation_from_quaternion, transform_matrix
from mazebot.common.messages import documents as doc
from mazebot.common.world.geometry import TriangleMesh, mesh_from_bytes, triangles_of
from mazebot.common.world.marker_entities import PanelStyle, marker_entities
from mazebot.common.world.marker_picture import identity_problem, own_dictionaries, panel_side_m
from mazebot.common.world.placement import hang
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.sdf.marker_model import marker_model_files, model_name
from mazebot.worldgen.sdf.writing import (
    SHEET_THICKNESS_M,
    add,
    add_look,
    annotate,
    numbers,
    sdf_root,
    xml_bytes,
)

MANIFEST = "mazebot-export.json"
"""Lists the files of an export, so that the next one may replace them."""

COVERING_THICKNESS_M = 0.0005
"""Closer to the wall than any marker's panel."""
_GROUND_SIDE_M = 100.0
_STEP_S = 1.0 / 240.0
_GREY = (0.5, 0.5, 0.5, 1.0)
_MESH_FILE = re.compile(r"(?P<file>.+)\.(?:glb|gltf|dae|obj|stl)(?:\.(?P<part>.*))?", re.IGNORECASE)


def export_world(loaded: LoadedWorld, folder: Path) -> Path:
    """Write a world into a folder, and return its SDF file, `<name>.sdf`.

    The folder is a new or an empty one, or that of an earlier export, which is replaced. Markers
    are exported as models in it: Gazebo finds them with GZ_SIM_RESOURCE_PATH=<folder>. Raises
    ConfigError if the folder contains anything else or cannot be written.
    """
    files = export_files(loaded)
    manifest = json.dumps({"files": sorted(files)}, indent=1) + "\n"
    former = {MANIFEST, *_former_files(folder)}
    write_folder(folder, {**files, MANIFEST: manifest.encode()}, former.__contains__)
    return folder / f"{loaded.world.name}.sdf"


def export_files(loaded: LoadedWorld) -> dict[str, bytes]:
    """The files of an export, by their path in its folder; the SDF file is the first."""
    return _Export(loaded).files()


def _former_files(folder: Path) -> list[str]:
    """Files of an earlier export."""
    try:
        named = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))["files"]
        return [str(name) for name in named]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return []


class _Names:
    """Names for siblings: valid in SDF, and unique."""

    def __init__(self) -> None:
        self._given: set[str] = set()

    def give(self, wanted: str) -> str:
        """The wanted name, or a similar one."""
        name = "".join(c if c.isprintable() else "_" for c in wanted).replace("::", "_").strip()
        if not name or name == "world" or re.fullmatch(r"__.*__", name):
            name = f"{name.strip('_')}_"
        free, count = name, 1
        while free in self._given:
            count += 1
            free = f"{name}_{count}"
        self._given.add(free)
        return free


class _Export:
    def __init__(self, loaded: LoadedWorld) -> None:
        self._loaded = loaded
        self._world = loaded.world
        self._materials = {material.name: material for material in loaded.world.materials}
        self._names = _Names()
        self._files: dict[str, bytes] = {}
        self._uri_of_texture: dict[str, str] = {}
        self._mesh_places: dict[str, tuple[str, str]] = {}
        """URI and submesh, by sha256."""

    def files(self) -> dict[str, bytes]:
        world = self._world
        # SDF supports cones since 1.11.
        cones = any(
            isinstance(shape.geometry, doc.Cone) for body in world.bodies for shape in body.shapes
        )
        root = sdf_root("1.11" if cones else "1.9")
        inside = add(root, "world", name=world.name)
        self._files[f"{world.name}.sdf"] = b""
        self._place_textures()
        self._place_meshes()
        notes = add(inside, f"{{{root.nsmap['mazebot']}}}world")
        physics = add(inside, "physics", name="default_physics", type="ode")
        add(physics, "max_step_size", numbers((_STEP_S,)))
        add(physics, "real_time_factor", "1")
        add(inside, "gravity", "0 0 -9.8")
        self._scene(inside)
        self._lights(inside)
        for wall in world.walls:
            self._wall(inside, wall)
        for body in world.bodies:
            self._body(inside, body)
        self._floor(inside)
        self._ceiling(inside)
        self._notes(notes, self._markers(inside))
        self._files[f"{world.name}.sdf"] = xml_bytes(root)
        return self._files

    def _notes(self, notes: etree._Element, markers: list[dict[str, object]]) -> None:
        """Data that SDF cannot express; each child's text is JSON.

        recipe: its file's name. start, locations, keepout_zones, speed_limits. map_resolution_m, or
        map: a ready file for map_server. markers, in their order: of each placed one the names of
        its model and of its wall, of others all fields.
        """
        world = self._world
        content: dict[str, object] = {
            "recipe": world.recipe,
            "start": world.start.model_dump(),
            "locations": [location.model_dump() for location in world.locations],
            "markers": markers,
        }
        for field in ("keepout_zones", "speed_limits"):
            if zones := getattr(world, field):
                content[field] = [zone.model_dump(exclude_none=True) for zone in zones]
        if world.map_sha256:
            content["map"] = self._map()
        else:
            content["map_resolution_m"] = world.map_resolution_m
        for key, value in content.items():
            add(notes, notes.tag.replace("}world", f"}}{key}"), json.dumps(value))

    def _map(self) -> str:
        # The map writer is not needed for worlds without a ready map.
        from mazebot.common.world.map_files import write_map  # noqa: PLC0415

        world, loaded = self._world, self._loaded
        with tempfile.TemporaryDirectory(prefix="mazebot-export-") as folder:
            written = write_map(
                Path(folder),
                world.name,
                loaded.map_cells,
                world.map_resolution_m,
                loaded.map_origin,
            )
            for file in sorted(written.parent.iterdir()):
                self._files[f"maps/{file.name}"] = file.read_bytes()
        return f"maps/{written.name}"

    def _scene(self, inside: etree._Element) -> None:
        scene = add(inside, "scene")
        ambient = self._world.light_ambient
        add(scene, "ambient", numbers((ambient, ambient, ambient, 1.0)))
        add(scene, "background", numbers(self._world.sky))
        add(scene, "shadows", "false")
        add(scene, "grid", "false")

    def _lights(self, inside: etree._Element) -> None:
        world = self._world
        # Lamps first: an import identifies them by their name alone.
        names = [self._names.give(lamp.name) for lamp in world.lights]
        sun = add(inside, "light", type="directional", name=self._names.give("sun"))
        add(sun, "pose", "0 0 10 0 0 0")
        add(sun, "cast_shadows", "false")
        strength = world.light_diffuse
        add(sun, "diffuse", numbers((strength, strength, strength, 1.0)))
        add(sun, "specular", "0 0 0 1")
        add(sun, "direction", numbers(world.light_direction))
        for name, lamp in zip(names, world.lights, strict=True):
            light = add(inside, "light", type="point", name=name)
            add(light, "pose", f"{numbers(lamp.position_m)} 0 0 0")
            add(light, "cast_shadows", "false")
            add(light, "diffuse", numbers(lamp.diffuse))
            add(light, "specular", "0 0 0 1")
            attenuation = add(light, "attenuation")
            add(attenuation, "range", numbers((lamp.range_m,)))
            add(attenuation, "constant", numbers((lamp.constant,)))
            add(attenuation, "linear", numbers((lamp.linear,)))
            add(attenuation, "quadratic", numbers((lamp.quadratic,)))

    def _model(
        self, inside: etree._Element, wanted: str, static: bool = True
    ) -> tuple[etree._Element, etree._Element, str]:
        """A model, its link of the same name, and the name."""
        name = self._names.give(wanted)
        model = add(inside, "model", name=name)
        add(model, "static", "true" if static else "false")
        return model, etree.Element("link", name=name), name

    def _wall(self, inside: etree._Element, wall: doc.Wall) -> None:
        model, link, name = self._model(inside, wall.name)
        at = (wall.x_m, wall.y_m, wall.height_m / 2.0, 0.0, 0.0, wall.yaw_rad)
        add(model, "pose", numbers(at))
        model.append(link)
        annotate(link, kind="wall", **_name_note(wall.name, name))
        if wall.yaw_rad:
            annotate(link, yaw_rad=repr(wall.yaw_rad))
        size_m = (wall.length_m, wall.thickness_m, wall.height_m)
        add_box(add(link, "collision", name="collision"), size_m)
        visual = add(link, "visual", name="visual")
        add_box(visual, size_m)
        self._look(visual, wall.material)
        for index, covering in enumerate(wall.coverings):
            visual = add(link, "visual", name=f"covering_{index}")
            annotate(
                visual,
                covering=covering.side,
                span_m=json.dumps([covering.from_m, covering.to_m]),
            )
            sign = 1.0 if covering.side == "left" else -1.0
            out_m = sign * (wall.thickness_m + COVERING_THICKNESS_M) / 2.0
            along_m = (covering.from_m + covering.to_m) / 2.0
            add(visual, "pose", numbers((along_m, out_m, 0.0, 0.0, 0.0, 0.0)))
            length_m = covering.to_m - covering.from_m
            add_box(visual, (length_m, COVERING_THICKNESS_M, wall.height_m))
            self._look(visual, covering.material)

    def _body(self, inside: etree._Element, body: doc.Body) -> None:
        model, link, name = self._model(inside, body.name, body.mass_kg == 0.0)
        _pose(model, body.position_m, body.orientation_xyzw)
        model.append(link)
        annotate(
            link, kind="body", **_name_note(body.name, name), **_turn_note(body.orientation_xyzw)
        )
        if body.mass_kg > 0.0:
            self._inertial(link, body)
        names = _Names()
        for shape in body.shapes:
            noted = json.dumps(shape.name)
            if shape.solid:
                collision = add(link, "collision", name=names.give(f"{shape.name}_collision"))
                annotate(collision, shape=noted, **_turn_note(shape.orientation_xyzw))
                self._collision(collision, shape)
            if shape.material or not shape.solid:
                visual = add(link, "visual", name=names.give(f"{shape.name}_visual"))
                annotate(visual, shape=noted, **_turn_note(shape.orientation_xyzw))
                _pose(visual, shape.position_m, shape.orientation_xyzw)
                self._geometry(visual, shape.geometry)
                self._look(visual, shape.material)
                if not shape.material:
                    add(visual, "transparency", "1")

    def _collision(self, collision: etree._Element, shape: doc.Shape) -> None:
        if not isinstance(shape.geometry, doc.Plane):
            _pose(collision, shape.position_m, shape.orientation_xyzw)
            self._geometry(collision, shape.geometry)
            return
        # In Gazebo a solid plane is infinite.
        annotate(collision, geometry="plane", position_m=json.dumps(shape.position_m))
        rotation = rotation_from_quaternion(*shape.orientation_xyzw)
        x, y, z = np.array(shape.position_m) - SHEET_THICKNESS_M / 2.0 * rotation[:, 2]
        _pose(collision, (float(x), float(y), float(z)), shape.orientation_xyzw)
        add_box(collision, (*shape.geometry.size_m, SHEET_THICKNESS_M))

    def _inertial(self, link: etree._Element, body: doc.Body) -> None:
        """Inertia of a box around all collisions, its centre at the body's origin."""
        corners = [_corners_m(shape, self._mesh) for shape in body.shapes if shape.solid]
        extent_m = np.ptp(np.concatenate(corners), axis=0) if corners else np.full(3, 0.1)
        squares = np.maximum(extent_m, 0.01) ** 2
        inertial = add(link, "inertial")
        add(inertial, "mass", numbers((body.mass_kg,)))
        inertia = add(inertial, "inertia")
        for axis, tag in enumerate(("ixx", "iyy", "izz")):
            moment = body.mass_kg / 12.0 * float(squares.sum() - squares[axis])
            add(inertia, tag, numbers((moment,)))
        for tag in ("ixy", "ixz", "iyz"):
            add(inertia, tag, "0")

    def _floor(self, inside: etree._Element) -> None:
        model, link, _ = self._model(inside, "ground_plane")
        model.append(link)
        side = numbers((_GROUND_SIDE_M, _GROUND_SIDE_M))
        for tag in ("collision", "visual"):
            part = add(link, tag, name=tag)
            plane = add(add(part, "geometry"), "plane")
            add(plane, "normal", "0 0 1")
            add(plane, "size", side)
        self._look(part, self._world.floor_material, _GREY)
        for room in self._world.rooms:
            model, link, _ = self._model(inside, f"room_{room.name}")
            model.append(link)
            visual = add(link, "visual", name="visual")
            annotate(visual, room=json.dumps(room.name))
            outline = doc.Polyline(polygons_m=(room.polygon_m,), height_m=SHEET_THICKNESS_M)
            self._geometry(visual, outline)
            self._look(visual, room.floor_material, _GREY, self._world.floor_material)

    def _ceiling(self, inside: etree._Element) -> None:
        ceiling = self._world.ceiling
        if ceiling is None:
            return
        reach_m = [
            (wall.x_m + sign * wall.length_m / 2.0, wall.y_m + sign * wall.length_m / 2.0)
            for wall in self._world.walls
            for sign in (-1.0, 1.0)
        ] or [(-5.0, -5.0), (5.0, 5.0)]
        (x0, y0), (x1, y1) = np.min(reach_m, axis=0), np.max(reach_m, axis=0)
        model, link, _ = self._model(inside, "ceiling")
        at = ((x0 + x1) / 2.0, (y0 + y1) / 2.0, ceiling.height_m + SHEET_THICKNESS_M / 2.0)
        add(model, "pose", f"{numbers(at)} 0 0 0")
        model.append(link)
        visual = add(link, "visual", name="visual")
        annotate(visual, ceiling=repr(ceiling.height_m))
        add(visual, "cast_shadows", "false")
        add_box(visual, (float(x1 - x0), float(y1 - y0), SHEET_THICKNESS_M))
        self._look(visual, ceiling.material)

    def _markers(self, inside: etree._Element) -> list[dict[str, object]]:
        """Include a model for every placed marker; returns the note of each marker."""
        entities, _ = marker_entities(self._world, max_markers=len(self._world.markers))
        pose_of = {entity.name: entity.position_m for entity in entities.markers}
        walls = {wall.name: wall for wall in self._world.walls}
        own = own_dictionaries(self._world.dictionaries)
        notes: list[dict[str, object]] = []
        for marker in self._world.markers:
            entity = marker.name
            panel = None
            book = own.get(marker.dictionary)
            if not identity_problem(marker, book) and marker.wall in walls:
                wall = walls[marker.wall]
                panel = hang(entity, marker, wall, panel_side_m(marker, book), PanelStyle().gap_m)
            # Of several of one id, the placed one.
            if panel is None or pose_of.get(entity) != tuple(panel.centre_m.tolist()):
                notes.append(marker.model_dump())
                continue
            del pose_of[entity]
            name = self._names.give(entity)
            include = add(inside, "include")
            add(include, "name", name)
            add(include, "uri", f"model://{model_name(marker.id)}")
            yaw_rad = math.atan2(panel.right[1], panel.right[0])
            add(include, "pose", numbers((*panel.centre_m, math.pi / 2.0, 0.0, yaw_rad)))
            place = marker.model_dump(include={"wall", "offset_m", "height_m"})
            notes.append({"model": name, **place})
            for file, data in marker_model_files(marker).items():
                self._files[f"{model_name(marker.id)}/{file}"] = data
        return notes

    def _look(
        self, visual: etree._Element, name: str, none: doc.Rgba = _GREY, instead: str = ""
    ) -> None:
        """Add the look of a material; if there is none, of `instead`, or plain."""
        annotate(visual, material=name)
        material = self._materials.get(name or instead)
        if material is None:
            add_look(visual, none, none)
            return
        annotate(visual, texture_side_m=repr(material.texture_side_m))
        texture = self._uri_of_texture.get(material.texture_sha256, "")
        add_look(visual, material.ambient, material.diffuse, texture)

    def _geometry(self, part: etree._Element, shape: doc.Geometry) -> None:
        geometry = add(part, "geometry")
        kind = add(geometry, shape.kind)
        match shape:
            case doc.Box():
                add(kind, "size", numbers(shape.size_m))
            case doc.Cylinder() | doc.Cone() | doc.Capsule():
                add(kind, "radius", numbers((shape.radius_m,)))
                add(kind, "length", numbers((shape.length_m,)))
            case doc.Sphere():
                add(kind, "radius", numbers((shape.radius_m,)))
            case doc.Ellipsoid():
                add(kind, "radii", numbers(shape.radii_m))
            case doc.Plane():
                add(kind, "normal", "0 0 1")
                add(kind, "size", numbers(shape.size_m))
            case doc.Polyline():
                for index, polygon in enumerate(shape.polygons_m):
                    line = add(geometry, "polyline") if index else kind
                    for point in polygon:
                        add(line, "point", numbers(point))
                    add(line, "height", numbers((shape.height_m,)))
            case doc.Mesh():
                uri, submesh = self._mesh_places[shape.sha256]
                add(kind, "uri", uri)
                if submesh:
                    add(add(kind, "submesh"), "name", submesh)
                add(kind, "scale", numbers(shape.scale))

    def _place_textures(self) -> None:
        names = _Names()
        for material in self._world.materials:
            sha256 = material.texture_sha256
            if sha256 and sha256 not in self._uri_of_texture:
                uri = f"materials/textures/{_free_file(names, material.texture_name, '.png')}"
                self._files[uri] = self._loaded.assets[sha256]
                self._uri_of_texture[sha256] = uri

    def _place_meshes(self) -> None:
        """One GLB for every source file of meshes, with the parts that are used."""
        sources: dict[str, dict[str, tuple[str, str]]] = {}
        for body in self._world.bodies:
            for shape in body.shapes:
                if isinstance(shape.geometry, doc.Mesh):
                    found = _MESH_FILE.fullmatch(shape.geometry.name)
                    file = found["file"] if found else shape.geometry.name
                    part = (found["part"] if found else "") or ""
                    parts = sources.setdefault(file, {})
                    # Of two with the same name, one gets a separate file.
                    if part in parts and parts[part][0] != shape.geometry.sha256:
                        parts = sources.setdefault(f"{file}-{shape.geometry.sha256[:8]}", {})
                    parts[part] = (shape.geometry.sha256, part)
        if not sources:
            return
        # Imports of mesh writers are slow, and most worlds have none.
        from mazebot.worldgen.assets.glb import glb_of  # noqa: PLC0415
        from mazebot.worldgen.assets.meshes import MeshPart  # noqa: PLC0415

        names = _Names()
        for file, parts in sources.items():
            uri = f"meshes/{_free_file(names, file + '.glb', '.glb')}"
            self._files[uri] = glb_of(
                tuple(
                    MeshPart(part, self._mesh(sha), None, None, "") for sha, part in parts.values()
                )
            )
            for sha256, part in parts.values():
                self._mesh_places.setdefault(sha256, (uri, part if len(parts) > 1 else ""))

    def _mesh(self, sha256: str) -> TriangleMesh:
        mesh = self._loaded.meshes.get(sha256)
        return mesh_from_bytes(self._loaded.assets[sha256]) if mesh is None else mesh


def add_box(part: etree._Element, size_m: tuple[float, float, float]) -> None:
    """Append the geometry of a box."""
    add(add(add(part, "geometry"), "box"), "size", numbers(size_m))


def _pose(
    element: etree._Element, position_m: doc.Vector, orientation_xyzw: doc.Quaternion
) -> None:
    if orientation_xyzw == (0.0, 0.0, 0.0, 1.0):
        add(element, "pose", f"{numbers(position_m)} 0 0 0")
    else:
        text = f"{numbers(position_m)} {numbers(orientation_xyzw)}"
        # Euler angles would lose digits at a pitch near 90 degrees.
        add(element, "pose", text, rotation_format="quat_xyzw")


def _name_note(wanted: str, given: str) -> dict[str, str]:
    return {} if wanted == given else {"name": json.dumps(wanted)}


def _turn_note(orientation_xyzw: doc.Quaternion) -> dict[str, str]:
    if orientation_xyzw == (0.0, 0.0, 0.0, 1.0):
        return {}
    return {"orientation_xyzw": json.dumps(orientation_xyzw)}


def _corners_m(shape: doc.Shape, mesh_of: Callable[[str], TriangleMesh]) -> Array:
    """(n, 3) vertices of a shape in the body's frame."""
    geometry = shape.geometry
    meshes = {geometry.sha256: mesh_of(geometry.sha256)} if isinstance(geometry, doc.Mesh) else {}
    rotation = rotation_from_quaternion(*shape.orientation_xyzw)
    body_from_shape = transform_matrix(rotation, shape.position_m)
    return triangles_of(geometry, meshes).moved(body_from_shape).vertices_m


def _free_file(names: _Names, wanted: str, suffix: str) -> str:
    """An unused file name: the wanted one's letters, with the suffix."""
    stem = wanted.removesuffix(suffix)
    stem = "".join(c if c.isascii() and (c.isalnum() or c in "_-.") else "_" for c in stem)
    return names.give(f"{stem.lstrip('_-.') or 'unnamed'}{suffix}")
