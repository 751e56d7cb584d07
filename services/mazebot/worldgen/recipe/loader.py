"""Loads world recipes, textures, meshes and maps from files, and reports their problems: the only
module that reads them.
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from mazebot.common.config import ConfigError
from mazebot.common.files.root import ROOT
from mazebot.common.files.yaml_source import Source, read_source
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import DICTIONARY_FILES, Planar, World
from mazebot.common.problems import (
    Location,
    Mistake,
    Problem,
    WorldError,
    field_name,
    shown_value,
    words,
)
from mazebot.common.world.costmap import FREE, OCCUPIED
from mazebot.common.world.geometry import MAX_TRIANGLES, TriangleMesh, mesh_to_bytes
from mazebot.worldgen.assets.sound_parts import SoundParts, sound_parts
from mazebot.worldgen.map.clearance import automatic_start
from mazebot.worldgen.map.occupancy import OPEN_MARGIN_M, Grid, floor_map, grid_of, occupancy
from mazebot.worldgen.recipe.field_words import must_of
from mazebot.worldgen.recipe.mistakes import mistakes
from mazebot.worldgen.recipe.overrides import (
    MAX_OVERRIDES,
    parse_override,
    shown_override,
    with_value,
)
from mazebot.worldgen.recipe.recipe_fields import place_of
from mazebot.worldgen.recipe.resolve import (
    MeshAsset,
    MeshKey,
    finished,
    maze_wall_names,
    mesh_keys,
    resolve,
    with_textures,
)
from mazebot.worldgen.recipe.texture_file import read_texture_file
from mazebot.worldgen.recipe_model import MAX_ASSETS, Recipe

if TYPE_CHECKING:
    from mazebot.common.world.map_files import MapFile
    from mazebot.worldgen.maze.maze import Maze

MAX_DICTIONARY_DIGITS = 250_000
"""Modules of all markers of a dictionary, which goes to each service with the world"""
DEFAULT_WORLDS_DIR = ROOT / "worlds"
SHORT_NAMES = {
    "original": "sim_house",
    "enhanced": "sim_house_enhanced",
    "floor": "sim_house_floor",
    "rooms": "sim_house_rooms",
    "slam": "sim_house_slam",
    "markers": "sim_house_markers",
}

MAX_MAP_ERROR_M = 0.1
"""Mean distance between a ready map's walls and the world's. SLAM's are 2 to 5 cm off."""

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
    """The recipe of the world, including overrides."""


def known_worlds(worlds_dir: Path = DEFAULT_WORLDS_DIR) -> list[str]:
    """Names of the recipes in a folder, sorted.

    Raises WorldError if there is no such folder.
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

    `texture_base` is the folder of the textures, if that is not `textures` in `worlds_dir`.
    `overrides` are `field=value`, applied to the recipe's in turn.

    Raises WorldError for everything that makes the world unusable: in its name, an override, the
    recipe, a texture, a mesh or a map. A world with smaller problems (a marker that cannot be
    placed) is loaded: see check.problems_of.
    """
    return _loaded(named_sources(name, worlds_dir), use_aruco, worlds_dir, texture_base, overrides)


def load_file(
    path: Path,
    use_aruco: bool = True,
    texture_base: Path | None = None,
    overrides: Sequence[str] = (),
) -> LoadedWorld:
    """The same for a recipe's file in any folder; the files it needs are beside it."""
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


@dataclass(frozen=True, eq=False)
class Draft:
    """A world, built as far as its problems allow."""

    recipe: Recipe
    world: World
    meshes: Mapping[str, TriangleMesh]
    grid: Grid
    cells: NDArray[np.int8]
    """(rows, columns) in the grid, built from the world even if there is a ready map."""
    map_cells: NDArray[np.int8]
    """Of the map used for navigation: the ready one, else `cells`."""
    map_resolution_m: float
    map_origin: SE2

    def is_free(self, place: Planar) -> bool:
        """Whether a pose is on free floor that is connected to the start."""
        cell = self.grid.cell(place.x_m, place.y_m)
        return cell is not None and bool(self.cells[cell] == FREE)


class Loading:
    """Result of loading a recipe: the world if there is one, and all problems."""

    def __init__(
        self,
        sources: Sequence[Source],
        use_aruco: bool,
        worlds_dir: Path,
        texture_base: Path | None,
        overrides: Sequence[str],
        *,
        thorough: bool = False,
        name: str | None = None,
    ) -> None:
        """`sources` are the recipe, then the one it extends, and so on. A thorough loading leaves
        out invalid parts and checks the rest. `name` is the recipe's expected name, if that is
        not the name of its file.
        """
        self.problems: list[Problem] = []
        self.loaded: LoadedWorld | None = None
        self.draft: Draft | None = None
        """Set by a thorough loading, if it can be built."""
        self._sources = tuple(sources)
        self._overrides: list[tuple[Location, Source]] = []
        self._worlds_dir = worlds_dir
        self._textures_dir = texture_base or worlds_dir / "textures"
        self._thorough = thorough
        self._sound: SoundParts | None = None
        self._assets: dict[str, bytes] = {}
        self._mesh_of: dict[str, TriangleMesh] = {}
        file = Path(self._sources[0].file)
        name = name or file.stem
        content = self._merged(overrides)
        if self.problems and not thorough:
            return
        try:
            recipe = Recipe.model_validate(content, strict=True)
        except ValidationError as error:
            wrong = self._add_all(error)
            if not thorough:
                return
            self._sound = sound_parts(content, wrong, name)
            try:
                recipe = Recipe.model_validate(self._sound.content, strict=True)
            except ValidationError:
                return
        self._build(recipe, file.name, name, use_aruco)

    def add(self, mistake: Mistake) -> None:
        """Add a problem of the checked recipe, with the file and the line of its location.

        Problems that are only caused by left-out parts are skipped.
        """
        location, other = mistake.location, mistake.other
        if self._sound is not None:
            if self._sound.explains(location, mistake.value):
                return
            location, other = self._sound.before(location), self._sound.before(other)
        must = mistake.must.replace("{other}", field_name(other))
        self._add(location, shown_value(mistake.value), must, mistake.fatal)

    def _add(self, location: Location, value: str, must: str, fatal: bool = True) -> None:
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
                value=value,
                must=words(must),
                fatal=fatal,
            )
        )

    def read_texture(self, name: str, location: Location, fatal: bool = True) -> bytes | None:
        """The bytes of a texture; None if it is invalid, which adds a problem."""
        path = self._textures_dir / name
        try:
            return read_texture_file(path)
        except ValueError as error:
            wrong = f"{shown_path(path)} {error}"
        self.add(Mistake(location, name, wrong, fatal))
        return None

    def _merged(self, overrides: Sequence[str]) -> dict[Any, Any]:
        """The sources' content, the first over the others, and the overrides over all."""
        content: dict[Any, Any] = {}
        for source in reversed(self._sources):
            content = _merge(content, source.content)
        # Problems with what the requested file extends are reported for the chain.
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

    def _add_all(self, error: ValidationError) -> list[Location]:
        """Add the problems of single fields; returns their locations."""
        said: dict[tuple[Location, str], str] = {}
        found = error.errors(include_url=False)
        for problem in found:
            # Invalid parts are not counted as parts: so a list may seem too short.
            within = [other for other in found if other["loc"][: len(problem["loc"])] ==
                      problem["loc"]] if problem["type"] == "too_short" else ()  # fmt: skip
            if len(within) > 1:
                continue
            location, _ = place_of(problem["loc"])
            must = must_of(problem, place_of(problem["loc"][:-1])[1])
            missing = problem["type"] == "missing"
            said.setdefault((location, must), "" if missing else shown_value(problem["input"]))
        for (location, must), value in said.items():
            self._add(location, value, must)
        return [location for location, _ in said]

    def _build(self, recipe: Recipe, file_name: str, name: str, use_aruco: bool) -> None:
        """Build the world, or as much of it as its problems allow."""
        if recipe.name != name:
            self.add(Mistake(("name",), recipe.name, f"must be {name!r}, as the file is called"))
        maze = self._maze(recipe)
        wrong_bodies: set[str | int] = set()
        too_much = False
        for mistake in mistakes(recipe, maze_wall_names(maze)):
            self.add(mistake)
            too_much = too_much or mistake.location == ("walls",)
            if mistake.location[0] == "bodies":
                number = mistake.location[1:2] or range(len(recipe.bodies))
                wrong_bodies.update(number)
        meshes = self._meshes(recipe)
        # Shapes that may have no triangles are not used.
        bodies = tuple(b for i, b in enumerate(recipe.bodies) if i not in wrong_bodies)
        world = resolve(
            recipe.model_copy(update={"bodies": bodies}), file_name, maze, meshes, use_aruco
        )
        world = self._with_textures(recipe, world)
        if use_aruco:
            world = self._with_dictionaries(recipe, world)
        if too_much or not (self._thorough or self._may_run()):
            return
        # Without a start, reachability cannot be checked.
        if self._sound is not None and not self._sound.dropped.isdisjoint(("start", "maze")):
            return
        try:
            if recipe.start is None and recipe.maze is None:
                world = world.model_copy(update={"start": automatic_start(world, self._mesh_of)})
            grid, cells = floor_map(world, self._mesh_of)
        except ValueError as error:
            self.add(Mistake(("map_resolution_m",), recipe.map_resolution_m, str(error)))
            return
        draft = Draft(
            recipe, world, self._mesh_of, grid, cells, cells, grid.resolution_m, grid.origin
        )
        self._judge_places(draft)
        origin = grid.origin
        if self._may_run():
            world = self._with_placed_markers(draft, use_aruco)
            draft = dataclasses.replace(draft, world=world)
        told = len(self.problems)
        if recipe.map is not None:
            world, cells, origin = self._with_ready_map(recipe.map, draft)
            if len(self.problems) == told:
                # Checks of poses on a wrong map would only repeat the problem.
                draft = dataclasses.replace(
                    draft,
                    map_cells=cells,
                    map_resolution_m=world.map_resolution_m,
                    map_origin=origin,
                )
        if self._thorough:
            self.draft = draft
        if self._may_run():
            self.loaded = LoadedWorld(
                finished(world), self._assets, cells, origin, self._mesh_of, recipe
            )

    def _may_run(self) -> bool:
        return not any(problem.fatal for problem in self.problems)

    def _maze(self, recipe: Recipe) -> Maze | None:
        if recipe.maze is None:
            return None
        # It imports Numba, which most worlds do not need.
        from mazebot.worldgen.maze.maze import generate  # noqa: PLC0415

        try:
            return generate(recipe.maze, recipe.wall_thickness_m)
        except ValueError as error:
            self.add(Mistake(("maze", "cell_m"), recipe.maze.cell_m, str(error)))
            return None

    def _with_textures(self, recipe: Recipe, world: World) -> World:
        """The world with its materials' textures, as far as these can be read."""
        sha256_of: dict[str, str] = {}
        used = {material.name for material in world.materials}
        for name, material in recipe.materials.items():
            texture = material.texture
            if name in used and texture and texture not in sha256_of:
                data = self.read_texture(texture, ("materials", name, "texture"))
                sha256_of[texture] = "" if data is None else self._asset(data)
        if len(self._assets) > MAX_ASSETS:
            must = f"must be at most {MAX_ASSETS}"
            self.add(Mistake(("materials",), f"{len(self._assets)} textures and meshes", must))
        return with_textures(world, sha256_of)

    def _with_dictionaries(self, recipe: Recipe, world: World) -> World:
        """The world with the dictionaries of its markers that are files, as far as these can be
        read.
        """
        named: dict[str, Location] = {}
        for index, marker in enumerate(world.markers):
            named.setdefault(marker.dictionary, ("markers", index, "dictionary"))
        if recipe.marker_cover is not None:
            named.setdefault(recipe.marker_cover.dictionary, ("marker_cover", "dictionary"))
        found = []
        for name, location in named.items():
            if not name.lower().endswith(DICTIONARY_FILES):
                continue
            # Most worlds have none, and do not need the readers of their formats.
            from mazebot.common.world.marker_dictionary import read_codes  # noqa: PLC0415

            folder = self._worlds_dir / "dictionaries"
            try:
                if Path(name).name != name:
                    raise ConfigError(f"must be the name of a file in {shown_path(folder)}")
                codes = read_codes(folder / name)
                digits = sum(len(code) for code in codes.codes)
                if digits > MAX_DICTIONARY_DIGITS:
                    raise ConfigError(
                        f"{digits} modules in all markers: must be at most {MAX_DICTIONARY_DIGITS}"
                    )
            except ConfigError as error:
                self.add(Mistake(location, name, str(error)))
                continue
            found.append(codes)
        return world.model_copy(update={"dictionaries": tuple(found)})

    def _meshes(self, recipe: Recipe) -> dict[MeshKey, tuple[MeshAsset, ...]]:
        """The readable meshes; the others add problems."""
        found: dict[MeshKey, tuple[MeshAsset, ...]] = {}
        wrong: set[MeshKey] = set()
        triangles = 0
        for location, key in mesh_keys(recipe):
            if key in wrong:
                continue
            if key not in found:
                # Imports of mesh readers are slow, and most worlds have none.
                from mazebot.worldgen.assets.meshes import load_mesh  # noqa: PLC0415

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

    def _judge_places(self, draft: Draft) -> None:
        """Start and locations must be on the floor."""
        world, cells = draft.world, draft.cells
        start = draft.grid.cell(world.start.x_m, world.start.y_m)
        xy = (world.start.x_m, world.start.y_m)
        open_floor = self._sound is not None and self._sound.lost_something_solid
        if start is None:
            if not open_floor:
                self.add(
                    Mistake(
                        ("start",), xy, f"must lie within {OPEN_MARGIN_M:g} m of something solid"
                    )
                )
            return
        if cells[start] == OCCUPIED:
            inside = "must not lie in a wall or anything else that is solid"
            self.add(Mistake(("start",), xy, inside))
            return
        for place in world.locations:
            cell = draft.grid.cell(place.x_m, place.y_m)
            in_solid = cell is not None and cells[cell] == OCCUPIED
            if in_solid or not (draft.is_free(place) or open_floor):
                must = "must lie on free floor that is connected to the start"
                self.add(Mistake(("locations", place.name), (place.x_m, place.y_m), must))

    def _with_placed_markers(self, draft: Draft, use_aruco: bool) -> World:
        wanted = draft.recipe.marker_cover
        if wanted is None or not use_aruco:
            return draft.world
        # The import of the solver is slow.
        from mazebot.worldgen.markers.marker_cover import cover  # noqa: PLC0415

        # Markers far out on open floor are not needed.
        near = grid_of(draft.world, draft.meshes)
        cells = occupancy(draft.world, draft.meshes, near)
        try:
            markers = cover(draft.world, cells, near.origin, wanted, draft.meshes)
        except ValueError as error:
            self.add(Mistake(("marker_cover",), wanted.share, str(error)))
            return draft.world
        return draft.world.model_copy(update={"markers": (*draft.world.markers, *markers)})

    def _with_ready_map(self, name: str, draft: Draft) -> tuple[World, NDArray[np.int8], SE2]:
        """The world, the map's cells and its origin."""
        # Most worlds have none, and do not need the map reader.
        from mazebot.common.world.map_files import read_map  # noqa: PLC0415

        try:
            ready = read_map(self._worlds_dir / "maps" / name)
        except ConfigError as error:
            self.add(Mistake(("map",), name, str(error)))
            return draft.world, draft.cells, draft.grid.origin
        if self._thorough:
            self._judge_map(name, ready, draft)
        shape, pose = np.array(ready.cells.shape, "<i8"), np.array(ready.origin, "<f8")
        content = shape.tobytes() + pose.tobytes() + ready.cells.tobytes()
        changes = {
            "map_sha256": hashlib.sha256(content).hexdigest(),
            "map_resolution_m": ready.resolution_m,
        }
        return draft.world.model_copy(update=changes), ready.cells, ready.origin

    def _judge_map(self, name: str, ready: MapFile, draft: Draft) -> None:
        """A ready map must match the world that it is used in."""
        from mazebot.common.world.map_files import MapFile  # noqa: PLC0415
        from mazebot.worldgen.map.disagreement import disagreement  # noqa: PLC0415

        own = MapFile(draft.cells, draft.grid.resolution_m, draft.grid.origin)
        try:
            found = disagreement(ready, own)
        except ValueError as error:
            self.add(Mistake(("map",), name, f"must show the world: {error}", fatal=False))
            return
        if found.mean_m > MAX_MAP_ERROR_M:
            must = f"must lie on the world: {found}"
            self.add(Mistake(("map",), name, must, fatal=False))


def named_sources(name: str, worlds_dir: Path) -> list[Source]:
    """The recipe of that name, then the one it extends, and so on.

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
    """A path, as short as possible."""
    return str(path.relative_to(ROOT) if path.is_relative_to(ROOT) else path)


def _merge(base: Mapping[Any, Any], over: Mapping[Any, Any]) -> dict[Any, Any]:
    """Merge mappings key by key; for everything else `over` wins."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        if isinstance(below, dict) and isinstance(value, dict):
            merged[key] = _merge(below, value)
        else:
            merged[key] = value
    return merged
