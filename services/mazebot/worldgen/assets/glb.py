"""Meshes as self-contained GLB."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mazebot.worldgen.assets.meshes import EXTRAS, UV_ATTRIBUTE, MeshPart


def glb_of(parts: Sequence[MeshPart]) -> bytes:
    """The parts as one self-contained GLB, from which `meshes.load_mesh` reads identical parts.

    The same bytes for the same parts. Positions, normals and uvs are in single precision.
    """
    writer = _GlbWriter()
    for part in parts:
        writer.add(part)
    return writer.finished()


class _GlbWriter:
    """glTF 2.0 in one file: a JSON header, then the arrays and images that it refers to."""

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
            # Readers that count v from the bottom would round it.
            attributes[UV_ATTRIBUTE] = attributes["TEXCOORD_0"]
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
                "extras": {EXTRAS: exact},
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
