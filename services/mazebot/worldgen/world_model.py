"""Exports a world as a glTF model for any viewer."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from mazebot.common.maths.frames import pose_matrix, rotation_from_quaternion
from mazebot.common.messages.documents import MarkerEntity, Material, Rgba, World
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.marker_entities import marker_entities
from mazebot.common.world.surfaces import PLAIN, Surface, surfaces
from mazebot.worldgen.recipe.loaded_world import LoadedWorld

_MAP_FROM_GLTF = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""glTF has y up, and z towards the viewer (glTF 2.0 specification, section 3.4)."""

# Their types are unknown.
_PBR: Any = trimesh.visual.material.PBRMaterial
_TextureVisuals: Any = trimesh.visual.TextureVisuals


def world_glb(loaded: LoadedWorld) -> bytes:
    """The world, including markers, as binary glTF: y up, metres, textures inside.

    Moving bodies are at their initial poses. The same bytes for the same world.
    """
    world = loaded.world
    entities, pictures = marker_entities(world, meshes=loaded.meshes)
    bodies = {body.name: body for body in world.bodies}
    looks = {m.name: _look(m, loaded.assets) for m in (PLAIN, *world.materials)}
    scene: Any = trimesh.Scene()
    # One mesh per kind and material: a maze has thousands of faces.
    groups: dict[tuple[str, str, bool], list[TriangleMesh]] = {}
    for surface in surfaces(world, loaded.meshes):
        mesh = surface.mesh
        if surface.moves:
            mesh = mesh.moved(pose_matrix(bodies[surface.name]))
        groups.setdefault(_group(surface), []).append(mesh)
    for (kind, material, textured), meshes in groups.items():
        name = f"{kind}_{material}" + ("" if textured else "_plain")
        look = looks[material] if textured else _plain(material, world)
        _add(scene, name, _joined(meshes), look)
    for entity in entities.markers:
        picture = _picture(pictures[entity.texture_sha256])
        _add(scene, entity.name, _panel_mesh(entity), _material(entity.name, (1, 1, 1, 1), picture))
    return bytes(scene.export(file_type="glb"))


def _group(surface: Surface) -> tuple[str, str, bool]:
    return surface.kind, surface.material, surface.textured


def _joined(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    firsts = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
    return TriangleMesh(
        np.concatenate([mesh.vertices_m for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.uvs for mesh in meshes]),
        np.concatenate(
            [m.triangles + first for m, first in zip(meshes, firsts, strict=False)]
        ).astype(np.int32),
    )


def _panel_mesh(entity: MarkerEntity) -> TriangleMesh:
    half = entity.panel_side_m / 2.0
    rotation = rotation_from_quaternion(*entity.orientation_xyzw)
    corners = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    return TriangleMesh(
        corners @ rotation.T + np.array(entity.position_m),
        np.tile(rotation[:, 2], (4, 1)),
        np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]),
        np.array([[0, 2, 1], [0, 3, 2]], np.int32),
    )


def _look(material: Material, assets: Mapping[str, bytes]) -> Any:
    data = assets.get(material.texture_sha256)
    if data is None:
        return _material(material.name, material.diffuse, None)
    return _material(material.name, (1.0, 1.0, 1.0, 1.0), _picture(data))


def _picture(data: bytes) -> Image.Image:
    """An image that trimesh embeds as its original file, if glTF allows the format: re-encoding
    the house's images takes a second, and would degrade a JPEG.
    """
    picture = Image.open(io.BytesIO(data))
    if picture.format in ("PNG", "JPEG"):
        vars(picture)["save"] = lambda file, **_: file.write(data)
    return picture


def _plain(name: str, world: World) -> Any:
    material = next(material for material in world.materials if material.name == name)
    return _material(f"{name}_plain", material.diffuse, None)


def _material(name: str, colour: Rgba, picture: Image.Image | None) -> Any:
    return _PBR(
        name=name,
        baseColorFactor=[round(255 * value) for value in colour],
        baseColorTexture=picture,
        metallicFactor=0.0,
        roughnessFactor=1.0,
    )


def _add(
    scene: Any,
    name: str,
    mesh: TriangleMesh,
    material: Any,
) -> None:
    # In trimesh v points upwards; it flips it for glTF.
    uvs = np.stack([mesh.uvs[:, 0], 1.0 - mesh.uvs[:, 1]], axis=1)
    scene.add_geometry(
        trimesh.Trimesh(
            vertices=mesh.vertices_m @ _MAP_FROM_GLTF,
            faces=mesh.triangles,
            vertex_normals=mesh.normals @ _MAP_FROM_GLTF,
            visual=_TextureVisuals(uv=uvs, material=material),
            process=False,
            validate=False,
        ),
        node_name=name,
        geom_name=name,
    )
