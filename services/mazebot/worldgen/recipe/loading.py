"""Builds a world from a recipe, and finds everything that prevents it."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from mazebot.common.files.yaml_source import Source
from mazebot.common.maths.frames import SE2
from mazebot.common.messages.documents import World
from mazebot.common.problems import Mistake
from mazebot.common.world.costmap import OCCUPIED
from mazebot.worldgen.assets.sound_parts import sound_parts
from mazebot.worldgen.map.clearance import automatic_start
from mazebot.worldgen.map.occupancy import OPEN_MARGIN_M, floor_map, grid_of, occupancy
from mazebot.worldgen.recipe.asset_files import AssetFiles
from mazebot.worldgen.recipe.loaded_world import Draft, LoadedWorld
from mazebot.worldgen.recipe.mistakes import mistakes
from mazebot.worldgen.recipe.recipe_problems import RecipeProblems
from mazebot.worldgen.recipe.resolve import finished, maze_wall_names, resolve
from mazebot.worldgen.recipe_model import Recipe

if TYPE_CHECKING:
    from mazebot.common.world.map_files import MapFile
    from mazebot.worldgen.maze.maze import Maze


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
        self.problems = RecipeProblems(sources)
        self.files = AssetFiles(worlds_dir, texture_base or worlds_dir / "textures", self.problems)
        self.loaded: LoadedWorld | None = None
        self.draft: Draft | None = None
        """Set by a thorough loading, if it can be built."""
        self._thorough = thorough
        file = Path(sources[0].file)
        name = name or file.stem
        content = self.problems.merged(overrides)
        if self.problems.found and not thorough:
            return
        try:
            recipe = Recipe.model_validate(content, strict=True)
        except ValidationError as error:
            wrong = self.problems.add_all(error)
            if not thorough:
                return
            self.problems.sound = sound_parts(content, wrong, name)
            try:
                recipe = Recipe.model_validate(self.problems.sound.content, strict=True)
            except ValidationError:
                return
        self._build(recipe, file.name, name, use_aruco)

    def _build(self, recipe: Recipe, file_name: str, name: str, use_aruco: bool) -> None:
        """Build the world, or as much of it as its problems allow."""
        if recipe.name != name:
            self.problems.add(Mistake(("name",), recipe.name, f"must be {name!r}, the file's name"))
        maze = self._maze(recipe)
        wrong_bodies: set[str | int] = set()
        too_much = False
        for mistake in mistakes(recipe, maze_wall_names(maze)):
            self.problems.add(mistake)
            too_much = too_much or mistake.location == ("walls",)
            if mistake.location[0] == "bodies":
                number = mistake.location[1:2] or range(len(recipe.bodies))
                wrong_bodies.update(number)
        meshes = self.files.meshes(recipe)
        # Shapes that may have no triangles are not used.
        bodies = tuple(b for i, b in enumerate(recipe.bodies) if i not in wrong_bodies)
        world = resolve(
            recipe.model_copy(update={"bodies": bodies}), file_name, maze, meshes, use_aruco
        )
        world = self.files.textured(recipe, world)
        if use_aruco:
            world = self.files.with_dictionaries(recipe, world)
        if too_much or (self.problems.are_fatal and not self._thorough):
            return
        # Without a start, reachability cannot be checked.
        if self.problems.sound is not None and not self.problems.sound.dropped.isdisjoint(
            ("start", "maze")
        ):
            return
        try:
            if recipe.start is None and recipe.maze is None:
                world = world.model_copy(
                    update={"start": automatic_start(world, self.files.mesh_of)}
                )
            grid, cells = floor_map(world, self.files.mesh_of)
        except ValueError as error:
            self.problems.add(Mistake(("map_resolution_m",), recipe.map_resolution_m, str(error)))
            return
        draft = Draft(
            recipe, world, self.files.mesh_of, grid, cells, cells, grid.resolution_m, grid.origin
        )
        self._judge_places(draft)
        origin = grid.origin
        if not self.problems.are_fatal:
            world = self._with_placed_markers(draft, use_aruco)
            draft = dataclasses.replace(draft, world=world)
        before = len(self.problems.found)
        if recipe.map is not None:
            world, cells, origin = self._with_ready_map(recipe.map, draft)
            if len(self.problems.found) == before:
                # Checks of poses on a wrong map would only repeat the problem.
                draft = dataclasses.replace(
                    draft,
                    map_cells=cells,
                    map_resolution_m=world.map_resolution_m,
                    map_origin=origin,
                )
        if self._thorough:
            self.draft = draft
        if not self.problems.are_fatal:
            self.loaded = LoadedWorld(
                finished(world), self.files.assets, cells, origin, self.files.mesh_of, recipe
            )

    def _maze(self, recipe: Recipe) -> Maze | None:
        if recipe.maze is None:
            return None
        # It imports Numba, which most worlds do not need.
        from mazebot.worldgen.maze.maze import generate  # noqa: PLC0415

        try:
            return generate(recipe.maze, recipe.wall_thickness_m)
        except ValueError as error:
            self.problems.add(Mistake(("maze", "cell_m"), recipe.maze.cell_m, str(error)))
            return None

    def _judge_places(self, draft: Draft) -> None:
        """Start and locations must be on the floor."""
        world, cells = draft.world, draft.cells
        start = draft.grid.cell(world.start.x_m, world.start.y_m)
        xy = (world.start.x_m, world.start.y_m)
        open_floor = self.problems.sound is not None and self.problems.sound.lost_something_solid
        if start is None:
            if not open_floor:
                self.problems.add(
                    Mistake(
                        ("start",), xy, f"must lie within {OPEN_MARGIN_M:g} m of something solid"
                    )
                )
            return
        if cells[start] == OCCUPIED:
            inside = "must not lie in a wall or anything else that is solid"
            self.problems.add(Mistake(("start",), xy, inside))
            return
        for place in world.locations:
            cell = draft.grid.cell(place.x_m, place.y_m)
            in_solid = cell is not None and cells[cell] == OCCUPIED
            if in_solid or not (draft.is_free(place) or open_floor):
                must = "must lie on free floor that is connected to the start"
                self.problems.add(Mistake(("locations", place.name), (place.x_m, place.y_m), must))

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
            self.problems.add(Mistake(("marker_cover",), wanted.share, str(error)))
            return draft.world
        return draft.world.model_copy(update={"markers": (*draft.world.markers, *markers)})

    def _with_ready_map(self, name: str, draft: Draft) -> tuple[World, NDArray[np.int8], SE2]:
        """The world, the map's cells and its origin."""
        ready = self.files.ready_map(name)
        if ready is None:
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
        from mazebot.worldgen.map.disagreement import misfit  # noqa: PLC0415

        found = misfit(ready, MapFile(draft.cells, draft.grid.resolution_m, draft.grid.origin))
        if found:
            self.problems.add(
                Mistake(("map",), name, f"must match the world: {found}", fatal=False)
            )
