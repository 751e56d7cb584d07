"""The robot tells when it begins to touch something, and once."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mazebot.common.files.root import ROOT
from mazebot.common.messages.documents import (
    Body,
    BodyEntity,
    Box,
    Contact,
    Cylinder,
    Entities,
    Geometry,
    Mesh,
    Plane,
    ScriptedPath,
    Shape,
)
from mazebot.common.messages.topics import CONTACTS, DESIRED_ENTITIES
from mazebot.common.world.geometry import TriangleMesh
from mazebot.physics.bodies.bodies import Bodies, Touch
from mazebot.physics.bodies.robot_model import robot_model_from_urdf
from mazebot.physics.sensors.contacts import ContactEvents
from tests.physics.driver import HOUSE_WALLS, Driver, world

AHEAD = [("Ahead", 2.0, 0.6, 0.0, math.pi / 2)]
FACE_X_M = 0.6 - 0.075
HULL_FRONT_M, HULL_HALF_WIDTH_M = 0.0685, 0.1325
MASS_KG = 1.362
GRIP_N = MASS_KG * 9.8
"""The most that the tyres can push with."""


def spawned(name: str, geometry: Geometry, **changes: object) -> BodyEntity:
    shape = Shape(name="all", geometry=geometry, material="")
    return BodyEntity.model_validate({"name": name, "shapes": (shape,), **changes})


MESH_SHA256 = "a" * 64
MODEL = ROOT / "models/turtlebot3_waffle/model.urdf"


def floor_part(name: str, geometry: Geometry, x_m: float, y_m: float, z_m: float) -> Body:
    shape = Shape(name="all", geometry=geometry, material="")
    return Body(name=name, position_m=(x_m, y_m, z_m), shapes=(shape,))


def relief(slope: float) -> TriangleMesh:
    """Level squares of 0.1 m with low waves, and a ramp from x = 0.5 m on."""
    rows = np.linspace(-2.0, 2.0, 41)
    x, y = (axis.ravel() for axis in np.meshgrid(rows, rows, indexing="ij"))
    z = 0.002 * np.sin(5.0 * x) * np.cos(3.0 * y) + slope * np.clip(x - 0.5, 0.0, None)
    corner = np.arange(41 * 41).reshape(41, 41)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    triangles = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    points = np.column_stack((x, y, z))
    up = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    return TriangleMesh(points, up, np.zeros((len(points), 2)), triangles.astype(np.int32))


FLOORS: dict[str, tuple[Body, ...]] = {
    "mesh": (floor_part("Terrain", Mesh(sha256=MESH_SHA256), 0.0, 0.0, 0.003),),
    "box": (floor_part("Slab", Box(size_m=(4.0, 4.0, 0.1)), 0.0, 0.0, -0.045),),
    "raised plane": (floor_part("Deck", Plane(size_m=(4.0, 4.0)), 0.0, 0.0, 0.005),),
    "tiles": tuple(
        floor_part(
            f"Tile_{i}_{j}", Box(size_m=(0.25, 0.25, 0.1)), 0.25 * i + 0.07, 0.25 * j, -0.045
        )
        for i in range(-3, 6)
        for j in range(-3, 4)
    ),
}


def touched_on(
    floor: tuple[Body, ...], walls: list[tuple[str, float, float, float, float]]
) -> tuple[float, set[tuple[str, str]]]:
    """How far the robot comes in 3 s straight ahead, and what it touches with which link."""
    of = world(walls).model_copy(update={"bodies": floor})
    model = robot_model_from_urdf(MODEL.read_text())
    bodies = Bodies(of, model, 2.0, {MESH_SHA256: relief(slope=0.2)})
    try:
        bodies.set_wheel_speeds(0.3 / 0.033, 0.3 / 0.033)
        touched = set()
        for _ in range(3 * 240):
            bodies.step()
            touched |= {(touch.robot_link, touch.body) for touch in bodies.touches()}
        return float(bodies.map_from_footprint()[0, 3]), touched
    finally:
        bodies.close()


@pytest.mark.parametrize("floor", FLOORS)
def test_what_the_wheels_stand_on_is_floor_whatever_it_is_made_of(floor: str) -> None:
    driven_m, touched = touched_on(FLOORS[floor], [])
    assert touched == set()
    assert driven_m > 0.7


@pytest.mark.parametrize("floor", FLOORS)
def test_a_wall_on_such_a_floor_is_touched(floor: str) -> None:
    _, touched = touched_on(FLOORS[floor], [("Ahead", 2.0, 0.4, 0.0, math.pi / 2)])
    assert touched == {("base_link", "Ahead")}


def test_a_kerb_that_stops_the_wheels_is_touched_by_them() -> None:
    # Beside the hull, which would be stopped first by anything as high.
    track_m, size = 0.147, Box(size_m=(0.2, 0.02, 0.05))
    kerbs = tuple(floor_part(f"Kerb_{y:+}", size, 0.4, y, 0.0) for y in (-track_m, track_m))
    driven_m, touched = touched_on(kerbs, [])
    assert driven_m < 0.3
    assert touched == {
        ("wheel_right_link", f"Kerb_{-track_m:+}"),
        ("wheel_left_link", f"Kerb_{track_m:+}"),
    }


def driver_among(*entities: BodyEntity) -> Driver:
    of = world(walls=())
    robot = Driver().load(of)
    robot.deliver(DESIRED_ENTITIES, Entities(world_hash=of.hash, revision=1, entities=entities))
    robot.turn()
    return robot


def first_contact(robot: Driver, speed_m_s: float) -> Contact:
    robot.drive(speed_m_s, 0.0, 0.5 / speed_m_s + 0.5)
    return robot.all(CONTACTS)[0]


@pytest.mark.parametrize("speed_m_s", [0.2, 0.3, 0.46])
def test_the_impulse_stops_the_robot_and_the_place_is_on_the_wall(speed_m_s: float) -> None:
    robot = Driver().load(world(AHEAD))
    contact = first_contact(robot, speed_m_s)
    assert (contact.robot_link, contact.body) == ("base_link", "Ahead")
    x_m, y_m, z_m = contact.position_m
    assert x_m == pytest.approx(FACE_X_M, abs=2e-3)
    assert abs(y_m) <= HULL_HALF_WIDTH_M + 1e-3
    assert 0.0 < z_m < 0.2
    # All momentum, in one step, and no bounce; the motors push on, and the wheels have momentum.
    momentum_n_s = MASS_KG * speed_m_s
    assert 0.95 * momentum_n_s < contact.impulse_n_s < 1.05 * momentum_n_s + GRIP_N / 240.0
    # The ramp up to the speed, at 1 m/s2, takes half of it longer than the way at full speed.
    arrival_s = (FACE_X_M - HULL_FRONT_M) / speed_m_s + speed_m_s / 2.0
    assert contact.time_s == pytest.approx(arrival_s, abs=0.02)
    robot.node.close()


def test_a_spawned_body_is_touched_by_its_name() -> None:
    crate = spawned("crate", Box(size_m=(0.3, 0.4, 0.5)), position_m=(0.6, 0.0, 0.25))
    robot = driver_among(crate)
    contact = first_contact(robot, 0.3)
    assert (contact.robot_link, contact.body) == ("base_link", "crate")
    assert contact.position_m[0] == pytest.approx(0.45, abs=2e-3)
    momentum_n_s = MASS_KG * 0.3
    assert 0.95 * momentum_n_s < contact.impulse_n_s < 1.05 * momentum_n_s + GRIP_N / 240.0
    assert robot.pose.x_m == pytest.approx(0.45 - HULL_FRONT_M, abs=2e-3)
    robot.node.close()


def test_what_comes_to_stand_close_ahead_of_a_robot_with_nothing_near_is_touched() -> None:
    robot = driver_among()
    robot.wait(0.5)
    side_m = 0.3
    crate = spawned(
        "crate",
        Box(size_m=(side_m, 0.4, 0.5)),
        position_m=(HULL_FRONT_M + 0.02 + side_m / 2.0, 0.0, 0.25),
    )
    robot.deliver(
        DESIRED_ENTITIES,
        Entities(world_hash=robot.node.world_hash, revision=2, entities=(crate,)),
    )
    robot.turn()
    robot.drive(0.2, 0.0, 0.5)
    assert [(one.robot_link, one.body) for one in robot.all(CONTACTS)] == [("base_link", "crate")]
    robot.node.close()


def test_a_round_body_is_touched_where_it_is_nearest() -> None:
    post = spawned("post", Cylinder(radius_m=0.1, length_m=1.0), position_m=(0.5, 0.05, 0.5))
    robot = driver_among(post)
    contact = first_contact(robot, 0.3)
    assert contact.body == "post"
    assert contact.position_m[:2] == pytest.approx((0.4, 0.05), abs=4e-3)
    robot.node.close()


def test_a_body_that_gives_way_takes_less_than_a_wall() -> None:
    size = Box(size_m=(0.2, 0.2, 0.2))
    light = spawned("light", size, position_m=(0.5, 0.0, 0.1), mass_kg=0.3)
    robot = driver_among(light)
    contact = first_contact(robot, 0.3)
    assert (contact.robot_link, contact.body) == ("base_link", "light")
    assert contact.position_m[0] == pytest.approx(0.4, abs=3e-3)
    # Two bodies that go on together: the reduced mass; and the floor holds the crate a little.
    reduced_kg = MASS_KG * 0.3 / (MASS_KG + 0.3)
    friction_n_s = 0.3 * 9.8 / 240.0
    assert contact.impulse_n_s > 0.8 * reduced_kg * 0.3
    assert contact.impulse_n_s < 1.2 * reduced_kg * 0.3 + 2.0 * friction_n_s + GRIP_N / 240.0
    assert robot.pose.x_m > 0.4
    robot.node.close()


def test_one_that_comes_along_its_path_is_told_by_its_name() -> None:
    path = ScriptedPath(waypoints_m=((-1.0, 0.0),), speed_m_s=0.3, yields=False)
    post = Cylinder(radius_m=0.1, length_m=0.5)
    robot = driver_among(spawned("patrol", post, position_m=(1.0, 0.0, 0.26), path=path))
    robot.wait(5.0)
    contact = robot.all(CONTACTS)[0]
    assert (contact.robot_link, contact.body) == ("base_link", "patrol")
    assert contact.position_m[0] == pytest.approx(HULL_FRONT_M, abs=0.01)
    robot.node.close()


def test_points_of_one_pair_are_one_event_and_another_pair_is_another() -> None:
    touches = [
        Touch("base_link", "Wall", (1.0, 0.1, 0.05), 10.0),
        Touch("base_link", "Wall", (1.0, -0.1, 0.05), 30.0),
        Touch("wheel_left_link", "Wall", (0.9, 0.2, 0.03), 5.0),
    ]
    events = ContactEvents()
    hull, wheel = events.begun(touches, 1_000_000_000, 1.0 / 240.0)
    assert (hull.robot_link, wheel.robot_link) == ("base_link", "wheel_left_link")
    assert hull.position_m == (1.0, -0.1, 0.05)
    assert hull.impulse_n_s == pytest.approx(40.0 / 240.0)
    assert hull.time_s == 1.0
    assert events.begun(touches[:2], 1_100_000_000, 1.0 / 240.0) == []
    # The hull's touch went on at 1.1 s; the wheel's did not.
    (again,) = events.begun(touches, 1_250_000_000, 1.0 / 240.0)
    assert again.robot_link == "wheel_left_link"


def test_driving_into_a_wall_is_told_once() -> None:
    robot = Driver().load(world(AHEAD))
    robot.drive(0.3, 0.0, 4.0)
    (contact,) = robot.all(CONTACTS)
    assert (contact.robot_link, contact.body) == ("base_link", "Ahead")
    assert contact.position_m[0] == pytest.approx(0.6 - 0.075, abs=0.01)
    assert contact.impulse_n_s > 0.0
    # The hull's front is 68.5 mm ahead of the wheels; it had to get there first.
    assert contact.time_s > (0.525 - 0.0685) / 0.3
    assert robot.pose.x_m == pytest.approx(0.525 - 0.0685, abs=0.01)


def test_a_new_touch_is_told_anew() -> None:
    robot = Driver().load(world(AHEAD))
    for _ in range(2):
        robot.drive(0.3, 0.0, 3.0)
        robot.drive(-0.3, 0.0, 1.5)
    assert len(robot.all(CONTACTS)) == 2


def test_the_floor_is_not_told_of() -> None:
    robot = Driver().load(world(HOUSE_WALLS))
    robot.drive(0.2, 1.0, 3.0)
    assert robot.all(CONTACTS) == []


def test_a_wheel_that_rubs_along_a_wall_is_told_by_its_name() -> None:
    robot = Driver().load(world([("Left", 3.0, 0.0, 0.24, 0.0)], start=(-0.5, 0.0, 0.2)))
    robot.drive(0.2, 0.0, 3.0)
    contacts = robot.all(CONTACTS)
    assert {contact.body for contact in contacts} == {"Left"}
    assert "wheel_left_link" in {contact.robot_link for contact in contacts}
    assert all(contact.robot_link != "wheel_right_link" for contact in contacts)
