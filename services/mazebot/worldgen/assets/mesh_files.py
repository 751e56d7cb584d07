"""The files that a mesh file refers to: materials, buffers and images."""

from __future__ import annotations

import io
import re
import urllib.parse
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from trimesh.resolvers import Resolver

from mazebot.common.files.images import ImageError, open_image
from mazebot.common.files.limits import MAX_DOCUMENT_BYTES, MAX_IMAGE_PIXELS
from mazebot.common.files.reading import NotReadableError, read_limited
from mazebot.common.problems import shown_value

MAX_COMMENTS = 1_000_000
MAX_TEXTURE_PX = 2048
"""Side of a texture; larger ones are scaled down."""


class MeshError(Exception):
    """Describes an invalid file, as a phrase."""


def read_bytes(path: Path) -> bytes:
    """Contents of a file. Raises MeshError, or OSError."""
    try:
        return read_limited(path, MAX_DOCUMENT_BYTES)
    except NotReadableError as error:
        raise MeshError(str(error)) from error


class MissingFileError(MeshError):
    """A picture or a library of materials that is not there: the mesh is one without it."""


class MeshFiles(Resolver):
    """The files that a mesh file refers to."""

    def __init__(self, path: Path, missing: list[str] | None = None) -> None:
        """Pictures and materials that are not there are appended to `missing`; without it, the
        first is the problem.
        """
        self._missing = missing
        self._folder = path.resolve().parent
        above = [self._folder, *self._folder.parents]
        models = (folder for folder in above if (folder / "model.config").is_file())
        self._root = next(models, self._folder.parent)
        self.file_path = str(path)
        self.file_name = path.name
        self.problem: MeshError | None = None
        """The first problem; trimesh continues without files that it cannot read."""
        self._pngs: dict[int, tuple[Image.Image, bytes]] = {}

    def get(self, name: str) -> bytes:
        """Contents of a file. Raises MeshError."""
        kind = name.lower().rpartition(".")[2]
        try:
            data = read_bytes(self._find(name))
        except MissingFileError as error:
            if self._missing is None or kind == "bin":
                self.problem = self.problem or error
            elif str(error) not in self._missing:
                self._missing.append(str(error))
            raise
        except MeshError as error:
            self.problem = self.problem or error
            raise
        except OSError as error:
            self.problem = self.problem or MeshError(
                f"{shown_value(name)}: cannot be read: {error.strerror}"
            )
            raise self.problem from error
        if kind == "mtl":
            return bare_lines(data)
        if kind != "bin":
            self._check_picture(data, name)
        return data

    def namespaced(self, namespace: str) -> MeshFiles:
        """Files are searched in one folder only."""
        return self

    def keys(self) -> tuple[str, ...]:
        """None are listed."""
        return ()

    def write(self, name: str, data: Any) -> None:
        """Nothing is written."""

    def _check_picture(self, data: bytes, name: str) -> None:
        try:
            open_image(data).close()
        except ImageError as error:
            self.problem = self.problem or MeshError(f"{shown_value(name)}: {error}")
            raise self.problem from error

    def png(self, image: Image.Image) -> bytes:
        """An image as PNG. Raises MeshError."""
        known = self._pngs.get(id(image))
        if known is None:
            known = self._pngs[id(image)] = (image, _png(image))
        return known[1]

    def _find(self, name: str) -> Path:
        relative = urllib.parse.unquote(name).removeprefix("file://").replace("\\", "/").strip()
        base = relative.rpartition("/")[2]
        if "\0" in relative or not base:
            raise MeshError(f"{shown_value(name)}: must be a file name")
        textures = self._folder.parent / "materials" / "textures"
        outside = False
        # The search order of Gazebo; of an absolute path only the last part is used.
        for candidate in (self._folder / relative, self._folder / base, textures / base):
            found = candidate.resolve()
            if found.is_relative_to(self._root):
                if found.is_file():
                    return found
            elif found.exists():
                outside = True
        if outside:
            raise MeshError(f"{shown_value(name)}: must lie in {self._root}")
        raise MissingFileError(f"{shown_value(name)}: no such file")


def bare_lines(text: bytes) -> bytes:
    """OBJ and MTL without comments and runs of blanks. Raises MeshError for too many comments."""
    if text.count(b"#") > MAX_COMMENTS:
        raise MeshError(f"must have at most {MAX_COMMENTS} comments")
    if b"#" in text:
        text = re.sub(rb"(?m)(^|[ \t])#.*$", b"", text)
    # The time that readers take grows with the square of a run of blanks. Substituting one by one
    # would take ten times the memory of the file.
    characters = np.frombuffer(text.replace(b"\t", b" "), np.uint8)
    blank = characters == ord(" ")
    blank[1:] &= blank[:-1]
    blank[:1] = False
    return bytes(characters[~blank])


def _png(image: Image.Image) -> bytes:
    if image.width * image.height > MAX_IMAGE_PIXELS:
        raise MeshError(
            f"a texture of {image.width} x {image.height} pixels: must have at most "
            f"{MAX_IMAGE_PIXELS}"
        )
    try:
        has_alpha = "A" in image.getbands() or "transparency" in image.info
        pixels = image.convert("RGBA" if has_alpha else "RGB")
        if max(pixels.size) > MAX_TEXTURE_PX:
            share = MAX_TEXTURE_PX / max(pixels.size)
            size = [max(1, round(side * share)) for side in pixels.size]
            pixels = pixels.resize((size[0], size[1]), Image.Resampling.LANCZOS)
        png = io.BytesIO()
        # As a new image: without the file's metadata.
        Image.fromarray(np.asarray(pixels)).save(png, "PNG")
    except Exception as error:
        raise MeshError("a texture is cut short or damaged") from error
    return png.getvalue()
