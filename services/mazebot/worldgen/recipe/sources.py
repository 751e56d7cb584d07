"""Which files a recipe consists of."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mazebot.common.files.root import ROOT
from mazebot.common.files.yaml_source import Source, read_source
from mazebot.common.problems import Problem, WorldError, shown_value, words

if TYPE_CHECKING:
    pass


DEFAULT_WORLDS_DIR = ROOT / "worlds"
SHORT_NAMES = {
    "original": "sim_house",
    "enhanced": "sim_house_enhanced",
    "floor": "sim_house_floor",
    "rooms": "sim_house_rooms",
    "slam": "sim_house_slam",
    "markers": "sim_house_markers",
}

_MAX_EXTENDS = 20


def known_worlds(worlds_dir: Path = DEFAULT_WORLDS_DIR) -> list[str]:
    """Names of the recipes in a folder, sorted.

    Raises WorldError if there is no such folder.
    """
    try:
        return sorted(path.stem for path in worlds_dir.iterdir() if path.suffix == ".yaml")
    except OSError as error:
        raise WorldError(f"worlds_dir: {worlds_dir}: {error.strerror}") from error


def full_name(name: str, worlds_dir: Path) -> str:
    """The name of the recipe that a short name stands for; any other text as it is.

    Raises WorldError if there is no such folder.
    """
    return _full_name(name, known_worlds(worlds_dir))


def _full_name(name: str, known: Sequence[str]) -> str:
    # A world of one's own may be called as a short name is.
    stem = SHORT_NAMES.get(name, name)
    return stem if name not in known and stem in known else name


def named_sources(name: str, worlds_dir: Path) -> list[Source]:
    """The recipe of that name, then the one it extends, and so on.

    Raises WorldError.
    """
    known = known_worlds(worlds_dir)
    stem = _full_name(name, known)
    if stem not in known:
        short = [f"{s} (short for {n})" for s, n in SHORT_NAMES.items() if n in known]
        value = words(f"{name!r:.80}")
        must = f"must be one of {', '.join(known + short)}"
        if not known:
            must = f"{shown_path(worlds_dir)} contains no *.yaml"
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
            must = f"must not extend itself ({circle})"
        elif not (folder / extends).is_file():
            files_known = ", ".join(f"{stem}.yaml" for stem in known_worlds(folder))
            must = f"no such file: must be one of {files_known}"
        elif len(files) >= _MAX_EXTENDS:
            must = f"must not end a chain of more than {_MAX_EXTENDS} recipes"
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
