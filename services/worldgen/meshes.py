"""Meshes in files: COLLADA, OBJ, STL and glTF in, self-contained GLB out.

As in Gazebo, a COLLADA file's unit counts and its `up_axis` does not, and nothing is turned: what
the file calls z is up.
"""

from __future__ import annotations

import dataclasses
import io
import json
import logging
import re
import struct
import urllib.parse
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import collada
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.resolvers import Resolver

from services.common.config import ConfigError
from services.common.documents import Rgba
from services.common.frames import Array
from services.common.geometry import MAX_TRIANGLES, TriangleMesh
from services.worldgen.problems import shown_value, words

MAX_FILE_BYTES = 64 * 1024 * 1024
MAX_TEXTURE_PX = 2048
"""Side of a texture; larger ones are made smaller."""
MAX_IMAGE_PIXELS = 64 * 1024 * 1024
MAX_NODES = 20_000
MAX_DEPTH = 50
MAX_OBJECTS = 2_000
MAX_COORDINATE_M = 1e5

SUFFIXES = (".dae", ".obj", ".stl", ".glb", ".gltf")
_EXTRAS = "mazebot"
_UV = "_MAZEBOT_UV"
_IDENTITY = np.eye(4)


@dataclass(frozen=True, eq=False)
class MeshPart:
    """The triangles of a mesh that look alike."""

    name: str
    mesh: TriangleMesh
    diffuse: Rgba | None
    """None: the file says none."""
    texture: bytes | None
    """PNG, at most MAX_TEXTURE_PX a side."""
    texture_name: str
    """File name, for people; empty where there is no texture."""


def load_mesh(
    path: Path, submesh: str | None = None, center: bool = False, data: bytes | None = None
) -> tuple[MeshPart, ...]:
    """The parts of a mesh in a file, one for each material, in metres.

    `submesh` is the name of a node or geometry: only its parts are taken. `center` moves the middle
    of the box around what is taken to the origin. Triangles without area are dropped; where the
    file has no normals they are the triangles' own. Files that it names are read from its model's
    folder, the one with a model.config; else from the folder above its own. `data` is what the file
    holds where it need not be read.

    Raises ConfigError with one line for a file that is missing, too large or damaged.
    """
    try:
        return _load(path, submesh, center, data)
    except _MeshError as error:
        raise ConfigError(words(f"{path}: {error}")) from error
    except OSError as error:
        raise ConfigError(words(f"{path}: cannot be read: {error.strerror or error}")) from error
    except (Exception, RecursionError) as error:
        # The readers of damaged files raise whatever they please.
        kind = path.suffix[1:].upper()
        said = words(str(error)[:200]) or type(error).__name__
        raise ConfigError(words(f"{path}: is damaged, or no {kind}: {said:.120}")) from error


def glb_of(parts: Sequence[MeshPart]) -> bytes:
    """The parts as one self-contained GLB, from which `load_mesh` reads the very same.

    The same bytes for the same parts. Positions, normals and uvs are in single precision.
    """
    writer = _GlbWriter()
    for part in parts:
        writer.add(part)
    return writer.finished()


class _MeshError(Exception):
    """What is wrong with a file, as a phrase."""


@dataclass(frozen=True)
class _Piece:
    """What a reader found: one mesh of one material where it stands."""

    names: tuple[str, ...]
    """The one to show, then others that it may be called by."""
    vertices: Array
    triangles: NDArray[np.int64]
    normals: Array | None
    uvs: Array | None
    """(0, 0) is the top left."""
    matrix: Array
    diffuse: Rgba | None
    image: Image.Image | None
    texture_name: str


def _load(
    path: Path, submesh: str | None, center: bool, data: bytes | None
) -> tuple[MeshPart, ...]:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise _MeshError(f"must be one of {', '.join(SUFFIXES)}")
    if data is None:
        data = _read(path)
    files = _Files(path)
    with warnings.catch_warnings(), _quiet():
        warnings.simplefilter("ignore")
        read = {".dae": _read_dae, ".stl": _read_stl, ".obj": _read_obj}.get(suffix, _read_gltf)
        pieces = _told_apart(read(data, files))
        if files.problem is not None:
            raise files.problem
        if submesh is not None:
            chosen = [piece for piece in pieces if submesh in piece.names]
            if not chosen:
                known = sorted({piece.names[0] for piece in pieces})
                raise _MeshError(
                    f"has no submesh {shown_value(submesh)}: must be one of {', '.join(known):.200}"
                )
            pieces = chosen
        if sum(len(piece.triangles) for piece in pieces) > MAX_TRIANGLES:
            raise _MeshError(f"must have at most {MAX_TRIANGLES} triangles")
        parts = [part for piece in pieces if (part := _part(piece, files)) is not None]
    if not parts:
        raise _MeshError("has no triangles")
    return tuple(_centred(parts) if center else parts)


def _told_apart(pieces: Iterable[_Piece]) -> list[_Piece]:
    """The second of one name is called `name-2`, and still found by the name it had."""
    taken: dict[str, int] = {}
    apart = []
    for piece in pieces:
        name = piece.names[0]
        while name in taken:
            taken[name] += 1
            name = f"{piece.names[0]}-{taken[piece.names[0]]}"
        taken[name] = 1
        apart.append(dataclasses.replace(piece, names=(name, *piece.names)))
    return apart


def _read(path: Path) -> bytes:
    if not path.is_file():
        # Opening a pipe would wait for ever.
        path.stat()
        raise _MeshError("must be a file")
    with path.open("rb") as file:
        data = file.read(MAX_FILE_BYTES + 1)
    if len(data) > MAX_FILE_BYTES:
        raise _MeshError(f"must have at most {MAX_FILE_BYTES} bytes")
    return data


class _quiet:  # noqa: N801
    """Keeps the readers' complaints, which are ours to tell, out of the log."""

    def __enter__(self) -> None:
        self._level = logging.getLogger("trimesh").level
        logging.getLogger("trimesh").setLevel(logging.CRITICAL)

    def __exit__(self, *_: object) -> None:
        logging.getLogger("trimesh").setLevel(self._level)


class _Files(Resolver):
    """The files that a mesh names."""

    def __init__(self, path: Path) -> None:
        self._folder = path.resolve().parent
        above = [self._folder, *self._folder.parents]
        models = (folder for folder in above if (folder / "model.config").is_file())
        self._root = next(models, self._folder.parent)
        self.file_path = str(path)
        self.file_name = path.name
        self.problem: _MeshError | None = None
        """The first thing wrong; trimesh goes on without what it cannot read."""
        self._pngs: dict[int, tuple[Image.Image, bytes]] = {}

    def get(self, name: str) -> bytes:
        """Contents of a file. Raises _MeshError."""
        try:
            data = _read(self._find(name))
        except _MeshError as error:
            self.problem = self.problem or error
            raise
        except OSError as error:
            self.problem = self.problem or _MeshError(
                f"{shown_value(name)}: cannot be read: {error.strerror}"
            )
            raise self.problem from error
        kind = name.lower().rpartition(".")[2]
        if kind == "mtl":
            return _without_comments(data)
        if kind != "bin":
            self._check_picture(data, name)
        return data

    def namespaced(self, namespace: str) -> _Files:
        """Files are looked for in one place."""
        return self

    def keys(self) -> tuple[str, ...]:
        """None are listed."""
        return ()

    def write(self, name: str, data: Any) -> None:
        """Nothing is written."""

    def _check_picture(self, data: bytes, name: str) -> None:
        try:
            Image.open(io.BytesIO(data)).close()
        except Exception as error:
            self.problem = self.problem or _MeshError(f"{shown_value(name)}: must be a picture")
            raise self.problem from error

    def png(self, image: Image.Image) -> bytes:
        """A picture as PNG. Raises _MeshError."""
        known = self._pngs.get(id(image))
        if known is None:
            known = self._pngs[id(image)] = (image, _png(image))
        return known[1]

    def _find(self, name: str) -> Path:
        relative = urllib.parse.unquote(name).removeprefix("file://").replace("\\", "/").strip()
        base = relative.rpartition("/")[2]
        if "\0" in relative or not base:
            raise _MeshError(f"{shown_value(name)}: must be a file name")
        textures = self._folder.parent / "materials" / "textures"
        outside = False
        # As Gazebo looks for them; an author's own absolute path is as good as its last part.
        for candidate in (self._folder / relative, self._folder / base, textures / base):
            found = candidate.resolve()
            if found.is_relative_to(self._root):
                if found.is_file():
                    return found
            elif found.exists():
                outside = True
        wrong = f"must lie in {self._root}" if outside else "no such file"
        raise _MeshError(f"{shown_value(name)}: {wrong}")


def _without_comments(text: bytes) -> bytes:
    # Readers take a time that grows with the square of a run of blanks.
    return re.sub(rb"[ \t]+", b" ", re.sub(rb"(?m)(^|[ \t])#.*$", b"", text))


def _png(image: Image.Image) -> bytes:
    if image.width * image.height > MAX_IMAGE_PIXELS:
        raise _MeshError(
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
        # As a new picture: without the file's own notes.
        Image.fromarray(np.asarray(pixels)).save(png, "PNG")
    except Exception as error:
        raise _MeshError("a texture is cut short or damaged") from error
    return png.getvalue()


def _read_stl(data: bytes, _: _Files) -> Iterator[_Piece]:
    scene = trimesh.load_scene(io.BytesIO(data), file_type="stl", process=False)
    for name, geometry in scene.geometry.items():
        # The normals of an STL are its triangles' own.
        yield _piece_of_trimesh((name,), geometry, _IDENTITY, None, None)


def _read_obj(data: bytes, files: _Files) -> Iterator[_Piece]:
    data = _without_comments(data)
    known = _obj_names(data)
    scene = trimesh.load_scene(
        io.BytesIO(data), file_type="obj", resolver=files, process=False,
        split_objects=True, split_groups=True, group_material=True,
    )  # fmt: skip
    # trimesh joins the names of object, group and material.
    for joined, geometry in sorted(scene.geometry.items()):
        of = tuple(name for name in known if f"_{name}_" in f"_{joined}_")
        yield _of_trimesh((joined, *of), geometry, _IDENTITY, files)


def _obj_names(data: bytes) -> list[str]:
    """Of the objects and groups in an OBJ. Raises _MeshError where there are too many of them."""
    current = {b"o": b"", b"g": b"", b"usemtl": b""}
    parts: set[tuple[bytes, ...]] = set()
    names: dict[str, None] = {}
    for count, (kind, name) in enumerate(
        found.groups() for found in re.finditer(rb"(?m)^[ \t]*(o|g|usemtl)[ \t]+(\S.*)$", data)
    ):
        current[kind] = name.strip()
        parts.add(tuple(current.values()))
        if len(parts) > MAX_OBJECTS or count > 10 * MAX_OBJECTS:
            raise _MeshError(f"must have at most {MAX_OBJECTS} objects, groups and materials")
        if kind != b"usemtl":
            names[current[kind].decode(errors="replace")] = None
    return list(names)


def _read_gltf(data: bytes, files: _Files) -> Iterator[_Piece]:
    is_binary = data[:4] == b"glTF"
    _check_header(data, is_binary)
    scene = trimesh.load_scene(
        io.BytesIO(data), file_type="glb" if is_binary else "gltf", resolver=files, process=False
    )
    order = {name: index for index, name in enumerate(scene.geometry)}
    placed = [(node, *scene.graph[node]) for node in scene.graph.nodes_geometry]
    placed.sort(key=lambda one: (order[one[2]], one[0]))
    for node, matrix, name in placed:
        geometry = scene.geometry[name]
        yield _of_trimesh((str(node), str(name)), geometry, np.asarray(matrix, np.float64), files)


def _check_header(data: bytes, is_binary: bool) -> None:
    """Refuse what a reader would work on without end, or go on without. Raises _MeshError."""
    whole, start = data, 0
    if is_binary:
        if len(data) < 20:
            raise _MeshError("is cut short")
        (size,) = struct.unpack_from("<I", data, 12)
        if 20 + size > len(data):
            raise _MeshError("is cut short")
        data, start = data[20 : 20 + size], 28 + size
    header = json.loads(data)
    if not isinstance(header, dict):
        raise _MeshError("is no glTF")
    nodes = header.get("nodes", [])
    children = [child for node in nodes for child in node.get("children", [])]
    if len(nodes) > MAX_NODES:
        raise _MeshError(f"must have at most {MAX_NODES} nodes")
    if len(set(children)) != len(children):
        raise _MeshError("has a node with two parents")
    parent = {
        child: index for index, node in enumerate(nodes) for child in node.get("children", [])
    }
    for index in range(len(nodes)):
        here: int | None = index
        for _ in range(MAX_DEPTH):
            here = None if here is None else parent.get(here)
        if here is not None:
            raise _MeshError(f"must have nodes at most {MAX_DEPTH} deep, none above itself")
    for accessor in header.get("accessors", []):
        if not 0 <= accessor.get("count", 0) <= 3 * MAX_TRIANGLES:
            raise _MeshError(f"must have at most {MAX_TRIANGLES} triangles")
    triangles = 0
    for node in nodes:
        if "mesh" in node:
            for primitive in header["meshes"][node["mesh"]]["primitives"]:
                index = primitive.get("indices", primitive["attributes"].get("POSITION"))
                triangles += header["accessors"][index]["count"] // 3
    if triangles > MAX_TRIANGLES:
        raise _MeshError(f"must have at most {MAX_TRIANGLES} triangles")
    for image in header.get("images", []):
        if is_binary and "bufferView" in image:
            view = header["bufferViews"][image["bufferView"]]
            first = start + view.get("byteOffset", 0)
            picture = whole[first : first + view["byteLength"]]
            try:
                Image.open(io.BytesIO(picture)).close()
            except Exception as error:
                raise _MeshError("a texture is damaged, or no picture") from error


def _of_trimesh(names: tuple[str, ...], geometry: Any, matrix: Array, files: _Files) -> _Piece:
    normals = (
        np.asarray(geometry.vertex_normals, np.float64)
        if "vertex_normals" in geometry._cache
        else None
    )
    uvs = getattr(geometry.visual, "uv", None)
    if uvs is not None and len(uvs) == len(geometry.vertices):
        # trimesh counts v from the bottom.
        uvs = np.asarray(uvs, np.float64) * (1.0, -1.0) + (0.0, 1.0)
    else:
        uvs = None
    return _piece_of_trimesh(names, geometry, matrix, normals, uvs, files)


def _piece_of_trimesh(
    names: tuple[str, ...], geometry: Any, matrix: Array, normals: Array | None,
    uvs: Array | None, files: _Files | None = None,
) -> _Piece:  # fmt: skip
    material = getattr(geometry.visual, "material", None)
    diffuse, image, texture_name = _look(material)
    exact = geometry.metadata.get(_EXTRAS)
    if isinstance(exact, dict):
        # Written by `glb_of`: what trimesh would round or rename.
        names = (str(exact.get("name", names[0])), *names)
        texture_name = str(exact.get("texture_name", ""))
        colour = exact.get("diffuse")
        diffuse = _rgba(colour) if isinstance(colour, list) else None
        uv = geometry.vertex_attributes.get(_UV)
        uvs = np.asarray(uv, np.float64) if uv is not None else uvs
    return _Piece(
        names=names,
        vertices=np.asarray(geometry.vertices, np.float64),
        triangles=np.asarray(geometry.faces, np.int64),
        normals=normals,
        uvs=uvs,
        matrix=matrix,
        diffuse=diffuse,
        image=image,
        texture_name=(texture_name or f"{names[0]}.png") if image is not None else "",
    )


def _look(material: Any) -> tuple[Rgba | None, Image.Image | None, str]:
    """Colour, texture and its name of one of trimesh's materials."""
    if material is None:
        return None, None, ""
    if hasattr(material, "baseColorFactor"):
        colour, image = material.baseColorFactor, material.baseColorTexture
    else:
        colour, image = material.diffuse, material.image
    name = getattr(image, "info", {}).get("file_path", "") if image is not None else ""
    rgba = None if colour is None else _rgba((np.asarray(colour, np.float64) / 255.0).tolist())
    return rgba, image, str(name).replace("\\", "/").rpartition("/")[2]


def _rgba(colour: Sequence[float]) -> Rgba:
    values = [min(1.0, max(0.0, float(value))) for value in [*colour, 1.0][:4]]
    return values[0], values[1], values[2], values[3]


def _read_dae(data: bytes, files: _Files) -> Iterator[_Piece]:
    if re.search(rb"<!(DOCTYPE|ENTITY)", data):
        raise _MeshError("must have no document type of its own")
    document = collada.Collada(
        io.BytesIO(data),
        ignore=[collada.common.DaeError],
        aux_file_loader=files.get,
    )
    unit_m = document.assetInfo.unitmeter or 1.0
    scale = np.diag([unit_m, unit_m, unit_m, 1.0])
    if document.scene is None:
        raise _MeshError("has no scene")
    pictures: dict[str, Image.Image] = {}
    budget = [MAX_NODES]
    for node in document.scene.nodes:
        yield from _of_dae_node(node, scale, ("",), files, pictures, budget)


def _of_dae_node(
    node: Any, parent: Array, names: tuple[str, ...], files: _Files,
    pictures: dict[str, Image.Image], budget: list[int],
) -> Iterator[_Piece]:  # fmt: skip
    budget[0] -= 1
    if budget[0] < 0:
        raise _MeshError(f"must have at most {MAX_NODES} nodes")
    if isinstance(node, collada.scene.GeometryNode):
        yield from _of_dae_geometry(node, parent, names, files, pictures)
    elif isinstance(node, collada.scene.Node):
        element = node.xmlnode
        own = (element.get("name"), element.get("id"))
        called = tuple(name for name in own if name) or names
        matrix = parent @ np.asarray(node.matrix, np.float64)
        for child in node.children or ():
            yield from _of_dae_node(child, matrix, called, files, pictures, budget)


def _of_dae_geometry(
    node: Any, matrix: Array, names: tuple[str, ...], files: _Files,
    pictures: dict[str, Image.Image],
) -> Iterator[_Piece]:  # fmt: skip
    geometry = node.geometry
    materials = {one.symbol: one.target for one in node.materials}
    called = tuple(name for name in (*names, geometry.name, geometry.id) if name) or ("mesh",)
    for primitive in geometry.primitives:
        triangles = primitive.triangleset() if hasattr(primitive, "triangleset") else primitive
        if not isinstance(triangles, collada.triangleset.TriangleSet) or triangles.vertex is None:
            continue
        corners = np.asarray(triangles.vertex_index).reshape(-1)
        normals = uvs = None
        if triangles.normal is not None and triangles.normal_index is not None:
            normals = np.asarray(triangles.normal, np.float64)[triangles.normal_index.reshape(-1)]
        if len(triangles.texcoordset):
            uvs = np.asarray(triangles.texcoordset[0], np.float64)[
                triangles.texcoord_indexset[0].reshape(-1)
            ]
            uvs = uvs[:, :2] * (1.0, -1.0) + (0.0, 1.0)
        diffuse, image, texture_name = _dae_look(materials.get(triangles.material), files, pictures)
        yield _Piece(
            names=called,
            vertices=np.asarray(triangles.vertex, np.float64)[corners],
            triangles=np.arange(len(corners), dtype=np.int64).reshape(-1, 3),
            normals=normals,
            uvs=uvs,
            matrix=matrix,
            diffuse=diffuse,
            image=image,
            texture_name=texture_name,
        )


def _dae_look(
    material: Any, files: _Files, pictures: dict[str, Image.Image]
) -> tuple[Rgba | None, Image.Image | None, str]:
    diffuse = getattr(getattr(material, "effect", None), "diffuse", None)
    if diffuse is None:
        return None, None, ""
    if isinstance(diffuse, collada.material.Map):
        name = str(diffuse.sampler.surface.image.path)
        if name not in pictures:
            pictures[name] = Image.open(io.BytesIO(files.get(name)))
        return None, pictures[name], name.replace("\\", "/").rpartition("/")[2]
    return _rgba([float(value) for value in diffuse]), None, ""


def _part(piece: _Piece, files: _Files) -> MeshPart | None:
    """Placed, rounded and made whole; None where nothing is left. Raises _MeshError."""
    matrix = piece.matrix
    vertices, triangles = piece.vertices, piece.triangles
    normals, uvs = piece.normals, piece.uvs
    if not len(triangles):
        return None
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise _MeshError("has a triangle of a vertex that is not there")
    moves = not np.array_equal(matrix, _IDENTITY)
    if moves:
        vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        if np.linalg.det(matrix[:3, :3]) < 0.0:
            triangles = triangles[:, ::-1]
    vertices = _rounded(vertices)
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > MAX_COORDINATE_M:
        raise _MeshError(f"has a vertex that is not within {MAX_COORDINATE_M:g} m")
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    facing = np.cross(b - a, c - a)
    length = np.linalg.norm(facing, axis=1)
    triangles, facing = triangles[length > 0.0], facing[length > 0.0]
    if not len(triangles):
        return None
    facing /= length[length > 0.0][:, None]
    if normals is not None and len(normals) == len(vertices):
        normals = _unit(normals @ _cofactors(matrix).T if moves else normals)
    else:
        normals = None
    if normals is None:
        flat = triangles.reshape(-1)
        vertices, normals = vertices[flat], np.repeat(facing, 3, axis=0)
        uvs = None if uvs is None else uvs[flat]
        triangles = np.arange(len(flat)).reshape(-1, 3)
    else:
        used, index = np.unique(triangles, return_inverse=True)
        vertices, normals = vertices[used], normals[used]
        uvs = None if uvs is None else uvs[used]
        triangles = index.reshape(-1, 3)
    if uvs is None:
        uvs = np.zeros((len(vertices), 2))
    uvs, normals = _rounded(uvs), _rounded(normals)
    if not np.isfinite(uvs).all():
        raise _MeshError("has a texture coordinate that is not finite")
    return MeshPart(
        name=piece.names[0],
        mesh=TriangleMesh(vertices, normals, uvs, triangles.astype(np.int32)),
        diffuse=piece.diffuse,
        texture=None if piece.image is None else files.png(piece.image),
        texture_name=piece.texture_name if piece.image is not None else "",
    )


def _rounded(values: Array) -> Array:
    """To single precision, in which assets and GLB hold them."""
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32).astype(np.float64)


def _cofactors(matrix: Array) -> Array:
    """(3, 3) that turns normals with the surface, even where the matrix has no inverse."""
    m = matrix[:3, :3]
    cofactors = np.stack([np.cross(m[1], m[2]), np.cross(m[2], m[0]), np.cross(m[0], m[1])])
    return np.asarray(cofactors * np.sign(np.linalg.det(m)))


def _unit(normals: Array) -> Array | None:
    """Of unit length; None where one is none."""
    length = np.linalg.norm(normals, axis=1)
    if not np.isfinite(length).all() or not (length > 1e-9).all():
        return None
    # What is a unit vector but for its rounding is left, so that it stays what it is.
    return np.where(np.abs(length - 1.0)[:, None] < 1e-6, normals, normals / length[:, None])


def _centred(parts: Iterable[MeshPart]) -> list[MeshPart]:
    parts = list(parts)
    points = np.concatenate([part.mesh.vertices_m for part in parts])
    middle = (points.min(0) + points.max(0)) / 2.0
    return [
        MeshPart(
            part.name,
            TriangleMesh(
                _rounded(part.mesh.vertices_m - middle),
                part.mesh.normals,
                part.mesh.uvs,
                part.mesh.triangles,
            ),
            part.diffuse,
            part.texture,
            part.texture_name,
        )
        for part in parts
    ]


class _GlbWriter:
    """glTF 2.0 in one file: a header in JSON, then the arrays and pictures it speaks of."""

    def __init__(self) -> None:
        self._binary = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._meshes: list[dict[str, Any]] = []
        self._materials: list[dict[str, Any]] = []
        self._images: list[dict[str, Any]] = []
        self._image_of: dict[bytes, int] = {}

    def add(self, part: MeshPart) -> None:
        mesh = part.mesh
        uvs = mesh.uvs.astype("<f4")
        attributes = {
            "POSITION": self._accessor(mesh.vertices_m.astype("<f4"), "VEC3", 34962, True),
            "NORMAL": self._accessor(mesh.normals.astype("<f4"), "VEC3", 34962),
            "TEXCOORD_0": self._accessor(uvs, "VEC2", 34962),
        }
        one = np.float32(1.0)
        if not np.array_equal(one - (one - uvs[:, 1]), uvs[:, 1]):
            # Readers that count v from the bottom round it.
            attributes[_UV] = attributes["TEXCOORD_0"]
        indices = self._accessor(mesh.triangles.astype("<u4").reshape(-1), "SCALAR", 34963)
        exact = {
            "name": part.name,
            "texture_name": part.texture_name,
            "diffuse": None if part.diffuse is None else list(part.diffuse),
        }
        self._meshes.append(
            {
                "name": part.name or f"part{len(self._meshes)}",
                "primitives": [
                    {
                        "attributes": attributes,
                        "indices": indices,
                        "material": len(self._materials),
                    }
                ],
                "extras": {_EXTRAS: exact},
            }
        )
        self._materials.append(self._material(part))

    def finished(self) -> bytes:
        count = len(self._meshes)
        header: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "mazebot"},
            "scene": 0,
            "scenes": [{"nodes": list(range(count))}],
            "nodes": [
                {"mesh": index, "name": mesh["name"]} for index, mesh in enumerate(self._meshes)
            ],
            "meshes": self._meshes,
            "materials": self._materials,
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._binary)}],
        }
        if self._images:
            header["images"] = self._images
            header["textures"] = [
                {"source": index, "sampler": 0} for index in range(len(self._images))
            ]
            # Linear with mipmaps, repeated.
            header["samplers"] = [
                {"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497}
            ]
        text = json.dumps(header, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self._binary), b"BIN\0") + self._binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _view(self, data: bytes, target: int | None = None) -> int:
        view: dict[str, Any] = {
            "buffer": 0, "byteOffset": len(self._binary), "byteLength": len(data)
        }  # fmt: skip
        if target is not None:
            view["target"] = target
        self._views.append(view)
        self._binary += data + b"\0" * (-len(data) % 4)
        return len(self._views) - 1

    def _accessor(self, array: NDArray[Any], kind: str, target: int, bounds: bool = False) -> int:
        accessor: dict[str, Any] = {
            "bufferView": self._view(array.tobytes(), target),
            "componentType": 5125 if array.dtype.kind == "u" else 5126,
            "count": len(array),
            "type": kind,
        }
        if bounds and len(array):
            accessor["min"], accessor["max"] = array.min(0).tolist(), array.max(0).tolist()
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def _material(self, part: MeshPart) -> dict[str, Any]:
        surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
        if part.diffuse is not None:
            surface["baseColorFactor"] = list(part.diffuse)
        if part.texture is not None:
            surface["baseColorTexture"] = {"index": self._image(part.texture, part.texture_name)}
        material: dict[str, Any] = {
            "name": part.texture_name or part.name or f"part{len(self._materials)}",
            "pbrMetallicRoughness": surface,
        }
        if part.diffuse is not None and part.diffuse[3] < 1.0:
            material["alphaMode"] = "BLEND"
        return material

    def _image(self, png: bytes, name: str) -> int:
        index = self._image_of.get(png)
        if index is None:
            index = self._image_of[png] = len(self._images)
            view = self._view(png)
            self._images.append({"bufferView": view, "mimeType": "image/png", "name": name})
        return index
