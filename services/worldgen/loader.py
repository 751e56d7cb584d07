"""World recipes, textures, meshes and maps from files: the one place that reads them, and says
what is wrong.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from services.common.config import ROOT, ConfigError
from services.common.documents import World
from services.common.frames import SE2
from services.common.geometry import MAX_TRIANGLES, TriangleMesh, mesh_to_bytes
from services.worldgen import maze as mazes
from services.worldgen import png
from services.worldgen.mistakes import mistakes
from services.worldgen.occupancy import FREE, OCCUPIED, grid_of, occupancy
from services.worldgen.overrides import (
    MAX_OVERRIDES,
    parse_override,
    shown_override,
    with_value,
)
from services.worldgen.problems import (
    Location,
    Mistake,
    Problem,
    WorldError,
    field_name,
    shown_value,
    words,
)
from services.worldgen.recipe import MAX_ASSETS, Recipe
from services.worldgen.recipe_fields import fields_of, place_of
from services.worldgen.resolve import (
    MeshAsset,
    MeshKey,
    finished,
    maze_wall_names,
    mesh_keys,
    resolve,
)
from services.worldgen.yaml_source import Source, read_source

DEFAULT_WORLDS_DIR = ROOT / "worlds"
SHORT_NAMES = {"original": "sim_house", "enhanced": "sim_house_enhanced"}

_MAX_EXTENDS = 20


@dataclass(frozen=True)
class LoadedWorld:
    """A world, its assets, and its map as (rows, columns) cells of -1, 0 or 100."""

    world: World
    assets: dict[str, bytes]
    """PNG of textures and .npz of meshes, by their sha256 in hex."""
    map_cells: NDArray[np.int8]
    map_origin: SE2
    meshes: dict[str, TriangleMesh] = field(default_factory=dict)
    """Of the assets that are meshes, by their sha256 in hex."""
    recipe: Recipe | None = None
    """That the world was made from, overrides and all."""


def known_worlds(worlds_dir: Path = DEFAULT_WORLDS_DIR) -> list[str]:
    """Names of the recipes in a folder, sorted.

    Raises WorldError where there is no such folder.
    """
    try:
        return sorted(path.stem for path in worlds_dir.iterdir() if path.suffix == ".yaml")
    except OSError as error:
        raise WorldError(f"worlds_dir: {worlds_dir}: {error.strerror}") from error


def load_world(
    name: str,
    use_aruco: bool = True,
    worlds_dir: Path = DEFAULT_WORLDS_DIR,
    texture_base: Path | None = None,
    overrides: Sequence[str] = (),
) -> LoadedWorld:
    """Load a world by the name of its recipe, or by a short name.

    `texture_base` is the folder of the textures where that is not `textures` in `worlds_dir`.
    `overrides` are `field=value`, put over the recipe's in turn.

    Raises WorldError for everything that makes the world unusable: in its name, an override, the
    recipe, a texture, a mesh or a map. What only lacks something (a marker that cannot hang) is
    loaded: see check.problems_of.
    """
    return _loaded(named_sources(name, worlds_dir), use_aruco, worlds_dir, texture_base, overrides)


def load_file(
    path: Path,
    use_aruco: bool = True,
    texture_base: Path | None = None,
    overrides: Sequence[str] = (),
) -> LoadedWorld:
    """The same for a recipe's file, wherever it lies; what it needs lies beside it."""
    return _loaded(sources_of(path), use_aruco, path.parent, texture_base, overrides)


def _loaded(
    sources: Sequence[Source],
    use_aruco: bool,
    worlds_dir: Path,
    texture_base: Path | None,
    overrides: Sequence[str],
) -> LoadedWorld:
    loading = Loading(sources, use_aruco, worlds_dir, texture_base, overrides)
    fatal = [problem for problem in loading.problems if problem.fatal]
    if fatal or loading.loaded is None:
        raise WorldError(fatal or "cannot be loaded")
    return loading.loaded


class Loading:
    """What became of a recipe: the world where there is one, and everything that is wrong."""

    def __init__(
        self,
        sources: Sequence[Source],
        use_aruco: bool,
        worlds_dir: Path,
        texture_base: Path | None,
        overrides: Sequence[str],
    ) -> None:
        """`sources` are the recipe, then the one it extends, and so on."""
        self.problems: list[Problem] = []
        self.loaded: LoadedWorld | None = None
        self.textures_dir = texture_base or worlds_dir / "textures"
        self._sources = tuple(sources)
        self._overrides: list[tuple[Location, Source]] = []
        self._worlds_dir = worlds_dir
        self._assets: dict[str, bytes] = {}
        self._mesh_of: dict[str, TriangleMesh] = {}
        content = self._merged(overrides)
        if self.problems:
            return
        try:
            recipe = Recipe.model_validate(content, strict=True)
        except ValidationError as error:
            self._add_all(error)
            return
        self._build(recipe, Path(self._sources[0].file), use_aruco)

    def add(self, mistake: Mistake, missing: bool = False) -> None:
        """Add a problem, with the file and the line of its place."""
        location = mistake.location
        given = [source for place, source in self._overrides if location[: len(place)] == place]
        if given:
            source = given[-1]
        else:
            source = max(self._sources, key=lambda source: source.depth_of(location))
        self.problems.append(
            Problem(
                file=source.file,
                line=source.line_of(location),
                field=field_name(location),
                value="" if missing else shown_value(mistake.value),
                must=words(mistake.must),
                fatal=mistake.fatal,
            )
        )

    def read_texture(self, name: str, location: Location, fatal: bool = True) -> bytes | None:
        """The bytes of a texture; None where it is not one, which adds a problem."""
        path = self.textures_dir / name
        try:
            if not path.is_file():
                path.read_bytes()
            size = path.stat().st_size
            data = path.read_bytes() if size <= png.MAX_BYTES else b""
        except OSError as error:
            wrong = f"cannot be read ({error.strerror}), must be a PNG"
        else:
            wrong = png.problem(data) if data or not size else ""
            if size > png.MAX_BYTES:
                wrong = f"must have at most {png.MAX_BYTES} bytes"
            if not wrong:
                return data
        self.add(Mistake(location, name, f"{shown_path(path)} {wrong}", fatal))
        return None

    def _merged(self, overrides: Sequence[str]) -> dict[Any, Any]:
        """What the sources hold, the first over the others, and the overrides over all."""
        content: dict[Any, Any] = {}
        for source in reversed(self._sources):
            content = _merge(content, source.content)
        # What the requested file extends is said in the chain.
        content["extends"] = self._sources[0].content.get("extends")
        if len(overrides) > MAX_OVERRIDES:
            must = f"must be at most {MAX_OVERRIDES}"
            self.problems.append(Problem(field="overrides", value=f"{len(overrides)}", must=must))
            return content
        for override in overrides:
            try:
                place, value = parse_override(override, content)
            except WorldError as error:
                self.problems += error.problems
                continue
            content = with_value(content, place, value)
            self._overrides.append((place, Source(shown_override(override), {})))
        return content

    def _add_all(self, error: ValidationError) -> None:
        said = set()
        for problem in error.errors(include_url=False):
            location, _ = place_of(problem["loc"])
            must = _must(problem, place_of(problem["loc"][:-1])[1])
            if (location, must) not in said:
                said.add((location, must))
                self.add(Mistake(location, problem["input"], must), problem["type"] == "missing")

    def _build(self, recipe: Recipe, path: Path, use_aruco: bool) -> None:
        """Make the world as far as its mistakes let it; it is there where none is fatal."""
        if recipe.name != path.stem:
            must = f"must be {path.stem!r}, as the file is called"
            self.add(Mistake(("name",), recipe.name, must))
        maze = self._maze(recipe)
        for mistake in mistakes(recipe, maze_wall_names(maze)):
            self.add(mistake)
        meshes = self._meshes(recipe)
        world = resolve(recipe, path.name, maze, {}, meshes, use_aruco)
        textures = self._textures(recipe, {material.name for material in world.materials})
        if len(self._assets) > MAX_ASSETS:
            must = f"must be at most {MAX_ASSETS}, with the parts of meshes"
            self.add(Mistake(("materials",), f"{len(self._assets)} textures and meshes", must))
        if self._has_fatal():
            # Geometry is judged all the same, where there is enough of it.
            if not (world.walls or world.bodies):
                return
        try:
            grid = grid_of(world, self._mesh_of)
        except ValueError as error:
            self.add(Mistake(("map_resolution_m",), recipe.map_resolution_m, str(error)))
            return
        cells = occupancy(world, self._mesh_of, grid)
        self._places(recipe, world, grid, cells)
        if self._has_fatal():
            return
        world = resolve(recipe, path.name, maze, textures, meshes, use_aruco)
        world = self._with_placed_markers(recipe, world, cells, grid.origin, use_aruco)
        world, cells, origin = self._with_ready_map(recipe, world, cells, grid.origin)
        if self._has_fatal():
            return
        self.loaded = LoadedWorld(
            finished(world), self._assets, cells, origin, self._mesh_of, recipe
        )

    def _has_fatal(self) -> bool:
        return any(problem.fatal for problem in self.problems)

    def _maze(self, recipe: Recipe) -> mazes.Maze | None:
        if recipe.maze is None:
            return None
        try:
            return mazes.generate(recipe.maze, recipe.wall_thickness_m)
        except ValueError as error:
            self.add(Mistake(("maze", "cell_m"), recipe.maze.cell_m, str(error)))
            return None

    def _textures(self, recipe: Recipe, used: set[str]) -> dict[str, str]:
        """sha256 by file name, of the textures that something has."""
        sha256_of: dict[str, str] = {}
        seen: set[str] = set()
        for name, material in recipe.materials.items():
            if name not in used or not material.texture or material.texture in seen:
                continue
            seen.add(material.texture)
            data = self.read_texture(material.texture, ("materials", name, "texture"))
            if data is not None:
                sha256_of[material.texture] = self._asset(data)
        return sha256_of

    def _meshes(self, recipe: Recipe) -> dict[MeshKey, tuple[MeshAsset, ...]]:
        """The meshes that can be read; the others add problems."""
        found: dict[MeshKey, tuple[MeshAsset, ...]] = {}
        wrong: set[MeshKey] = set()
        triangles = 0
        for location, key in mesh_keys(recipe):
            if key in wrong:
                continue
            if key not in found:
                # What reads meshes takes long to import, and most worlds have none.
                from services.worldgen.meshes import load_mesh  # noqa: PLC0415

                file, submesh, center = key
                try:
                    parts = load_mesh(self._worlds_dir / "meshes" / file, submesh, center)
                except ConfigError as error:
                    self.add(Mistake(location, file, str(error)))
                    wrong.add(key)
                    continue
                found[key] = tuple(self._mesh_asset(file, index, part) for index, part in
                                   enumerate(parts))  # fmt: skip
            triangles += sum(len(asset.mesh.triangles) for asset in found[key])
            if triangles > MAX_TRIANGLES:
                must = f"must have at most {MAX_TRIANGLES} triangles, with all meshes before it"
                self.add(Mistake(location, key[0], must))
                return {}
        return found

    def _mesh_asset(self, file: str, index: int, part: Any) -> MeshAsset:
        sha256 = self._asset(mesh_to_bytes(part.mesh))
        self._mesh_of[sha256] = part.mesh
        return MeshAsset(
            name=f"{file}.{part.name or index}",
            sha256=sha256,
            mesh=part.mesh,
            diffuse=part.diffuse,
            texture_sha256=self._asset(part.texture) if part.texture else "",
            texture_name=part.texture_name if part.texture else "",
        )

    def _asset(self, data: bytes) -> str:
        sha256 = hashlib.sha256(data).hexdigest()
        self._assets[sha256] = data
        return sha256

    def _places(self, recipe: Recipe, world: World, grid: Any, cells: NDArray[np.int8]) -> None:
        """Start and locations must be on the floor."""
        start = grid.cell(world.start.x_m, world.start.y_m)
        xy = (world.start.x_m, world.start.y_m)
        if start is None:
            self.add(Mistake(("start",), xy, "must lie among the walls"))
            return
        if cells[start] == OCCUPIED:
            inside = "must not lie in a wall or anything else that is solid"
            self.add(Mistake(("start",), xy, inside))
            return
        for place in world.locations:
            cell = grid.cell(place.x_m, place.y_m)
            if cell is None or cells[cell] != FREE:
                must = "must lie on free floor that is connected to the start"
                self.add(Mistake(("locations", place.name), (place.x_m, place.y_m), must))

    def _with_placed_markers(
        self, recipe: Recipe, world: World, cells: NDArray[np.int8], origin: SE2, use_aruco: bool
    ) -> World:
        if recipe.marker_cover is None or not use_aruco:
            return world
        from services.worldgen.marker_cover import cover  # noqa: PLC0415

        try:
            markers = cover(world, cells, origin, recipe.marker_cover)
        except ValueError as error:
            self.add(Mistake(("marker_cover",), recipe.marker_cover.share, str(error)))
            return world
        return finished(world, markers=(*world.markers, *markers))

    def _with_ready_map(
        self, recipe: Recipe, world: World, cells: NDArray[np.int8], origin: SE2
    ) -> tuple[World, NDArray[np.int8], SE2]:
        if recipe.map is None:
            return world, cells, origin
        from services.worldgen.map_files import read_map  # noqa: PLC0415

        try:
            ready = read_map(self._worlds_dir / "maps" / recipe.map)
        except ConfigError as error:
            self.add(Mistake(("map",), recipe.map, str(error)))
            return world, cells, origin
        content = np.array([*ready.cells.shape], "<i8").tobytes() + ready.cells.tobytes()
        pose = np.array([*ready.origin], "<f8").tobytes()
        changed = finished(
            world,
            map_sha256=hashlib.sha256(content + pose).hexdigest(),
            map_resolution_m=ready.resolution_m,
        )
        return changed, ready.cells, ready.origin


def named_sources(name: str, worlds_dir: Path) -> list[Source]:
    """The recipe of a name, then the one it extends, and so on.

    Raises WorldError.
    """
    known = known_worlds(worlds_dir)
    stem = name if name in known else SHORT_NAMES.get(name, name)
    if stem not in known:
        short = [f"{s} (short for {n})" for s, n in SHORT_NAMES.items() if n in known]
        value = words(f"{name!r:.80}")
        must = f"must be one of {', '.join(known + short)}"
        if not known:
            must = f"{shown_path(worlds_dir)} holds no *.yaml"
        raise WorldError([Problem(field="world_name", value=value, must=must)])
    return sources_of(worlds_dir / f"{stem}.yaml")


def sources_of(path: Path) -> list[Source]:
    """A recipe's file, then the one it extends, and so on.

    Raises WorldError.
    """
    folder = path.parent
    files = [path.name]
    sources: list[Source] = []
    while True:
        source = read_source(path, shown_path(path))
        sources.append(source)
        extends = source.content.get("extends")
        if extends is None:
            return sources
        if not isinstance(extends, str) or not re.fullmatch(r"[\w.-]+\.yaml", extends, re.ASCII):
            must = f"must be a file of {shown_path(folder)}/*.yaml"
        elif extends in files:
            circle = " -> ".join([*files[files.index(extends) :], extends])
            must = f"must not lead back to itself ({circle})"
        elif not (folder / extends).is_file():
            files_known = ", ".join(f"{stem}.yaml" for stem in known_worlds(folder))
            must = f"no such file: must be one of {files_known}"
        elif len(files) >= _MAX_EXTENDS:
            must = f"must not be the end of more than {_MAX_EXTENDS} recipes"
        else:
            files.append(extends)
            path = folder / extends
            continue
        raise WorldError(
            [
                Problem(
                    file=source.file,
                    line=source.line_of(("extends",)),
                    field="extends",
                    value=shown_value(extends),
                    must=must,
                )
            ]
        )


def shown_path(path: Path) -> str:
    """A path as short as it can be said."""
    return str(path.relative_to(ROOT) if path.is_relative_to(ROOT) else path)


def _merge(base: Mapping[Any, Any], over: Mapping[Any, Any]) -> dict[Any, Any]:
    """Mappings key by key; of everything else `over` wins."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        if isinstance(below, dict) and isinstance(value, dict):
            merged[key] = _merge(below, value)
        else:
            merged[key] = value
    return merged


def _must(problem: ErrorDetails, outer: Iterable[Any]) -> str:
    """What would be right. `outer` are the types of what holds the place."""
    context = problem.get("ctx", {})
    match problem["type"]:
        case "missing":
            return "is missing"
        case "extra_forbidden":
            return f"unknown field: must be one of {', '.join(fields_of(list(outer)))}"
        case "greater_than":
            return f"must be > {context['gt']:g}"
        case "greater_than_equal":
            return f"must be >= {context['ge']:g}"
        case "less_than_equal":
            return f"must be <= {context['le']:g}"
        case "finite_number":
            return "must be finite"
        case "float_type" | "float_parsing":
            return "must be a number"
        case "int_type" | "int_parsing" | "int_from_float":
            return "must be a whole number"
        case "bool_type":
            return "must be true or false"
        case "string_type" | "invalid_key":
            return "must be a text"
        case "string_pattern_mismatch":
            return "must be letters, digits, `_`, `.` and `-`, and begin with a letter or digit"
        case "string_too_short":
            return f"must have at least {context['min_length']} characters"
        case "string_too_long":
            return f"must have at most {context['max_length']} characters"
        case "too_short":
            return f"must hold at least {context['min_length']}"
        case "too_long":
            return f"must hold at most {context['max_length']}"
        case "model_type" | "dict_type" | "model_attributes_type":
            return "must be a mapping of fields to values"
        case "tuple_type":
            return "must be a list"
        case "literal_error":
            return f"must be {context['expected']}"
        case "union_tag_not_found":
            return "must have a `kind`"
        case "union_tag_invalid":
            return f"must be of a kind among {context['expected_tags']}"
        case _:
            return words(problem["msg"][:1].lower() + problem["msg"][1:])
