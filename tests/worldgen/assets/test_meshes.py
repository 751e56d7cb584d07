from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mazebot.common.config import ConfigError
from mazebot.common.world.geometry import TriangleMesh
from mazebot.worldgen.assets import mesh_files, meshes
from mazebot.worldgen.assets.glb import glb_of
from mazebot.worldgen.assets.meshes import MeshPart, load_mesh

OBJ = """# a house, with a comment at the end of a line
mtllib house.mtl
o wall
v 0 0 0  # Vertex 1
v 1 0 0
v 1 0 1
v 0 0 1
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 -1 0
usemtl bricks
f 1/1/1 2/2/1 3/3/1 4/4/1
o roof
usemtl red
f 1/1 2/2 5/3
f 1/1 1/1 5/3
"""
MTL = """newmtl red # bright
Kd 1.0 0.2 0.0
newmtl bricks
Kd 1 1 1
map_Kd ../materials/textures/bricks.png
"""


def picture(width: int = 8, height: int = 4) -> Image.Image:
    pixels = np.arange(width * height * 3, dtype=np.uint32).reshape(height, width, 3) % 251
    return Image.fromarray(pixels.astype(np.uint8))


def house(folder: Path) -> Path:
    """A model in the layout of Gazebo's."""
    for name in ("meshes", "materials/textures"):
        (folder / name).mkdir(parents=True)
    (folder / "model.config").write_text("<model/>")
    picture().save(folder / "materials" / "textures" / "bricks.png")
    (folder / "meshes" / "house.mtl").write_text(MTL)
    (folder / "meshes" / "house.obj").write_text(OBJ)
    return folder / "meshes" / "house.obj"


def dae(
    body: str = "", nodes: str = "", unit: str = "1", materials: str = "", symbol: str = ""
) -> str:
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="{unit}"/><up_axis>Y_UP</up_axis></asset>{materials}
<library_geometries><geometry id="g1" name="Corner"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 2 0 0 0 3 0 0 0 4</float_array>
<technique_common><accessor source="#pa" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<source id="t"><float_array id="ta" count="6">0 0 1 0 0 0.25</float_array>
<technique_common><accessor source="#ta" count="3" stride="2">
<param name="S" type="float"/><param name="T" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="2" {symbol}><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="TEXCOORD" source="#t" offset="1"/><p>0 0 1 1 2 2 0 0 2 1 3 2</p></triangles>
{body}</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


NODE = """<node id="n1" name="Left"><translate>1 0 0</translate>
<instance_geometry url="#g1">{}</instance_geometry>
<node id="n2" name="Right"><scale>1 1 -2</scale><instance_geometry url="#g1"/></node></node>"""


def write(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def corners(part: MeshPart) -> list[list[list[float]]]:
    return part.mesh.vertices_m[part.mesh.triangles].tolist()  # type: ignore[no-any-return]


def assert_same(one: MeshPart, other: MeshPart) -> None:
    for name in ("vertices_m", "normals", "uvs", "triangles"):
        assert np.array_equal(getattr(one.mesh, name), getattr(other.mesh, name)), name
        assert getattr(one.mesh, name).dtype == getattr(other.mesh, name).dtype
    assert (one.name, one.diffuse, one.texture_name) == (
        other.name, other.diffuse, other.texture_name,
    )  # fmt: skip
    assert one.texture == other.texture


def test_an_obj_has_a_part_for_each_object_and_material(tmp_path: Path) -> None:
    roof, wall = load_mesh(house(tmp_path))
    assert wall.texture_name == "bricks.png"
    assert wall.texture is not None
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(wall.texture))), np.asarray(picture()))
    assert np.array_equal(wall.mesh.normals, [(0.0, -1.0, 0.0)] * len(wall.mesh.vertices_m))
    # An OBJ counts v from the bottom, a TriangleMesh from the top.
    bottom_left = (wall.mesh.vertices_m == 0.0).all(1)
    assert wall.mesh.uvs[bottom_left].tolist() == [[0.0, 1.0]]
    assert roof.diffuse == pytest.approx((1.0, 0.2, 0.0, 1.0))
    assert roof.texture is None
    # Of its two triangles one has no area, and none has normals.
    assert corners(roof) == [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]
    assert roof.mesh.normals.tolist() == [[0.0, 0.0, 1.0]] * 3


def test_a_submesh_is_taken_by_name_and_centred(tmp_path: Path) -> None:
    path = house(tmp_path)
    (wall,) = load_mesh(path, "wall")
    assert wall.texture is not None
    (centred,) = load_mesh(path, "wall", center=True)
    assert centred.mesh.vertices_m.min(0).tolist() == [-0.5, 0.0, -0.5]
    assert centred.mesh.vertices_m.max(0).tolist() == [0.5, 0.0, 0.5]
    with pytest.raises(ConfigError, match="has no submesh 'door': must be one of roof"):
        load_mesh(path, "door")


def test_of_a_dae_the_unit_counts_and_the_up_axis_does_not(tmp_path: Path) -> None:
    path = write(tmp_path / "a.dae", dae(nodes=NODE.format(""), unit="0.01"))
    left, right = load_mesh(path)
    assert (left.name, right.name) == ("Left", "Right")
    assert left.mesh.vertices_m.max(0).tolist() == pytest.approx([0.03, 0.03, 0.04])
    assert left.mesh.uvs[:3].tolist() == [[0.0, 1.0], [1.0, 1.0], [0.0, 0.75]]
    assert left.mesh.normals[:3].tolist() == [[0.0, 0.0, 1.0]] * 3
    # What faced up faces down in a mirror, and is still the outside.
    assert right.mesh.vertices_m.min(0)[2] == pytest.approx(-0.08)
    a, b, c = np.array(corners(right))[0]
    assert np.cross(b - a, c - a)[2] < 0.0
    assert right.mesh.normals[0].tolist() == [0.0, 0.0, -1.0]
    for name in ("Left", "n1", "Right"):
        assert len(load_mesh(path, name)) == 1
    assert len(load_mesh(path, "Corner")) == len(load_mesh(path, "g1")) == 2


def test_a_dae_may_have_hyphens_in_comments(tmp_path: Path) -> None:
    text = dae(nodes=NODE.format(""))
    path = write(tmp_path / "a.dae", text.replace("<asset>", "<!-- a -- b --><asset>"))
    assert "-- b" in path.read_text()
    plain = load_mesh(write(tmp_path / "b.dae", text))
    assert [part.name for part in load_mesh(path)] == [part.name for part in plain]


def test_a_dae_has_colours_and_textures(tmp_path: Path) -> None:
    library = """<library_images><image id="i"><init_from>my%20bricks.jpg</init_from></image>
</library_images><library_effects><effect id="e"><profile_COMMON>
<newparam sid="su"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="sa"><sampler2D><source>su</source></sampler2D></newparam>
<technique sid="c"><lambert><diffuse><texture texture="sa" texcoord="U"/></diffuse></lambert>
</technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>"""
    bound = """<bind_material><technique_common><instance_material symbol="x" target="#m"/>
</technique_common></bind_material>"""
    text = dae(nodes=NODE.format(bound), materials=library, symbol='material="x"')
    path = write(tmp_path / "a.dae", text)
    with pytest.raises(ConfigError, match=r"my%20bricks\.jpg.*no such file"):
        load_mesh(path)
    missing: list[str] = []
    assert [part.texture for part in load_mesh(path, missing=missing)] == [None, None]
    assert missing == ["'my%20bricks.jpg': no such file"]
    picture().save(tmp_path / "my bricks.jpg")
    left, right = load_mesh(path)
    assert left.texture is not None
    assert left.texture[:4] == b"\x89PNG"
    assert left.texture_name.endswith("bricks.jpg")
    assert right.texture is None
    colour = "<diffuse><color>0.5 0.25 1 1</color></diffuse>"
    text = text.replace('<diffuse><texture texture="sa" texcoord="U"/></diffuse>', colour)
    assert load_mesh(write(path, text))[0].diffuse == (0.5, 0.25, 1.0, 1.0)


def test_an_stl_is_read_in_letters_and_in_bytes(tmp_path: Path) -> None:
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n"
    path = write(tmp_path / "a.stl", f"solid a\n{facet}endfacet\nendsolid a\n")
    binary = write(
        tmp_path / "b.STL",
        b"\0" * 80 + struct.pack("<I12fH", 1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0),
    )
    for file in (path, binary):
        (part,) = load_mesh(file)
        assert corners(part) == [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]
        assert part.mesh.normals.tolist() == [[0.0, 0.0, 1.0]] * 3
        assert (part.texture, part.texture_name) == (None, "")


def some_parts() -> tuple[MeshPart, ...]:
    rng = np.random.default_rng(11)

    def single(*shape: int) -> Any:
        return rng.normal(0.0, 3.0, shape).astype(np.float32).astype(np.float64)

    made = []
    png = io.BytesIO()
    picture().save(png, "PNG")
    for index, name in enumerate(("one", "two äö", "")):
        normals = single(9, 3)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        mesh = TriangleMesh(
            single(9, 3),
            normals.astype(np.float32).astype(np.float64),
            single(9, 2),
            rng.permutation(9).reshape(3, 3).astype(np.int32),
        )
        made.append(
            MeshPart(
                name,
                mesh,
                (0.1, 1.0 / 3.0, 0.7, 0.5) if index else None,
                None if index == 1 else png.getvalue(),
                "" if index == 1 else "a.png",
            )
        )
    return tuple(made)


def test_what_is_written_as_glb_is_read_again_to_the_bit(tmp_path: Path) -> None:
    parts = some_parts()
    data = glb_of(parts)
    assert data == glb_of(parts)
    read = load_mesh(write(tmp_path / "a.glb", data))
    for one, other in zip(parts, read, strict=True):
        texture = other.texture
        if one.texture is not None and texture is not None:
            ours, theirs = (Image.open(io.BytesIO(png)) for png in (one.texture, texture))
            assert np.array_equal(np.asarray(ours), np.asarray(theirs))
            texture = one.texture
        assert_same(
            one, MeshPart(other.name, other.mesh, other.diffuse, texture, other.texture_name)
        )
    again = load_mesh(write(tmp_path / "b.glb", glb_of(read)))
    for one, other in zip(read, again, strict=True):
        assert_same(one, other)
    assert glb_of(again) == glb_of(read)


def test_a_glb_of_what_was_read_is_the_same_whatever_it_was_read_from(tmp_path: Path) -> None:
    sources = [house(tmp_path / "model"), write(tmp_path / "a.dae", dae(nodes=NODE.format("")))]
    for path in sources:
        parts = load_mesh(path)
        read = load_mesh(write(tmp_path / "again.glb", glb_of(parts)))
        assert {part.name for part in read} == {part.name for part in parts}
        for one, other in zip(parts, read, strict=True):
            assert_same(one, other)
        for part in parts:
            (found,) = load_mesh(tmp_path / "again.glb", part.name)
            assert_same(part, found)


def gltf(**changed: Any) -> dict[str, Any]:
    return {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "Top", "mesh": 0, "translation": [0, 0, 5],
                   "scale": [2, 1, 1]}],
        "meshes": [{"name": "Tri", "primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": "a.bin"}],
        **changed,
    }  # fmt: skip


def test_a_gltf_is_read_with_its_nodes_and_the_files_beside_it(tmp_path: Path) -> None:
    write(tmp_path / "a.bin", np.array([0, 0, 0, 1, 0, 0, 0, 1, 0], "<f4").tobytes())
    (part,) = load_mesh(write(tmp_path / "a.gltf", json.dumps(gltf())))
    assert part.name == "Top"
    assert corners(part) == [[[0.0, 0.0, 5.0], [2.0, 0.0, 5.0], [0.0, 1.0, 5.0]]]
    assert load_mesh(tmp_path / "a.gltf", "Tri")[0].name == "Top"


def test_large_textures_are_made_smaller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = house(tmp_path)
    monkeypatch.setattr(mesh_files, "MAX_TEXTURE_PX", 4)
    texture = load_mesh(path, "wall")[0].texture
    assert texture is not None
    assert Image.open(io.BytesIO(texture)).size == (4, 2)


def test_files_are_read_from_the_models_folder_only(tmp_path: Path) -> None:
    path = house(tmp_path / "model")
    picture().save(tmp_path / "secret.png")
    mtl = path.with_name("house.mtl")
    for name in ("../../secret.png", str(tmp_path / "secret.png"), "link.png"):
        mtl.write_text(MTL.replace("../materials/textures/bricks.png", name))
        (path.parent / "link.png").unlink(missing_ok=True)
        (path.parent / "link.png").symlink_to(tmp_path / "secret.png")
        with pytest.raises(ConfigError, match="must lie in "):
            load_mesh(path)
    mtl.write_text(MTL.replace("../materials/textures/bricks.png", "bricks.png"))
    assert load_mesh(path, "wall")[0].texture_name == "bricks.png"
    mtl.unlink()
    with pytest.raises(ConfigError, match=r"house\.mtl.*no such file"):
        load_mesh(path)


def test_a_mesh_does_without_materials_and_pictures_that_are_not_there(tmp_path: Path) -> None:
    path = house(tmp_path)
    (tmp_path / "materials" / "textures" / "bricks.png").unlink()
    missing: list[str] = []
    roof, wall = load_mesh(path, missing=missing)
    assert missing == ["'../materials/textures/bricks.png': no such file"]
    assert (roof.texture, wall.texture) == (None, None)
    assert roof.diffuse == pytest.approx((1.0, 0.2, 0.0, 1.0), abs=0.01)
    path.with_name("house.mtl").unlink()
    missing = []
    plain = load_mesh(path, missing=missing)
    assert missing == ["'house.mtl': no such file"]
    assert sum(len(part.mesh.triangles) for part in plain) == 3
    # What is there and is no picture is a mistake still.
    (tmp_path / "materials" / "textures" / "bricks.png").write_bytes(b"no picture")
    path.with_name("house.mtl").write_text(MTL)
    with pytest.raises(ConfigError, match="is not an image"):
        load_mesh(path, missing=[])


GLB = glb_of(some_parts()[:1])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ply", b"ply", "must be one of .dae, .obj, .stl, .glb, .gltf"),
        ("a.obj", b"", "a.obj: "),
        ("a.obj", b"v 0 0 0\nv 1 0 0\n", "a.obj: "),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "a.obj: "),
        ("a.obj", b"v 0 0 0\nv 1 0 x\nv 0 1 0\nf 1 2 3\n", "a.obj: is damaged, or is not OBJ"),
        ("a.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "a.obj: "),
        (
            "a.obj",
            b"v 0 0 0\nv 1e30 0 0\nv 0 1 0\nf 1 2 3\n",
            "has a vertex that is not within 100000 m",
        ),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "has no triangles"),
        ("a.stl", b"solid", "a.stl: "),
        ("a.stl", b"\0" * 80 + b"\xff\xff\xff\x7f", "a.stl: is damaged, or is not STL"),
        ("a.dae", b"<COLLADA", "a.dae: is damaged, or is not DAE"),
        ("a.dae", b"<!DOCTYPE a [<!ENTITY b 'c'>]><COLLADA/>", "must not have a DOCTYPE"),
        ("a.dae", dae().encode(), "a.dae: "),
        ("a.glb", b"glTF", "is cut short"),
        ("a.glb", GLB[:60], "is cut short"),
        ("a.glb", GLB.replace(b"\x89PNG", b"\x89PGN"), "a texture is damaged, or is not an image"),
        ("a.glb", GLB[:-40], "a.glb: "),
        ("a.gltf", b"{}", "a.gltf: "),
        ("a.gltf", b"[" * 100_000, "a.gltf: is damaged, or is not GLTF"),
        ("a.gltf", json.dumps(gltf(accessors=[{"count": 10**12}])).encode(), "triangles"),
        (
            "a.gltf",
            json.dumps(gltf(nodes=[{"children": [1, 1]}, {"mesh": 0}])).encode(),
            "has a node with two parents",
        ),
        ("a.gltf", json.dumps(gltf()).encode(), "a.bin': no such file"),
        (
            "a.gltf",
            json.dumps(gltf(buffers=[{"byteLength": 36, "uri": "http://x/a.bin"}])).encode(),
            "no such file",
        ),
    ],
)
def test_a_bad_file_is_told_in_one_line(
    tmp_path: Path, name: str, content: bytes, message: str
) -> None:
    path = write(tmp_path / name, content)
    with pytest.raises(ConfigError) as caught:
        load_mesh(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_what_is_no_file_or_too_large_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ConfigError, match=r"none\.obj: cannot be read: No such file"):
        load_mesh(tmp_path / "none.obj")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(ConfigError, match="must be a file"):
        load_mesh(tmp_path / "folder.obj")
    path = house(tmp_path / "model")
    with monkeypatch.context() as patch:
        patch.setattr(meshes, "MAX_TRIANGLES", 1)
        with pytest.raises(ConfigError, match="must have at most 1 triangles"):
            load_mesh(path)
    monkeypatch.setattr(mesh_files, "MAX_IMAGE_PIXELS", 10)
    with pytest.raises(ConfigError, match="a texture of 8 x 4 pixels"):
        load_mesh(path)
    monkeypatch.setattr(mesh_files, "MAX_DOCUMENT_BYTES", 10)
    with pytest.raises(ConfigError, match="must have at most 10 bytes"):
        load_mesh(path)


def test_a_damaged_texture_is_a_mistake(tmp_path: Path) -> None:
    path = house(tmp_path)
    texture = tmp_path / "materials" / "textures" / "bricks.png"
    whole = texture.read_bytes()
    for data in (b"", b"no picture", whole[: len(whole) // 2]):
        texture.write_bytes(data)
        with pytest.raises(ConfigError, match=r"texture|picture") as caught:
            load_mesh(path)
        assert "\n" not in str(caught.value)
