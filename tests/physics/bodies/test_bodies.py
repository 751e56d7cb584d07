"""Bodies of every shape: solid where they should be, moving as they should, refused where not."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from mazebot.common.maths.frames import (
    quaternion_from_rotation,
    rotation_from_rpy,
)
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    Body,
    BodyEntity,
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Entities,
    Geometry,
    Mesh,
    Plane,
    Polyline,
    Shape,
    Sphere,
    World,
)
from mazebot.common.messages.topics import (
    ASSETS,
    CONTACTS,
    DESIRED_ENTITIES,
    ENTITIES,
    SCAN,
    SIMULATION_STATS,
    TF,
)
from mazebot.common.world.geometry import TriangleMesh, joined, mesh_to_bytes, triangles_of
from mazebot.physics.bodies.bodies import Bodies
from mazebot.physics.bodies.collision import inertia_of
from mazebot.physics.bodies.robot_model import robot_model_from_urdf
from mazebot.physics.bodies.world_limits import check
from mazebot.physics.config import PhysicsConfig
from tests.physics.driver import TABLE, URCHIN, Driver, hit_distances_m, world

MODEL = robot_model_from_urdf(PhysicsConfig().robot_urdf())
CUBE_SHA = "c" * 64
MESHES = {CUBE_SHA: triangles_of(Box(size_m=(1.0, 1.0, 1.0)), {})}
BEND = ((-0.2, -0.2), (0.2, -0.2), (0.2, 0.0), (0.0, 0.0), (0.0, 0.2), (-0.2, 0.2))
RING = (
    ((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)),
    ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)),
)
KINDS: dict[str, Geometry] = {
    "box": Box(size_m=(0.4, 0.4, 0.4)),
    "cylinder": Cylinder(radius_m=0.2, length_m=0.4),
    "cone": Cone(radius_m=0.2, length_m=0.4),
    "capsule": Capsule(radius_m=0.1, length_m=0.2),
    "sphere": Sphere(radius_m=0.2),
    "ellipsoid": Ellipsoid(radii_m=(0.2, 0.15, 0.1)),
    "polyline": Polyline(polygons_m=(BEND,), height_m=0.4),
    "mesh": Mesh(sha256=CUBE_SHA, scale=(0.4, 0.4, 0.4)),
}


def body(name: str = "thing", geometry: Geometry = KINDS["box"], **changes: Any) -> Body:
    shape = Shape(name="shape", geometry=geometry, material="plain")
    values = {"name": name, "position_m": (1.0, 0.0, 0.2), "shapes": (shape,)}
    return Body.model_validate({**values, **changes})


def world_of(*bodies: Body, walls: Any = ()) -> World:
    draft = world(walls=walls).model_copy(update={"bodies": bodies})
    return draft.model_copy(update={"hash": draft.content_hash()})


def made(*bodies: Body, meshes: dict[str, TriangleMesh] = MESHES) -> Bodies:
    return Bodies(world_of(*bodies), MODEL, 1.0, meshes)


@pytest.fixture
def closing() -> Iterator[list[Any]]:
    things: list[Any] = []
    yield things
    for thing in things:
        thing.close()


def surface_distance_m(mesh: TriangleMesh, start: Any, end: Any) -> float:
    """Where a ray first meets triangles, by Moeller and Trumbore."""
    origin, way = np.array(start, float), np.array(end, float) - np.array(start, float)
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]] for k in range(3))
    p = np.cross(way, c - a)
    det = np.einsum("ij,ij->i", b - a, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ij,ij->i", origin - a, p) / det
        q = np.cross(origin - a, b - a)
        v = q @ way / det
        t = np.einsum("ij,ij->i", c - a, q) / det
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0)
    return float(t[met].min() * np.linalg.norm(way)) if met.any() else math.inf


@pytest.mark.parametrize("mass_kg", [0.0, 1.0], ids=["static", "moving"])
@pytest.mark.parametrize("kind", KINDS)
def test_rays_meet_a_body_where_its_triangles_are(
    kind: str, mass_kg: float, closing: list[Any]
) -> None:
    turn = quaternion_from_rotation(rotation_from_rpy(0.3, -0.2, 0.9))
    thing = body(geometry=KINDS[kind], mass_kg=mass_kg, orientation_xyzw=turn)
    bodies = made(thing)
    closing.append(bodies)
    mesh = (
        triangles_of(KINDS[kind], MESHES).moved(bodies.map_from_movers()[0])
        if mass_kg
        else (triangles_of(KINDS[kind], MESHES))
    )
    if not mass_kg:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation_from_rpy(0.3, -0.2, 0.9), (1.0, 0.0, 0.2)
        mesh = mesh.moved(pose)
    aims = mesh.vertices_m.mean(0) + np.array([[0, 0, 0], [0.03, 0.05, 0.02], [-0.04, 0, -0.06]])
    for aim in aims:
        for start in ([-1, 0.1, 0.3], [1.1, 1.0, 0.25], [1.2, -0.9, 1.5]):
            far = np.array(start) + 3.0 * (aim - start)
            (found,) = hit_distances_m(bodies, [start], [far])
            # Round triangles lie within the true shape, hulls have a margin.
            assert found == pytest.approx(surface_distance_m(mesh, start, far), abs=0.006)


@pytest.mark.parametrize("mass_kg", [0.0, 1.0], ids=["static", "moving"])
@pytest.mark.parametrize("radii_m", [(0.2, 0.15, 0.1), (0.4, 0.4, 0.4001), (0.01, 0.5, 0.3)])
def test_rays_meet_an_ellipsoid_where_its_equation_says(
    radii_m: tuple[float, float, float], mass_kg: float, closing: list[Any]
) -> None:
    turn = rotation_from_rpy(0.3, -0.2, 0.9)
    xyzw = quaternion_from_rotation(turn)
    geometry = Ellipsoid(radii_m=radii_m)
    bodies = made(body(geometry=geometry, mass_kg=mass_kg, orientation_xyzw=xyzw))
    closing.append(bodies)
    middle = np.array([1.0, 0.0, 0.2])
    rng = np.random.default_rng(4)
    aims = rng.normal(size=(60, 3))
    # Up to its very edge, and past it.
    aims *= (rng.uniform(0.0, 1.05, 60) / np.linalg.norm(aims, axis=1))[:, None]
    aims = aims * radii_m @ turn.T + middle
    starts = rng.normal(size=(60, 3))
    starts = starts / np.linalg.norm(starts, axis=1)[:, None] * 1.5 + middle
    ways = (aims - starts) / np.linalg.norm(aims - starts, axis=1)[:, None]
    o, u = (starts - middle) @ turn / radii_m, ways @ turn / radii_m
    a, b, c = (u * u).sum(1), (o * u).sum(1), (o * o).sum(1) - 1.0
    under = b * b - a * c
    true_m = np.where(under >= 0.0, (-b - np.sqrt(np.maximum(under, 0.0))) / a, np.inf)
    found_m = hit_distances_m(bodies, starts, starts + 3.0 * ways)
    assert found_m == pytest.approx(true_m, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_what_moves_falls_and_rests_on_the_floor(kind: str, closing: list[Any]) -> None:
    bodies = made(body(geometry=KINDS[kind], mass_kg=1.0, position_m=(1.0, 0.0, 0.6)))
    closing.append(bodies)
    for _ in range(480):
        bodies.step()
    (pose,) = bodies.map_from_movers()
    low = triangles_of(KINDS[kind], MESHES).moved(pose).vertices_m[:, 2].min()
    assert abs(low) < 0.006
    assert bodies.mover_states[0].is_sane()
    assert np.linalg.norm(pose[:2, 3] - (1.0, 0.0)) < 0.1


def test_poses_are_those_of_the_document_at_the_start(closing: list[Any]) -> None:
    turn = rotation_from_rpy(0.3, -0.2, 0.9)
    shapes = tuple(
        Shape(name=name, geometry=geometry, position_m=(x, 0.0, 0.0), material="plain")
        for name, geometry, x in (
            ("a", KINDS["box"], 0.0),
            ("b", KINDS["sphere"], 0.7),
            ("c", KINDS["cone"], 1.2),
        )
    )
    bodies = made(
        body(
            shapes=shapes, mass_kg=3.0, position_m=(1.0, 2.0, 3.0),
            orientation_xyzw=quaternion_from_rotation(turn),
        )
    )  # fmt: skip
    closing.append(bodies)
    (pose,) = bodies.map_from_movers()
    assert np.abs(pose[:3, :3] - turn).max() < 1e-9
    assert pose[:3, 3] == pytest.approx((1.0, 2.0, 3.0))
    places = [pose[:3, :3] @ (x, 0.0, 0.0) + pose[:3, 3] for x in (0.0, 0.7, 1.2)]
    for place in places:
        (found,) = hit_distances_m(bodies, [np.add(place, (0.0, 0.0, 2.0))], [place])
        assert 1.6 < found < 1.9


def test_inertia_is_that_of_the_textbook() -> None:
    box = inertia_of(body(geometry=Box(size_m=(1.0, 2.0, 3.0)), mass_kg=12.0), {})
    assert sorted(box.diagonal_kg_m2) == pytest.approx([5.0, 10.0, 13.0])
    ball = inertia_of(body(geometry=Sphere(radius_m=0.5), mass_kg=10.0), {})
    assert ball.diagonal_kg_m2 == pytest.approx([1.0, 1.0, 1.0], rel=0.02)
    cube = inertia_of(body(geometry=Mesh(sha256=CUBE_SHA, scale=(1, 2, 3)), mass_kg=12.0), MESHES)
    assert sorted(cube.diagonal_kg_m2) == pytest.approx([5.0, 10.0, 13.0])
    shapes = tuple(
        Shape(name=str(x), geometry=Box(size_m=(1, 1, 1)), position_m=(x, 0.0, 0.0))
        for x in (0.0, 1.0)
    )
    table = body(geometry=Mesh(sha256="d" * 64), mass_kg=1.0)
    top_m3, leg_m3 = 1.2 * 1.2 * 0.04, 0.06 * 0.06 * 0.66
    low_m = (top_m3 * 0.7 + 4 * leg_m3 * 0.33) / (top_m3 + 4 * leg_m3)
    assert inertia_of(table, {"d" * 64: TABLE}).body_from_com[:3, 3] == pytest.approx((0, 0, low_m))
    pair = inertia_of(body(shapes=shapes, mass_kg=12.0), {})
    assert pair.body_from_com[:3, 3] == pytest.approx((0.5, 0.0, 0.0))
    assert sorted(pair.diagonal_kg_m2) == pytest.approx([2.0, 5.0, 5.0])


def test_things_rest_on_things_and_do_not_pass_through(closing: list[Any]) -> None:
    bodies = made(
        body("table", geometry=Box(size_m=(1.0, 1.0, 0.4))),
        body("crate", mass_kg=1.0, position_m=(1.0, 0.0, 0.8)),
        body("ball", KINDS["sphere"], mass_kg=0.5, position_m=(1.0, 0.0, 1.3)),
    )
    closing.append(bodies)
    for _ in range(360):
        bodies.step()
    crate, ball = bodies.map_from_movers()
    assert crate[2, 3] == pytest.approx(0.6, abs=0.01)
    assert ball[2, 3] == pytest.approx(1.0, abs=0.01)


def test_a_ring_is_hollow_and_a_bend_has_a_corner(closing: list[Any]) -> None:
    for mass_kg in (0.0, 1.0):
        ring = body(geometry=Polyline(polygons_m=RING, height_m=0.4), mass_kg=mass_kg)
        bend = body("bend", KINDS["polyline"], mass_kg=mass_kg, position_m=(3.0, 0.0, 0.2))
        bodies = made(ring, bend)
        closing.append(bodies)
        starts = [[1.0, 0.0, 1.0], [1.15, 0.0, 1.0], [3.1, 0.1, 1.0], [3.1, -0.1, 1.0]]
        found = hit_distances_m(bodies, starts, [[x, y, 0.1] for x, y, _ in starts])
        assert found == pytest.approx([math.inf, 0.4, math.inf, 0.4], abs=0.005)


@pytest.mark.parametrize("mass_kg", [0.0, 15.0], ids=["static", "moving"])
def test_a_table_has_room_for_rays_and_bodies_between_its_legs(
    mass_kg: float, closing: list[Any]
) -> None:
    meshes, geometry = {"d" * 64: TABLE}, Mesh(sha256="d" * 64)
    table = body(geometry=geometry, mass_kg=mass_kg, position_m=(2.0, 0.0, 0.0))
    crate = body("crate", mass_kg=1.0, position_m=(2.0, 0.0, 0.2))
    bodies = made(table, crate, meshes=meshes)
    closing.append(bodies)
    starts = [[0.0, 0.4, 0.2], [0.0, 0.55, 0.2], [0.0, 0.55, 0.7], [2.0, 0.0, 2.0]]
    ends = [[4.0, 0.4, 0.2], [4.0, 0.55, 0.2], [4.0, 0.55, 0.7], [2.0, 0.0, 0.0]]
    assert hit_distances_m(bodies, starts, ends) == pytest.approx([np.inf, 1.42, 1.4, 1.28])
    for _ in range(240):
        bodies.step()
    (*_, pose) = bodies.map_from_movers()
    assert pose[:3, 3] == pytest.approx((2.0, 0.0, 0.2), abs=0.003)


def test_a_plane_is_solid_and_one_on_the_floor_is_the_floor() -> None:
    shelf = body("shelf", Plane(size_m=(1.0, 1.0)), position_m=(1.0, 0.0, 0.5))
    ground = body("ground", Plane(size_m=(100.0, 100.0)), position_m=(0.0, 0.0, 0.0))
    upright = body(
        "board", Plane(size_m=(1.0, 1.0)), position_m=(0.5, 0.0, 0.2),
        orientation_xyzw=quaternion_from_rotation(rotation_from_rpy(0.0, -math.pi / 2, 0.0)),
    )  # fmt: skip
    driver = Driver(scan_noise_m=0.0).load(world_of(shelf, ground, upright))
    driver.drive(0.4, 0.0, 2.5)
    assert {contact.body for contact in driver.all(CONTACTS)} == {"board"}
    assert driver.pose.x_m < 0.5
    assert driver.all(SCAN)[0].ranges[0] == pytest.approx(0.564, abs=0.01)
    simulation = driver.node._simulation
    assert simulation is not None
    (found,) = hit_distances_m(simulation.bodies, [[1.0, 0.0, 1.0]], [[1.0, 0.0, 0.1]])
    assert found == pytest.approx(0.5, abs=1e-3)
    driver.node.close()


def test_rays_meet_a_plane_itself_from_either_side_and_nothing_at_its_edge(
    closing: list[Any],
) -> None:
    upright = quaternion_from_rotation(rotation_from_rpy(0.0, -math.pi / 2.0, 0.0))
    bodies = made(body(geometry=Plane(size_m=(1.0, 1.0)), orientation_xyzw=upright))
    closing.append(bodies)
    starts = [[0.0, 0.0, 0.2], [2.0, 0.0, 0.2], [1.01, -1.0, 0.2], [0.99, -1.0, 0.2]]
    ends = [[2.0, 0.0, 0.2], [0.0, 0.0, 0.2], [1.01, 1.0, 0.2], [0.99, 1.0, 0.2]]
    assert hit_distances_m(bodies, starts, ends) == pytest.approx([1.0, 1.0, np.inf, np.inf])


def test_the_robot_pushes_a_crate_that_has_rested_and_touches_a_post() -> None:
    crate = body("crate", Box(size_m=(0.2, 0.2, 0.2)), mass_kg=0.3, position_m=(0.5, 0.0, 0.1))
    post = body("post", KINDS["cylinder"], position_m=(1.6, 0.0, 0.2))
    driver = Driver(scan_noise_m=0.0).load(world_of(crate, post))
    driver.wait(4.0)
    before = driver.last(SCAN).ranges[0]
    driver.drive(0.3, 0.0, 2.0)
    simulation = driver.node._simulation
    assert simulation is not None
    pose = simulation.bodies.map_from_movers()[0]
    assert pose[0, 3] > driver.pose.x_m + 0.1 > 0.5
    assert before == pytest.approx(0.464, abs=0.01)
    assert "crate" in {contact.body for contact in driver.all(CONTACTS)}
    frames = {frame.child_frame_id: frame for frame in driver.last(TF).transforms}
    assert frames["crate"].header.frame_id == "map"
    told = frames["crate"].transform.translation
    assert told.x == pytest.approx(pose[0, 3], abs=0.02)
    driver.node.close()


def test_without_things_that_move_tf_is_the_odometry_and_at_times_the_wheels() -> None:
    driver = Driver().load(world_of(body()))
    driver.wait(0.2)
    assert [len(message.transforms) for message in driver.all(TF)] == [1, 1, 3] * 2
    driver.node.close()


def tumbling() -> World:
    kinds = [geometry for kind, geometry in KINDS.items() if kind != "mesh"]
    return world_of(
        *(
            body(
                f"thing{n}", kinds[n % len(kinds)], mass_kg=1.0 + n,
                position_m=(0.6 + 0.1 * (n % 3), 0.1 * n, 0.3 + 0.45 * n),
            )
            for n in range(8)
        )
    )  # fmt: skip


def test_things_tumble_the_same_each_time_and_count_in_the_state() -> None:
    hashes = []
    for of in (tumbling(), tumbling(), world_of()):
        driver = Driver(scan_noise_m=0.0).load(of)
        driver.drive(0.2, 0.0, 1.0)
        hashes.append(driver.last(SIMULATION_STATS).state_hash)
        driver.node.close()
    assert hashes[0] == hashes[1]
    assert hashes[2] != hashes[0]


def test_a_thing_whose_state_goes_bad_is_built_anew(caplog: pytest.LogCaptureFixture) -> None:
    from mazebot.physics.bodies.bullet import pybullet

    driver = Driver().load(world_of(body("crate", mass_kg=1.0)))
    driver.wait(0.1)
    simulation = driver.node._simulation
    assert simulation is not None
    bodies = simulation.bodies
    number = bodies._movers[0].numbers[0]
    pybullet.resetBaseVelocity(number, [math.nan, 0.0, 0.0], physicsClientId=bodies._client)
    driver.wait(0.1)
    assert simulation.bodies is not bodies
    assert simulation.bodies.map_from_movers()[0][:3, 3] == pytest.approx((1, 0, 0.2), abs=0.01)
    assert "rebuilt world" in caplog.text
    driver.node.close()


def mesh_asset(mesh: TriangleMesh) -> msg.CompressedImage:
    data = mesh_to_bytes(mesh)
    return msg.CompressedImage(
        header=msg.header(0, hashlib.sha256(data).hexdigest()),
        format="npz",
        data=np.frombuffer(data, np.uint8),
    )


def test_a_world_waits_for_its_meshes() -> None:
    rock = mesh_asset(triangles_of(Sphere(radius_m=0.3), {}))
    sha256 = rock.header.frame_id
    driver = Driver(renderer="auto").load(world_of(body("rock", Mesh(sha256=sha256))))
    assert (driver.node.waiting_for() or "").startswith("assets of the world on /world/assets: ")
    driver.send_asset(rock)
    driver.turn()
    assert driver.node.waiting_for() is None
    driver.drive(0.4, 0.0, 2.5)
    assert {contact.body for contact in driver.all(CONTACTS)} == {"rock"}
    driver.node.close()


def test_a_mesh_that_parts_cannot_follow_is_told_of_once(caplog: pytest.LogCaptureFixture) -> None:
    asset = mesh_asset(URCHIN)
    spiky = body(geometry=Mesh(sha256=asset.header.frame_id), mass_kg=1.0)
    pair = world_of(spiky, spiky.model_copy(update={"name": "other", "position_m": (2, 0, 0.2)}))
    driver = Driver().load(pair)
    driver.send_asset(asset)
    driver.wait(0.1)
    (told,) = [one for one in caplog.messages if "convex parts" in one]
    assert told.startswith("body 'thing': shape 'shape' collides as 32 convex parts")
    assert told.endswith("(and 1 more)")
    caplog.clear()
    shape = spiky.shapes[0].model_copy(update={"material": ""})
    for revision, y_m in ((1, 1.0), (2, -1.0)):
        spawned = BodyEntity(
            name="spawned", position_m=(1.0, y_m, 0.2), mass_kg=1.0, shapes=(shape,)
        )
        wanted = Entities(world_hash=pair.hash, revision=revision, entities=(spawned,))
        driver.deliver(DESIRED_ENTITIES, wanted)
        driver.wait(0.1)
        assert [one.name for one in driver.last(ENTITIES).entities] == ["spawned"]
    (told,) = [one for one in caplog.messages if "convex parts" in one]
    assert told.startswith("body 'spawned': ")
    driver.node.close()


def test_an_asset_that_is_no_mesh_is_not_taken_in() -> None:
    driver = Driver()
    good = mesh_asset(MESHES[CUBE_SHA])
    data = good.data.tobytes()[:-50]
    cut = msg.CompressedImage(
        header=msg.header(0, hashlib.sha256(data).hexdigest()),
        format="npz",
        data=np.frombuffer(data, np.uint8),
    )
    driver.send_asset(cut)
    driver.send_asset(msg.CompressedImage(header=good.header, format="obj", data=good.data))
    driver.send_asset(msg.CompressedImage(header=good.header, format="png", data=good.data))
    driver.turn()
    assert driver.inbox.counts[ASSETS.name].rejected == {
        "not a mesh": 1,
        "neither png nor npz": 1,
        "not a PNG of at most 2048 x 2048": 1,
    }


def heap(count: int) -> tuple[Body, ...]:
    return tuple(
        body(f"b{n}", mass_kg=1.0, position_m=(1.0 + 0.001 * n, 0.0, 0.2)) for n in range(count)
    )


def shaped(geometry: Any, **changes: Any) -> Body:
    """A body with a shape that no document would let through."""
    shape = Shape.model_construct(name="shape", geometry=geometry, material="plain", solid=True)
    return body(shapes=()).model_copy(update={"shapes": (shape,), **changes})


@pytest.mark.parametrize(
    ("bodies", "words"),
    [
        ((body("a"), body("a")), "'a' is not unique"),
        ((body(position_m=(1e4, 0, 0)),), "position_m: .* must be within 1000 m"),
        ((body().model_copy(update={"position_m": (math.nan, 0, 0)}),), "position_m"),
        ((body(orientation_xyzw=(0, 0, 0, 0)),), "orientation_xyzw: .* must be of unit length"),
        ((body(geometry=Box(size_m=(1, 1, 1e-3))),), r"size_m\[2\]: 0.001: must be 0.002 to"),
        ((body(geometry=Sphere(radius_m=0.003), mass_kg=1.0),), "radius_m: 0.003: must be 0.005"),
        ((body(geometry=Sphere(radius_m=5e3)),), "radius_m: 5000.0: must be 0.002 to 1000 m"),
        ((shaped(Sphere.model_construct(radius_m=-1.0)),), "radius_m: -1.0: must be"),
        ((shaped(Sphere.model_construct(radius_m=math.nan)),), "radius_m: nan: must be"),
        ((body(mass_kg=1e-6),), "mass_kg: 1e-06: must be 0, or 0.001 to 1e"),
        ((body(mass_kg=1.0).model_copy(update={"mass_kg": math.nan}),), "mass_kg: nan"),
        ((body("base_link", mass_kg=1.0),), "name: is a frame of the robot"),
        ((body(geometry=Plane(size_m=(1, 1)), mass_kg=1.0),), "plane: must not be solid"),
        ((body(geometry=Mesh(sha256="e" * 64)),), "mesh eeeeeeeeeeee is missing"),
        ((body(geometry=Mesh(sha256=CUBE_SHA, scale=(1, 0, 1))),), "scale: .* must be nonzero"),
        ((body(geometry=Mesh(sha256=CUBE_SHA, scale=(1, 1e5, 1))),), "extend beyond 1000 m"),
        ((body(geometry=Mesh(sha256="0" * 64)),), "has no triangles"),
        (
            (body(geometry=Mesh(sha256="f" * 64), mass_kg=1.0),),
            "'thing': shapes: is flat or empty: it must have a volume",
        ),
        ((body(geometry=Polyline(polygons_m=(BEND[:2],), height_m=1.0)),), "has no triangles"),
        ((body(mass_kg=1.0, shapes=(Shape(name="a", geometry=KINDS["box"], solid=False),)),),
         "mass_kg: 1.0: must be 0: none of its shapes is solid"),
        (heap(12), "'b0': position_m: overlaps 11 others that move: at most 10"),
        (tuple(body(f"b{n}", mass_kg=1.0, position_m=(n, 0, 1)) for n in range(401)),
         "bodies: 401 that move: at most 400"),
    ],
)  # fmt: skip
def test_what_cannot_be_simulated_is_refused_in_one_line(
    bodies: tuple[Body, ...], words: str
) -> None:
    flat = triangles_of(Plane(size_m=(1.0, 1.0)), {})
    meshes = {**MESHES, "0" * 64: joined(()), "f" * 64: flat}
    of = world_of().model_copy(update={"bodies": bodies})
    with pytest.raises(ValueError, match=words) as caught:
        Bodies(of, MODEL, 1.0, meshes)
    assert "\n" not in str(caught.value)


def test_a_body_may_not_have_the_name_of_a_wall() -> None:
    of = world_of(body("W"), walls=[("W", 1.0, 3.0, 0.0, 0.0)])
    with pytest.raises(ValueError, match="bodies: 'W' is not unique"):
        check(of, {})


def test_ten_in_one_place_are_pushed_apart(closing: list[Any]) -> None:
    bodies = made(*heap(11))
    closing.append(bodies)
    for _ in range(240):
        bodies.step()
    assert all(state.is_sane() for state in bodies.mover_states)
    places = bodies.map_from_movers()[:, :3, 3]
    apart = np.linalg.norm(places[:, None] - places, axis=2) + 9.0 * np.eye(len(places))
    assert apart.min() > 0.3
