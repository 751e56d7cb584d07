"""The reader and files: includes, xacro, and what means harm."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from xacro import XacroException

from mazebot.common.maths.frames import rotation_from_rpy, transform_matrix
from mazebot.worldgen.sdf.files.xacro_process import compiled
from mazebot.worldgen.sdf.model import SdfWorld
from mazebot.worldgen.sdf.reading.read import read_sdf

BOX = "<geometry><box><size>1 1 1</size></box></geometry>"
LINK = f'<link name="link"><collision name="c">{BOX}</collision></link>'
XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'


def world_file(file: Path, inside: str, root: str = "") -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f'<sdf version="1.9" {root}><world name="w">{inside}</world></sdf>')
    return file


def model_folder(folder: Path, inside: str = LINK, more: str = "") -> Path:
    folder.mkdir(parents=True)
    (folder / "model.config").write_text(
        f"<model><name>{folder.name}</name><sdf version='1.9'>model.sdf</sdf></model>"
    )
    (folder / "model.sdf").write_text(
        f'<sdf version="1.9"><model name="{folder.name}" {more}>{inside}</model></sdf>'
    )
    return folder


def include(uri: str, more: str = "") -> str:
    return f"<include><uri>{uri}</uri>{more}</include>"


def clean(world: SdfWorld) -> SdfWorld:
    assert world.report.errors == ()
    return world


def kinds(world: SdfWorld) -> list[str]:
    return [error.kind for error in world.report.errors]


def test_an_include_is_found_on_the_roots_and_beside_the_file(tmp_path: Path) -> None:
    model_folder(tmp_path / "path" / "chair", f"<pose>9 9 9 0 0 0</pose><static>1</static>{LINK}")
    model_folder(tmp_path / "w" / "models" / "table")
    model_folder(tmp_path / "w" / "worlds" / "lamp")
    file = world_file(
        tmp_path / "w" / "worlds" / "w.sdf",
        include("model://chair", "<name>throne</name><pose>1 0 0 0 0 0</pose><static>0</static>")
        + include("model://chair")
        + include("model://table", "<experimental:params><a/></experimental:params>")
        + include("lamp"),
    )
    world = clean(read_sdf(file, [tmp_path / "path"]))
    assert [model.name for model in world.models] == ["throne", "chair", "table", "lamp"]
    assert [model.static for model in world.models] == [False, True, False, False]
    assert world.models[0].world_from_model[0, 3] == 1.0
    assert world.models[1].world_from_model[0, 3] == 9.0
    assert [(one.uri, one.name, one.file) for one in world.report.includes] == [
        ("model://chair", "throne", "path/chair/model.sdf"),
        ("model://chair", "chair", "path/chair/model.sdf"),
        ("model://table", "table", str(tmp_path / "w" / "models" / "table" / "model.sdf")),
        ("lamp", "lamp", "lamp/model.sdf"),
    ]
    assert [one.what for one in world.report.ignored] == ["element experimental:params"]


def test_a_model_includes_models_and_is_placed_by_a_frame_of_theirs(tmp_path: Path) -> None:
    model_folder(tmp_path / "inner", LINK + '<frame name="top"><pose>0 0 2 0 0 0.5</pose></frame>')
    model_folder(
        tmp_path / "outer",
        '<link name="base"/>'
        + include(
            "model://inner",
            '<name>i</name><placement_frame>top</placement_frame><pose relative_to="f"/>',
        )
        + '<frame name="f" attached_to="base"><pose>0 3 0 0 0 0</pose></frame>'
        + '<joint name="j" type="fixed"><parent>base</parent><child>i::link</child></joint>',
    )
    file = world_file(
        tmp_path / "w.sdf", include("model://outer", "<pose degrees='true'>1 0 0 0 0 90</pose>")
    )
    world = clean(read_sdf(file))
    assert [model.name for model in world.models] == ["outer", "outer::i"]
    assert [(link.name, link.fixed_to) for link in world.links] == [
        ("outer::base", "outer::base"),
        ("outer::i::link", "outer::base"),
    ]
    expected = transform_matrix(rotation_from_rpy(0, 0, np.pi / 2), (-2.0, 0.0, 0.0))
    inner = transform_matrix(rotation_from_rpy(0, 0, -0.5), (0.0, 0.0, -2.0))
    np.testing.assert_allclose(world.links[1].world_from_link, expected @ inner, atol=1e-12)


def test_a_merged_include_leaves_no_model_behind(tmp_path: Path) -> None:
    model_folder(
        tmp_path / "part",
        LINK + '<frame name="tip"><pose>0 0 1 0 0 0</pose></frame><joint name="k" type="fixed">'
        "<parent>__model__</parent><child>other</child></joint>"
        '<link name="other"><pose relative_to="tip">0 0 1 0 0 0</pose></link>',
    )
    file = world_file(
        tmp_path / "w.sdf",
        '<model name="m"><link name="base"/><include merge="true"><uri>model://part</uri>'
        "<pose>5 0 0 0 0 0</pose></include>"
        '<joint name="j" type="fixed"><parent>base</parent><child>link</child></joint></model>',
    )
    world = clean(read_sdf(file))
    poses = {link.name: tuple(link.world_from_link[:3, 3]) for link in world.links}
    assert poses == {"m::base": (0, 0, 0), "m::link": (5, 0, 0), "m::other": (5, 0, 2)}
    assert {link.fixed_to for link in world.links} == {"m::base"}


def test_a_merged_include_can_be_placed_by_a_frame(tmp_path: Path) -> None:
    model_folder(
        tmp_path / "part",
        '<link name="link"><visual name="v"><pose relative_to="__model__">0 7 0 0 0 0</pose>'
        f'{BOX}</visual><pose>0 1 0 0 0 0</pose></link><frame name="tip"><pose>0 0 2 0 0 0</pose>'
        "</frame>",
    )
    merge = (
        '<include merge="true"><uri>model://part</uri><pose>5 0 0 0 0 0</pose>'
        "<placement_frame>tip</placement_frame></include>"
    )
    file = world_file(tmp_path / "w.sdf", f'<model name="m"><link name="base"/>{merge}</model>')
    link = clean(read_sdf(file)).links[1]
    np.testing.assert_allclose(link.world_from_link[:3, 3], [5, 1, -2], atol=1e-12)
    np.testing.assert_allclose(link.shapes[0].link_from_shape[:3, 3], [0, 6, 0], atol=1e-12)
    file = world_file(tmp_path / "w.sdf", merge)
    assert kinds(read_sdf(file)) == ["MERGE_INCLUDE_UNSUPPORTED"]


def test_the_newest_file_that_can_be_read_is_chosen(tmp_path: Path) -> None:
    folder = model_folder(tmp_path / "m")
    listed = "".join(
        f"<sdf version='{version}'>{name}.sdf</sdf>"
        for version, name in (("1.5", "old"), ("1.10", "new"), ("1.9", "mid"), ("3.0", "far"))
    )
    (folder / "model.config").write_text(f"<model>{listed}</model>")
    for name in ("old", "new", "mid", "far"):
        (folder / f"{name}.sdf").write_text(
            f'<sdf version="1.5"><model name="{name}">{LINK}</model></sdf>'
        )
    world = clean(read_sdf(folder))
    assert (world.name, world.links[0].name) == ("new", "new::link")


def test_includes_that_cannot_be_had(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "lost").mkdir()
    (tmp_path / "lost" / "model.config").write_text(
        "<model><sdf version='1.5'>no.sdf</sdf></model>"
    )
    (tmp_path / "bad.sdf").write_text("<sdf")
    world_file(tmp_path / "world.sdf", "")
    uris = ("model://empty", "model://lost", "bad.sdf", "world.sdf", "ftp://x", "a\tb", "model://")
    file = world_file(tmp_path / "w.sdf", "".join(include(uri) for uri in uris))
    assert kinds(read_sdf(file)) == [
        "URI_LOOKUP",
        "URI_LOOKUP",
        "FILE_READ",
        "ELEMENT_MISSING",
        "URI_INVALID",
        "URI_INVALID",
        "URI_INVALID",
    ]


@pytest.mark.parametrize(
    "address",
    [
        "https://fuel.gazebosim.org/1.0/OpenRobotics/models/",
        "https://fuel.ignitionrobotics.org/1.0/openrobotics/models/",
        "http://fuel.ignitionrobotics.org/1.0/OpenRobotics/models/",
        "https://api.ignitionfuel.org/1.0/OpenRobotics/models/",
        "https://app.gazebosim.org/OpenRobotics/fuel/models/",
        "https://app.gazebosim.org/OpenRobotics/models/",
        "fuel://fuel.gazebosim.org/1.0/OpenRobotics/models/",
        "model://",
    ],
)
@pytest.mark.parametrize("ground", ["Ground Plane", "Ground%20Plane", "ground_plane"])
def test_gazebos_ground_plane_and_sun_need_not_be_fetched(
    tmp_path: Path, address: str, ground: str
) -> None:
    world = clean(
        read_sdf(
            world_file(tmp_path / "w.sdf", include(address + ground) + include(address + "Sun"))
        )
    )
    assert [model.name for model in world.models] == ["ground_plane"]
    assert [light.kind for light in world.lights] == ["directional"]


@pytest.mark.parametrize(
    "ending", ["/2", "/tip", "/", "/2/files/model.sdf", "/tip/files/model.sdf"]
)
def test_gazebos_ground_plane_may_be_asked_for_by_version_and_file(
    tmp_path: Path, ending: str
) -> None:
    uri = f"https://fuel.gazebosim.org/1.0/OpenRobotics/models/Ground Plane{ending}"
    world = clean(read_sdf(world_file(tmp_path / "w.sdf", include(uri))))
    assert [model.name for model in world.models] == ["ground_plane"]


def test_a_ground_plane_of_ones_own_comes_before_the_shipped_one(tmp_path: Path) -> None:
    model_folder(tmp_path / "mine" / "ground_plane", LINK + LINK.replace('"link"', '"second"'))
    for uri in (
        "https://fuel.gazebosim.org/1.0/OpenRobotics/models/Ground Plane",
        "model://ground_plane",
    ):
        file = world_file(tmp_path / "w.sdf", include(uri))
        assert clean(read_sdf(file, [tmp_path / "mine"])).report.links == 2


@pytest.mark.parametrize("model", ["Somebody/models/Ground Plane", "OpenRobotics/models/Table"])
def test_no_other_model_of_fuel_is_taken_for_the_shipped_ones(tmp_path: Path, model: str) -> None:
    uri = f"https://fuel.gazebosim.org/1.0/{model}"
    world = read_sdf(world_file(tmp_path / "w.sdf", include(uri)))
    assert kinds(world) == ["URI_INVALID"]


def test_a_model_of_fuel_is_taken_from_the_path(tmp_path: Path) -> None:
    uri = "https://fuel.gazebosim.org/1.0/OpenRobotics/models/Cardboard%20Box/2"
    world = read_sdf(world_file(tmp_path / "w.sdf", include(uri)))
    assert kinds(world) == ["URI_INVALID"]
    assert "--path" in world.report.errors[0].message
    model_folder(tmp_path / "mine" / "Cardboard Box")
    found = read_sdf(world_file(tmp_path / "w.sdf", include(uri)), [tmp_path / "mine"])
    assert kinds(found) == []
    assert found.report.models == 1


@pytest.mark.parametrize(
    ("folder", "uri"),
    [
        ("ground_plane", "Ground Plane"),
        ("ground plane", "Ground%20Plane/tip"),
        ("fuel.gazebosim.org/openrobotics/models/ground plane/10", "Ground Plane"),
        ("fuel.gazebosim.org/openrobotics/models/ground plane/9", "Ground Plane/9"),
    ],
)
def test_a_model_of_fuel_may_be_in_a_folder_of_gazebos_manner(
    tmp_path: Path, folder: str, uri: str
) -> None:
    roots = [tmp_path / "mine"]
    for version in ("9", "10"):
        if folder.endswith(version):
            model_folder(roots[0] / folder)
            model_folder((roots[0] / folder).with_name("8"), "")
    if not folder[-1].isdigit():
        model_folder(roots[0] / folder)
    uri = f"https://fuel.gazebosim.org/1.0/OpenRobotics/models/{uri}"
    world = clean(read_sdf(world_file(tmp_path / "w.sdf", include(uri)), roots))
    assert world.report.links == 1


def test_a_uri_may_have_two_schemes(tmp_path: Path) -> None:
    model_folder(tmp_path / "models" / "box", LINK)
    (tmp_path / "models" / "box" / "face.png").write_bytes(b"picture")
    look = (
        "<material><pbr><metal><albedo_map>file://model://box/face.png</albedo_map></metal></pbr>"
        "</material>"
    )
    link = f'<link name="l"><visual name="v">{BOX}{look}</visual></link>'
    inside = f'<model name="m">{link}</model>'
    world = clean(read_sdf(world_file(tmp_path / "w.sdf", inside)))
    material = world.links[0].shapes[0].material
    assert material is not None
    assert material.albedo_map == (tmp_path / "models" / "box" / "face.png").resolve()


def test_a_file_may_hold_an_include_alone(tmp_path: Path) -> None:
    model_folder(tmp_path / "models" / "box")
    file = tmp_path / "w.sdf"
    file.write_text(f'<sdf version="1.9">{include("model://box", "<name>crate</name>")}</sdf>')
    world = clean(read_sdf(file))
    assert (world.name, [link.name for link in world.links]) == ("crate", ["crate::link"])
    assert world.report.ignored == ()


def test_only_models_are_merged(tmp_path: Path) -> None:
    (tmp_path / "lamp.sdf").write_text('<sdf version="1.9"><light name="lamp" type="point"/></sdf>')
    inside = '<include merge="true"><uri>lamp.sdf</uri></include>'
    world = read_sdf(world_file(tmp_path / "w.sdf", inside))
    assert kinds(world) == ["MERGE_INCLUDE_UNSUPPORTED"]


PLAIN = f'<sdf version="1.9"><world name="w"><model name="m">{LINK}</model></world></sdf>'


@pytest.mark.parametrize(
    "data",
    [
        PLAIN.encode("utf-8-sig"),
        PLAIN.encode("utf-16"),
        ('<?xml version="1.0" encoding="ISO-8859-1"?>' + PLAIN.replace('m"', 'Möbel"')).encode(
            "latin-1"
        ),
        ("\n \n<?xml version='1.0'?>\n" + PLAIN).encode(),
        ('<?xml version="0.0" ?>' + PLAIN).encode(),
        ("\n<?xml version = '2.0' encoding='utf-8'?>" + PLAIN).encode(),
        PLAIN.replace(">", ">\r\n").encode(),
        PLAIN.replace("<sdf", '<sdf xmlns="http://sdformat.org/root"').encode(),
        PLAIN.replace("<link", "<!-- a --><link").replace("1 1 1", "1 <!-- b -->1\n\t1").encode(),
        PLAIN.replace("1 1 1", "<![CDATA[1e0 +1.0 1.]]>").encode(),
        PLAIN.replace("<link", "<!-- a -- b ----><!-----><link").encode(),
        ("<!-- -- -->\n<?xml version='1.0'?><!-- <? -- -->" + PLAIN + "<!-- -- -->").encode(),
        PLAIN.replace("<link", "<!-- \x00 \xff & <a b> <!-- <!DOCTYPE --><link").encode("latin-1"),
        PLAIN.replace("<link", f"<!-- {XACRO} --><link").encode(),
    ],
    ids=[
        *("mark", "utf-16", "latin-1", "late", "version 0", "late version 2"),
        *("crlf", "namespace", "comments", "cdata"),
        *("hyphens", "hyphens around", "anything", "xacro"),
    ],
)
def test_xml_may_be_written_in_many_ways(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "w.SDF").write_bytes(data)
    world = clean(read_sdf(tmp_path / "w.SDF"))
    assert world.report.collisions == {"box": 1}
    assert world.report.ignored == ()


def test_lines_are_those_of_the_file_behind_a_late_declaration(tmp_path: Path) -> None:
    (tmp_path / "w.sdf").write_text("\n\n<?xml version='1.0'?>\n" + PLAIN.replace("1 1 1", "1"))
    (error,) = read_sdf(tmp_path / "w.sdf").report.errors
    assert error.where.startswith("w.sdf:4: ")


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_lines_are_those_of_the_file_behind_comments_of_many_lines(
    tmp_path: Path, end: str
) -> None:
    text = "<?xml version='1.0'?>\n<!-- a --\n\n -- b\n-->\n" + PLAIN.replace("1 1 1", "1")
    (tmp_path / "w.sdf").write_bytes(text.replace("\n", end).encode())
    (error,) = read_sdf(tmp_path / "w.sdf").report.errors
    assert error.where.startswith("w.sdf:6: ")


def test_what_looks_like_a_comment_in_cdata_is_text(tmp_path: Path) -> None:
    name = "<name><![CDATA[a<!-- -- -->b]]></name>"
    model_folder(tmp_path / "models" / "box")
    file = world_file(tmp_path / "w.sdf", include("model://box", name))
    assert [model.name for model in clean(read_sdf(file)).models] == ["a<!-- -- -->b"]


def test_a_comment_between_numbers_parts_them(tmp_path: Path) -> None:
    file = tmp_path / "w.sdf"
    file.write_text(PLAIN.replace("1 1 1", "2<!-- -- -->3<!-- -- -->4"))
    (link,) = clean(read_sdf(file)).links
    assert link.shapes[0].geometry.model_dump()["size_m"] == (2.0, 3.0, 4.0)


def test_a_models_config_and_xacro_may_have_hyphens_in_comments(tmp_path: Path) -> None:
    folder = model_folder(tmp_path / "models" / "box")
    config = folder / "model.config"
    config.write_text("<!-- -- -->" + config.read_text())
    (tmp_path / "part.xacro").write_text(f"<!-- a -- b --><a {XACRO}/>")
    file = world_file(
        tmp_path / "w.sdf.xacro",
        '<!-- a -- b --><xacro:include filename="part.xacro"/>' + include("model://box"),
        XACRO,
    )
    assert [model.name for model in clean(read_sdf(file)).models] == ["box"]


def test_urdf_is_read_as_the_model_it_means(tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text(
        '<robot name="r"><link name="a"/><link name="b"><visual><geometry><sphere radius="0.1"/>'
        '</geometry></visual></link>\n<joint name="j" type="fixed"><parent link="a"/>'
        '<child link="b"/><origin xyz="0 0 1"/></joint></robot>'
    )
    world = read_sdf(tmp_path / "r.urdf")
    assert world.report.errors == ()
    assert [(link.name, link.world_from_link[2, 3]) for link in world.links] == [
        ("r::a", 0.0), ("r::b", 1.0),
    ]  # fmt: skip


def test_xacro_is_known_by_any_address_and_in_any_encoding(tmp_path: Path) -> None:
    text = PLAIN.replace('name="m"', 'name="m${1 + 1}"')
    text = text.replace("<sdf", '<sdf xmlns:xacro="http://ros.org/xacro"')
    (tmp_path / "a.sdf").write_text(text)
    (tmp_path / "b.sdf").write_text(
        '<?xml version="1.0" encoding="utf-16"?>' + text, encoding="utf-16"
    )
    for name in ("a.sdf", "b.sdf"):
        assert clean(read_sdf(tmp_path / name)).links[0].name == "m2::link"


def test_two_worlds_of_a_file_have_two_names(tmp_path: Path) -> None:
    for other, expected in (("v", []), ("w", ["DUPLICATE_NAME"])):
        second = f'</world><world name="{other}"><model name="n">{LINK}</model>'
        world = read_sdf(world_file(tmp_path / "w.sdf", f'<model name="m">{LINK}</model>{second}'))
        assert kinds(world) == expected
        assert [one.what for one in world.report.ignored] == ["second <world>"]
        assert world.report.models == 1


def test_errors_of_included_files_name_those_files(tmp_path: Path) -> None:
    model_folder(tmp_path / "bad", "\n<link/>")
    file = world_file(tmp_path / "w.sdf", include("model://bad"))
    (error,) = read_sdf(file).report.errors
    assert error.where == "bad/model.sdf:2: model bad/link"


def test_lights_are_included_too(tmp_path: Path) -> None:
    folder = model_folder(tmp_path / "sun")
    (folder / "model.sdf").write_text(
        '<sdf version="1.5"><light name="sun" type="directional"><pose>0 0 10 0 0 0</pose></light>'
        "</sdf>"
    )
    file = world_file(
        tmp_path / "w.sdf",
        include("model://sun") + include("model://sun", "<name>b</name><pose>1 0 0 0 0 0</pose>"),
    )
    first, second = clean(read_sdf(file)).lights
    assert (first.name, first.world_from_light[2, 3]) == ("sun", 10.0)
    assert (second.name, second.world_from_light[0, 3]) == ("b", 1.0)


def test_meshes_and_pictures_are_found_as_uris_say(tmp_path: Path) -> None:
    folder = model_folder(tmp_path / "path" / "pkg")
    (folder / "meshes").mkdir()
    (folder / "meshes" / "a b.dae").touch()
    (folder / "brick.png").touch()
    (folder / "package.xml").write_text("<package><name>my_pkg</name></package>")

    def visual(name: str, uri: str, texture: str) -> str:
        return (
            f'<visual name="{name}"><geometry><mesh><uri>{uri}</uri><scale>1 2 -3</scale><submesh>'
            "<name>Door</name><center>1</center></submesh></mesh></geometry><material><pbr><metal>"
            f"<albedo_map>{texture}</albedo_map></metal></pbr></material></visual>"
        )

    full = folder / "meshes" / "a b.dae"
    uris = (
        "model://pkg/meshes/a b.dae",
        "meshes/a b.dae",
        f"file://{full}",
        str(full),
        "package://pkg/meshes/a b.dae",
        "package://my_pkg/meshes/a b.dae",
        "file://pkg/meshes/a b.dae",
    )
    visuals = "".join(
        visual(f"v{i}", uri, ("brick.png", "model://pkg/brick.png")[i % 2])
        for i, uri in enumerate(uris)
    )
    (folder / "model.sdf").write_text(
        f'<sdf version="1.9"><model name="m"><link name="l">{visuals}</link></model></sdf>'
    )
    file = world_file(tmp_path / "w" / "w.sdf", include("model://pkg"))
    world = clean(read_sdf(file, [tmp_path / "path", folder]))
    for shape in world.links[0].shapes:
        assert shape.mesh_file == full
        assert shape.geometry.kind == "mesh"
        assert (shape.geometry.file, shape.geometry.submesh) == ("a_b.dae", "Door")
        assert (shape.geometry.center, shape.geometry.scale) == (True, (1.0, 2.0, -3.0))
        assert shape.material is not None
        assert shape.material.albedo_map == folder / "brick.png"
    assert world.report.visuals == {"mesh": 7}
    assert world.report.materials == ("albedo brick.png",)


def test_materials_of_scripts_give_colour_and_picture(tmp_path: Path) -> None:
    folder = model_folder(tmp_path / "marker")
    (folder / "materials" / "scripts").mkdir(parents=True)
    (folder / "materials" / "textures").mkdir()
    (folder / "materials" / "textures" / "marker7.png").touch()
    (folder / "materials" / "scripts" / "a.material").write_text(
        """material Other { technique { pass { diffuse 0 0 0 1 } } }
        // material Marker/Seven in a comment
        material Marker/Seven
        {
          technique { pass {
            ambient 0.5 0.5 0.5 1.0
            diffuse 0.9 0.8 0.7
            texture_unit { texture marker7.png
              filtering trilinear } } }
        }
        material Marker/Lost { technique { pass { texture_unit { texture no.png } } } }"""
    )
    uris = "".join(
        f"<uri>model://marker/materials/{name}</uri>" for name in ("scripts", "textures")
    )
    visuals = "".join(
        f'<visual name="{name}">{BOX}<material><script>{uris}<name>Marker/{name}</name></script>'
        "</material></visual>"
        for name in ("Seven", "Lost", "None")
    )
    file = world_file(
        tmp_path / "w.sdf", f'<model name="m"><link name="l">{visuals}</link></model>'
    )
    world = read_sdf(file)
    assert [one.kind for one in clean(world).report.missing] == ["URI_LOOKUP"]
    assert [one.what for one in world.report.ignored] == ["material script Marker/None"]
    material = world.links[0].shapes[0].material
    assert material is not None
    assert (material.ambient, material.diffuse) == ((0.5, 0.5, 0.5, 1.0), (0.9, 0.8, 0.7, 1.0))
    assert material.albedo_map == folder / "materials" / "textures" / "marker7.png"
    assert world.report.materials[0] == "albedo marker7.png"


def test_what_is_only_seen_may_be_missing(tmp_path: Path) -> None:
    def visual(name: str, geometry: str, look: str = "") -> str:
        return f'<visual name="{name}">{geometry}{look}</visual>'

    picture = "<material><diffuse>1 0 0 1</diffuse><pbr><metal><albedo_map>no.png</albedo_map>"
    picture += "</metal></pbr></material>"
    gone, blend = (
        f"<geometry><mesh><uri>{uri}</uri></mesh></geometry>"
        for uri in ("model://gone/a.dae", "a.blend")
    )
    (tmp_path / "a.blend").touch()
    solid = f'<collision name="c"><pose>0 0 1 0 0 0</pose>{BOX}</collision>'
    links = {
        "picture": visual("v", BOX, picture),
        "mesh": solid + visual("v", gone, picture) + visual("w", blend),
        "half": solid + visual("v", gone) + visual("w", BOX),
        "nothing": visual("v", gone),
    }
    inside = "".join(f'<link name="{name}">{text}</link>' for name, text in links.items())
    world = clean(read_sdf(world_file(tmp_path / "w.sdf", f'<model name="m">{inside}</model>')))
    found = {link.name: [(one.role, one.name) for one in link.shapes] for link in world.links}
    assert found == {
        "m::picture": [("visual", "v")],
        "m::mesh": [("collision", "c"), ("visual", "c_visual")],
        "m::half": [("collision", "c"), ("visual", "w")],
        "m::nothing": [],
    }
    shape = world.links[1].shapes[1]
    assert shape.material is not None
    assert shape.material.diffuse == (1.0, 0.0, 0.0, 1.0)
    np.testing.assert_allclose(shape.link_from_shape[:3, 3], (0.0, 0.0, 1.0))
    kinds = [one.kind for one in world.report.missing]
    assert sorted(kinds) == ["GEOMETRY_UNSUPPORTED", *["URI_LOOKUP"] * 4]
    first, second = world.report.warnings()
    assert first.startswith(
        "5 pictures and meshes of visuals are missing, and drawn without: w.sdf"
    )
    assert first.endswith(" (and 4 more)")
    assert second.startswith("m::picture, m::nothing have a <visual> and no <collision>: ")


def test_a_mesh_that_collides_must_be_there(tmp_path: Path) -> None:
    mesh = "<geometry><mesh><uri>gone.dae</uri></mesh></geometry>"
    link = f'<collision name="c">{mesh}</collision><visual name="v">{mesh}</visual>'
    world = read_sdf(
        world_file(tmp_path / "w.sdf", f'<model name="m"><link name="l">{link}</link></model>')
    )
    assert kinds(world) == ["URI_LOOKUP"]


def test_nothing_outside_of_folder_and_roots_is_read(tmp_path: Path) -> None:
    model_folder(tmp_path / "secret")
    (tmp_path / "secret" / "mesh.stl").touch()
    inside = tmp_path / "inside"
    inside.mkdir()
    (inside / "link").symlink_to(tmp_path / "secret")
    (inside / "loop").symlink_to(inside / "loop")
    model_folder(inside / "m", "")
    (inside / "m" / "model.sdf").unlink()
    (inside / "m" / "model.sdf").symlink_to(tmp_path / "secret" / "model.sdf")
    for uri in (
        "../secret",
        "model://../secret",
        "model://link",
        "model://m",
        f"file://{tmp_path}/secret",
        "m/../../secret",
        "file:///etc/passwd",
        "/dev/zero",
    ):
        world = read_sdf(world_file(inside / "w.sdf", include(uri)))
        assert kinds(world)[0] in ("URI_INVALID", "URI_LOOKUP"), uri
        assert world.models == ()
    assert kinds(read_sdf(world_file(inside / "w.sdf", include("model://loop")))) == ["URI_LOOKUP"]
    clean(read_sdf(world_file(inside / "w.sdf", include("../secret")), [tmp_path]))


def test_includes_that_never_end_end(tmp_path: Path) -> None:
    model_folder(tmp_path / "a", include("model://b"))
    model_folder(tmp_path / "b", include("model://a"))
    file = world_file(tmp_path / "w.sdf", include("model://a"))
    assert "URI_INVALID" in kinds(read_sdf(file))
    for i in range(20):
        both = "".join(include(f"model://bomb{i + 1}", f"<name>n{k}</name>") for k in range(8))
        model_folder(tmp_path / f"bomb{i}", both)
    model_folder(tmp_path / "bomb20")
    start = time.process_time()
    world = read_sdf(world_file(tmp_path / "w.sdf", include("model://bomb0")))
    assert "URI_INVALID" in kinds(world)
    assert time.process_time() - start < 5.0


@pytest.mark.parametrize(
    "text",
    [
        '<!DOCTYPE x [<!ENTITY % a SYSTEM "file:///etc/passwd"> %a;]><sdf version="1.9"/>',
        '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;">]>'
        '<sdf version="1.9"><world name="&b;"/></sdf>',
        '<sdf version="1.9"><world name="&a;"/></sdf>',
        '<sdf version="1.9">' + "<model>" * 100_000,
        '<sdf version="1.9"><world name="w">' + "<a/>" * 400_000 + "</world></sdf>",
        '<sdf version="1.9"><world name="w"><b>' + "x" * 11_000_000 + "</b></world></sdf>",
        '<sdf version="1.9"><world name="w" '
        + "".join(f'a{i}="" ' for i in range(50_000))
        + "/></sdf>",
        '<sdf version="1.9">' + "<!-- " * 1_000_000,
        "<!-- --><![CDATA[<!--" * 200_000,
    ],
    ids=[
        *("external", "entities", "undefined", "deep", "many", "long", "attributes"),
        *("comments without end", "cdata without end"),
    ],
)
def test_hostile_xml_is_refused_at_once(tmp_path: Path, text: str) -> None:
    file = tmp_path / "w.sdf"
    file.write_text(text)
    start = time.process_time()
    assert kinds(read_sdf(file)) == ["FILE_READ"]
    assert time.process_time() - start < 5.0


@pytest.mark.parametrize("doctype", ["<!DOCTYPE sdf>", '<!DOCTYPE sdf SYSTEM\n"file:///no.dtd">'])
@pytest.mark.parametrize("root", ["", XACRO])
def test_a_document_type_that_declares_nothing_is_nothing(
    tmp_path: Path, doctype: str, root: str
) -> None:
    file = tmp_path / "w.sdf"
    file.write_text(f'<?xml version="1.0"?>\n{doctype}\n{PLAIN.replace("<sdf", f"<sdf {root}")}')
    assert len(clean(read_sdf(file)).links) == 1
    file.write_text(f'<?xml version="1.0"?>\n{doctype}\n<sdf {root} version="1.9"></sdf')
    (error,) = read_sdf(file).report.errors
    assert f"line {3 + doctype.count(chr(10))}" in error.message


@pytest.mark.parametrize(
    ("inside", "line", "message"),
    [
        ('<xacro:include filename="$(find gone)/a.xacro"/>', 3, "$(find gone): no such package"),
        ('\n<xacro:if value="$(find gone)"></xacro:if>', 4, "$(find gone): no such package"),
        ('<model name="$(eval 1 +)"/>', 3, "invalid syntax"),
        ('<model name="${gone + 1}"/>', 3, "name 'gone' is not defined when evaluating expression"),
        ("\n\n<xacro:wall/>", 5, "unknown macro name: xacro:wall"),
        ('<xacro:include filename="gone.xacro"/>', 3, "No such file: gone.xacro"),
        ('<xacro:include filename="inner.xacro"/>', 0, "inner.xacro:2: $(find deep): no such"),
        ("</model>", 3, "mismatched tag"),
    ],
)
def test_an_error_in_xacro_is_one_sentence_with_its_line(
    tmp_path: Path, inside: str, line: int, message: str
) -> None:
    (tmp_path / "inner.xacro").write_text(f'<a {XACRO}>\n<b c="$(find deep)"/></a>')
    file = tmp_path / "w.sdf"
    file.write_text(f'<?xml version="1.0"?>\n<sdf version="1.9" {XACRO}>\n{inside}</sdf>')
    (error,) = read_sdf(file).report.errors
    assert error.where == (f"w.sdf:{line}" if line else "w.sdf")
    assert error.message.startswith(f"cannot be expanded: {message}")
    assert error.message.count("no such package") <= 1
    assert "<class" not in error.message


def test_xacro_takes_arguments_macros_and_packages(tmp_path: Path) -> None:
    package = tmp_path / "ws" / "my_maze"
    model_folder(package / "models" / "chair")
    (package / "package.xml").write_text("<package><name>my_maze</name></package>")
    (package / "parts.xacro").write_text(
        f"""<parts {XACRO}><xacro:macro name="box" params="name x">
        <model name="${{name}}"><pose>${{x * 2}} ${{round(sqrt(16))}} ${{sum}} 0 0 0</pose>
        {LINK}</model></xacro:macro></parts>"""
    )
    file = world_file(
        package / "worlds" / "w.sdf.xacro",
        """<xacro:arg name="chairs" default="false"/><xacro:arg name="x" default="1"/>
        <xacro:property name="sum" value="${[1, 2, 3][2] + $(eval 1 + 1)}"/>
        <xacro:include filename="$(find my_maze)/parts.xacro"/><xacro:box name="a" x="$(arg x)"/>
        <xacro:if value="$(arg chairs)"><include>
        <uri>file://$(find my_maze)/models/chair</uri></include></xacro:if>""",
        XACRO,
    )
    world = clean(read_sdf(file))
    assert [model.name for model in world.models] == ["a"]
    np.testing.assert_allclose(world.models[0].world_from_model[:3, 3], [2, 4, 5])
    world = clean(read_sdf(file, [tmp_path / "ws"], {"chairs": "true", "x": "3.5"}))
    assert [model.name for model in world.models] == ["a", "chair"]
    assert world.models[0].world_from_model[0, 3] == 7.0


@pytest.mark.parametrize(
    ("inside", "word"),
    [
        ('<xacro:include filename="../outside.xacro"/>', "outside"),
        ('<xacro:include filename="/etc/passwd"/>', "outside"),
        ("${load_yaml('/etc/passwd')}", "outside"),
        ("$(find nowhere)", "nowhere"),
        ("$(env HOME)", "environment"),
        ("$(eval open)", "open"),
        ("${[x.__class__ for x in [()]]}", "__class__"),
        ("$(arg missing)", "missing"),
        ("${1 +}", "1 +"),
        ("<xacro:nothing/>", "nothing"),
        ("${9**9**9}", "xacro exceeded its"),
        ("${'x' * 10**10}", ""),
        ('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>', "deep"),
        ('<xacro:include filename="w.sdf.xacro"/>', ""),
        ('<model name="$(arg size)"/>', "argument size: give it with `--arg NAME:=VALUE`"),
    ],
)
def test_what_xacro_may_not_do_is_one_error(tmp_path: Path, inside: str, word: str) -> None:
    (tmp_path / "outside.xacro").write_text(f"<a {XACRO}/>")
    (tmp_path / "outside.yaml").write_text("a: 1")
    file = world_file(tmp_path / "in" / "w.sdf.xacro", inside, XACRO)
    (error,) = read_sdf(file).report.errors
    assert error.kind == "FILE_READ"
    assert error.where in ("w.sdf.xacro", "w.sdf.xacro:1")
    assert error.message.startswith("cannot be expanded: ")
    assert word in error.message
    assert "\n" not in error.message


@pytest.mark.parametrize(
    ("expression", "name"),
    [
        ("[x.__class__ for x in [()]]", "__class__"),
        ("(lambda: 0).__globals__", "__globals__"),
        ("(x for x in [1]).gi_frame", "gi_frame"),
        ("'{0.__class__}'.format(1)", "format"),
        ("__import__('os')", "__import__"),
        ("math._x", "_x"),
    ],
)
def test_expressions_do_not_reach_the_interpreter(expression: str, name: str) -> None:
    with pytest.raises(XacroException, match=name):
        compiled(expression)
    assert eval(compiled(" 1 + 2 ")) == 3


def test_places_in_xacro_are_of_the_expanded_text(tmp_path: Path) -> None:
    file = world_file(tmp_path / "w.sdf.xacro", "\n<model/>", XACRO)
    (error, *_) = read_sdf(file).report.errors
    assert error.where == "w.sdf.xacro:4 (expanded): world w/model"
