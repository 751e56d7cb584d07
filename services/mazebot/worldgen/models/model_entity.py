"""A model in a file, or a mesh, as one rigid body that can be spawned in a world."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from pydantic import ValidationError

from mazebot.common.config import ConfigError, one_line
from mazebot.common.maths import portable
from mazebot.common.maths.frames import inverse_matrix, pose_matrix, rotation_from_quaternion
from mazebot.common.messages.documents import Material, Mesh, Quaternion, Shape
from mazebot.common.problems import field_name, shown_value, words
from mazebot.common.world.geometry import TriangleMesh, mesh_to_bytes, triangles_of
from mazebot.worldgen.recipe.mistakes import mistakes
from mazebot.worldgen.recipe.resolve import MeshAsset, MeshKey, mesh_keys, resolve, with_textures
from mazebot.worldgen.recipe.texture_file import read_texture_file
from mazebot.worldgen.recipe_model import Recipe
from mazebot.worldgen.sdf.convert import to_recipe
from mazebot.worldgen.sdf.files.locate import SHIPPED
from mazebot.worldgen.sdf.model import SdfLink, SdfModel, SdfWorld
from mazebot.worldgen.sdf.reading.read import read_sdf


@dataclass(frozen=True, eq=False)
class Model:
    """The contents of a body, in the frame of its model."""

    shapes: tuple[Shape, ...]
    materials: tuple[Material, ...]
    mass_kg: float
    """0: it is static."""
    assets: dict[str, bytes]
    """PNG of textures and .npz of meshes, by sha256."""
    meshes: dict[str, TriangleMesh]
    """Of the assets that are meshes, by sha256."""
    marker: dict[str, str]
    """Attributes of an ArUco marker's model as `mazebot markers make` writes them: `marker` (its
    id), `dictionary`, `size_m`, `quiet_zone_modules`. Empty for any other.
    """
    missing: tuple[str, ...] = ()
    """Pictures and meshes of visuals that cannot be had, a line each."""
    ignored: tuple[str, ...] = ()
    """Contents of the files that are not simulated, one line each."""
    name: str = ""
    """As its file says; empty for a mesh."""


def find_model(name: str, roots: Sequence[Path] = ()) -> Path:
    """The file or folder of a model: a path, or the name of a folder in one of the roots or among
    the shipped models. Raises ConfigError.
    """
    try:
        if Path(name).exists():
            return Path(name)
    except (OSError, ValueError):
        pass
    return named_model(name, roots)


def named_model(name: str, roots: Sequence[Path] = ()) -> Path:
    """The folder of a model by its name, in one of the roots or among the shipped models. Raises
    ConfigError.
    """
    for folder in (*roots, SHIPPED):
        try:
            if (folder / name).exists():
                return folder / name
        except (OSError, ValueError):
            continue
    known = ", ".join(model_names(roots))
    raise ConfigError(
        words(f"model: {name!r:.100}: must be a file, a folder, or one of {known:.300}")
    )


def model_names(roots: Sequence[Path] = ()) -> list[str]:
    """The names that `named_model` takes, sorted."""
    folders = (*roots, SHIPPED)
    return sorted({path.parent.name for one in folders for path in one.glob("*/model.config")})


def read_model(
    path: Path,
    roots: Sequence[Path] = (),
    arguments: Mapping[str, str] = MappingProxyType({}),
) -> Model:
    """The model in an SDF, URDF or xacro file, or in a model's folder; all its links become one.

    Raises ConfigError, in one line, if a file is invalid, if there is not exactly one model, or if
    a joint lets its links move.
    """
    sdf = read_sdf(path, roots, arguments)
    _raise_first(f"{error.where}: {error.message}" for error in sdf.report.errors)
    model, links = _one_rigid_model(path, sdf)
    marker = {name: value for name, value in model.attributes.items() if not name.startswith("_")}
    converted = to_recipe(_merged(sdf, model, links), "model")
    _raise_first(f"{error.where}: {error.message}" for error in converted.report.errors)
    missing = [f"{one.where}: {one.message}" for one in converted.report.missing]
    if not converted.recipe.get("bodies"):
        _raise_first(missing)
        raise ConfigError(words(f"{path}: contains only a floor, must contain a body"))
    made = _made(path, converted.recipe, converted.files)
    static = all(link.static for link in links)
    return dataclasses.replace(
        made,
        name=model.name,
        mass_kg=0.0 if static else sum(link.mass_kg for link in links),
        marker=marker if "marker" in marker else {},
        missing=tuple(missing),
        ignored=tuple(f"{one.where}: {one.what}" for one in converted.report.ignored),
    )


def read_mesh(path: Path, scale: Sequence[float] = (1.0, 1.0, 1.0)) -> Model:
    """A mesh in a file as a static body, with the file's own materials; white if it has none.
    Raises ConfigError.
    """
    # Imports of mesh readers are slow.
    from mazebot.worldgen.assets.meshes import load_mesh  # noqa: PLC0415

    missing: list[str] = []
    parts = load_mesh(path, missing=missing)
    geometry = {"kind": "mesh", "file": "mesh", "scale": list(scale)}
    shape = {"name": "mesh", "geometry": geometry, "material": "mesh"}
    recipe = {
        "name": "mesh",
        "wall_height_m": 1.0,
        "wall_thickness_m": 0.1,
        "materials": {"white": {}},
        "wall_materials": ["white"],
        "bodies": [{"name": "mesh", "position_m": [0.0, 0.0, 0.0], "shapes": [shape]}],
    }
    made = _made(path, recipe, {}, {"mesh": parts})
    return dataclasses.replace(made, missing=tuple(f"{path.name}: {one}" for one in missing))


def lowest_m(
    shapes: Iterable[Shape], meshes: Mapping[str, TriangleMesh], orientation_xyzw: Quaternion
) -> float:
    """Height of a body's lowest point relative to its origin, in its orientation."""
    map_from_thing = rotation_from_quaternion(*orientation_xyzw)
    lows = []
    for shape in shapes:
        surface = triangles_of(shape.geometry, meshes).moved(pose_matrix(shape))
        if len(surface.vertices_m):
            lows.append(float((portable.product(surface.vertices_m, map_from_thing[2])).min()))
    return min(lows, default=0.0)


def _raise_first(errors: Iterable[str]) -> None:
    lines = list(errors)
    if lines:
        more = f" (and {len(lines) - 1} more)" if len(lines) > 1 else ""
        raise ConfigError(words(f"{lines[0]}{more}"))


def _one_rigid_model(path: Path, sdf: SdfWorld) -> tuple[SdfModel, tuple[SdfLink, ...]]:
    """The one model of a file and its links. Raises ConfigError."""
    outermost = [model for model in sdf.models if "::" not in model.name]
    if len(outermost) != 1:
        names = ", ".join(model.name for model in outermost) or "none"
        raise ConfigError(words(f"{path}: must contain one model, has {names:.200}"))
    _raise_first(
        f"{one.where}: {one.what.rpartition(': ')[0]}: must be fixed: what is put into a world is "
        "one rigid body"
        for one in sdf.report.ignored
        if one.what.startswith("joint ")
    )
    links = sdf.links
    if not links:
        raise ConfigError(words(f"{path}: model {outermost[0].name!r:.60} has no links"))
    loose = [link for link in links if link.fixed_to != links[0].fixed_to and not link.static]
    if loose:
        raise ConfigError(
            words(
                f"{path}: link {loose[0].name!r:.60}: must be joined to {links[0].name!r:.60} by "
                "fixed joints: what is put into a world is one rigid body"
            )
        )
    return outermost[0], links


def _merged(sdf: SdfWorld, model: SdfModel, links: Sequence[SdfLink]) -> SdfWorld:
    """The same with all links merged into one, at the model's frame, at the world's origin."""
    model_from_world = inverse_matrix(model.world_from_model)
    shapes = []
    for link in links:
        model_from_link = portable.product(model_from_world, link.world_from_link)
        for shape in link.shapes:
            placed = portable.product(model_from_link, shape.link_from_shape)
            shapes.append(dataclasses.replace(shape, link_from_shape=placed))
    one = dataclasses.replace(
        links[0],
        world_from_link=np.eye(4),
        static=all(link.static for link in links),
        fixed_to=links[0].name,
        shapes=tuple(shapes),
        # Otherwise an upright box of an import becomes a wall.
        attributes={**links[0].attributes, "kind": "body"},
    )
    return dataclasses.replace(sdf, models=(), links=(one,), lights=(), attributes={})


def _made(
    path: Path,
    content: Mapping[str, Any],
    files: Mapping[str, bytes],
    parts_of: Mapping[str, Sequence[Any]] = MappingProxyType({}),
) -> Model:
    """The one body of a recipe. `files` are by their path from the recipe's folder, `parts_of` the
    parts of meshes that were already read, by file. Raises ConfigError.
    """
    try:
        recipe = Recipe.model_validate_json(json.dumps(content), strict=True)
    except ValidationError as error:
        raise ConfigError(words(f"{path}: {one_line(error):.300}")) from error
    _raise_first(
        f"{path}: {field_name(one.location)}: {shown_value(one.value)}: {one.must}"
        for one in mistakes(recipe, [])
    )
    assets: dict[str, bytes] = {}
    meshes: dict[str, TriangleMesh] = {}

    def asset(data: bytes) -> str:
        sha256 = hashlib.sha256(data).hexdigest()
        assets[sha256] = data
        return sha256

    found: dict[MeshKey, list[MeshAsset]] = {}
    for _, key in mesh_keys(recipe):
        if key in found:
            continue
        found[key] = []
        for index, part in enumerate(parts_of.get(key[0]) or _parts(files, key)):
            sha256 = asset(mesh_to_bytes(part.mesh))
            meshes[sha256] = part.mesh
            texture_sha256 = asset(part.texture) if part.texture else ""
            name = f"{key[0]}.{part.name or index}"
            found[key].append(
                MeshAsset(name, sha256, part.mesh, part.diffuse, texture_sha256, part.texture_name)
            )
    textures = {
        material.texture: asset(files[f"textures/{material.texture}"])
        for material in recipe.materials.values()
        if material.texture is not None
    }
    world = with_textures(resolve(recipe, "", None, found, use_aruco=False), textures)
    (body,) = world.bodies
    used = {shape.material for shape in body.shapes}
    needed = {shape.geometry.sha256 for shape in body.shapes if isinstance(shape.geometry, Mesh)}
    materials = tuple(material for material in world.materials if material.name in used)
    needed |= {material.texture_sha256 for material in materials}
    return Model(
        shapes=body.shapes,
        materials=materials,
        mass_kg=0.0,
        assets={sha256: data for sha256, data in assets.items() if sha256 in needed},
        meshes=meshes,
        marker={},
    )


def _parts(files: Mapping[str, bytes], key: MeshKey) -> Sequence[Any]:
    from mazebot.worldgen.assets.meshes import load_mesh  # noqa: PLC0415

    file, submesh, center = key
    return load_mesh(Path(file), submesh, center, files[f"meshes/{file}"])


def texture_asset(path: Path) -> bytes:
    """The bytes of a PNG file. Raises ConfigError."""
    try:
        return read_texture_file(path)
    except ValueError as error:
        raise ConfigError(words(f"{path}: {error}")) from error
