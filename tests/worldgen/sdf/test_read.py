"""The reader against the specification: what it reads, leaves out, and calls wrong."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mazebot.common.maths.frames import Array, rotation_from_rpy, transform_matrix
from mazebot.common.messages import documents as doc
from mazebot.worldgen.sdf.model import MAZEBOT_NAMESPACE, SdfWorld
from mazebot.worldgen.sdf.reading.read import read_sdf

BOX = "<geometry><box><size>1 2 3</size></box></geometry>"
LINK = f'<link name="link"><collision name="c">{BOX}</collision></link>'


def read(folder: Path, inside: str, version: str = "1.9", root: str = "") -> SdfWorld:
    """A file with a world that holds `inside`."""
    file = folder / "test.sdf"
    file.write_text(f'<sdf version="{version}" {root}><world name="w">{inside}</world></sdf>')
    return read_sdf(file)


def clean(world: SdfWorld) -> SdfWorld:
    """A world without errors."""
    assert world.report.errors == ()
    return world


def kinds(world: SdfWorld) -> list[str]:
    return [error.kind for error in world.report.errors]


def ignored(world: SdfWorld) -> list[str]:
    return [one.what for one in world.report.ignored]


def pose(
    x: float, y: float, z: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0
) -> Array:
    return transform_matrix(rotation_from_rpy(roll, pitch, yaw), (x, y, z))


def frame(world: SdfWorld, name: str) -> Array:
    (found,) = [one.world_from_frame for one in world.frames if one.name == name]
    return found


def test_a_world_of_boxes(tmp_path: Path) -> None:
    world = clean(
        read(
            tmp_path,
            f"""<model name="a"><static>true</static><pose>1 2 0 0 0 1.5</pose>
            <link name="l"><pose>0 0 1 0 0 0</pose>
              <collision name="c"><pose>0.5 0 0 0 0 0</pose>{BOX}</collision>
              <visual name="c">{BOX}<material><ambient>1 0 0 1</ambient>
                <diffuse>0 1 0</diffuse></material></visual></link></model>
            <model name="b">{LINK}</model>""",
        )
    )
    (a, b) = world.links
    assert (a.name, a.model, a.static, b.static) == ("a::l", "a", True, False)
    np.testing.assert_allclose(a.world_from_link, pose(1, 2, 1, yaw=1.5), atol=1e-12)
    collision, visual = a.shapes
    np.testing.assert_allclose(collision.link_from_shape, pose(0.5, 0, 0), atol=1e-12)
    assert collision.geometry == doc.Box(size_m=(1.0, 2.0, 3.0))
    assert visual.material is not None
    assert visual.material.ambient == (1.0, 0.0, 0.0, 1.0)
    assert visual.material.diffuse == (0.0, 1.0, 0.0, 1.0)
    report = world.report
    assert (report.models, report.links, report.collisions) == (2, 2, {"box": 2})
    assert report.visuals == {"box": 1}
    assert report.materials == ("rgba 0 1 0 1",)


@pytest.mark.parametrize(
    ("xml", "expected"),
    [
        (
            "<cylinder><radius>1</radius><length>2</length></cylinder>",
            doc.Cylinder(radius_m=1, length_m=2),
        ),
        ("<cone><radius>1</radius><length>2</length></cone>", doc.Cone(radius_m=1, length_m=2)),
        (
            "<capsule><radius>1</radius><length>2</length></capsule>",
            doc.Capsule(radius_m=1, length_m=2),
        ),
        ("<sphere><radius>.5</radius></sphere>", doc.Sphere(radius_m=0.5)),
        ("<ellipsoid><radii>1 2 3</radii></ellipsoid>", doc.Ellipsoid(radii_m=(1, 2, 3))),
        ("<plane><normal>0 0 1</normal><size>4 5</size></plane>", doc.Plane(size_m=(4, 5))),
        (
            "<polyline><point>0 0</point><point>4 0</point><point>0 4</point><height>2</height>"
            "</polyline><polyline><point>1 1</point><point>2 1</point><point>1 2</point>"
            "<height>2</height></polyline>",
            doc.Polyline(
                polygons_m=(((0, 0), (4, 0), (0, 4)), ((1, 1), (2, 1), (1, 2))), height_m=2
            ),
        ),
    ],
)
def test_every_geometry(tmp_path: Path, xml: str, expected: object) -> None:
    world = clean(
        read(
            tmp_path,
            f'<model name="m"><link name="l"><collision name="c"><geometry>{xml}</geometry>'
            "</collision></link></model>",
        )
    )
    assert world.links[0].shapes[0].geometry == expected
    assert sum(world.report.collisions.values()) == 1


def test_a_plane_is_turned_to_its_normal(tmp_path: Path) -> None:
    for normal in ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.6, -0.8, 0.0), (0.0, 0.6, 0.8)):
        text = " ".join(str(part) for part in normal)
        world = clean(
            read(
                tmp_path,
                f'<model name="m"><link name="l"><visual name="v"><geometry><plane><normal>{text}'
                "</normal><size>1 1</size></plane></geometry></visual></link></model>",
            )
        )
        rotation = world.links[0].shapes[0].link_from_shape[:3, :3]
        np.testing.assert_allclose(rotation @ [0, 0, 1], normal, atol=1e-12)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_what_has_no_shape_of_ours_is_refused_and_counted(tmp_path: Path) -> None:
    shapes = (
        "<image><uri>a.png</uri></image>",
        "<heightmap><uri>b.png</uri></heightmap>",
        "<empty/>",
    )
    collisions = "".join(
        f'<collision name="c{i}"><geometry>{xml}</geometry></collision>'
        for i, xml in enumerate(shapes)
    )
    world = read(tmp_path, f'<model name="m"><link name="l">{collisions}</link></model>')
    assert kinds(world) == ["GEOMETRY_UNSUPPORTED", "GEOMETRY_UNSUPPORTED"]
    assert world.report.collisions == {"empty": 1, "heightmap": 1, "image": 1}
    assert "test.sdf:1: world w/model m/link l/collision c0" in world.report.errors[0].where


def test_frames_joints_and_nested_models_place_each_other(tmp_path: Path) -> None:
    world = clean(
        read(
            tmp_path,
            f"""<frame name="base"><pose>10 0 0 0 0 {math.pi / 2}</pose></frame>
            <model name="m"><pose relative_to="base">1 0 0 0 0 0</pose>
              <frame name="f" attached_to="b"><pose>0 0 1 0 0 0</pose></frame>
              <link name="a">
                <visual name="v"><pose relative_to="f">0 0 1 0 0 0</pose>{BOX}</visual></link>
              <link name="b"><pose relative_to="j">0 3 0 0 0 0</pose></link>
              <joint name="j" type="fixed"><pose relative_to="a">2 0 0 0 0 0</pose>
                <parent>a</parent><child>b</child></joint>
              <model name="inner"><pose relative_to="f">0 0 5 0 0 0</pose>
                <link name="l"/><frame name="tip"><pose>0 0 1 0 0 0</pose></frame></model>
              <frame name="g"><pose relative_to="inner::tip"/></frame>
              <frame name="h"><pose relative_to="inner::__model__"/></frame>
            </model>
            <model name="n"><pose relative_to="m::inner::tip">0 0 1 0 0 0</pose>{LINK}</model>""",
        )
    )
    turn = {"yaw": math.pi / 2}
    for name, expected in {
        "m": pose(10, 1, 0, **turn),
        "m::a": pose(10, 1, 0, **turn),
        "m::j": pose(10, 3, 0, **turn),
        "m::b": pose(7, 3, 0, **turn),
        "m::f": pose(7, 3, 1, **turn),
        "m::inner": pose(7, 3, 6, **turn),
        "m::inner::l": pose(7, 3, 6, **turn),
        "m::g": pose(7, 3, 7, **turn),
        "m::h": pose(7, 3, 6, **turn),
        "n": pose(7, 3, 8, **turn),
    }.items():
        np.testing.assert_allclose(frame(world, name), expected, atol=1e-12, err_msg=name)
    (tip,) = [one for one in world.frames if one.name == "m::inner::tip"]
    np.testing.assert_allclose(tip.model_from_frame, pose(0, 0, 1), atol=1e-12)
    (visual,) = world.links[0].shapes
    np.testing.assert_allclose(visual.link_from_shape, pose(2, 3, 2), atol=1e-12)
    assert world.links[0].fixed_to == world.links[1].fixed_to == "m::a"
    assert world.links[2].fixed_to == "m::inner::l"


def test_a_joint_stands_at_its_child_by_default(tmp_path: Path) -> None:
    world = clean(
        read(
            tmp_path,
            """<model name="m"><link name="a"/><link name="b"><pose>1 0 0 0 0 0</pose></link>
            <joint name="j" type="fixed"><pose>0 1 0 0 0 0</pose><parent>a</parent>
            <child>b</child></joint></model>""",
        )
    )
    np.testing.assert_allclose(frame(world, "m::j"), pose(1, 1, 0), atol=1e-12)


def test_a_placement_frame_is_put_where_the_pose_says(tmp_path: Path) -> None:
    world = clean(
        read(
            tmp_path,
            """<model name="m" placement_frame="foot"><pose>1 2 3 0 0 0.7</pose>
            <link name="l"/><frame name="foot"><pose>0.5 0 -1 0.1 0 0.4</pose></frame></model>""",
        )
    )
    np.testing.assert_allclose(frame(world, "m::foot"), pose(1, 2, 3, yaw=0.7), atol=1e-12)
    expected = pose(1, 2, 3, yaw=0.7) @ np.linalg.inv(pose(0.5, 0, -1, 0.1, 0, 0.4))
    np.testing.assert_allclose(frame(world, "m::l"), expected, atol=1e-12)


def test_rotations_in_degrees_and_as_quaternions(tmp_path: Path) -> None:
    world = clean(
        read(
            tmp_path,
            f"""<model name="a"><pose degrees="true">0 0 0 0 0 90</pose>{LINK}</model>
            <model name="b"><pose rotation_format="quat_xyzw">0 0 0 0 0 2 2</pose>{LINK}</model>
            <model name="c"><pose rotation_format="euler_rpy">0 0 0 0 0 1.5707963267948966</pose>
            {LINK}</model><model name="d"><pose rotation_format="quat_xyzw"/>{LINK}</model>""",
        )
    )
    for name in "abc":
        np.testing.assert_allclose(frame(world, name), pose(0, 0, 0, yaw=math.pi / 2), atol=1e-12)
    np.testing.assert_allclose(frame(world, "d"), np.eye(4))


def test_the_frame_attribute_is_of_versions_before_1_7(tmp_path: Path) -> None:
    inside = """<model name="m"><link name="a"><pose>1 0 0 0 0 0</pose></link>
        <link name="b"><pose frame="a">1 0 0 0 0 0</pose></link></model>"""
    old, new = clean(read(tmp_path, inside, "1.5")), clean(read(tmp_path, inside, "1.7"))
    np.testing.assert_allclose(frame(old, "m::b"), pose(2, 0, 0))
    np.testing.assert_allclose(frame(new, "m::b"), pose(1, 0, 0))
    assert ignored(old) == []
    assert ignored(new) == ["attribute frame of pose"]


def model(inside: str, more: str = "") -> str:
    return f'<model name="m" {more}>{inside}</model>'


def collision(xml: str) -> str:
    geometry = f"<geometry>{xml}</geometry>"
    return model(f'<link name="l"><collision name="c">{geometry}</collision></link>')


def linked(joint: str) -> str:
    return model(f'<link name="a"/><link name="b"/><frame name="f" attached_to="b"/>{joint}')


def fixed(parent: str, child: str) -> str:
    ends = f"<parent>{parent}</parent><child>{child}</child>"
    return linked(f'<joint name="j" type="fixed">{ends}</joint>')


def turning(axis: str) -> str:
    return linked(f'<joint name="j" type="revolute">{ENDS}<axis>{axis}</axis></joint>')


def visual(more: str) -> str:
    return model(f'<link name="l"><visual name="v">{BOX}{more}</visual></link>')


LAMP = '<light name="lamp" type="point"/>'
ENDS = "<parent>a</parent><child>b</child>"
POINTS = "<point>0 0</point><point>1 0</point><height>1</height>"
TWO_VISUALS = (
    f'<link name="l"><visual name="v">{BOX}</visual><visual name="v">{BOX}</visual></link>'
)


@pytest.mark.parametrize(
    ("kind", "inside"),
    [
        ("DUPLICATE_NAME", model(LINK) + model(LINK)),
        ("DUPLICATE_NAME", model(LINK + LINK)),
        ("DUPLICATE_NAME", model(LINK + '<frame name="link"/>')),
        ("DUPLICATE_NAME", model(LINK) + '<frame name="m"/>'),
        ("DUPLICATE_NAME", model(TWO_VISUALS)),
        ("DUPLICATE_NAME", LAMP + LAMP),
        ("DUPLICATE_NAME", model(LINK) + LAMP.replace("lamp", "m")),
        ("DUPLICATE_NAME", LAMP.replace("lamp", "m") + model(LINK)),
        ("DUPLICATE_NAME", model(f'<link name="l">{LAMP}{LAMP}</link>')),
        ("RESERVED_NAME", '<model name="world">' + LINK + "</model>"),
        ("RESERVED_NAME", model('<link name="__model__"/>')),
        ("RESERVED_NAME", model('<link name="a"/><frame name="__x__"/>')),
        ("RESERVED_NAME", model('<link name="a::b"/>')),
        ("ATTRIBUTE_MISSING", model("<link/>")),
        ("ATTRIBUTE_MISSING", f"<model>{LINK}</model>"),
        ("ATTRIBUTE_MISSING", linked('<joint name="j">' + ENDS + "</joint>")),
        ("ATTRIBUTE_MISSING", '<light name="sun"/>'),
        ("ATTRIBUTE_INVALID", '<light name="sun" type="laser"/>'),
        ("ATTRIBUTE_INVALID", linked('<joint name="j" type="magic">' + ENDS + "</joint>")),
        ("ATTRIBUTE_INVALID", model('<pose rotation_format="matrix">0 0 0 0 0 0</pose>' + LINK)),
        ("ATTRIBUTE_INVALID", model('<pose degrees="yes">0 0 0 0 0 0</pose>' + LINK)),
        ("ATTRIBUTE_INVALID", model('<pose relative_to="__root__"/>' + LINK)),
        ("ATTRIBUTE_INVALID", model(LINK + '<frame name="f" attached_to="__root__"/>')),
        ("ATTRIBUTE_INVALID", model(LINK, 'placement_frame="__root__"')),
        ("ATTRIBUTE_INVALID", model(LINK, 'canonical_link="__root__"')),
        ("ELEMENT_MISSING", linked('<joint name="j" type="fixed"><parent>a</parent></joint>')),
        ("ELEMENT_MISSING", model('<link name="l"><collision name="c"/></link>')),
        ("ELEMENT_MISSING", collision("<box/>")),
        ("ELEMENT_MISSING", collision("<cylinder><radius>1</radius></cylinder>")),
        ("ELEMENT_MISSING", collision("<mesh/>")),
        ("ELEMENT_MISSING", "<include><name>a</name></include>"),
        ("ELEMENT_INVALID", collision("<box><size>1 2</size></box>")),
        ("ELEMENT_INVALID", collision("<box><size>1 2 nan</size></box>")),
        ("ELEMENT_INVALID", collision("<box><size>1 2 inf</size></box>")),
        ("ELEMENT_INVALID", collision("<box><size>1 2 -3</size></box>")),
        ("ELEMENT_INVALID", collision("<box><size>1 2 1e400</size></box>")),
        ("ELEMENT_INVALID", collision("<box><size>1 2 1_0</size></box>")),
        ("ELEMENT_INVALID", collision("<sphere><radius>0</radius></sphere>")),
        ("ELEMENT_INVALID", collision("<plane><normal>0 0 0</normal><size>1 1</size></plane>")),
        (
            "ELEMENT_INVALID",
            collision("<box><size>1 1 1</size></box><sphere><radius>1</radius></sphere>"),
        ),
        ("ELEMENT_INVALID", collision("<polyline>" + POINTS + "</polyline>")),
        ("ELEMENT_INVALID", model("<pose>1 2 3</pose>" + LINK)),
        ("ELEMENT_INVALID", model('<pose rotation_format="quat_xyzw">0 0 0 0 0 0 0</pose>' + LINK)),
        ("ELEMENT_INVALID", model("<static>maybe</static>" + LINK)),
        ("ELEMENT_INVALID", visual("<material><diffuse>2 0 0 1</diffuse></material>")),
        (
            "LINK_INERTIA_INVALID",
            model('<link name="l"><inertial><mass>-1</mass></inertial></link>'),
        ),
        (
            "LINK_INERTIA_INVALID",
            model('<link name="l"><inertial><mass>0</mass></inertial></link>'),
        ),
        ("MODEL_WITHOUT_LINK", model("")),
        ("FRAME_ATTACHED_TO_INVALID", model(LINK + '<frame name="f" attached_to="no"/>')),
        (
            "FRAME_ATTACHED_TO_CYCLE",
            model(LINK + '<frame name="f" attached_to="g"/><frame name="g" attached_to="f"/>'),
        ),
        ("FRAME_ATTACHED_TO_CYCLE", model(LINK + '<frame name="f" attached_to="f"/>')),
        (
            "POSE_RELATIVE_TO_INVALID",
            model(LINK + '<frame name="f"><pose relative_to="no"/></frame>'),
        ),
        ("POSE_RELATIVE_TO_INVALID", model('<pose relative_to="no"/>' + LINK)),
        ("POSE_RELATIVE_TO_INVALID", model('<link name="l"><pose relative_to="world"/></link>')),
        ("POSE_RELATIVE_TO_INVALID", visual('<pose relative_to="no"/>')),
        (
            "POSE_RELATIVE_TO_CYCLE",
            model(
                '<link name="a"><pose relative_to="b"/></link>'
                '<link name="b"><pose relative_to="a"/></link>'
            ),
        ),
        ("POSE_RELATIVE_TO_CYCLE", model('<link name="a"><pose relative_to="a"/></link>')),
        ("POSE_RELATIVE_TO_CYCLE", model('<pose relative_to="m::link"/>' + LINK)),
        ("MODEL_CANONICAL_LINK_INVALID", model(LINK, 'canonical_link="no"')),
        ("MODEL_PLACEMENT_FRAME_INVALID", model(LINK, 'placement_frame="no"')),
        ("JOINT_PARENT_LINK_INVALID", fixed("no", "b")),
        ("JOINT_PARENT_LINK_INVALID", fixed("j", "b")),
        ("JOINT_CHILD_LINK_INVALID", fixed("a", "no")),
        ("JOINT_CHILD_LINK_INVALID", fixed("a", "world")),
        ("JOINT_AXIS_EXPRESSED_IN_INVALID", turning('<xyz expressed_in="no">0 0 1</xyz>')),
        ("ELEMENT_INVALID", turning("<xyz>0 0 0</xyz>")),
        ("ELEMENT_INVALID", turning("<xyz>0 1</xyz>")),
        ("JOINT_PARENT_SAME_AS_CHILD", fixed("b", "b")),
        ("JOINT_PARENT_SAME_AS_CHILD", fixed("b", "f")),
        ("URI_LOOKUP", collision("<mesh><uri>model://no/mesh.dae</uri></mesh>")),
        ("URI_INVALID", collision("<mesh><uri>https://fuel.gazebosim.org/mesh.dae</uri></mesh>")),
        ("URI_INVALID", "<include><uri>https://fuel.gazebosim.org/1.0/a/models/b</uri></include>"),
        ("URI_LOOKUP", "<include><uri>model://no</uri></include>"),
    ],
)
def test_the_errors_of_the_specification(tmp_path: Path, kind: str, inside: str) -> None:
    world = read(tmp_path, inside)
    assert kinds(world) == [kind]
    assert world.report.errors[0].where.startswith("test.sdf:1: world w/")
    assert "\n" not in world.report.errors[0].message


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("FILE_READ", ""),
        ("FILE_READ", "<sdf"),
        ("FILE_READ", '<sdf version="1.6"><world name="w"><model'),
        ("FILE_READ", "\x00\x01\x02junk"),
        ("FILE_READ", '<?xml version="1.0" encoding="klingon"?><sdf version="1.6"/>'),
        ("FILE_READ", '<!DOCTYPE a [<!ENTITY b "c">]><sdf version="1.6"/>'),
        ("FILE_READ", '<sdf version="1.6">' + "<a>" * 5000),
        ("ATTRIBUTE_MISSING", "<robot/>"),
        ("ELEMENT_MISSING", '<sdf version="1.6"/>'),
        ("ATTRIBUTE_MISSING", '<sdf><world name="w"/></sdf>'),
        ("ATTRIBUTE_INVALID", '<sdf version="2.0"><world name="w"/></sdf>'),
        ("ATTRIBUTE_INVALID", '<sdf version="new"><world name="w"/></sdf>'),
        ("ATTRIBUTE_MISSING", '<sdf version="1.6"><world/></sdf>'),
    ],
)
def test_files_that_are_no_sdf_are_one_error(tmp_path: Path, kind: str, text: str) -> None:
    file = tmp_path / "bad.sdf"
    file.write_text(text)
    world = read_sdf(file)
    assert kinds(world) == [kind]
    assert world.report.errors[0].where.startswith("bad.sdf")


def test_a_file_in_another_encoding_and_one_that_is_not_there(tmp_path: Path) -> None:
    text = '<?xml version="1.0" encoding="{}"?><sdf version="1.6"><world name="wörld"/></sdf>'
    for encoding in ("utf-16", "iso-8859-1", "utf-8"):
        file = tmp_path / "encoded.sdf"
        file.write_bytes(text.format(encoding).encode(encoding))
        assert clean(read_sdf(file)).name == "wörld"
    file.write_bytes(text.format("utf-8").encode("latin-1"))
    assert kinds(read_sdf(file)) == ["FILE_READ"]
    file.write_bytes(text.format("utf-16").replace("<sdf", "<!DOCTYPE a><sdf").encode("utf-16"))
    assert kinds(read_sdf(file)) == ["FILE_READ"]
    assert kinds(read_sdf(tmp_path / "no.sdf")) == ["FILE_READ"]
    assert kinds(read_sdf(Path("/dev/zero"))) == ["FILE_READ"]


def test_what_is_not_simulated_is_listed(tmp_path: Path) -> None:
    world = clean(
        read(
            tmp_path,
            f"""<plugin filename="gz-sim-physics-system" name="p"/><gui><camera/></gui>
            <physics name="fast" type="ode"/><wind/><spherical_coordinates/><audio/>
            <actor name="walker"/><frobnicate/><gravity>0 0 -9.8</gravity>
            <model name="m"><link name="a"><sensor name="eye" type="camera"/></link>
            <link name="b"/><joint name="wheel" type="revolute"><parent>a</parent><child>b</child>
            <axis/></joint><plugin name="only_name"/></model>
            <model name="n">{LINK}</model>""",
        )
    )
    assert ignored(world) == [
        "plugin gz-sim-physics-system",
        "gui",
        "physics fast (ode)",
        "wind",
        "spherical_coordinates",
        "audio",
        "actor walker",
        "unknown element <frobnicate> in world",
        "gravity",
        "plugin only_name",
        "joint m::wheel (revolute): is held still, and its model with it",
        "sensor eye (camera)",
    ]
    np.testing.assert_allclose(frame(world, "m"), np.eye(4))
    assert [link.static for link in world.links] == [True, True, False]
    assert [link.fixed_to for link in world.links] == ["m::a", "m::b", "n::link"]


def test_the_same_thing_left_out_is_listed_once_with_its_number(tmp_path: Path) -> None:
    visual = f'<visual name="v{{}}">{BOX}<material><specular>1 1 1 1</specular></material></visual>'
    visuals = "".join(visual.format(i) for i in range(3))
    world = clean(read(tmp_path, model(f'<link name="l">{visuals}</link>')))
    (specular,) = world.report.ignored
    assert specular.what == "specular"
    assert specular.where.endswith("visual v0/material/specular (and 2 more)")


def test_a_joint_that_is_its_own_child_is_a_cycle(tmp_path: Path) -> None:
    world = read(tmp_path, fixed("a", "j"))
    assert kinds(world) == ["FRAME_ATTACHED_TO_CYCLE", "JOINT_CHILD_LINK_INVALID"]


def test_an_axis_may_point_along_the_axes_of_any_frame_beside_it(tmp_path: Path) -> None:
    for name in ("__model__", "a", "f", "j"):
        clean(read(tmp_path, turning(f'<xyz expressed_in="{name}">0 0 1</xyz>')))


def test_text_that_means_nothing_is_listed(tmp_path: Path) -> None:
    world = clean(read(tmp_path, model(LINK) + " --> "))
    assert ignored(world) == ["text `-->` in world"]


def test_elements_without_a_value_have_the_default(tmp_path: Path) -> None:
    world = clean(
        read(
            tmp_path,
            model("<static/><pose/>" + LINK)
            + '<light name="lamp" type="point"><pose></pose><diffuse> </diffuse></light>',
        )
    )
    assert not world.links[0].static
    assert world.lights[0].diffuse == (1.0, 1.0, 1.0, 1.0)


def test_what_stands_still_needs_no_mass(tmp_path: Path) -> None:
    massless = '<link name="l"><inertial><mass>0</mass></inertial></link>'
    world = clean(read(tmp_path, model("<static>1</static>" + massless)))
    assert ignored(world) == ["zero mass of a static model"]


def test_a_name_may_be_a_lights_and_a_models_before_1_7(tmp_path: Path) -> None:
    clean(read(tmp_path, model(LINK) + LAMP.replace("lamp", "m"), version="1.6"))
    assert kinds(read(tmp_path, LAMP + LAMP, version="1.6")) == ["DUPLICATE_NAME"]


def test_a_joint_of_its_links_name_is_renamed_before_1_7_and_the_report_says_so(
    tmp_path: Path,
) -> None:
    joint = "<parent>link</parent><child>wheel</child>"
    inside = LINK + '<link name="wheel"/>\n' + f'<joint name="wheel" type="fixed">{joint}</joint>'
    world = clean(read(tmp_path, model(inside), version="1.6"))
    (renamed,) = world.report.renamed
    assert (renamed.kind, renamed.name, renamed.new_name) == ("joint", "wheel", "wheel_joint")
    assert renamed.where == "test.sdf:2: world w/model m/joint wheel"
    assert "m::wheel_joint" in {one.name for one in world.frames if one.kind == "joint"}
    # Nor does it take the name of what comes behind it.
    inside += f'<joint name="wheel_joint" type="fixed">{joint}</joint>'
    world = clean(read(tmp_path, model(inside), version="1.6"))
    assert [one.new_name for one in world.report.renamed] == ["wheel_joint1"]
    assert kinds(read(tmp_path, model(inside), version="1.7")) == ["DUPLICATE_NAME"]


def test_a_joint_to_the_world_holds_its_link(tmp_path: Path) -> None:
    world = clean(read(tmp_path, fixed("world", "f")))  # fmt: skip
    assert [link.static for link in world.links] == [False, True]


def test_models_in_models(tmp_path: Path) -> None:
    world = clean(
        read(tmp_path, f'<model name="o"><static>1</static><model name="i">{LINK}</model></model>')
    )
    assert [(m.name, m.static) for m in world.models] == [("o", True), ("o::i", True)]
    assert world.links[0].static
    deep = "".join(f'<model name="m{i}">' for i in range(60)) + LINK + "</model>" * 60
    assert kinds(read(tmp_path, deep)) == ["ELEMENT_INVALID"]


def test_masses(tmp_path: Path) -> None:
    sphere = "<geometry><sphere><radius>1</radius></sphere></geometry>"
    world = clean(
        read(
            tmp_path,
            f"""<model name="a"><link name="given"><inertial><mass>2.5</mass></inertial></link>
            <link name="default"/>
            <link name="auto"><inertial auto="true"/><collision name="c">{BOX}</collision>
              <collision name="d"><density>10</density>{sphere}</collision></link>
            <link name="light"><inertial auto="true"><density>2</density></inertial>
              <collision name="c">{BOX}</collision></link></model>""",
            "1.11",
        )
    )
    masses = [link.mass_kg for link in world.links]
    assert masses == pytest.approx([2.5, 1.0, 6000.0 + 10.0 * 4 / 3 * math.pi, 12.0])


def test_lights_and_scene(tmp_path: Path) -> None:
    world = clean(
        read(
            tmp_path,
            """<light name="sun" type="directional"><pose>0 0 10 0 0 0</pose>
              <diffuse>0.8 0.8 0.8 1</diffuse><direction>-0.5 0.1 -0.9</direction></light>
            <light name="off" type="point"><light_on>false</light_on></light>
            <scene><ambient>0.4 0.4 0.4 1</ambient><background>0.7 0.7 0.7 1</background></scene>
            <model name="m"><pose>1 0 0 0 0 0</pose><link name="l">
              <light name="lamp" type="point"><pose>0 0 2 0 0 0</pose>
              <attenuation><range>7</range><constant>0.5</constant><linear>0.25</linear>
              <quadratic>0.125</quadratic></attenuation></light></link></model>""",
        )
    )
    sun, lamp = world.lights
    assert (sun.kind, sun.direction, sun.diffuse) == (
        "directional",
        (-0.5, 0.1, -0.9),
        (0.8, 0.8, 0.8, 1.0),
    )
    assert (lamp.name, lamp.range_m, lamp.constant, lamp.linear, lamp.quadratic) == (
        "m::l::lamp", 7.0, 0.5, 0.25, 0.125,
    )  # fmt: skip
    np.testing.assert_allclose(lamp.world_from_light, pose(1, 0, 2))
    assert ignored(world) == ["light off (it is off)"]
    assert world.ambient == (0.4, 0.4, 0.4, 1.0)
    assert world.background == (0.7, 0.7, 0.7, 1.0)


def test_materials_of_gazebo(tmp_path: Path) -> None:
    script = "<material><script><uri>file://x</uri><name>Gazebo/{}</name></script></material>"
    visuals = "".join(
        f'<visual name="{name}">{BOX}{script.format(name)}</visual>' for name in ("Orange", "Mud")
    )
    world = clean(read(tmp_path, model(f'<link name="l">{visuals}</link>')))
    orange, mud = (shape.material for shape in world.links[0].shapes)
    assert orange is not None
    assert orange.diffuse == (1.0, 0.5088, 0.0468, 1.0)
    assert mud is not None
    assert (mud.script, mud.diffuse) == ("Gazebo/Mud", None)
    assert ignored(world) == ["material script Gazebo/Mud"]
    assert world.report.materials == ("script Gazebo/Orange", "script Gazebo/Mud")


def test_the_notes_of_exports_come_back_and_other_namespaces_are_listed(tmp_path: Path) -> None:
    inside = f"""<mazebot:world><mazebot:floor>tiles</mazebot:floor>
        <mazebot:start>1 2</mazebot:start>
        </mazebot:world><model name="m" mazebot:role="wall"><link name="l" mazebot:a="1">
        <collision name="c" mazebot:b="2" drake:x="3">{BOX}</collision><drake:hint>1</drake:hint>
        </link></model>"""
    root = f'xmlns:mazebot="{MAZEBOT_NAMESPACE}" xmlns:drake="d"'
    declared = clean(read(tmp_path, inside, "1.9", root))
    undeclared = clean(read(tmp_path, inside))
    for world in (declared, undeclared):
        assert world.attributes == {"floor": "tiles", "start": "1 2"}
        assert world.models[0].attributes == {"role": "wall"}
        assert world.links[0].attributes == {"a": "1"}
        assert world.links[0].shapes[0].attributes == {"b": "2"}
        assert "element drake:hint" in ignored(world)
        assert len(ignored(world)) == 2


def test_a_file_with_a_model_is_a_world_of_its_name(tmp_path: Path) -> None:
    file = tmp_path / "thing.model.sdf"
    file.write_text(
        f'<sdf version="1.4"><model name="thing"><pose>0 0 2 0 0 0</pose>{LINK}</model></sdf>'
    )
    world = clean(read_sdf(file))
    assert (world.name, world.report.world, world.links[0].name) == (
        "thing",
        "thing",
        "thing::link",
    )
    np.testing.assert_allclose(world.links[0].world_from_link, pose(0, 0, 2))


def test_names_of_flattened_includes_are_taken_as_they_are_before_1_8(tmp_path: Path) -> None:
    inside = model('<link name="i::l"><pose>1 0 0 0 0 0</pose></link>')
    assert clean(read(tmp_path, inside, "1.6")).links[0].name == "m::i::l"


def test_hundreds_of_cylinders_are_read_at_once(tmp_path: Path) -> None:
    cylinder = "<geometry><cylinder><radius>0.075</radius><length>1</length></cylinder></geometry>"
    models = "".join(
        f"""<model name="unit_cylinder_{i}"><static>1</static><pose frame="">{i} 0 0.5 0 0 0</pose>
        <link name="link"><inertial><mass>1</mass></inertial><collision name="collision">{cylinder}
        <max_contacts>10</max_contacts><surface><contact/></surface></collision>
        <visual name="visual">{cylinder}<material><script><name>Gazebo/Grey</name></script>
        </material></visual></link></model>"""
        for i in range(300)
    )
    world = clean(read(tmp_path, models, "1.6"))
    assert world.report.collisions == world.report.visuals == {"cylinder": 300}
    np.testing.assert_allclose(world.links[299].world_from_link, pose(299, 0, 0.5))
    assert len(world.report.ignored) == 2


def test_a_long_chain_of_frames_is_followed(tmp_path: Path) -> None:
    chain = "".join(
        f'<frame name="f{i}" attached_to="{f"f{i + 1}" if i < 2999 else "link"}">'
        "<pose>0.5 0 0 0 0 0</pose></frame>"
        for i in range(3000)
    )
    world = clean(read(tmp_path, model(LINK + chain)))
    np.testing.assert_allclose(frame(world, "m::f0"), pose(1500, 0, 0))


STATE = f"""
<model name="wall"><static>1</static><pose>0 0 0.5 0 0 0</pose>{LINK}
  <frame name="top"><pose>0 0 1 0 0 0</pose></frame></model>
<model name="outer"><pose>1 0 0 0 0 0</pose><model name="inner">{LINK}</model></model>
<light name="lamp" type="point"><pose>0 0 3 0 0 0</pose></light>
<state world_name="w"><sim_time>1 2</sim_time>
  <model name="wall"><pose frame="">3 2 0.5 0 0 1.5707963267948966</pose><scale>1 1 1</scale>
    <link name="link"><pose>3 2 1.0 0 0 1.5707963267948966</pose>
      <velocity>0 0 0 0 0 0</velocity></link>
  </model>
  <model name="outer"><pose>0 5 0 0 0 0</pose><model name="inner"><pose>0 6 0 0 0 0</pose>
    <link name="link"><pose>0 6 0.25 0 0 0</pose></link></model></model>
  <model name="gone"><pose>7 7 7 0 0 0</pose></model>
  <light name="lamp"><pose>1 1 4 0 0 0</pose></light>
</state>
<state world_name="later"><model name="wall"><pose>9 9 9 0 0 0</pose></model></state>
"""


def test_a_state_of_gazebo_classic_says_where_everything_is(tmp_path: Path) -> None:
    world = clean(read(tmp_path, STATE, "1.6"))
    assert ignored(world) == ["second <state>"]
    turn = [[0.0, -1.0], [1.0, 0.0]]
    np.testing.assert_allclose(frame(world, "wall")[:3, 3], (3.0, 2.0, 0.5))
    np.testing.assert_allclose(frame(world, "wall")[:2, :2], turn, atol=1e-12)
    np.testing.assert_allclose(frame(world, "wall::top")[:3, 3], (3.0, 2.0, 1.5))
    at = {link.name: link.world_from_link for link in world.links}
    np.testing.assert_allclose(at["wall::link"][:3, 3], (3.0, 2.0, 1.0))
    np.testing.assert_allclose(at["wall::link"][:2, :2], turn, atol=1e-12)
    np.testing.assert_allclose(frame(world, "outer::inner")[:3, 3], (0.0, 6.0, 0.0))
    np.testing.assert_allclose(at["outer::inner::link"][:3, 3], (0.0, 6.0, 0.25))
    np.testing.assert_allclose(world.lights[0].world_from_light[:3, 3], (1.0, 1.0, 4.0))


def test_the_state_of_an_included_model_is_that_of_its_own_frame(tmp_path: Path) -> None:
    (tmp_path / "box").mkdir()
    (tmp_path / "box" / "model.config").write_text('<model><sdf version="1.8">m.sdf</sdf></model>')
    (tmp_path / "box" / "m.sdf").write_text(
        f'<sdf version="1.8"><model name="box" placement_frame="top">{LINK}'
        '<frame name="top"><pose>0 0 1 0 0 0</pose></frame></model></sdf>'
    )
    boxes = "".join(
        f"<include><uri>box</uri><name>{name}</name><pose>{x} 0 1 0 0 0</pose></include>"
        for name, x in (("a", 1), ("b", 2))
    )
    state = '<state world_name="w"><model name="b"><pose>4 0 0 0 0 0</pose></model></state>'
    world = clean(read(tmp_path, boxes + state, "1.8"))
    np.testing.assert_allclose(frame(world, "a")[:3, 3], (1.0, 0.0, 0.0))
    np.testing.assert_allclose(frame(world, "b")[:3, 3], (4.0, 0.0, 0.0))


def test_what_of_a_state_is_not_applied_is_told(tmp_path: Path) -> None:
    state = f"""<model name="wall"><static>1</static>{LINK}</model>
    <state world_name="w"><insertions><model name="new">{LINK}</model></insertions>
    <model name="wall"><pose>1 2 nonsense 0 0 0</pose><scale>2 0 1</scale></model></state>"""
    world = read(tmp_path, state, "1.6")
    assert ignored(world) == ["insertions of state"]
    assert kinds(world) == ["ELEMENT_INVALID", "ELEMENT_INVALID"]
    assert world.report.errors[0].message == "<scale> `2 0 1` must be > 0 each"
