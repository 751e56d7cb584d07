"""Every problem of a world: of its files, its fields, and of what stands where in it."""

from __future__ import annotations

import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from services.common.config import ConfigError
from services.common.documents import Entities, Marker
from services.common.footprint import footprints
from services.common.frames import rotation_from_quaternion, transform_matrix
from services.common.furnish import furnish
from services.common.placement import Panel
from services.worldgen.clearance import ROBOT_RADIUS_M, cannot_be_reached, clear_m
from services.worldgen.loader import (
    DEFAULT_WORLDS_DIR,
    Draft,
    Loading,
    named_sources,
    shown_path,
    sources_of,
)
from services.worldgen.problems import Mistake, Problem, WorldError
from services.worldgen.yaml_source import Source

SDF_SUFFIXES = (".sdf", ".world", ".xacro", ".urdf")


def problems_of(
    name_or_path: str | Path,
    use_aruco: bool = True,
    worlds_dir: Path = DEFAULT_WORLDS_DIR,
    texture_base: Path | None = None,
    overrides: Sequence[str] = (),
    arguments: Mapping[str, str] | None = None,
    roots: Sequence[Path] = (),
) -> tuple[Problem, ...]:
    """Everything wrong with a world, by the name of its recipe or by a file.

    A text is a name in `worlds_dir`, a path a file: a recipe with what it needs beside it, an SDF,
    URDF or xacro file, or a model's folder. `arguments` are xacro's, `roots` folders of models.
    Empty where all is well. Never raises.
    """
    try:
        if isinstance(name_or_path, str):
            sources = named_sources(name_or_path, worlds_dir)
            return _judged(sources, use_aruco, worlds_dir, texture_base, overrides)
        if is_sdf(name_or_path):
            return tuple(_of_sdf(name_or_path, use_aruco, overrides, arguments or {}, roots))
        sources, folder = sources_of(name_or_path), name_or_path.parent
        return _judged(sources, use_aruco, folder, texture_base, overrides)
    except WorldError as error:
        return error.problems or (Problem(must=str(error)),)


def is_sdf(path: Path) -> bool:
    """Whether a path is one of Gazebo's files, by its name, or a folder of a model."""
    try:
        return path.suffix.lower() in SDF_SUFFIXES or (path / "model.config").is_file()
    except OSError:
        # A name that is too long, which reading will tell.
        return False


def _judged(
    sources: Sequence[Source],
    use_aruco: bool,
    worlds_dir: Path,
    texture_base: Path | None,
    overrides: Sequence[str],
    name: str | None = None,
) -> tuple[Problem, ...]:
    """The problems of a recipe, those of its geometry among them."""
    loading = Loading(
        sources, use_aruco, worlds_dir, texture_base, overrides, thorough=True, name=name
    )
    if loading.draft is not None:
        for mistake in _geometry(loading.draft):
            loading.add(mistake)
        _unused_textures(loading, loading.draft)
    return tuple(dict.fromkeys(loading.problems))


def _geometry(draft: Draft) -> Iterator[Mistake]:
    yield from _room_to_stand(draft)
    if draft.is_free(draft.world.start):
        # Whether one can see them is asked from there.
        yield from _markers(draft)


def _room_to_stand(draft: Draft) -> Iterator[Mistake]:
    """Start and locations need room for the robot, and a way."""
    world = draft.world
    places = [world.start, *(place for place in world.locations)]
    fields = [("start",), *(("locations", place.name) for place in world.locations)]
    on_floor = [draft.is_free(place) for place in places]
    if not on_floor[0]:
        return
    distances_m = clear_m(footprints(world, draft.meshes), places)
    unreachable = cannot_be_reached(world, draft.meshes, places)
    for place, field, free, distance_m, apart in zip(
        places, fields, on_floor, distances_m, unreachable, strict=True
    ):
        if not free:
            continue
        xy = (place.x_m, place.y_m)
        if distance_m < ROBOT_RADIUS_M:
            must = f"must have {ROBOT_RADIUS_M:g} m clear around it, not {distance_m:.3f}"
            yield Mistake(field, xy, must, fatal=False)
        elif apart and distances_m[0] >= ROBOT_RADIUS_M:
            must = f"must be reached from the start by a way {2 * ROBOT_RADIUS_M:g} m wide"
            yield Mistake(field, xy, must, fatal=False)


def _markers(draft: Draft) -> Iterator[Mistake]:
    """Markers must hang where one can see them."""
    markers = draft.world.markers
    if not markers:
        return
    walls = {wall.name for wall in draft.world.walls}
    entities, _ = furnish(draft.world, meshes=draft.meshes)
    hung = {entity.name for entity in entities.markers}
    reasons: dict[str, list[str]] = {}
    for refusal in entities.refused:
        reasons.setdefault(refusal.name, []).append(refusal.reason)
    number_of: Counter[str] = Counter()
    for index, marker in enumerate(markers):
        name = marker.name
        said = reasons.get(name, [])
        if name in hung:
            # Those of one name that came before it were refused for their place, those after it
            # for their id.
            before = sum("must be unique" not in reason for reason in said)
            said = [*said[:before], "", *said[before:]]
        reason = said[number_of[name]]
        number_of[name] += 1
        if reason and marker.wall in walls:
            yield _refused(draft, index, marker, reason)
    yield from _unseen(draft, entities)


def _unseen(draft: Draft, entities: Entities) -> Iterator[Mistake]:
    """Markers that hang well, and that the robot can read from nowhere."""
    if not entities.entities:
        return
    from services.worldgen.visibility import Sight  # noqa: PLC0415

    sight = Sight(draft.world, draft.cells, draft.grid.origin, draft.meshes)
    index_of = {marker.id: index for index, marker in reversed([*enumerate(draft.world.markers)])}
    for entity in entities.markers:
        rotation = rotation_from_quaternion(*entity.orientation_xyzw)
        map_from_panel = transform_matrix(rotation, entity.position_m)
        _, _, cells = sight.window(Panel(entity.name, map_from_panel, entity.panel_side_m))
        if not cells.any():
            index = index_of[entity.marker_id]
            marker = draft.world.markers[index]
            yield _refused(draft, index, marker, "is seen from nowhere that the robot can reach")


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
            loading.read_texture(material.texture, ("materials", name, "texture"), fatal=False)


def _of_sdf(
    path: Path,
    use_aruco: bool,
    overrides: Sequence[str],
    arguments: Mapping[str, str],
    roots: Sequence[Path],
) -> Iterator[Problem]:
    """What reading says, then what is wrong with the recipe that it makes."""
    from services.worldgen.sdf.convert import to_recipe, write_recipe  # noqa: PLC0415
    from services.worldgen.sdf.read import read_sdf  # noqa: PLC0415

    sdf = read_sdf(path, roots, arguments)
    report = sdf.report
    if not report.errors:
        imported = to_recipe(sdf, "world")
        report = imported.report
    for error in report.errors:
        place = re.match(r"(?s)(.*?):(\d+)(?::\s*|\s+|$)(.*)", error.where)
        yield Problem(
            file=place[1] if place else error.where or shown_path(path),
            line=int(place[2]) if place else 0,
            field=place[3] if place else "",
            must=f"{error.kind}: {error.message}",
        )
    if report.errors:
        # What is left of the world would only give rise to more.
        return
    with tempfile.TemporaryDirectory(prefix="mazebot-check-") as folder:
        recipe = Path(folder) / "world.yaml"
        try:
            write_recipe(imported, recipe)
        except ConfigError as error:
            yield Problem(file=shown_path(path), must=str(error))
            return
        # The recipe is nobody's: its problems are told as the file's.
        sources = [Source(shown_path(path), sources_of(recipe)[0].content)]
        yield from _judged(sources, use_aruco, recipe.parent, None, overrides, recipe.stem)
