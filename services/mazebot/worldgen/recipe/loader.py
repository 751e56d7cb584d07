"""Loads worlds by the names or files of their recipes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mazebot.common.files.yaml_source import Source
from mazebot.common.problems import WorldError
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loading import Loading
from mazebot.worldgen.recipe.sources import DEFAULT_WORLDS_DIR, named_sources, sources_of

if TYPE_CHECKING:
    pass


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
    fatal = [problem for problem in loading.problems.found if problem.fatal]
    if fatal or loading.loaded is None:
        raise WorldError(fatal or "cannot be loaded")
    return loading.loaded
