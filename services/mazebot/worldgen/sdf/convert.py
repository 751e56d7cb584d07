"""Converts a resolved SDF world to a recipe, with the images and meshes that it needs."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import FiniteFloat, TypeAdapter

from mazebot.common.config import ConfigError
from mazebot.common.files.limits import MAX_DOCUMENT_BYTES
from mazebot.common.files.reading import NotReadableError, read_limited, reason
from mazebot.common.maths.frames import Array, inverse_matrix, quaternion_from_rotation
from mazebot.common.messages import documents as doc
from mazebot.common.world.placement import CONTACT_M
from mazebot.worldgen.recipe_model import MAX_COORDINATE_M, MeshGeometry
from mazebot.worldgen.sdf.floor import (
    ALIGNED,
    FLOOR_M,
    Floor,
    floor_of,
    level_height,
    lowered,
)
from mazebot.worldgen.sdf.model import (
    Ignored,
    SdfError,
    SdfLink,
    SdfMaterial,
    SdfModel,
    SdfShape,
    SdfWorld,
)
from mazebot.worldgen.sdf.notes import (
    SAME,
    TEXT,
    colour,
    from_json,
    noted,
    number,
    numbers,
    strength,
    validated,
)
from mazebot.worldgen.sdf.parts import Group, Part, groups_of, product
from mazebot.worldgen.sdf.pictures import picture_as_png
from mazebot.worldgen.sdf.recipe_file import ImportedWorld

MAX_LIGHTS = 8

_LEANS = 1e-3
"""Sine of the maximum tilt of a marker, or of its angle to its wall."""
_DEFAULT_DIFFUSE = (0.7, 0.7, 0.7, 1.0)
_WHITE = (1.0, 1.0, 1.0, 1.0)
# SDF's defaults for worlds whose scene or lights do not set these.
_SDF_AMBIENT = (0.4, 0.4, 0.4, 1.0)

_NUMBER: TypeAdapter[float] = TypeAdapter(FiniteFloat)
_NOTES = TypeAdapter(list[dict[str, Any]])
_MARKER = TypeAdapter(doc.Marker)
_PLANAR = TypeAdapter(doc.Planar)
_LOCATIONS = TypeAdapter(list[doc.Location])
_ZONES: Mapping[str, TypeAdapter[Any]] = {
    "keepout_zones": TypeAdapter(list[doc.KeepoutZone]),
    "speed_limits": TypeAdapter(list[doc.SpeedZone]),
}


def to_recipe(sdf: SdfWorld, name: str) -> ImportedWorld:
    """The recipe, named `name`, of an SDF world.

    The floor is as `floor_of` finds it, and the world is moved so that it is at z = 0. A static,
    solid, visible, upright box on the floor becomes a wall, the first directional light the sun, a
    panel as written by marker_model a marker on its wall, the pose of the one model with a plugin
    that drives it the start; everything else becomes a body, one for all links connected by fixed
    joints. Anything
    that cannot be converted is added to the report's `ignored`, an unreadable mesh to its `errors`,
    and an image or mesh that is only seen to what is `missing`. Raises nothing.
    """
    return _Conversion(sdf, name).run()


class _Conversion:
    def __init__(self, sdf: SdfWorld, name: str) -> None:
        self._sdf = sdf
        self._name = name
        self._ignored: list[Ignored] = []
        self._errors: list[SdfError] = []
        self._told: list[str] = []
        self._missing: list[SdfError] = []
        self._files: dict[str, bytes] = {}
        self._materials: dict[str, dict[str, Any]] = {}
        self._material_names: set[str] = set()
        self._looks: dict[str, dict[str, str]] = {}
        """Names and appearances of materials, by the requested name."""
        self._textures: dict[Path, str] = {}
        """File name in the folder of textures, by image; empty if it is unreadable."""
        self._meshes: dict[tuple[Path, str | None, bool], tuple[str, str | None]] = {}
        """File name in the folder of meshes, and submesh."""
        self._walls: list[dict[str, Any]] = []
        self._bodies: list[dict[str, Any]] = []
        self._rooms: dict[str, Any] = {}
        self._ceiling: dict[str, Any] | None = None
        self._floor = Floor()
        self._has_floor = False
        self._floor_material: str | None = None
        self._taken: set[str] = set()
        self._wall_of_link: dict[str, str] = {}

    def run(self) -> ImportedWorld:
        markers = {model.name: model for model in self._sdf.models if "marker" in model.attributes}
        start = self._start()
        groups = tuple(groups_of(self._sdf.links, markers))
        self._floor = floor_of(groups, (start["x_m"], start["y_m"]) if start else (0.0, 0.0))
        if abs(self._floor.level_m) > FLOOR_M:
            self._sdf = lowered(self._sdf, self._floor.level_m)
            markers = {model.name: model for model in self._sdf.models if model.name in markers}
            groups = tuple(groups_of(self._sdf.links, markers))
        for group in groups:
            self._convert(group)
        found_markers = self._markers(markers)
        recipe: dict[str, Any] = {
            "name": self._name,
            "wall_height_m": _commonest([wall["height_m"] for wall in self._walls], 1.0),
            "wall_thickness_m": _commonest([wall["thickness_m"] for wall in self._walls], 0.15),
        }
        for wall in self._walls:
            for key in ("height_m", "thickness_m"):
                if wall[key] == recipe[f"wall_{key}"]:
                    del wall[key]
        if start is not None:
            recipe["start"] = start
        recipe |= self._map_and_places()
        recipe |= self._lights()
        recipe["materials"] = self._materials or {"plain": _look(None)}
        recipe["wall_materials"] = [next(iter(recipe["materials"]))]
        if self._floor_material is not None:
            recipe["floor_material"] = self._floor_material
        if self._ceiling is not None:
            recipe["ceiling"] = self._ceiling
        for key, value in (
            ("rooms", self._rooms),
            ("markers", found_markers),
            ("walls", self._walls),
            ("bodies", self._bodies),
        ):
            if value:
                recipe[key] = value
        report = self._sdf.report.model_copy(
            update={
                "ignored": (*self._sdf.report.ignored, *self._ignored),
                "errors": (*self._sdf.report.errors, *self._errors),
                "missing": (*self._sdf.report.missing, *self._missing),
                "floor": self._told_floor(),
                "told": (*self._told, *self._floor.told),
            }
        )
        return ImportedWorld(recipe, self._files, report)

    def _start(self) -> dict[str, float] | None:
        """Take the one model that a plugin drives out of the world: the pose where it stands, for
        our robot takes its place. None if there is no such model, or more than one.
        """
        drives: dict[str, str] = {}
        for model in self._sdf.models:
            if model.drive and not model.static:
                drives.setdefault(model.name.partition("::")[0], model.drive)
        for name, plugin in drives.items() if len(drives) > 1 else ():
            self._told.append(
                f"model {name} stands still as an obstacle: nothing drives it ({plugin})"
            )
        if len(drives) != 1:
            return None
        ((name, plugin),) = drives.items()
        pose = next(one.world_from_model for one in self._sdf.models if one.name == name)
        x_m, y_m = numbers(pose[:2, 3])
        self._told.append(
            f"model {name} is a robot ({plugin}): Mazebot's starts in its place, at "
            f"({x_m:g}, {y_m:g})"
        )
        others = (one for one in self._sdf.links if one.model.partition("::")[0] != name)
        self._sdf = replace(self._sdf, links=tuple(others))
        return {"x_m": x_m, "y_m": y_m, "yaw_rad": number(math.atan2(pose[1, 0], pose[0, 0]))}

    def _told_floor(self) -> str:
        height_m = self._floor.level_m
        if abs(height_m) <= FLOOR_M:
            return ""
        what = self._floor.slabs[0] if self._floor.slabs else "the ground plane"
        moved = f"{'lowered' if height_m > 0.0 else 'raised'} by {abs(height_m):g} m"
        return f"{what}, at z = {height_m:g} m: the world is {moved}"

    # Converts groups to walls, bodies, floor, rooms and ceiling

    def _convert(self, group: Group) -> None:
        for link in group.links:
            for shape in link.shapes:
                self._room_or_ceiling(link, shape)
        parts = [part for part in group.parts if not self._is_floor(group, part)]
        if not parts:
            return
        # A wall's group contains only upright boxes on the floor; a table's does not.
        poses = [product(group.world_from_body, part.body_from_part) for part in parts]
        is_wall = (
            group.static
            and group.links[0].attributes.get("kind") != "body"
            and all(
                _is_wall(part, pose, self._floor.level_m)
                for part, pose in zip(parts, poses, strict=True)
            )
        )
        if is_wall:
            for part, pose in zip(parts, poses, strict=True):
                more = "" if len(parts) == 1 else f"_{part.name}"
                names = [_legal(f"{name}{more}") for name in (group.name, group.full_name)]
                self._wall(group, part, pose, self._free(names, self._taken))
        else:
            self._body(group, parts)

    def _room_or_ceiling(self, link: SdfLink, shape: SdfShape) -> None:
        if shape.role != "visual":
            return
        pose = product(link.world_from_link, shape.link_from_shape)
        room = from_json(shape.attributes.get("room"), TEXT)
        if room is not None and isinstance(shape.geometry, doc.Polyline):
            corners = shape.geometry.polygons_m[0]
            moved = [pose @ np.array([x, y, 0.0, 1.0]) for x, y in corners]
            look: dict[str, Any] = {"polygon_m": [corner[:2].tolist() for corner in moved]}
            material = self._material(shape)
            if material is not None:
                look["floor_material"] = material
            self._rooms[self._free((_legal(room),), set(self._rooms))] = look
        elif "ceiling" in shape.attributes and isinstance(shape.geometry, doc.Box):
            bottom_m = float(pose[2, 3]) - shape.geometry.size_m[2] / 2.0
            (bottom_m,) = noted([bottom_m], f"[{shape.attributes['ceiling']}]")
            self._ceiling = {
                "material": self._material(shape) or self._named("colour", _look(None)),
                "height_m": bottom_m,
            }

    def _is_floor(self, group: Group, part: Part) -> bool:
        """Whether a part is the floor, is under it, or is an infinite plane that cannot be
        simulated.
        """
        if part.solid and part.where in self._floor.slabs:
            if part.visual is not None and part.where == self._floor.slabs[0]:
                self._floor_material = self._material(part.visual)
            return True
        height_m = level_height(group, part) if group.static else None
        on_floor = height_m is not None and abs(height_m) <= FLOOR_M
        if part.has_end:
            # A visual on a floor's collision defines the floor's material.
            is_floor = (
                on_floor
                and isinstance(part.geometry, doc.Plane)
                and not part.solid
                and any(not other.has_end for other in group.parts)
            )
        elif on_floor and not self._has_floor:
            is_floor = self._has_floor = True
        elif height_m is not None and height_m < 0.0 and abs(self._floor.level_m) > FLOOR_M:
            return True
        else:
            self._ignore("plane collision that is not the floor", part.where, solid=True)
            return part.visual is None
        if is_floor and part.visual is not None and self._floor_material is None:
            self._floor_material = self._material(part.visual)
        return is_floor

    def _wall(self, group: Group, part: Part, pose: Array, name: str) -> None:
        assert isinstance(part.geometry, doc.Box)
        length_m, thickness_m, height_m = part.geometry.size_m
        if pose[2, 3] < height_m / 2.0 - FLOOR_M:
            # Its foot is under the floor.
            height_m = number(pose[2, 3] + height_m / 2.0)
        yaw_rad = math.atan2(pose[1, 0], pose[0, 0])
        if group.links[0].attributes.get("kind") != "wall" and thickness_m > length_m:
            length_m, thickness_m = thickness_m, length_m
            yaw_rad = math.remainder(yaw_rad + math.pi / 2.0, math.tau)
        noted_rad = from_json(group.links[0].attributes.get("yaw_rad"), _NUMBER)
        if noted_rad is not None and abs(math.remainder(noted_rad - yaw_rad, math.tau)) <= SAME:
            yaw_rad = noted_rad
        wall: dict[str, Any] = {
            "name": name,
            "length_m": length_m,
            "x_m": float(pose[0, 3]),
            "y_m": float(pose[1, 3]),
            "yaw_rad": number(yaw_rad),
            "thickness_m": thickness_m,
            "height_m": height_m,
        }
        assert part.visual is not None
        wall["material"] = self._material(part.visual)
        coverings = []
        for body_from_covering, shape in group.coverings:
            covering = product(inverse_matrix(part.body_from_part), body_from_covering)
            material = self._material(shape)
            if isinstance(shape.geometry, doc.Box) and material is not None:
                half_m, along_m = shape.geometry.size_m[0] / 2.0, float(covering[0, 3])
                span_m = [along_m - half_m, along_m + half_m]
                from_m, to_m = noted(span_m, shape.attributes.get("span_m"))
                coverings.append(
                    {
                        "side": "left" if covering[1, 3] > 0.0 else "right",
                        "from_m": from_m,
                        "to_m": to_m,
                        "material": material,
                    }
                )
        if coverings:
            wall["coverings"] = coverings
        self._walls.append(wall)
        self._wall_of_link[group.links[0].name] = name

    def _body(self, group: Group, parts: Sequence[Part]) -> None:
        shapes: list[dict[str, Any]] = []
        taken: set[str] = set()
        lacking = False
        for part in parts:
            geometry = self._geometry(part)
            if geometry is None:
                lacking |= not part.solid
                continue
            material = None
            if part.visual is not None:
                material = self._material(part.visual, geometry.get("file"))
            name = self._free((part.name,), taken)
            shape = {
                "name": name,
                "geometry": geometry,
                **_placed(part.body_from_part, part.attributes),
            }
            if material is not None:
                shape["material"] = material
            if not (part.solid and part.has_end):
                shape["solid"] = False
            shapes.append(shape)
        if not shapes:
            return
        if lacking and not any("material" in shape for shape in shapes):
            # Otherwise nothing would be seen of it.
            for shape in shapes:
                shape["material"] = self._named("colour", _look(None))
        names = (group.name, group.full_name)
        printable = ["".join(c if c.isprintable() else "_" for c in name) for name in names]
        name = self._free(printable, self._taken)
        body = {"name": name, **_placed(group.world_from_body, group.links[0].attributes)}
        body.setdefault("position_m", [0.0, 0.0, 0.0])
        if not group.static and group.mass_kg > 0.0:
            body["mass_kg"] = group.mass_kg
        body["shapes"] = shapes
        self._bodies.append(body)

    def _geometry(self, part: Part) -> dict[str, Any] | None:
        """As in a recipe; None if it is an unreadable mesh."""
        geometry = part.geometry
        if not isinstance(geometry, MeshGeometry):
            return geometry.model_dump(mode="json")
        if part.mesh_file is None:
            self._lack(part, "URI_LOOKUP", f"{geometry.file}: does not exist")
            return None
        key = (part.mesh_file, geometry.submesh, geometry.center)
        if key not in self._meshes:
            try:
                self._meshes[key] = self._mesh(*key, part.where)
            except ConfigError as error:
                self._lack(part, "MESH_INVALID", str(error))
                return None
        file, submesh = self._meshes[key]
        named = {"kind": "mesh", "file": file}
        return {**named, **({"submesh": submesh} if submesh else {}), "scale": list(geometry.scale)}

    def _mesh(
        self, file: Path, submesh: str | None, center: bool, where: str
    ) -> tuple[str, str | None]:
        """Add a mesh to the files: the name of its file, and the submesh. Raises ConfigError."""
        # Imports of mesh readers are slow, and most worlds have none.
        from mazebot.worldgen.assets.glb import glb_of  # noqa: PLC0415
        from mazebot.worldgen.assets.meshes import load_mesh  # noqa: PLC0415

        missing: list[str] = []
        whole = load_mesh(file, missing=missing)
        for phrase in missing:
            self._missing.append(self._found("URI_LOOKUP", where, f"{file.name}: {phrase}"))
        if submesh is None and not center:
            return self._file("meshes", file.stem, ".glb", glb_of(whole)), None
        chosen = glb_of(load_mesh(file, submesh, center, missing=missing))
        named = tuple(part for part in whole if part.name == submesh)
        if named and glb_of(named) == chosen:
            return self._file("meshes", file.stem, ".glb", glb_of(whole)), submesh
        stem = f"{file.stem}-{submesh}" if submesh else file.stem
        return self._file("meshes", stem, ".glb", chosen), None

    # Materials

    def _material(self, visual: SdfShape, mesh: str | None = None) -> str | None:
        """Name of a visual's material, added to the materials; None if it is invisible.

        `mesh` is the file of its mesh, whose own material is the fallback.
        """
        name = visual.attributes.get("material")
        if name == "":
            return None
        if visual.material is None and mesh is not None and name is None:
            return mesh
        look = _look(visual.material)
        side_m = from_json(visual.attributes.get("texture_side_m"), _NUMBER)
        if side_m is not None and 0.0 <= side_m <= MAX_COORDINATE_M:
            look["texture_side_m"] = side_m
        if visual.material is not None and visual.material.albedo_map is not None:
            texture = self._texture(visual.material.albedo_map, visual.name)
            if texture:
                # Gazebo stretches an image over each face once.
                look = {"texture": texture, "texture_side_m": 0.0, **look}
            if name is None:
                name = visual.material.albedo_map.stem
        elif name is None and visual.material is not None:
            name = visual.material.script.rpartition("/")[2]
        return self._named(name or "colour", look)

    def _named(self, wanted: str, look: dict[str, Any]) -> str:
        """A name for this material: the wanted one may be in use by another."""
        known = self._looks.setdefault(_legal(wanted), {})
        key = repr(sorted(look.items()))
        if key not in known:
            base = _legal(wanted)
            known[key] = self._free([base, f"{base[:52]}_{len(known) + 1}"], self._material_names)
            self._materials[known[key]] = look
        return known[key]

    def _texture(self, picture: Path, where: str) -> str:
        """File name in the folder of textures; empty if the image is unreadable."""
        if picture not in self._textures:
            try:
                data = picture_as_png(picture)
            except ConfigError as error:
                self._missing.append(self._found("MATERIAL_INVALID", where, str(error)))
                self._textures[picture] = ""
            else:
                self._textures[picture] = self._file("textures", picture.stem, ".png", data)
        return self._textures[picture]

    def _file(self, folder: str, stem: str, suffix: str, data: bytes) -> str:
        """Add a file to those of the recipe: its name in the folder."""
        stem = _legal(stem)[: 64 - len(suffix)]
        name, count = f"{stem}{suffix}", 1
        while self._files.setdefault(f"{folder}/{name}", data) != data:
            count += 1
            name = f"{stem[: 58 - len(suffix)]}_{count}{suffix}"
        return name

    # Markers, lights, locations

    def _markers(self, models: Mapping[str, SdfModel]) -> list[dict[str, Any]]:
        """The noted markers in their order, then those whose models were added since the export."""
        left = dict(models)
        found = []
        for note in from_json(self._sdf.attributes.get("markers"), _NOTES) or []:
            if "model" not in note:
                marker = validated(_MARKER, note)
                if marker is not None:
                    found.append(marker.model_dump(mode="json"))
            elif str(note["model"]) in left:
                # A noted marker whose model is no longer in the file was removed.
                model = left.pop(str(note["model"]))
                found += self._marker(model, note)
        for model in left.values():
            found += self._marker(model, {})
        return found

    def _marker(self, model: SdfModel, note: Mapping[str, Any]) -> list[dict[str, Any]]:
        """The marker of a model, on its wall; empty if it is on no wall."""
        preferred = self._wall_of_link.get(str(note.get("wall")))
        places = [
            (wall["name"] != preferred, gap_m, index, place)
            for index, wall in enumerate(self._walls)
            for gap_m, place in _places(model.world_from_model, wall)
        ]
        if not places:
            name, why = model.attributes["marker"], _off_wall(model.world_from_model)
            self._ignore(f"marker {name}, which {why}", model.name)
            self._told.append(
                f"marker {name} ({model.name}) is left out, for it {why}: a marker hangs upright "
                "on a face of a wall"
            )
            return []
        *_, place = min(places, key=lambda one: one[:3])
        for key in ("offset_m", "height_m"):
            (place[key],) = noted([place[key]], f"[{note.get(key)!r}]")
        values = {key: model.attributes[key] for key in _MARKER_KEYS if key in model.attributes}
        marker = validated(_MARKER, {"id": model.attributes["marker"], **values, **place})
        if marker is None:
            self._ignore(f"marker {model.attributes['marker']!r:.40}, which is invalid", model.name)
            return []
        return [marker.model_dump(mode="json")]

    def _lights(self) -> dict[str, Any]:
        found: dict[str, Any] = {}
        if self._sdf.background is not None:
            found["sky"] = colour(self._sdf.background)
        suns, lamps = [], []
        for light in self._sdf.lights:
            if light.kind == "spot":
                self._ignore(f"spot light {light.name}", light.name)
            elif light.kind == "point":
                lamps.append(light)
            else:
                suns.append(light)
        if self._sdf.ambient is None and not self._sdf.lights:
            return found
        found["light"] = {"ambient": strength(self._sdf.ambient or _SDF_AMBIENT), "diffuse": 0.0}
        for light in suns[1:]:
            self._ignore(f"directional light {light.name}, the second", light.name)
        for light in suns[:1]:
            direction = light.world_from_light[:3, :3] @ np.array(light.direction)
            if np.abs(direction).max() < SAME:
                self._ignore(f"directional light {light.name} without a direction", light.name)
                continue
            found["light"]["direction"] = numbers(direction)
            found["light"]["diffuse"] = strength(light.diffuse)
        for light in lamps[MAX_LIGHTS:]:
            self._ignore(f"point light {light.name}, the ninth or later", light.name)
        taken: set[str] = set()
        for light in lamps[:MAX_LIGHTS]:
            name = self._free((_legal(light.name),), taken)
            found.setdefault("lights", []).append(
                {
                    "name": name,
                    "position_m": light.world_from_light[:3, 3].tolist(),
                    "diffuse": colour(light.diffuse),
                    "range_m": light.range_m,
                    "constant": light.constant,
                    "linear": light.linear,
                    "quadratic": light.quadratic,
                }
            )
        return found

    def _map_and_places(self) -> dict[str, Any]:
        """Map, locations and zones from the notes of an export."""
        notes = self._sdf.attributes
        found: dict[str, Any] = {}
        resolution_m = from_json(notes.get("map_resolution_m"), _NUMBER)
        if resolution_m is not None:
            found["map_resolution_m"] = resolution_m
        ready = from_json(notes.get("map"), TEXT)
        if ready is not None:
            name = self._ready_map(ready)
            if name:
                found["map"] = name
        start = from_json(notes.get("start"), _PLANAR)
        if start is not None:
            found["start"] = start.model_dump()
        locations = from_json(notes.get("locations"), _LOCATIONS)
        if locations:
            found["locations"] = {
                place.name: place.model_dump(exclude={"name"}) for place in locations
            }
        for field, kind in _ZONES.items():
            if zones := from_json(notes.get(field), kind):
                found[field] = [zone.model_dump(mode="json", exclude_none=True) for zone in zones]
        return found

    def _ready_map(self, path: str) -> str:
        """Add a map beside the SDF file, and its image, to the files: its name; or empty."""
        folder = self._sdf.file.resolve().parent
        file = (folder / path).resolve()
        try:
            if not file.is_relative_to(folder) or file.suffix != ".yaml":
                raise OSError(0, "must be a YAML file beside the SDF file")
            beside = [one for one in sorted(file.parent.iterdir()) if one.stem == file.stem]
            for one in beside:
                if one.is_symlink():
                    raise OSError(0, f"{one.name} is a symbolic link")
                self._files[f"maps/{one.name}"] = read_limited(one, MAX_DOCUMENT_BYTES)
            return file.name
        except (OSError, NotReadableError) as error:
            what = f"map {path!r:.60}: {reason(error)}"
            self._errors.append(self._found("FILE_READ", str(file), what))
            return ""

    def _ignore(self, what: str, where: str, solid: bool = False) -> None:
        where = f"{self._sdf.file.name}: {where}"
        self._ignored.append(Ignored(what=what, where=where, solid=solid))

    def _lack(self, part: Part, kind: str, message: str) -> None:
        """A mesh cannot be had: an error, unless it is only seen."""
        found = self._errors if part.solid else self._missing
        found.append(self._found(kind, part.where, message))

    def _found(self, kind: str, where: str, message: str) -> SdfError:
        return SdfError(kind=kind, where=f"{self._sdf.file.name}: {where}", message=message)

    @staticmethod
    def _free(wanted: Sequence[str], taken: set[str]) -> str:
        """The first wanted name that is free, or one derived from the last; marks it as taken."""
        for name in wanted:
            if name not in taken:
                taken.add(name)
                return name
        count = 2
        while (name := f"{wanted[-1][:58]}_{count}") in taken:
            count += 1
        taken.add(name)
        return name


_MARKER_KEYS = ("dictionary", "size_m", "quiet_zone_modules")


def _is_wall(part: Part, world_from_part: Array, lowered_m: float) -> bool:
    """Whether a part is an upright box on the floor, or one whose foot went under it as the world
    was lowered.
    """
    if not isinstance(part.geometry, doc.Box):
        return False
    half_m = part.geometry.size_m[2] / 2.0
    foot_m, top_m = world_from_part[2, 3] - half_m, world_from_part[2, 3] + half_m
    return bool(
        part.solid
        and part.visual is not None
        and part.visual.attributes.get("material") != ""
        and world_from_part[2, 2] > 0.0
        and math.hypot(world_from_part[2, 0], world_from_part[2, 1]) <= ALIGNED
        and -max(lowered_m, 0.0) - FLOOR_M <= foot_m <= FLOOR_M < top_m
    )


def _places(
    world_from_panel: Array, wall: Mapping[str, Any]
) -> Iterator[tuple[float, dict[str, Any]]]:
    """Position of a panel on a wall, with its distance from the face; empty if not on the wall."""
    right, normal, centre = (world_from_panel[:3, column] for column in (0, 2, 3))
    if abs(right[2]) > _LEANS or abs(normal[2]) > _LEANS or world_from_panel[2, 1] < 0.0:
        return
    c, s = math.cos(wall["yaw_rad"]), math.sin(wall["yaw_rad"])
    dx, dy = centre[0] - wall["x_m"], centre[1] - wall["y_m"]
    along_m, out_m = c * dx + s * dy, c * dy - s * dx
    side = "left" if c * normal[1] - s * normal[0] > 0.0 else "right"
    sign = 1.0 if side == "left" else -1.0
    gap_m = sign * out_m - wall["thickness_m"] / 2.0
    if (
        sign * (c * normal[1] - s * normal[0]) >= math.sqrt(1.0 - _LEANS**2)
        and -FLOOR_M <= gap_m <= CONTACT_M
        and abs(along_m) <= wall["length_m"] / 2.0
        and 0.0 < centre[2] < wall["height_m"]
    ):
        at = {"wall": wall["name"], "side": side}
        yield gap_m, {**at, "offset_m": number(along_m), "height_m": float(centre[2])}


def _off_wall(world_from_panel: Array) -> str:
    """Why a panel can be on no wall, as a predicate."""
    right, up, normal = world_from_panel[2, :3].tolist()
    if abs(normal) > math.sqrt(1.0 - _LEANS**2):
        return "lies flat"
    if abs(normal) > _LEANS:
        return f"leans by {math.degrees(math.asin(abs(normal))):.1f} degrees"
    if abs(right) > _LEANS or up < 0.0:
        return f"is turned by {math.degrees(math.atan2(abs(right), up)):.1f} degrees in its plane"
    return "is not on a wall"


def _look(material: SdfMaterial | None) -> dict[str, Any]:
    """Colours as in a recipe. A missing one is set to the other; without any it is light grey, or
    white with a texture.
    """
    ambient = material.ambient if material else None
    diffuse = material.diffuse if material else None
    plain = _WHITE if material and material.albedo_map else _DEFAULT_DIFFUSE
    return {
        "ambient": colour(ambient or diffuse or plain),
        "diffuse": colour(diffuse or ambient or plain),
    }


def _placed(a_from_b: Array, attributes: Mapping[str, str]) -> dict[str, Any]:
    """Position and orientation, each only if it differs from a's."""
    placed: dict[str, Any] = {}
    if np.any(a_from_b[:3, 3]):
        placed["position_m"] = a_from_b[:3, 3].tolist()
    quaternion = numbers(quaternion_from_rotation(a_from_b[:3, :3]))
    note = attributes.get("orientation_xyzw")
    opposite = [0.0 - value for value in quaternion]
    quaternion = noted(quaternion, note, noted(opposite, note, quaternion))
    if quaternion != [0.0, 0.0, 0.0, 1.0]:
        placed["orientation_xyzw"] = quaternion
    return placed


def _commonest(values: Sequence[float], default: float) -> float:
    return Counter(values).most_common(1)[0][0] if values else default


def _legal(name: str) -> str:
    """A valid name in a recipe."""
    letters = "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "_" for c in name)
    return letters.lstrip("_.-")[:64] or "unnamed"
