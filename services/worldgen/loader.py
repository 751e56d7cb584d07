"""World recipes and textures from files: the one place that reads them, and says what is wrong."""

from __future__ import annotations

import hashlib
import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from services.common.config import ROOT, ConfigError
from services.common.documents import World
from services.common.frames import SE2
from services.worldgen import png
from services.worldgen.occupancy import FREE, OCCUPIED, grid_of, occupancy
from services.worldgen.recipe import MistakeError, PoseRecipe, Recipe, mistakes
from services.worldgen.resolve import resolve, used_materials

DEFAULT_WORLDS_DIR = ROOT / "worlds"
SHORT_NAMES = {"original": "sim_house", "enhanced": "sim_house_enhanced"}

_MAX_RECIPE_BYTES = 4 * 1024 * 1024

_Location = tuple[str | int, ...]
_Chain = list[tuple[Path, dict[Any, Any]]]


class WorldError(ConfigError):
    """A world that cannot be loaded: one line with file, field, value, and what would be right."""


@dataclass(frozen=True)
class LoadedWorld:
    """A world, its textures, and its map as (rows, columns) cells of -1, 0 or 100."""

    world: World
    assets: dict[str, bytes]
    """PNG bytes by their sha256 in hex."""
    map_cells: NDArray[np.int8]
    map_origin: SE2


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
) -> LoadedWorld:
    """Load a world by the name of its recipe, or by a short name.

    `texture_base` is the folder of the textures where that is not `textures` in `worlds_dir`.
    Raises WorldError for anything that is wrong with the name, the recipe or a texture.
    """
    chain = _read_chain(name, worlds_dir)
    path = chain[0][0]
    merged: dict[Any, Any] = {}
    for _, content in reversed(chain):
        merged = _merge(merged, content)
    # What the requested file extends is said in the chain.
    merged["extends"] = chain[0][1].get("extends")
    try:
        recipe = Recipe.model_validate(merged, strict=True)
    except ValidationError as error:
        raise WorldError(_first_of(error, chain)) from error
    try:
        return _build(recipe, path, use_aruco, texture_base or worlds_dir / "textures")
    except MistakeError as error:
        raise WorldError(_line(chain, error.location, error.value, error.must)) from error


def _build(recipe: Recipe, path: Path, use_aruco: bool, texture_dir: Path) -> LoadedWorld:
    """Raises MistakeError."""
    if recipe.name != path.stem:
        raise MistakeError(("name",), recipe.name, f"must be {path.stem!r}, as the file is called")
    for mistake in mistakes(recipe):
        raise mistake
    bare = resolve(recipe, path.name, defaultdict(str), use_aruco)
    try:
        grid = grid_of(bare, {})
    except ValueError as error:
        raise MistakeError(("map_resolution_m",), recipe.map_resolution_m, str(error)) from error
    place = recipe.start or PoseRecipe(x_m=0.0, y_m=0.0)
    start = grid.cell(place.x_m, place.y_m)
    if start is None:
        raise MistakeError(("start",), _xy(place), "must lie among the walls")
    cells = occupancy(bare, {}, grid)
    if cells[start] == OCCUPIED:
        raise MistakeError(("start",), _xy(place), "must not lie in a wall")
    for name, place in recipe.locations.items():
        cell = grid.cell(place.x_m, place.y_m)
        if cell is None or cells[cell] != FREE:
            raise MistakeError(
                ("locations", name),
                _xy(place),
                "must lie on free floor that is connected to the start",
            )
    assets: dict[str, bytes] = {}
    sha256_of: dict[str, str] = {}
    for name in used_materials(recipe):
        texture = recipe.materials[name].texture
        if texture and texture not in sha256_of:
            data = _read_texture(texture_dir / texture, ("materials", name, "texture"))
            sha256_of[texture] = hashlib.sha256(data).hexdigest()
            assets[sha256_of[texture]] = data
    world = resolve(recipe, path.name, sha256_of, use_aruco)
    return LoadedWorld(world, assets, cells, grid.origin)


def _xy(place: Any) -> tuple[float, float]:
    return place.x_m, place.y_m


def _read_texture(path: Path, location: _Location) -> bytes:
    """Raises MistakeError."""
    where = f"{_shown(path)} "
    try:
        if path.stat().st_size > png.MAX_BYTES:
            raise MistakeError(
                location, path.name, f"{where}must have at most {png.MAX_BYTES} bytes"
            )
        data = path.read_bytes()
    except OSError as error:
        raise MistakeError(
            location, path.name, f"{where}cannot be read ({error.strerror}), must be a PNG"
        ) from error
    wrong = png.problem(data)
    if wrong:
        raise MistakeError(location, path.name, where + wrong)
    return data


def _read_chain(name: str, worlds_dir: Path) -> _Chain:
    """The recipe of a name, then the one it extends, and so on."""
    known = known_worlds(worlds_dir)
    stem = name if name in known else SHORT_NAMES.get(name, name)
    if stem not in known:
        short = [f"{s} (short for {n})" for s, n in SHORT_NAMES.items() if n in known]
        if not known:
            raise WorldError(f"world_name: {name!r:.80}: {_shown(worlds_dir)} holds no *.yaml")
        names = ", ".join(known + short)
        raise WorldError(f"world_name: {name!r:.80}: must be one of {names}")
    chain: _Chain = []
    path = worlds_dir / f"{stem}.yaml"
    while True:
        chain.append((path, _read_yaml(path)))
        extends = chain[-1][1].get("extends")
        if extends is None:
            return chain
        if not isinstance(extends, str) or not re.fullmatch(r"[\w.-]+\.yaml", extends):
            raise WorldError(
                _line(
                    chain, ("extends",), extends, f"must be a file of {_shown(worlds_dir)}/*.yaml"
                )
            )
        base = worlds_dir / extends
        seen = [file.name for file, _ in chain]
        if base.name in seen:
            circle = " -> ".join([*seen[seen.index(base.name) :], base.name])
            raise WorldError(
                f"{_shown(path)}: extends: {extends!r}: must not lead back to itself ({circle})"
            )
        if not base.is_file():
            raise WorldError(
                f"{_shown(path)}: extends: {extends!r}: no such file: must be one of "
                f"{', '.join(f'{stem}.yaml' for stem in known)}"
            )
        path = base


class _Loader(yaml.SafeLoader):
    """YAML as people expect it: 1e-3 is a number, a key given twice a mistake, nothing aliased."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            event = self.get_event()  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(
                None, None, "an alias (*name): must be written out", event.start_mark
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key.value!r:.60} given twice", key.start_mark
                )
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else "")
        return super().construct_mapping(node, deep)


def _construct_tuple(loader: _Loader, node: yaml.Node) -> tuple[Any, ...]:
    if not isinstance(node, yaml.SequenceNode):
        raise yaml.constructor.ConstructorError(None, None, "must be a list", node.start_mark)
    return tuple(loader.construct_sequence(node, deep=True))


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"),
    "-+0123456789",
)
# Strict validation takes tuples, and no lists, for tuples.
_Loader.add_constructor("tag:yaml.org,2002:seq", _construct_tuple)


def _read_yaml(path: Path) -> dict[Any, Any]:
    shown = _shown(path)
    try:
        if path.stat().st_size > _MAX_RECIPE_BYTES:
            raise WorldError(f"{shown}: must have at most {_MAX_RECIPE_BYTES} bytes")
        content = yaml.load(path.read_text(encoding="utf-8"), _Loader)
    except OSError as error:
        raise WorldError(f"{shown}: cannot be read: {error.strerror}") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise WorldError(f"{shown}: not YAML: {where}{_words(error.problem)}") from error
    # PyYAML lets the errors of the types it converts to through.
    except (
        yaml.YAMLError, ValueError, LookupError, ArithmeticError, TypeError, AttributeError,
        RecursionError,
    ) as error:  # fmt: skip
        raise WorldError(f"{shown}: not YAML: {_words(error)}") from error
    if not isinstance(content, dict):
        raise WorldError(f"{shown}: {content!r:.60}: must be a mapping of fields to values")
    return content


def _merge(base: dict[Any, Any], over: dict[Any, Any]) -> dict[Any, Any]:
    """Mappings key by key; of everything else `over` wins."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        if isinstance(below, dict) and isinstance(value, dict):
            merged[key] = _merge(below, value)
        else:
            merged[key] = value
    return merged


def _first_of(error: ValidationError, chain: _Chain) -> str:
    problems = error.errors(include_url=False)
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    first = problems[0]
    location = tuple(part for part in first["loc"] if part != "[key]")
    return _line(chain, location, first["input"], _must(first), first["type"] == "missing") + more


def _must(problem: ErrorDetails) -> str:
    context = problem.get("ctx", {})
    match problem["type"]:
        case "missing":
            return "is missing"
        case "extra_forbidden":
            return f"unknown field: must be one of {', '.join(_fields(problem['loc'][:-1]))}"
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
        case "string_type" | "invalid_key":
            return "must be a text"
        case "string_pattern_mismatch":
            return "must be letters, digits, `_`, `.` and `-`, and begin with a letter or digit"
        case "model_type" | "dict_type" | "model_attributes_type":
            return "must be a mapping of fields to values"
        case "tuple_type":
            return "must be a list"
        case "literal_error":
            return f"must be {context['expected']}"
        case _:
            return _words(problem["msg"][:1].lower() + problem["msg"][1:])


def _fields(location: _Location) -> list[str]:
    """Names of the fields that the mapping at a place in a recipe may have."""
    schema: Any = Recipe.model_json_schema()
    definitions = schema["$defs"]
    for part in location:
        inner = schema["items"] if isinstance(part, int) else schema.get("properties", {}).get(part)
        if inner is None:
            # A mapping by names of the person's own: all its values are alike.
            (inner,) = schema["patternProperties"].values()
        schema = definitions[inner["$ref"].rpartition("/")[2]] if "$ref" in inner else inner
    return list(schema.get("properties", {}))


def _line(
    chain: _Chain, location: _Location, value: object, must: str, missing: bool = False
) -> str:
    """`worlds/house.yaml: walls[3].length_m: -1: must be > 0`."""
    field = ""
    for part in location:
        index = isinstance(part, int) and field
        field += f"[{part}]" if index else f".{part}" if field else str(part)
    said = "" if missing else f"{_value(value)}: "
    return _words(f"{_shown(_file_of(location, chain))}: {field}: {said}{must}")


def _value(value: object) -> str:
    """A value as a recipe would have it, shortened."""
    try:
        text = repr(value)
    except ValueError:
        return "a number of more digits than Python prints"
    return text if len(text) <= 60 else text[:57] + "..."


def _file_of(location: _Location, chain: _Chain) -> Path:
    """The file of the chain that holds the value at a place, or most of the way to it."""
    best, deepest = chain[0][0], 0
    for path, content in chain:
        here: Any = content
        depth = 0
        for part in location:
            try:
                here = here[part]
            except (LookupError, TypeError):
                break
            depth += 1
        if depth > deepest:
            best, deepest = path, depth
    return best


def _words(text: object) -> str:
    """One line of it."""
    return " ".join(str(text).split())


def _shown(path: Path) -> str:
    """A path as short as it can be said."""
    return str(path.relative_to(ROOT) if path.is_relative_to(ROOT) else path)
