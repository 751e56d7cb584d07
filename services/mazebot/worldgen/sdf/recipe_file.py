"""Writes an imported recipe to files: YAML, and the images, meshes and maps that it needs."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from mazebot.common.config import ConfigError
from mazebot.common.files.folder_writing import write_file
from mazebot.worldgen.sdf.model import ImportReport

_HEADER = "# Made from "


@dataclass(frozen=True)
class ImportedWorld:
    """The result of converting an SDF world."""

    recipe: dict[str, Any]
    """Input for recipe.Recipe."""
    files: dict[str, bytes]
    """By their path from the recipe's folder: `textures/x.png`, `meshes/y.glb`, `maps/z.yaml`."""
    report: ImportReport
    """The reader's, with elements that could not be converted added."""


def recipe_yaml(recipe: Mapping[str, Any]) -> str:
    """A recipe as YAML that preserves the numbers exactly."""
    text = yaml.dump(
        _plain(recipe), Dumper=_Dumper, sort_keys=False, default_flow_style=None,
        allow_unicode=True, width=100,
    )  # fmt: skip
    return str(text)


def write_recipe(imported: ImportedWorld, file: Path) -> None:
    """Write a recipe, and the files it needs in the folders beside it.

    An image or mesh is renamed if a different file has its name already. The recipe is written
    last, and replaces only one of an earlier import. Raises ConfigError.
    """
    try:
        if file.exists() and not file.read_text(encoding="utf-8").startswith(_HEADER):
            raise ConfigError(f"{file}: already exists and was not created by an import")
        renamed = {
            path: _free_path(file.parent, path, data) for path, data in imported.files.items()
        }
        recipe = {**_renamed(imported.recipe, renamed), "name": file.stem}
        for path, data in imported.files.items():
            _write(file.parent / renamed[path], data)
        source = " ".join(imported.report.world.split()) or "a world"
        text = f"{_HEADER}{source!r} in SDF by `mazebot world import`.\n{recipe_yaml(recipe)}"
        _write(file, text.encode())
    except OSError as error:
        raise ConfigError(f"{file}: cannot be written: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{file}: already exists and was not created by an import") from error


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data: object) -> bool:
        return True


# The recipe reader parses these as numbers: as names they need quotes.
_Dumper.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)


def _plain(value: Any) -> Any:
    """Converts tuples to lists."""
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return value


def _write(file: Path, data: bytes) -> None:
    """Write atomically; a file with the same content is left alone."""
    if file.is_file() and file.read_bytes() == data:
        return
    file.parent.mkdir(parents=True, exist_ok=True)
    write_file(file, data)


def _free_path(folder: Path, path: str, data: bytes) -> str:
    file = folder / path
    if not file.exists() or (file.is_file() and file.read_bytes() == data):
        return path
    kind, _, name = path.rpartition("/")
    stem, dot, suffix = name.rpartition(".")
    return f"{kind}/{stem}-{hashlib.sha256(data).hexdigest()[:8]}{dot}{suffix}"


def _renamed(recipe: Mapping[str, Any], paths: Mapping[str, str]) -> dict[str, Any]:
    """The recipe with the files' new names."""

    def name(kind: str, old: str) -> str:
        return paths.get(f"{kind}/{old}", old).rpartition("/")[2]

    changed = dict(recipe)
    changed["materials"] = {
        key: {**look, "texture": name("textures", look["texture"])} if "texture" in look else look
        for key, look in recipe["materials"].items()
    }
    changed["bodies"] = [
        {**body, "shapes": [_with_mesh(shape, name) for shape in body["shapes"]]}
        for body in recipe.get("bodies", ())
    ]
    if not changed["bodies"]:
        del changed["bodies"]
    if "map" in recipe:
        changed["map"] = name("maps", recipe["map"])
    return changed


def _with_mesh(shape: Mapping[str, Any], name: Callable[[str, str], str]) -> dict[str, Any]:
    geometry = shape["geometry"]
    if geometry["kind"] != "mesh":
        return dict(shape)
    new = name("meshes", geometry["file"])
    changed = {**shape, "geometry": {**geometry, "file": new}}
    if shape.get("material") == geometry["file"]:
        changed["material"] = new
    return changed
