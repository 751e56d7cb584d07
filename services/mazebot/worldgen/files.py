"""Loads a world by a recipe's name, a recipe's file, or an SDF, URDF or xacro file."""

from __future__ import annotations

import logging
import os
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from mazebot.common.config import ConfigError
from mazebot.common.problems import Problem, WorldError, words
from mazebot.common.world.convex.convex_parts import rough_text
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_file, load_world
from mazebot.worldgen.recipe.sources import DEFAULT_WORLDS_DIR, shown_path

if TYPE_CHECKING:
    from mazebot.worldgen.sdf.recipe_file import ImportedWorld

_log = logging.getLogger("worldgen")

SDF_SUFFIXES = (".sdf", ".world", ".xacro", ".urdf")
RECIPE_SUFFIXES = (".yaml", ".yml")


def is_sdf(path: Path) -> bool:
    """Whether a path is an SDF, URDF or xacro file, by its name, or a model's folder."""
    try:
        return path.suffix.lower() in SDF_SUFFIXES or (path / "model.config").is_file()
    except OSError:
        # A name that is too long: reading it will report that.
        return False


def is_file(world: str) -> bool:
    """Whether a text is a file rather than a world's name."""
    return os.sep in world or Path(world).suffix.lower() in (*SDF_SUFFIXES, *RECIPE_SUFFIXES)


def world_name(file: Path) -> str:
    """`tb3_house` for `a/tb3 house.sdf.xacro`: a valid recipe name."""
    stem = file.name.split(".")[0]
    name = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in stem)
    return name.lstrip("_-") or "world"


def load_any(
    world: str,
    use_aruco: bool = True,
    worlds_dir: Path = DEFAULT_WORLDS_DIR,
    texture_base: Path | None = None,
    overrides: Sequence[str] = (),
    arguments: Mapping[str, str] | None = None,
    roots: Sequence[Path] = (),
) -> LoadedWorld:
    """Load a world by the name of its recipe, by its recipe's file, or by an SDF, URDF or xacro
    file or a model's folder, which is imported without leaving files on disk.

    `arguments` are xacro's, `roots` folders of models; the rest is as in `load_world`. Raises
    ConfigError if there is no such file, else WorldError.
    """
    # The default may be missing: many worlds need no textures.
    usual = os.path.normpath(worlds_dir / "textures")
    if texture_base and not texture_base.is_dir() and os.path.normpath(texture_base) != usual:
        value = words(f"{str(texture_base)!r:.80}")
        raise WorldError([Problem(field="texture_base", value=value, must="must be a folder")])
    path = Path(world)
    if is_sdf(path):
        check_there(path)
        with imported_recipe(path, arguments or {}, roots) as (recipe, lacking):
            for line in lacking:
                _log.warning("%s: %s", shown_path(path), line)
            return load_file(recipe, use_aruco, overrides=overrides)
    if is_file(world):
        return load_file(path, use_aruco, texture_base, overrides)
    return load_world(world, use_aruco, worlds_dir, texture_base, overrides)


def check_there(file: Path) -> None:
    """Raises ConfigError if there is no such file."""
    if not os.path.lexists(file):
        raise ConfigError(f"{file}: no such file, must be an SDF, URDF or xacro file or a folder")


def rough_bodies(imported: ImportedWorld) -> str:
    """The bodies of an import whose meshes physics only follows roughly, in one line; empty, if
    there are none, or if it has other problems.
    """
    from mazebot.worldgen.sdf.recipe_file import write_recipe  # noqa: PLC0415

    if not any(body.get("mass_kg") for body in imported.recipe.get("bodies", ())):
        return ""
    with tempfile.TemporaryDirectory(prefix="mazebot-import-") as folder:
        recipe = Path(folder) / "import.yaml"
        try:
            write_recipe(imported, recipe)
            loaded = load_file(recipe)
        except ConfigError:
            return ""
    return rough_text(loaded.world.bodies, loaded.meshes)


@contextmanager
def imported_recipe(
    path: Path, arguments: Mapping[str, str], roots: Sequence[Path], name: str = ""
) -> Iterator[tuple[Path, tuple[str, ...]]]:
    """The recipe converted from a Gazebo file, with the files it needs beside it, within a context,
    and what the world lacks, a line each. `name` is the world's, if that is not the file's.

    Raises WorldError with every problem of the file.
    """
    # Imports of XML readers are slow.
    from mazebot.worldgen.sdf.convert import to_recipe  # noqa: PLC0415
    from mazebot.worldgen.sdf.reading.read import read_sdf  # noqa: PLC0415
    from mazebot.worldgen.sdf.recipe_file import write_recipe  # noqa: PLC0415

    name = name or world_name(path)
    sdf = read_sdf(path, roots, arguments)
    report = sdf.report
    if not report.errors:
        imported = to_recipe(sdf, name)
        report = imported.report
    problems = []
    for error in report.errors:
        place = re.match(r"(?s)(.*?):(\d+)(?::\s*|\s+|$)(.*)", error.where)
        problems.append(
            Problem(
                file=place[1] if place else error.where or shown_path(path),
                line=int(place[2]) if place else 0,
                field=place[3] if place else "",
                must=f"{error.kind}: {error.message}",
            )
        )
    if problems:
        # An incomplete world would only cause further problems.
        raise WorldError(problems)
    with tempfile.TemporaryDirectory(prefix="mazebot-import-") as folder:
        recipe = Path(folder) / f"{name}.yaml"
        try:
            write_recipe(imported, recipe)
        except ConfigError as error:
            raise WorldError([Problem(file=shown_path(path), must=str(error))]) from error
        yield recipe, report.warnings()
