"""Finds every problem of a world: in its files, its fields, and its geometry."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely

from mazebot.common.files.yaml_source import Source
from mazebot.common.maths import portable
from mazebot.common.maths.frames import (
    Array,
    pose_matrix,
    rotation_from_quaternion,
    transform_matrix,
)
from mazebot.common.messages.documents import Body, Entities, Marker, Wall
from mazebot.common.problems import Mistake, Problem, WorldError
from mazebot.common.robot.waffle import LIDAR_HEIGHT_M
from mazebot.common.world.convex.convex_parts import rough_text
from mazebot.common.world.costmap import ROBOT_RADIUS_M
from mazebot.common.world.footprint import footprint
from mazebot.common.world.geometry import TriangleMesh, triangles_of
from mazebot.common.world.marker_entities import marker_entities
from mazebot.common.world.placement import Panel
from mazebot.worldgen.files import imported_recipe, is_sdf
from mazebot.worldgen.map.clearance import (
    CORRIDOR_M,
    Reach,
    cut_off_by_zones,
    reach,
    rooms_to_stand,
)
from mazebot.worldgen.recipe.loaded_world import Draft
from mazebot.worldgen.recipe.loading import Loading
from mazebot.worldgen.recipe.mistakes import placed
from mazebot.worldgen.recipe.sources import (
    DEFAULT_WORLDS_DIR,
    named_sources,
    shown_path,
    sources_of,
)

_NAMED = 5
_PLANE = f"the plane of the lidar, {LIDAR_HEIGHT_M:g} m"


class Findings(NamedTuple):
    """Result of checking a world."""

    problems: tuple[Problem, ...]
    """Empty if there are none."""
    reach: Reach | None
    """Reachable floor; None if the world cannot be built."""


def problems_of(
    name_or_path: str | Path,
    use_aruco: bool = True,
    worlds_dir: Path = DEFAULT_WORLDS_DIR,
    texture_base: Path | None = None,
    overrides: Sequence[str] = (),
    arguments: Mapping[str, str] | None = None,
    roots: Sequence[Path] = (),
) -> tuple[Problem, ...]:
    """Everything wrong with a world: see `findings_of`."""
    return findings_of(
        name_or_path, use_aruco, worlds_dir, texture_base, overrides, arguments, roots
    ).problems


def findings_of(
    name_or_path: str | Path,
    use_aruco: bool = True,
    worlds_dir: Path = DEFAULT_WORLDS_DIR,
    texture_base: Path | None = None,
    overrides: Sequence[str] = (),
    arguments: Mapping[str, str] | None = None,
    roots: Sequence[Path] = (),
) -> Findings:
    """All problems of a world, by the name of its recipe or by a file, and its reachable floor.

    A str is a name in `worlds_dir`, a Path a file: a recipe with the files it needs beside it, an
    SDF, URDF or xacro file, or a model's folder. `arguments` are xacro's, `roots` model folders.
    Never raises.
    """
    try:
        if isinstance(name_or_path, str):
            sources = named_sources(name_or_path, worlds_dir)
            return _judged(sources, use_aruco, worlds_dir, texture_base, overrides)
        if is_sdf(name_or_path):
            with imported_recipe(name_or_path, arguments or {}, roots, "world") as (
                recipe,
                lacking,
            ):
                # The recipe is temporary: its problems are reported for the imported file.
                shown = shown_path(name_or_path)
                sources = [Source(shown, sources_of(recipe)[0].content)]
                found = _judged(sources, use_aruco, recipe.parent, None, overrides, recipe.stem)
            told = [Problem(file=shown, must=line, fatal=False) for line in lacking]
            return Findings((*told, *found.problems), found.reach)
        sources, folder = sources_of(name_or_path), name_or_path.parent
        return _judged(sources, use_aruco, folder, texture_base, overrides)
    except WorldError as error:
        return Findings(error.problems or (Problem(must=str(error)),), None)


def _judged(
    sources: Sequence[Source],
    use_aruco: bool,
    worlds_dir: Path,
    texture_base: Path | None,
    overrides: Sequence[str],
    name: str | None = None,
) -> Findings:
    """The problems of a recipe, including its geometry, and its reachable floor."""
    loading = Loading(
        sources, use_aruco, worlds_dir, texture_base, overrides, thorough=True, name=name
    )
    draft, found = loading.draft, None
    if draft is not None:
        if draft.is_free(draft.world.start):
            found = reach(draft.world, draft.meshes)
        for mistake in _geometry(draft, found):
            loading.problems.add(mistake)
        _unused_textures(loading, draft)
    return Findings(tuple(dict.fromkeys(loading.problems.found)), found)


def _geometry(draft: Draft, found: Reach | None) -> Iterator[Mistake]:
    yield from _narrow_maze(draft)
    rough = rough_text(draft.world.bodies, draft.meshes)
    if rough:
        yield Mistake(("bodies",), len(draft.world.bodies), rough, fatal=False)
    yield from _walls_below_lidar(draft)
    yield from _bodies_beside_lidar(draft)
    yield from _room_to_stand(draft)
    yield from _kept_out(draft)
    if found is not None:
        yield from _pocket(draft, found)
        # Marker visibility is checked from there.
        yield from _markers(draft)


def _narrow_maze(draft: Draft) -> Iterator[Mistake]:
    """A maze's corridors must be wide enough for the robot."""
    recipe = draft.recipe
    if recipe.maze is None or recipe.maze.cell_m - recipe.wall_thickness_m >= CORRIDOR_M - 1e-9:
        return
    must = f"must be at least {recipe.wall_thickness_m + CORRIDOR_M:g}: in corridors narrower than "
    must += f"{CORRIDOR_M:g} m the robot cannot turn round"
    yield Mistake(("maze", "cell_m"), recipe.maze.cell_m, must, fatal=False)


def _walls_below_lidar(draft: Draft) -> Iterator[Mistake]:
    """Walls must be seen by the lidar."""
    world = draft.world
    low = [wall for wall in world.walls if wall.height_m <= LIDAR_HEIGHT_M]
    if not low:
        return
    must = (
        f"must be above {_PLANE}: it sees nothing of {len(low)} of {len(world.walls)} walls "
        f"({_names(low)}), by which localization could find the robot"
    )
    own = {
        wall.name: index
        for index, wall in enumerate(draft.recipe.walls)
        if wall.height_m is not None
    }
    first = own.get(low[0].name)
    field = ("wall_height_m",) if first is None else ("walls", first, "height_m")
    yield Mistake(field, low[0].height_m, must, fatal=False)


def _bodies_beside_lidar(draft: Draft) -> Iterator[Mistake]:
    """Bodies on the map must be seen by the lidar; where there is no wall, one must."""
    world, meshes = draft.world, draft.meshes
    still, seen, on_map = set(), set(), []
    for body in world.bodies:
        solid = [
            (shape.geometry, portable.product(pose_matrix(body), pose_matrix(shape)))
            for shape in body.shapes
            if shape.solid
        ]
        if solid and not body.moves:
            still.add(body.name)
        heights_m = [_heights(triangles_of(one, meshes), at) for one, at in solid]
        if any(z.min() < LIDAR_HEIGHT_M < z.max() for z in heights_m):
            seen.add(body.name)
        if any(footprint(one, at, meshes).polygons_m for one, at in solid):
            on_map.append(body)
    sees_nothing_of = f"must cross {_PLANE}: it sees nothing of"
    if still and not world.walls and not still & seen:
        bodies = "body that stands" if len(still) == 1 else "bodies that stand"
        must = (
            f"{sees_nothing_of} the {len(still)} {bodies} still, by which localization could find "
            "the robot"
        )
        yield Mistake(("bodies",), len(world.bodies), must, fatal=False)
        return
    passed = [body for body in on_map if body.name not in seen]
    if passed:
        first = passed[0].name
        place = next(place for place, thing in placed(draft.recipe) if thing.name == first)
        must = f"{sees_nothing_of} {len(passed)} of {len(on_map)} bodies on the map"
        yield Mistake(place, first, f"{must} ({_names(passed)})", fatal=False)


def _names(things: Sequence[Wall] | Sequence[Body]) -> str:
    """The names of some things, of many the first ones."""
    names = [thing.name for thing in things]
    return ", ".join([*names[:_NAMED], *["..."][: len(names) > _NAMED]])


def _heights(mesh: TriangleMesh, map_from_shape: Array) -> Array:
    """Heights of a surface's corners."""
    rows = portable.product(mesh.vertices_m, map_from_shape[2:3, :3].T)
    return np.asarray(rows[:, 0] + map_from_shape[2, 3])


def _room_to_stand(draft: Draft) -> Iterator[Mistake]:
    """Start and locations need clearance and a path, as seen by navigation's costmap."""
    world = draft.world
    places = [world.start, *(place for place in world.locations)]
    fields = [("start",), *(("locations", place.name) for place in world.locations)]
    on_floor = [draft.is_free(place) for place in places]
    if not on_floor[0]:
        return
    found = rooms_to_stand(
        draft.map_cells, draft.map_resolution_m, draft.map_origin, world.start, places
    )
    for place, field, free, (too_near_m, reached) in zip(
        places, fields, on_floor, found, strict=True
    ):
        if not free:
            continue
        xy = (place.x_m, place.y_m)
        if too_near_m is not None:
            must = f"must have {ROBOT_RADIUS_M:g} m clear around it, not {too_near_m:.3f}"
            yield Mistake(field, xy, must, fatal=False)
        elif not reached:
            must = f"must be reached from the start by a way {2 * ROBOT_RADIUS_M:g} m wide"
            yield Mistake(field, xy, must, fatal=False)


def _kept_out(draft: Draft) -> Iterator[Mistake]:
    """Keepout zones must leave a way from the start to each location and back."""
    world = draft.world
    if not world.keepout_zones or not draft.is_free(world.start):
        return
    start = shapely.Point(world.start.x_m, world.start.y_m)
    areas = [(zone, shapely.Polygon(zone.polygon_m)) for zone in world.keepout_zones]
    # One that crosses itself is a problem of its own.
    zones = [(zone, area) for zone, area in areas if area.is_valid]
    for zone, area in zones:
        if area.intersects(start):
            must = f"must not lie in keepout zone {zone.name}: the robot cannot come back to it"
            yield Mistake(("start",), (start.x, start.y), must, fatal=False)
    # What lies in a zone is a problem of the recipe, reported there.
    places = [
        place
        for place in world.locations
        if not any(area.intersects(shapely.Point(place.x_m, place.y_m)) for _, area in zones)
    ]
    blocked = cut_off_by_zones(
        draft.map_cells, draft.map_resolution_m, draft.map_origin, world.start, places,
        [zone for zone, _ in zones],
    )  # fmt: skip
    for place, names in zip(places, blocked, strict=True):
        if names:
            which = f"zone{'s' if len(names) > 1 else ''} {', '.join(names)}"
            must = f"must be reached from the start by a way that keeps out of keepout {which}"
            yield Mistake(("locations", place.name), (place.x_m, place.y_m), must, fatal=False)


def _pocket(draft: Draft, found: Reach) -> Iterator[Mistake]:
    """The start must not be cut off from most of the floor."""
    start, better = draft.world.start, found.largest
    if found.reachable_m2 > 0.0 and found.is_pocket:
        must = (
            f"must not stand in a pocket of {found.reachable_m2:.1f} m2: "
            f"{found.largest_m2:.1f} m2 of floor lie around ({better.x_m:g}, {better.y_m:g})"
        )
        yield Mistake(("start",), (start.x_m, start.y_m), must, fatal=False)


def _markers(draft: Draft) -> Iterator[Mistake]:
    """Markers must be placed and visible."""
    markers = draft.world.markers
    if not markers:
        return
    walls = {wall.name for wall in draft.world.walls}
    entities, _ = marker_entities(draft.world, meshes=draft.meshes)
    hung = {entity.name for entity in entities.markers}
    reasons: dict[str, list[str]] = {}
    for refusal in entities.refused:
        reasons.setdefault(refusal.name, []).append(refusal.reason)
    number_of: Counter[str] = Counter()
    for index, marker in enumerate(markers):
        name = marker.name
        refusals = reasons.get(name, [])
        if name in hung:
            # Earlier ones of the same name were refused for their pose, later ones for their id.
            before = sum("must be unique" not in reason for reason in refusals)
            refusals = [*refusals[:before], "", *refusals[before:]]
        reason = refusals[number_of[name]]
        number_of[name] += 1
        if reason and marker.wall in walls:
            yield _refused(draft, index, marker, reason)
    yield from _unseen(draft, entities)


def _unseen(draft: Draft, entities: Entities) -> Iterator[Mistake]:
    """Markers that are placed correctly, but that the robot can read from nowhere."""
    if not entities.entities:
        return
    from mazebot.worldgen.markers.visibility import Sight  # noqa: PLC0415

    sight = Sight(draft.world, draft.cells, draft.grid.origin, draft.meshes)
    index_of = {marker.id: index for index, marker in reversed([*enumerate(draft.world.markers)])}
    for entity in entities.markers:
        rotation = rotation_from_quaternion(*entity.orientation_xyzw)
        map_from_panel = transform_matrix(rotation, entity.position_m)
        _, _, cells = sight.window(Panel(entity.name, map_from_panel, entity.panel_side_m))
        if not cells.any():
            index = index_of[entity.marker_id]
            marker = draft.world.markers[index]
            yield _refused(
                draft, index, marker, "is not visible from anywhere that the robot can reach"
            )


def _refused(draft: Draft, index: int, marker: Marker, reason: str) -> Mistake:
    field = re.match(r"(id|dictionary|wall): .*?: (.*)", reason)
    if index >= len(draft.recipe.markers):
        return Mistake(("marker_cover",), marker.id, reason, fatal=False)
    if field:
        value = getattr(marker, field[1])
        return Mistake(("markers", index, field[1]), value, field[2], fatal=False)
    return Mistake(("markers", index), marker.name, reason, fatal=False)


def _unused_textures(loading: Loading, draft: Draft) -> None:
    used = {material.name for material in draft.world.materials}
    seen = {draft.recipe.materials[name].texture for name in used & set(draft.recipe.materials)}
    for name, material in draft.recipe.materials.items():
        if material.texture and material.texture not in seen:
            seen.add(material.texture)
            loading.files.read_texture(
                material.texture, ("materials", name, "texture"), fatal=False
            )
