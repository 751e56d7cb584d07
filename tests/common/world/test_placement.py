from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, rotation_from_rpy, transform_matrix
from mazebot.common.messages.documents import Body, Box, Ceiling, Marker, Mesh, Shape, Wall
from mazebot.common.world.geometry import TriangleMesh
from mazebot.common.world.marker_entities import marker_entities
from mazebot.common.world.placement import Panel, Placement, hang, panel_of
from mazebot.worldgen.recipe.loader import load_world
from tests.common.house import marker, wall, world

SIDE_M = 0.4


def problem(
    one: Marker, *others: Wall, host: Wall | None = None, hanging: tuple[Panel, ...] = ()
) -> str:
    host = host or wall()
    placement = Placement(world([host, *others], []))
    panel = hang("marker", one, host, SIDE_M, 0.002)
    by_name = placement.problem(panel, hanging, host.name)
    if by_name == "" or "beyond" not in by_name:
        assert placement.problem(panel, hanging) == by_name, "judged by its pose alone as well"
    return by_name


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("yaw_rad", [*np.linspace(-math.pi, math.pi, 9), 1.5708, -2.35619, 0.3])
def test_a_panel_hangs_flat_on_its_face_whatever_the_walls_yaw(yaw_rad: float, side: str) -> None:
    host = wall(pose=SE2(3.0, -2.0, yaw_rad))
    panel = hang("marker", marker(side=side, offset_m=0.3), host, SIDE_M, 0.002)
    # Seen from the wall: along it, out of the face, up.
    wall_from_panel = np.linalg.inv(host.map_from_wall().matrix()) @ panel.map_from_panel
    out = 1.0 if side == "left" else -1.0
    assert wall_from_panel[:3, 3] == pytest.approx([0.3, out * 0.102, 0.4], abs=1e-12)
    right, up, normal = wall_from_panel[:3, :3].T
    assert normal == pytest.approx([0.0, out, 0.0], abs=1e-12)
    assert up == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)
    # Who looks at the left face has the wall's x axis to the left.
    assert right == pytest.approx([-out, 0.0, 0.0], abs=1e-12)
    assert np.linalg.det(panel.map_from_panel) == pytest.approx(1.0)
    ahead = panel.centre_m + 2.0 * panel.normal
    start = SE2(float(ahead[0]), float(ahead[1]), 0.0)
    assert Placement(world([host], [], start)).problem(panel, (), "wall") == ""


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, ""),
        ({"offset_m": 0.8}, ""),
        ({"offset_m": 0.81}, "extends 0.010 m beyond the end of wall"),
        ({"offset_m": -1.5}, "extends 0.700 m beyond the end of wall"),
        ({"height_m": 0.8}, ""),
        ({"height_m": 0.81}, "extends 0.010 m above the top of wall"),
        ({"height_m": 0.2}, ""),
        ({"height_m": 0.15}, "extends 0.050 m below the floor"),
        ({"offset_m": 1e308}, "must lie within 10000 m"),
        ({"side": "right"}, ""),
    ],
)
def test_a_panel_stays_on_its_wall(changes: dict[str, object], said: str) -> None:
    assert problem(marker(**changes)) == said


def test_a_panel_is_not_inside_a_wall_that_crosses_its_own() -> None:
    crossing = wall("crossing", SE2(0.25, 0.5, math.pi / 2))
    assert problem(marker(), crossing) == "is buried in crossing over 0.050 m"
    assert problem(marker(offset_m=-0.06), crossing) == ""


def test_a_panel_is_not_hidden_by_a_wall_in_front_of_it() -> None:
    for gap_m, said in ((0.3, "is hidden by front, 0.298 m in front of it"), (0.6, "")):
        front = wall("front", SE2(0.3, 0.1 + gap_m + 0.1, 0.0), length_m=0.5)
        assert problem(marker(), front) == said
    low = wall("low", SE2(0.0, 0.5, 0.0), height_m=0.1)
    assert problem(marker(), low) == ""


def test_a_panel_faces_a_floor_that_the_robot_can_reach() -> None:
    room = [
        wall("north", SE2(0.0, 2.0, 0.0), 4.2), wall("east", SE2(2.0, 1.0, math.pi / 2), 2.2),
        wall("west", SE2(-2.0, 1.0, math.pi / 2), 2.2),
    ]  # fmt: skip
    host = wall(length_m=4.2)
    closed = "faces a part of the floor that is unreachable from the start"
    assert problem(marker(side="left"), *room, host=host) == closed
    assert problem(marker(side="right"), *room, host=host) == ""


def test_two_panels_do_not_overlap() -> None:
    first = hang("first", marker(offset_m=-0.2), wall(), SIDE_M, 0.002)
    assert problem(marker(offset_m=0.19), hanging=(first,)) == "overlaps first"
    assert problem(marker(offset_m=0.21), hanging=(first,)) == ""
    assert problem(marker(offset_m=-0.2, height_m=0.79), hanging=(first,)) == "overlaps first"
    # On the other face of the wall there is room.
    assert problem(marker(offset_m=-0.2, side="right"), hanging=(first,)) == ""


def posed(x_m: float, y_m: float, z_m: float, roll: float, pitch: float, yaw: float) -> Panel:
    """A panel by its pose in the house."""
    rotation = rotation_from_rpy(roll, pitch, yaw)
    return Panel("marker", transform_matrix(rotation, (x_m, y_m, z_m)), 0.3)


FACING_EAST = (math.pi / 2, 0.0, math.pi / 2)


@pytest.mark.parametrize(
    ("panel", "said"),
    [
        # The two layouts of the house that this one improves on.
        (posed(-1.08, 0.0, 0.2, *FACING_EAST), "floats 0.724 m off Wall_14"),
        (posed(2.12, 2.5, 0.2, *FACING_EAST), "floats 0.643 m off Wall_25"),
        (posed(-1.0, -2.0, 0.16, math.pi / 2, 0.0, math.pi), "is buried in Wall_0 over 0.300 m"),
        # Good but for one thing.
        (posed(-1.8015, 0.427, 0.25, *FACING_EAST), ""),
        (posed(-1.7905, 0.427, 0.25, *FACING_EAST), "floats 0.013 m off Wall_14"),
        (
            posed(-1.8015, 0.427, 0.25, math.pi / 2, 0.0, math.pi / 2 + 0.005),
            "does not lie flat on a",
        ),
        (posed(-1.8015, 0.427, 0.25, math.pi / 2, 0.0, -math.pi / 2), "does not lie flat on a fac"),
        (posed(-1.8015, 0.427, 0.25, 1.4, 0.0, math.pi / 2), "is not upright"),
        (posed(-1.8015, 0.427, 0.25, 0.0, math.pi / 2, 0.0), "is not upright"),
        (posed(-1.8015, 1.2, 0.25, *FACING_EAST), "extends 0.041 m beyond the end of Wall_14"),
        (
            posed(-2.5735, 0.427, 0.25, math.pi / 2, 0.0, -math.pi / 2),
            "faces a part of the floor that",
        ),
        (posed(math.nan, 0.427, 0.25, *FACING_EAST), "must lie within"),
    ],
)
def test_a_panel_in_the_house_is_judged_by_its_pose(panel: Panel, said: str) -> None:
    house = load_world("sim_house_enhanced").world
    found = Placement(house).problem(panel, ())
    assert found.startswith(said) if said else found == "", found


def test_without_walls_there_is_nowhere_to_hang() -> None:
    panel = hang("marker", marker(), wall(), SIDE_M, 0.002)
    assert Placement(world([], [])).problem(panel, ()) == "floats: there are no walls"
    assert "no such wall" in Placement(world([wall()], [])).problem(
        hang("marker", marker(), wall(pose=SE2(0.0, 1.0, 0.0)), SIDE_M, 0.002), (), "other"
    )


def body(
    x_m: float, y_m: float, z_m: float, size_m: tuple[float, float, float], **shape: object
) -> Body:
    values = {"name": "box", "geometry": Box(size_m=size_m), "material": "plain"} | shape
    return Body(name="crate", position_m=(x_m, y_m, z_m), shapes=(Shape.model_validate(values),))


def among(*bodies: Body, meshes: dict[str, TriangleMesh] | None = None, **changes: object) -> str:
    """What is wrong with a marker on the left face, at y = 0.1, among bodies."""
    one = world([wall()], []).model_copy(update={"bodies": bodies, **changes})
    panel = hang("marker", marker(), wall(), SIDE_M, 0.002)
    return Placement(one, meshes).problem(panel, (), "wall")


@pytest.mark.parametrize(
    ("crate", "said"),
    [
        (body(0.0, 0.2, 0.4, (0.3, 0.3, 0.1)), "is buried in crate over 0.300 m"),
        (body(0.0, 0.5, 0.4, (0.3, 0.2, 0.1)), "is hidden by crate, 0.298 m in front of it"),
        (body(0.0, 0.5, 0.09, (0.3, 0.2, 0.18)), ""),  # below the panel
        (body(0.0, 0.5, 0.9, (0.3, 0.2, 0.2)), ""),  # above it
        (body(0.5, 0.5, 0.4, (0.3, 0.2, 0.2)), ""),  # beside it
        (body(0.0, 0.5, 0.4, (0.3, 0.2, 0.1), material=""), ""),  # cannot be seen
        (body(0.0, 0.2, 0.4, (0.3, 0.3, 0.1), solid=False), "is buried in crate over 0.300 m"),
    ],
)
def test_a_panel_is_judged_among_bodies(crate: Body, said: str) -> None:
    assert among(crate) == said


def test_a_turned_body_is_met_where_it_is() -> None:
    # A long box, turned by an eighth about z, reaches before the panel with its end only.
    turn = (0.0, 0.0, math.sin(math.pi / 8), math.cos(math.pi / 8))
    crate = body(0.7, 0.9, 0.4, (1.6, 0.05, 0.1))
    assert among(crate) == ""
    assert among(crate.model_copy(update={"orientation_xyzw": turn})).startswith("is hidden by")


def test_a_mesh_hides_with_its_triangles_alone() -> None:
    frame = [((-0.8, 0.4), (-0.4, 0.4)), ((0.4, 0.4), (0.8, 0.4))]
    corners = np.array([[(*a, 0.0), (*b, 0.0), (*b, 1.0)] for a, b in frame]).reshape(-1, 3)
    mesh = TriangleMesh(
        corners, np.zeros((6, 3)), np.zeros((6, 2)), np.arange(6, dtype=np.int32).reshape(-1, 3)
    )
    around = body(0.0, 0.0, 0.0, (1.0, 1.0, 1.0), geometry=Mesh(sha256="mesh"))
    assert among(around, meshes={"mesh": mesh}) == ""
    beside = around.model_copy(update={"position_m": (0.6, 0.0, 0.0)})
    assert among(beside, meshes={"mesh": mesh}).startswith("is hidden by crate")
    assert among(beside) == "", "what is not known is not met"


def test_a_panel_stays_under_the_ceiling() -> None:
    ceiling = Ceiling(height_m=0.55, material="plain")
    assert among(ceiling=ceiling) == "extends 0.050 m through the ceiling"
    assert among(ceiling=ceiling.model_copy(update={"height_m": 0.6})) == ""


def test_a_panel_must_be_seen_from_somewhere_where_that_is_known() -> None:
    placement = Placement(world([wall()], []))
    panel = hang("marker", marker(), wall(), SIDE_M, 0.002)
    nowhere = np.zeros((3, 3), np.bool_)
    said = "is not visible from any position that the robot can reach"
    assert placement.problem(panel, (), "wall", nowhere) == said
    nowhere[1, 1] = True
    assert placement.problem(panel, (), "wall", nowhere) == ""


def test_bodies_close_a_floor_off() -> None:
    sides = [body(x, 1.0, 0.1, (0.1, 2.0, 0.2)) for x in (-0.95, 0.95)]
    front = body(0.0, 2.0, 0.1, (2.0, 0.1, 0.2))
    assert among(*sides) == ""
    assert among(*sides, front) == "faces a part of the floor that is unreachable from the start"


def test_hundreds_of_panels_among_thousands_of_walls_are_judged_at_once() -> None:
    walls = [
        wall(f"w{row}_{column}", SE2(2.5 * column, 1.5 * row, 0.0))
        for row in range(50)
        for column in range(50)
    ]
    placement = Placement(world(walls, [], start=SE2(0.0, 0.7, 0.0)))
    hanging: list[Panel] = []
    for host in walls[:300]:
        panel = hang(host.name, marker(wall=host.name), host, SIDE_M, 0.002)
        assert placement.problem(panel, hanging) == ""
        hanging.append(panel)


def test_an_entity_tells_its_panel() -> None:
    (entity,) = marker_entities(world([wall()], [marker(offset_m=0.3, side="right")]))[0].markers
    panel = hang("aruco_7", marker(offset_m=0.3, side="right"), wall(), SIDE_M, 0.002)
    again = panel_of(entity)
    assert again.map_from_panel == pytest.approx(panel.map_from_panel, abs=1e-12)
    assert again.name == "aruco_7"
    assert again.side_m == pytest.approx(SIDE_M)
