"""Meshes in files: COLLADA, OBJ, STL and glTF.

As in Gazebo, a COLLADA file's unit is applied and its `up_axis` is not; nothing is rotated: the
file's z axis is up.
"""

from __future__ import annotations

import dataclasses
import io
import json
import logging
import re
import struct
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

from mazebot.common.config import ConfigError
from mazebot.common.files.images import ImageError, open_image
from mazebot.common.maths import portable
from mazebot.common.maths.frames import Array
from mazebot.common.messages.documents import Rgba
from mazebot.common.problems import shown_value, words
from mazebot.common.world.geometry import MAX_TRIANGLES, TriangleMesh
from mazebot.worldgen.assets.mesh_files import (
    MeshError,
    MeshFiles,
    MissingFileError,
    bare_lines,
    read_bytes,
)
from mazebot.worldgen.xml_comments import without_comments

MAX_NODES = 20_000
MAX_DEPTH = 50
MAX_OBJ_LINE = 65_536
MAX_OBJECTS = 2_000
MAX_COORDINATE_M = 1e5

SUFFIXES = (".dae", ".obj", ".stl", ".glb", ".gltf")
EXTRAS = "mazebot"
"""Key of our own data in a GLB, for which glTF has no field."""
UV_ATTRIBUTE = "_MAZEBOT_UV"
"""Texture coordinates with v counted from the top, bit-exact."""
_IDENTITY = np.eye(4)


@dataclass(frozen=True, eq=False)
class MeshPart:
    """The triangles of a mesh that share a material."""

    name: str
    mesh: TriangleMesh
    diffuse: Rgba | None
    """None: not set in the file."""
    texture: bytes | None
    """PNG, at most MAX_TEXTURE_PX per side."""
    texture_name: str
    """File name, for display; empty if there is no texture."""


def load_mesh(
    path: Path,
    submesh: str | None = None,
    center: bool = False,
    data: bytes | None = None,
    missing: list[str] | None = None,
) -> tuple[MeshPart, ...]:
    """The parts of a mesh in a file, one for each material, in metres.

    `submesh` is the name of a node or geometry: only its parts are taken. `center` moves the middle
    of their bounding box to the origin. Triangles without area are dropped; if the file has no
    normals, those of the triangles are used. Files that it refers to are read from its model's
    folder, the one with a model.config; else from the folder above its own. Pictures and materials
    that are not there are appended to `missing`, a phrase each, and done without; if it is None,
    that is an error. `data` is the file's content, if it is known already.

    Raises ConfigError with one line for a file that is missing, too large or damaged.
    """
    try:
        return _load(path, submesh, center, data, missing)
    except MeshError as error:
        raise ConfigError(words(f"{path}: {error}")) from error
    except OSError as error:
        raise ConfigError(words(f"{path}: cannot be read: {error.strerror or error}")) from error
    except (Exception, RecursionError) as error:
        # Readers of damaged files may raise anything.
        kind = path.suffix[1:].upper()
        text = words(str(error)[:200]) or type(error).__name__
        raise ConfigError(words(f"{path}: is damaged, or is not {kind}: {text:.120}")) from error


@dataclass(frozen=True)
class _Piece:
    """One mesh of one material with its pose, as a reader found it."""

    names: tuple[str, ...]
    """The one to show, then aliases."""
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
    path: Path, submesh: str | None, center: bool, data: bytes | None, missing: list[str] | None
) -> tuple[MeshPart, ...]:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise MeshError(f"must be one of {', '.join(SUFFIXES)}")
    if data is None:
        data = read_bytes(path)
    files = MeshFiles(path, missing)
    with warnings.catch_warnings(), _quiet():
        warnings.simplefilter("ignore")
        read = {".dae": _read_dae, ".stl": _read_stl, ".obj": _read_obj}.get(suffix, _read_gltf)
        pieces = _uniquely_named(read(data, files))
        if files.problem is not None:
            raise files.problem
        if submesh is not None:
            chosen = [piece for piece in pieces if submesh in piece.names]
            if not chosen:
                known = sorted({piece.names[0] for piece in pieces})
                raise MeshError(
                    f"has no submesh {shown_value(submesh)}: must be one of {', '.join(known):.200}"
                )
            pieces = chosen
        if sum(len(piece.triangles) for piece in pieces) > MAX_TRIANGLES:
            raise MeshError(f"must have at most {MAX_TRIANGLES} triangles")
        parts = [part for piece in pieces if (part := _part(piece, files)) is not None]
    if not parts:
        raise MeshError("has no triangles")
    return tuple(_centred(parts) if center else parts)


def _uniquely_named(pieces: Iterable[_Piece]) -> list[_Piece]:
    """Renames the second piece of one name to `name-2`; its old name stays as an alias."""
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


class _quiet:  # noqa: N801
    """Keeps the readers' messages out of the log: their problems are reported by this module."""

    def __enter__(self) -> None:
        self._level = logging.getLogger("trimesh").level
        logging.getLogger("trimesh").setLevel(logging.CRITICAL)

    def __exit__(self, *_: object) -> None:
        logging.getLogger("trimesh").setLevel(self._level)


def _read_stl(data: bytes, _: MeshFiles) -> Iterator[_Piece]:
    scene = trimesh.load_scene(io.BytesIO(data), file_type="stl", process=False)
    for name, geometry in scene.geometry.items():
        # The normals of an STL are those of its triangles.
        yield _piece_of_trimesh((name,), geometry, _IDENTITY, None, None)


def _read_obj(data: bytes, files: MeshFiles) -> Iterator[_Piece]:
    data = bare_lines(data)
    _check_obj(data)
    known = _obj_names(data)
    scene = trimesh.load_scene(
        io.BytesIO(data), file_type="obj", resolver=files, process=False,
        split_objects=True, split_groups=True, group_material=True,
    )  # fmt: skip
    # trimesh joins the names of object, group and material.
    for joined, geometry in sorted(scene.geometry.items()):
        of = tuple(name for name in known if f"_{name}_" in f"_{joined}_")
        yield _of_trimesh((joined, *of), geometry, _IDENTITY)


def _check_obj(data: bytes) -> None:
    """Raises MeshError for an OBJ that takes much more memory than its file: with too many faces,
    or too many corners in one.
    """
    if data.count(b"\nf ") + data.count(b"\n f ") > MAX_TRIANGLES:
        raise MeshError(f"must have at most {MAX_TRIANGLES} triangles")
    ends = np.flatnonzero(np.frombuffer(data, np.uint8) == ord("\n"))
    longest = np.diff(ends, prepend=-1, append=len(data)).max()
    if longest > MAX_OBJ_LINE or data.count(b"\\\n") > MAX_OBJ_LINE:
        raise MeshError(f"must have lines of at most {MAX_OBJ_LINE} characters")


def _obj_names(data: bytes) -> list[str]:
    """Of the objects and groups in an OBJ. Raises MeshError where there are too many of them."""
    current = {b"o": b"", b"g": b"", b"usemtl": b""}
    parts: set[tuple[bytes, ...]] = set()
    names: dict[str, None] = {}
    for count, (kind, name) in enumerate(
        found.groups() for found in re.finditer(rb"(?m)^[ \t]*(o|g|usemtl)[ \t]+(\S.*)$", data)
    ):
        current[kind] = name.strip()
        parts.add(tuple(current.values()))
        if len(parts) > MAX_OBJECTS or count > 10 * MAX_OBJECTS:
            raise MeshError(f"must have at most {MAX_OBJECTS} objects, groups and materials")
        if kind != b"usemtl":
            names[current[kind].decode(errors="replace")] = None
    return list(names)


def _read_gltf(data: bytes, files: MeshFiles) -> Iterator[_Piece]:
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
        yield _of_trimesh((str(node), str(name)), geometry, np.asarray(matrix, np.float64))


def _check_header(data: bytes, is_binary: bool) -> None:
    """Refuse files that would make a reader hang, or silently skip data. Raises MeshError."""
    whole, start = data, 0
    if is_binary:
        if len(data) < 20:
            raise MeshError("is cut short")
        (size,) = struct.unpack_from("<I", data, 12)
        if 20 + size > len(data):
            raise MeshError("is cut short")
        data, start = data[20 : 20 + size], 28 + size
    header = json.loads(data)
    if not isinstance(header, dict):
        raise MeshError("is not glTF")
    nodes = header.get("nodes", [])
    children = [child for node in nodes for child in node.get("children", [])]
    if len(nodes) > MAX_NODES:
        raise MeshError(f"must have at most {MAX_NODES} nodes")
    if len(set(children)) != len(children):
        raise MeshError("has a node with two parents")
    parent = {
        child: index for index, node in enumerate(nodes) for child in node.get("children", [])
    }
    for index in range(len(nodes)):
        here: int | None = index
        for _ in range(MAX_DEPTH):
            here = None if here is None else parent.get(here)
        if here is not None:
            raise MeshError(f"must have nodes nested at most {MAX_DEPTH} deep, without cycles")
    for accessor in header.get("accessors", []):
        if not 0 <= accessor.get("count", 0) <= 3 * MAX_TRIANGLES:
            raise MeshError(f"must have at most {MAX_TRIANGLES} triangles")
    triangles = 0
    for node in nodes:
        if "mesh" in node:
            for primitive in header["meshes"][node["mesh"]]["primitives"]:
                index = primitive.get("indices", primitive["attributes"].get("POSITION"))
                triangles += header["accessors"][index]["count"] // 3
    if triangles > MAX_TRIANGLES:
        raise MeshError(f"must have at most {MAX_TRIANGLES} triangles")
    for image in header.get("images", []):
        if is_binary and "bufferView" in image:
            view = header["bufferViews"][image["bufferView"]]
            first = start + view.get("byteOffset", 0)
            picture = whole[first : first + view["byteLength"]]
            try:
                open_image(picture).close()
            except ImageError as error:
                raise MeshError(f"a texture {error}") from error


def _of_trimesh(names: tuple[str, ...], geometry: Any, matrix: Array) -> _Piece:
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
    return _piece_of_trimesh(names, geometry, matrix, normals, uvs)


def _piece_of_trimesh(
    names: tuple[str, ...], geometry: Any, matrix: Array, normals: Array | None,
    uvs: Array | None,
) -> _Piece:  # fmt: skip
    material = getattr(geometry.visual, "material", None)
    diffuse, image, texture_name = _look(material)
    exact = geometry.metadata.get(EXTRAS)
    if isinstance(exact, dict):
        # Written by `glb_of`: values that trimesh would round or rename.
        names = (str(exact.get("name", names[0])), *names)
        texture_name = str(exact.get("texture_name", ""))
        colour = exact.get("diffuse")
        diffuse = _rgba(colour) if isinstance(colour, list) else None
        uv = geometry.vertex_attributes.get(UV_ATTRIBUTE)
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


def _read_dae(data: bytes, files: MeshFiles) -> Iterator[_Piece]:
    data = without_comments(data)
    if re.search(rb"<!(DOCTYPE|ENTITY)", data):
        raise MeshError("must not have a DOCTYPE")
    document = collada.Collada(
        io.BytesIO(data),
        ignore=[collada.common.DaeError],
        aux_file_loader=files.get,
    )
    unit_m = document.assetInfo.unitmeter or 1.0
    scale = np.diag([unit_m, unit_m, unit_m, 1.0])
    if document.scene is None:
        raise MeshError("has no scene")
    pictures: dict[str, Image.Image | None] = {}
    budget = [MAX_NODES]
    for node in document.scene.nodes:
        yield from _of_dae_node(node, scale, ("",), files, pictures, budget)


def _of_dae_node(
    node: Any, parent: Array, names: tuple[str, ...], files: MeshFiles,
    pictures: dict[str, Image.Image | None], budget: list[int],
) -> Iterator[_Piece]:  # fmt: skip
    budget[0] -= 1
    if budget[0] < 0:
        raise MeshError(f"must have at most {MAX_NODES} nodes")
    if isinstance(node, collada.scene.GeometryNode):
        yield from _of_dae_geometry(node, parent, names, files, pictures)
    elif isinstance(node, collada.scene.Node):
        element = node.xmlnode
        own = (element.get("name"), element.get("id"))
        called = tuple(name for name in own if name) or names
        matrix = portable.product(parent, np.asarray(node.matrix, np.float64))
        for child in node.children or ():
            yield from _of_dae_node(child, matrix, called, files, pictures, budget)


def _of_dae_geometry(
    node: Any, matrix: Array, names: tuple[str, ...], files: MeshFiles,
    pictures: dict[str, Image.Image | None],
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
    material: Any, files: MeshFiles, pictures: dict[str, Image.Image | None]
) -> tuple[Rgba | None, Image.Image | None, str]:
    diffuse = getattr(getattr(material, "effect", None), "diffuse", None)
    if diffuse is None:
        return None, None, ""
    if isinstance(diffuse, collada.material.Map):
        name = str(diffuse.sampler.surface.image.path)
        if name not in pictures:
            pictures[name] = _picture(files, name)
        return None, pictures[name], name.replace("\\", "/").rpartition("/")[2]
    return _rgba([float(value) for value in diffuse]), None, ""


def _picture(files: MeshFiles, name: str) -> Image.Image | None:
    """A picture; None where it is not there, which the files have noted."""
    try:
        return Image.open(io.BytesIO(files.get(name)))
    except MissingFileError:
        return None


def _part(piece: _Piece, files: MeshFiles) -> MeshPart | None:
    """Transformed, rounded and with missing normals added; None if nothing is left. Raises
    MeshError.
    """
    matrix = piece.matrix
    vertices, triangles = piece.vertices, piece.triangles
    normals, uvs = piece.normals, piece.uvs
    if not len(triangles):
        return None
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise MeshError("has a triangle with a vertex that does not exist")
    moves = not np.array_equal(matrix, _IDENTITY)
    if moves:
        vertices = portable.product(vertices, matrix[:3, :3].T) + matrix[:3, 3]
        if portable.determinants(matrix[:3, :3]) < 0.0:
            triangles = triangles[:, ::-1]
    vertices = _rounded(vertices)
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > MAX_COORDINATE_M:
        raise MeshError(f"has a vertex that is not within {MAX_COORDINATE_M:g} m")
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    facing = np.cross(b - a, c - a)
    length = portable.lengths(facing)
    triangles, facing = triangles[length > 0.0], facing[length > 0.0]
    if not len(triangles):
        return None
    facing /= length[length > 0.0][:, None]
    if normals is not None and len(normals) == len(vertices):
        normals = _unit(portable.product(normals, _cofactors(matrix).T) if moves else normals)
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
        raise MeshError("has a texture coordinate that is not finite")
    return MeshPart(
        name=piece.names[0],
        mesh=TriangleMesh(vertices, normals, uvs, triangles.astype(np.int32)),
        diffuse=piece.diffuse,
        texture=None if piece.image is None else files.png(piece.image),
        texture_name=piece.texture_name if piece.image is not None else "",
    )


def _rounded(values: Array) -> Array:
    """To single precision, as stored in assets and GLB."""
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32).astype(np.float64)


def _cofactors(matrix: Array) -> Array:
    """(3, 3) that transforms normals, even if the matrix has no inverse."""
    m = matrix[:3, :3]
    cofactors = np.stack([np.cross(m[1], m[2]), np.cross(m[2], m[0]), np.cross(m[0], m[1])])
    return np.asarray(cofactors * np.sign(portable.determinants(m)))


def _unit(normals: Array) -> Array | None:
    """Normalised; None if one has no length."""
    length = portable.lengths(normals)
    if not np.isfinite(length).all() or not (length > 1e-9).all():
        return None
    # Vectors of unit length up to rounding are left unchanged, so that they stay bit-identical.
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
