"""The files that a recipe names: textures, meshes, dictionaries and maps."""

from __future__ import annotations

import hashlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mazebot.common.config import ConfigError
from mazebot.common.messages.documents import DICTIONARY_FILES, World
from mazebot.common.problems import Location, Mistake
from mazebot.common.processors import processors
from mazebot.common.world.geometry import MAX_TRIANGLES, TriangleMesh, mesh_to_bytes
from mazebot.worldgen.recipe.recipe_problems import RecipeProblems
from mazebot.worldgen.recipe.resolve import MeshAsset, MeshKey, mesh_keys, with_textures
from mazebot.worldgen.recipe.sources import shown_path
from mazebot.worldgen.recipe.texture_file import read_texture_file
from mazebot.worldgen.recipe_model import MAX_ASSETS, Recipe

if TYPE_CHECKING:
    from mazebot.common.world.map_files import MapFile

MAX_DICTIONARY_DIGITS = 250_000
"""Modules of all markers of a dictionary, which goes to each service with the world"""


class AssetFiles:
    """Reads them, and reports those that are invalid."""

    def __init__(self, worlds_dir: Path, textures_dir: Path, problems: RecipeProblems) -> None:
        self.assets: dict[str, bytes] = {}
        """PNG of textures and .npz of meshes, by their sha256 in hex."""
        self.mesh_of: dict[str, TriangleMesh] = {}
        """Of the assets that are meshes, by their sha256 in hex."""
        self._worlds_dir = worlds_dir
        self._textures_dir = textures_dir
        self._problems = problems

    def read_texture(self, name: str, location: Location, fatal: bool = True) -> bytes | None:
        """The bytes of a texture; None if it is invalid, which adds a problem."""
        return self._readable(name, location, self._texture(name), fatal)

    def textured(self, recipe: Recipe, world: World) -> World:
        """The world with its materials' textures, as far as these can be read."""
        used = {material.name for material in world.materials}
        locations: dict[str, Location] = {}
        for name, material in recipe.materials.items():
            if name in used and material.texture:
                locations.setdefault(material.texture, ("materials", name, "texture"))
        # To decode them is a good part of loading a world.
        with ThreadPoolExecutor(processors()) as pool:
            textures = list(pool.map(self._texture, locations))
        sha256_of: dict[str, str] = {}
        for (name, location), texture in zip(locations.items(), textures, strict=True):
            data = self._readable(name, location, texture)
            sha256_of[name] = "" if data is None else self._asset(data)
        if len(self.assets) > MAX_ASSETS:
            must = f"must be at most {MAX_ASSETS}"
            self._problems.add(
                Mistake(("materials",), f"{len(self.assets)} textures and meshes", must)
            )
        return with_textures(world, sha256_of)

    def _texture(self, name: str) -> bytes | str:
        """The bytes of a texture, or what is wrong with it."""
        path = self._textures_dir / name
        try:
            return read_texture_file(path)
        except ValueError as error:
            return f"{shown_path(path)} {error}"

    def _readable(
        self, name: str, location: Location, texture: bytes | str, fatal: bool = True
    ) -> bytes | None:
        if isinstance(texture, bytes):
            return texture
        self._problems.add(Mistake(location, name, texture, fatal))
        return None

    def with_dictionaries(self, recipe: Recipe, world: World) -> World:
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
                self._problems.add(Mistake(location, name, str(error)))
                continue
            found.append(codes)
        return world.model_copy(update={"dictionaries": tuple(found)})

    def meshes(self, recipe: Recipe) -> dict[MeshKey, tuple[MeshAsset, ...]]:
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
                    self._problems.add(Mistake(location, file, str(error)))
                    wrong.add(key)
                    continue
                found[key] = tuple(self._mesh_asset(file, index, part) for index, part in
                                   enumerate(parts))  # fmt: skip
            triangles += sum(len(asset.mesh.triangles) for asset in found[key])
            if triangles > MAX_TRIANGLES:
                must = f"must have at most {MAX_TRIANGLES} triangles, with all meshes before it"
                self._problems.add(Mistake(location, key[0], must))
                return {}
        return found

    def ready_map(self, name: str) -> MapFile | None:
        """A ready map; None if it is invalid, which adds a problem."""
        # Most worlds have none, and do not need the map reader.
        from mazebot.common.world.map_files import read_map  # noqa: PLC0415

        try:
            return read_map(self._worlds_dir / "maps" / name)
        except ConfigError as error:
            self._problems.add(Mistake(("map",), name, str(error)))
            return None

    def _mesh_asset(self, file: str, index: int, part: Any) -> MeshAsset:
        sha256 = self._asset(mesh_to_bytes(part.mesh))
        self.mesh_of[sha256] = part.mesh
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
        self.assets[sha256] = data
        return sha256
