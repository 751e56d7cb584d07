"""What kills, hangs, poisons or bloats PyBullet does not get there, whatever the documents hold."""

from __future__ import annotations

import hashlib
import math
import time
import zlib
from typing import Any

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from mazebot.bench.memory import resident_mb
from mazebot.common.files import png
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    BodyEntity,
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Entities,
    Entity,
    Geometry,
    Mesh,
    Plane,
    Polyline,
    ScriptedPath,
    Shape,
    SimulationControl,
    SimulationControlReply,
    SimulationStats,
    Sphere,
)
from mazebot.common.messages.topics import (
    ASSETS,
    CMD_VEL,
    ENTITIES,
    GROUND_TRUTH_ODOM,
    SIMULATION_CONTROL,
    SIMULATION_STATS,
    WORLD,
)
from mazebot.common.world.geometry import TriangleMesh, mesh_to_bytes, triangles_of
from mazebot.physics.assets import Assets
from mazebot.physics.bodies.bullet import pybullet
from mazebot.physics.bodies.robot_model import ModelError, robot_model_from_urdf
from mazebot.physics.camera.camera import Intrinsics
from mazebot.physics.camera.renderers import RendererKind, make_renderer
from mazebot.physics.camera.scene import build_scene
from mazebot.physics.config import PhysicsConfig
from tests.physics.driver import asset, panel, texture, world
from tests.physics.own_process import figures
from tests.physics.stage import (
    CRATE,
    OPEN,
    PANEL_TEXTURE,
    RED,
    Stage,
    crate,
    names,
    path,
    reasons,
)

NOT_FINITE = (math.nan, math.inf, -math.inf)
MAX_S = 5.0
"""Longer is a hang."""
TEXTURES_INTRINSICS = Intrinsics.from_horizontal_fov(32, 24, 1.0)


def unchecked(entity: BodyEntity, **changes: Any) -> BodyEntity:
    """As no schema would let it through."""
    return entity.model_copy(update=changes)


def of_shape(geometry: Any, **changes: Any) -> BodyEntity:
    shape = Shape.model_construct(
        name="all", geometry=geometry, position_m=(0.0, 0.0, 0.0),
        orientation_xyzw=(0.0, 0.0, 0.0, 1.0), material="paint", solid=True,
    )  # fmt: skip
    return unchecked(crate(), shapes=(shape,), **changes)


def is_finite(stage: Stage) -> bool:
    bodies = stage.bodies
    return all(np.isfinite(np.concatenate([np.ravel(part) for part in state])).all()
               for state in (bodies.state, *bodies.mover_states))  # fmt: skip


HOSTILE: list[tuple[str, BodyEntity]] = [
    *((f"position {bad}", unchecked(crate(), position_m=(1.0, bad, 0.0))) for bad in NOT_FINITE),
    *(
        (f"orientation {bad}", unchecked(crate(), orientation_xyzw=(0.0, 0.0, bad, 1.0)))
        for bad in NOT_FINITE
    ),
    ("zero quaternion", unchecked(crate(), orientation_xyzw=(0.0, 0.0, 0.0, 0.0))),
    *((f"mass {bad}", unchecked(crate(), mass_kg=bad)) for bad in (*NOT_FINITE, -1.0, 1e-300)),
    *(
        (f"{kind} {bad}", of_shape(geometry))
        for bad in (*NOT_FINITE, 0.0, -0.1, 1e-300, 1e300)
        for kind, geometry in {
            "box": Box.model_construct(size_m=(0.1, bad, 0.1)),
            "sphere": Sphere.model_construct(radius_m=bad),
            "cylinder": Cylinder.model_construct(radius_m=0.1, length_m=bad),
            "capsule": Capsule.model_construct(radius_m=bad, length_m=0.1),
            "cone": Cone.model_construct(radius_m=bad, length_m=0.1),
            "ellipsoid": Ellipsoid.model_construct(radii_m=(0.1, 0.1, bad)),
            "plane": Plane.model_construct(size_m=(0.1, bad)),
            "polyline": Polyline.model_construct(
                polygons_m=(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)),), height_m=bad
            ),
            "scale": Mesh.model_construct(sha256="e" * 64, scale=(1.0, bad, 1.0)),
        }.items()
    ),
    *(
        (
            f"corner {bad}",
            of_shape(
                Polyline.model_construct(
                    polygons_m=(((0.0, 0.0), (bad, 0.0), (1.0, 1.0)),), height_m=1.0
                )
            ),
        )
        for bad in (*NOT_FINITE, 1e300)
    ),
    *(
        (
            f"shape {bad}",
            unchecked(crate(), shapes=(crate().shapes[0].model_copy(
                update={"position_m": (bad, 0.0, 0.0)}),)),
        )
        for bad in (*NOT_FINITE, 1e300)
    ),
    *(
        (
            f"waypoint {bad}",
            unchecked(crate(), path=ScriptedPath.model_construct(
                waypoints_m=((bad, 0.0),), speed_m_s=1.0, loop=False, yields=True)),
        )
        for bad in (*NOT_FINITE, 1e300)
    ),
    *(
        (f"speed {bad}", unchecked(crate(), path=path((2.0, 0.0)).model_copy(
            update={"speed_m_s": bad})))
        for bad in (*NOT_FINITE, 0.0, -1.0, 1e6)
    ),
]  # fmt: skip


def test_nothing_that_is_not_physical_enters(stage: Stage) -> None:
    good = crate("good", 2.0)
    bad = [unchecked(entity, name=name) for name, entity in HOSTILE]
    told = stage.desire(*bad, good)
    assert told.entities == (good,)
    assert [refusal.name for refusal in told.refused] == [name for name, _ in HOSTILE]
    assert not any("\n" in refusal.reason for refusal in told.refused)
    assert list(stage.bodies.entities) == ["good"]
    assert len(stage.bodies._names) == len(OPEN.walls) + 2
    stage.drive(0.3, 0.0, 0.5)
    assert is_finite(stage)
    assert stage.node._epoch == 1


def test_the_schema_refuses_what_is_not_finite() -> None:
    good = crate(path=path((2.0, 0.0))).model_dump_json()
    for old in ('"position_m":[1.0', '"mass_kg":0.0', '"speed_m_s":0.4', '"size_m":[0.3'):
        assert old in good
        for bad in ("NaN", "Infinity", "1e999"):
            with pytest.raises(ValidationError):
                BodyEntity.model_validate_json(
                    good.replace(old, old.rstrip("0123456789.") + bad, 1)
                )


def _mesh_file(**changes: Any) -> bytes:
    cube = triangles_of(CRATE, {})
    arrays = {"vertices_m": cube.vertices_m, "normals": cube.normals, "uvs": cube.uvs,
              "triangles": cube.triangles}  # fmt: skip
    return mesh_to_bytes(TriangleMesh(**{**arrays, **changes}))


def test_meshes_that_are_damaged_do_not_become_assets(stage: Stage) -> None:
    cube = triangles_of(CRATE, {})
    far = cube.triangles.copy()
    far[0, 0] = 10_000
    below = cube.triangles.copy()
    below[0, 0] = -1
    good = _mesh_file()
    files = [_mesh_file(vertices_m=cube.vertices_m * bad) for bad in NOT_FINITE]
    files += [_mesh_file(triangles=far), _mesh_file(triangles=below)]
    files += [b"", b"garbage", good[:-40], good[: len(good) // 2]]
    for data in files:
        message = asset(data)
        message.format = "npz"
        stage.deliver(ASSETS, message)
        sha256 = message.header.frame_id
        told = stage.desire(crate("rock", geometry=Mesh(sha256=sha256)))
        assert "is missing" in reasons(told)["rock"]
    assert stage.inbox.counts[ASSETS.name].rejected == {"not a mesh": len(files)}


def test_pictures_that_are_damaged_or_huge_do_not_become_assets(stage: Stage) -> None:
    good = texture(7).data.tobytes()
    side = png.MAX_SIDE_PX + 1
    wide = cv2.imencode(".png", np.zeros((1, side, 3), np.uint8))[1].tobytes()
    # A header that tells of a picture of 4 Gpx in a file of few bytes.
    header = b"IHDR" + (65_536).to_bytes(4, "big") * 2 + b"\x08\x02\x00\x00\x00"
    bomb = good[:8] + (13).to_bytes(4, "big") + header
    bomb += zlib.crc32(header).to_bytes(4, "big") + good[33:]
    files = [b"", b"garbage", good[:20], good[:-20], good[:60] + b"\0" + good[61:], wide, bomb]
    start = time.process_time()
    for data in files:
        stage.deliver(ASSETS, asset(data))
        look = RED.model_copy(update={"texture_sha256": hashlib.sha256(data).hexdigest()})
        told = stage.desire(crate(materials=(look,)))
        assert "no such asset" in reasons(told)["crate"]
    assert sum(stage.inbox.counts[ASSETS.name].rejected.values()) == len(files)
    assert time.process_time() - start < MAX_S


def test_a_mesh_where_a_picture_should_be_is_a_plain_colour() -> None:
    stage = Stage(renderer="auto", camera_width_px=32, camera_height_px=24)
    stage.load(OPEN)
    message = asset(_mesh_file())
    message.format = "npz"
    stage.deliver(ASSETS, message)
    look = RED.model_copy(update={"texture_sha256": message.header.frame_id})
    told = stage.desire(crate(materials=(look,)))
    assert names(told) == ["crate"] or "pixels" in reasons(told)["crate"]
    stage.wait(0.2)
    stage.node.close()


def test_only_so_many_assets_are_kept_and_those_in_use_stay(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("mazebot.physics.assets.MAX_ASSETS", 4)
    assets = Assets()
    files = [texture(shade) for shade in range(1, 9)]
    used = [files[0].header.frame_id, files[2].header.frame_id]
    for file in files:
        assert assets.add(file, lambda: used) == ""
        assert len(assets.files) <= 4
    assert list(assets.files) == [*used, files[6].header.frame_id, files[7].header.frame_id]
    everything = [file.header.frame_id for file in files]
    assert assets.add(texture(100), lambda: everything) == "too many assets"
    monkeypatch.setattr("mazebot.physics.assets.MAX_BYTES", 10)
    assert assets.add(texture(101)) == "too many assets"


def heap(count: int) -> list[BodyEntity]:
    cube = Box(size_m=(0.2, 0.2, 0.2))
    return [crate(f"b{n}", 2.0, 0.0, 0.15, cube, mass_kg=1.0) for n in range(count)]


def test_a_hundred_in_one_place_are_one(stage: Stage) -> None:
    start = time.process_time()
    told = stage.desire(*heap(100))
    assert names(told) == ["b0"]
    stage.wait(1.0)
    assert time.process_time() - start < MAX_S
    assert is_finite(stage)


def test_a_world_with_a_hundred_in_one_place_is_refused(stage: Stage) -> None:
    from tests.physics.bodies.test_bodies import heap as heap_of_world
    from tests.physics.bodies.test_bodies import world_of

    bad = world_of(*heap_of_world(100))
    stage.load(bad)
    assert stage.node.world_hash == OPEN.hash
    assert stage.inbox.counts[WORLD.name].rejected == {"cannot be built": 1}


def test_a_pile_of_many_falls_in_time(stage: Stage) -> None:
    cube = Box(size_m=(0.2, 0.2, 0.2))
    things = [
        crate(f"b{n}", 2.0 + 0.21 * (n % 5), 0.21 * (n // 5 % 5), 0.1 + 0.21 * (n // 25), cube,
              mass_kg=1.0)
        for n in range(100)
    ]  # fmt: skip
    start = time.process_time()
    assert len(stage.desire(*things).entities) == 100
    stage.wait(0.2)
    assert time.process_time() - start < MAX_S
    assert is_finite(stage)


@pytest.mark.parametrize(
    "geometry",
    [
        Ellipsoid(radii_m=(900.0, 900.0, 800.0)),
        Ellipsoid(radii_m=(0.4, 0.3, 0.2)),
        Polyline(
            polygons_m=(tuple((math.cos(0.1 * n), math.sin(0.1 * n)) for n in range(50)),),
            height_m=1.0,
        ),
    ],
    ids=["huge", "hulls", "prisms"],
)
def test_a_body_of_many_costly_shapes_is_refused_or_made_in_time(
    geometry: Geometry, stage: Stage
) -> None:
    shapes = tuple(Shape(name=str(n), geometry=geometry, material="paint") for n in range(50))
    start = time.process_time()
    stage.desire(crate(z_m=950.0, shapes=shapes, mass_kg=1.0))
    stage.turn()
    assert time.process_time() - start < MAX_S
    assert is_finite(stage)


def test_a_huge_mesh_is_refused(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    ball = asset(mesh_to_bytes(triangles_of(Sphere(radius_m=100.0), {})))
    ball.format = "npz"
    stage.deliver(ASSETS, ball)
    mesh = Mesh(sha256=ball.header.frame_id, scale=(0.002, 0.002, 0.002))
    shapes = tuple(Shape(name=str(n), geometry=mesh, material="paint") for n in range(40))
    # The same mesh forty times is forty meshes to PyBullet.
    assert "triangles in all bodies: at most 500000" in reasons(
        stage.desire(crate(shapes=shapes))
    )["crate"]  # fmt: skip
    monkeypatch.setattr("mazebot.common.world.geometry.MAX_TRIANGLES", 1000)
    other = asset(mesh_to_bytes(triangles_of(Sphere(radius_m=99.0), {})))
    other.format = "npz"
    stage.deliver(ASSETS, other)
    stage.turn()
    assert other.header.frame_id not in stage.node._assets.files


@pytest.mark.parametrize("size", [(-5, 10), (10, -5), (0, 10), (20_000, 20_000), (4097, 16)])
def test_no_picture_of_a_size_that_kills_can_be_asked_for(size: tuple[int, int]) -> None:
    with pytest.raises(ValidationError):
        PhysicsConfig(camera_width_px=size[0], camera_height_px=size[1])
    with pytest.raises(ValueError, match="must be 1 to 4096 pixels"):
        Intrinsics(*size, fx=1.0, fy=1.0, cx=0.0, cy=0.0)


@pytest.mark.parametrize("samples", [0, -1, 10_001, 20_000, 10**9])
def test_no_more_rays_than_a_scan_may_have_can_be_asked_for(samples: int) -> None:
    with pytest.raises(ValidationError):
        PhysicsConfig(scan_samples=samples)


def test_ten_thousand_rays_are_cast() -> None:
    stage = Stage(scan_samples=10_000)
    stage.load(OPEN)
    stage.desire(crate())
    assert stage.ahead_m() == pytest.approx(0.914, abs=2e-3)
    stage.node.close()


@pytest.mark.parametrize(
    "urdf",
    [
        "",
        "garbage",
        "<robot/>",
        "<robot><link name='a'/><joint name='j' type='fixed'><parent link='a'/><child link='a'/>"
        "</joint></robot>",
    ],
)
def test_a_robot_that_is_none_is_refused_in_one_line(urdf: str) -> None:
    with pytest.raises(ModelError) as caught:
        robot_model_from_urdf(urdf).body("base_link")
    assert "\n" not in str(caught.value)


def test_unknown_names_reach_nothing(stage: Stage) -> None:
    stage.desire(crate())
    # To be rid of what is not there, and of all that is, in any order.
    assert names(stage.desire(crate("other", 3.0))) == ["other"]
    assert names(stage.desire()) == []
    assert stage.bodies.entities == {}
    assert len(stage.bodies._names) == len(OPEN.walls) + 1


def _poison_robot(stage: Stage) -> None:
    robot, client = stage.bodies._robot.number, stage.bodies._client
    pybullet.resetBaseVelocity(robot, [math.nan, 0, 0], physicsClientId=client)


def _poison_wheel(stage: Stage) -> None:
    stage.bodies._robot.turn_wheels_to((0.0, 0.0), (math.nan, 0.0))


def _poison_mover(stage: Stage) -> None:
    bodies = stage.bodies
    (number,) = bodies._entities["ball"].numbers
    pybullet.resetBasePositionAndOrientation(
        number, [0, 0, math.inf], [0, 0, 0, 1], physicsClientId=bodies._client
    )


def _poison_scripted(stage: Stage) -> None:
    bodies = stage.bodies
    (number,) = bodies._entities["guard"].numbers
    pybullet.resetBaseVelocity(number, [math.nan, 0, 0], physicsClientId=bodies._client)


def _poison_wall(stage: Stage) -> None:
    bodies = stage.bodies
    (number,) = (number for number, name in bodies._names.items() if name == "Wall")
    pybullet.resetBasePositionAndOrientation(
        number, [math.nan] * 3, [0, 0, 0, 1], physicsClientId=bodies._client
    )


THINGS = (
    crate(x_m=2.0),
    crate("ball", 1.0, 1.0, 0.5, Sphere(radius_m=0.1), mass_kg=1.0),
    crate("guard", 3.0, 0.0, path=path((3.0, 1.0))),
)


@pytest.mark.parametrize("poison", [_poison_robot, _poison_wheel])
def test_a_thing_whose_move_was_refused_stands_again_in_a_world_built_anew(
    poison: Any, stage: Stage
) -> None:
    stage.desire(crate(x_m=2.0))
    # Into the wall.
    told = stage.desire(crate(x_m=1.0, y_m=-2.0))
    assert "crate" in reasons(told)
    poison(stage)
    stage.turn()
    assert list(stage.bodies.entities) == ["crate"]
    assert stage.bodies.entities["crate"].position_m[0] == 2.0
    assert stage.ahead_m() == pytest.approx(1.914, abs=0.01)


@pytest.mark.parametrize("poison", [_poison_robot, _poison_wheel, _poison_mover])
def test_a_poisoned_world_is_built_anew_within_a_step(
    poison: Any, stage: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    stage.desire(*THINGS)
    stage.drive(0.4, 0.3, 1.0)
    now_ns, told = stage.now_ns, len(stage.all(SIMULATION_STATS))
    poison(stage)
    start = time.process_time()
    stage.turn()
    assert time.process_time() - start < 2.0
    assert is_finite(stage)
    stats = stage.all(SIMULATION_STATS)[told]
    assert (stats.epoch, stats.entities) == (2, 3)
    assert stats.sim_time_s == pytest.approx(stage.now_ns * 1e-9)
    assert stage.now_ns > now_ns
    (line,) = [record.message for record in caplog.records if record.levelname == "ERROR"]
    assert "rebuilt world" in line
    assert list(stage.bodies.entities) == [entity.name for entity in THINGS]
    assert math.hypot(*stage.bodies.map_from_footprint()[:2, 3]) < 1e-3
    ball = stage.bodies.mover_states[0]
    assert ball.position_m == pytest.approx((1.0, 1.0, 0.5), abs=1e-3)
    assert stage.last(ENTITIES).entities == THINGS
    # It goes on: things fall, the guard walks and the robot drives.
    stage.drive(0.3, 0.0, 1.0)
    assert stage.last(GROUND_TRUTH_ODOM).pose.pose.position.x > 0.2
    assert stage.bodies.mover_states[0].position_m[2] == pytest.approx(0.1, abs=0.01)
    assert stage.bodies.mover_states[1].position_m[1] > 0.3
    assert stage.node._epoch == 2


@pytest.mark.parametrize("poison", [_poison_scripted, _poison_wall])
def test_poison_in_what_is_not_moved_by_pybullet_does_not_spread(poison: Any, stage: Stage) -> None:
    stage.desire(*THINGS)
    stage.wait(0.5)
    poison(stage)
    stage.drive(0.3, 0.0, 2.0)
    assert is_finite(stage)
    assert stage.last(GROUND_TRUTH_ODOM).pose.pose.position.x > 0.4
    assert stage.bodies.mover_states[0].position_m[2] == pytest.approx(0.1, abs=0.01)


def test_the_same_run_again_is_poisoned_and_built_anew_alike() -> None:
    hashes = []
    for _ in range(2):
        stage = Stage()
        stage.load(OPEN)
        stage.desire(*THINGS)
        stage.drive(0.4, 0.3, 0.5)
        _poison_robot(stage)
        stage.drive(0.4, 0.3, 0.5)
        hashes.append(stage.last(SIMULATION_STATS).state_hash)
        stage.node.close()
    assert hashes[0] == hashes[1]


def textures_mb(kind: RendererKind) -> tuple[float, float]:
    """Memory of this process after eight textures, and after each was shown three times more."""
    renderer = make_renderer(kind, TEXTURES_INTRINSICS)
    assert renderer is not None
    random = np.random.default_rng(3)
    pictures = []
    for _ in range(8):
        noise = random.integers(0, 255, (256, 256, 3), np.uint8)
        pictures.append(cv2.imencode(".png", noise)[1].tobytes())
    shown = world()
    resident = []
    for _ in range(4):
        for data in pictures:
            sha256 = hashlib.sha256(data).hexdigest()
            renderer.set_scene(build_scene(shown, {sha256: data}, [panel("a", sha256)]))
            renderer.render(np.eye(4))
        resident.append(resident_mb())
    renderer.close()
    return resident[0], resident[-1]


@pytest.mark.parametrize("kind", ["cpu", "gl", "tiny"])
def test_textures_that_come_and_go_take_no_memory(kind: RendererKind) -> None:
    try:
        renderer = make_renderer(kind, TEXTURES_INTRINSICS)
    except ValueError as error:
        pytest.skip(str(error))
    assert renderer is not None
    renderer.close()
    before_mb, after_mb = figures(__name__, f"textures_mb({kind!r})", timeout_s=120)
    # PyBullet alone would keep 0.4 MB of each, and there were 24.
    assert after_mb - before_mb < 5.0


class Fuzz:
    """Sets of entities, commands and controls of every kind, as a seed has them."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        rock = asset(_mesh_file())
        rock.format = "npz"
        self.rock = rock
        self.stage = Stage()
        self.stage.load(OPEN)
        self.stage.deliver(ASSETS, rock)
        self.stage.send_asset(PANEL_TEXTURE)
        self.stage.turn()
        self.wanted: dict[str, Entity] = {}
        self.requests = 0

    def number(self, usual: float) -> float:
        """Mostly about as large as usual, sometimes anything."""
        kind = self.random.integers(0, 40)
        if kind == 0:
            return float(self.random.choice([*NOT_FINITE, 0.0, -0.0, 5e-324, 1e308, -1e308]))
        if kind == 1:
            return float(10.0 ** self.random.uniform(-12, 12) * self.random.choice([-1, 1]))
        return float(usual * self.random.uniform(0.2, 2.0))

    def place(self, reach_m: float) -> tuple[float, float]:
        x, y = self.random.uniform(-reach_m, reach_m, 2)
        return self.number(float(x)), self.number(float(y))

    def geometry(self) -> Geometry:
        size = (self.number(0.3), self.number(0.3), self.number(0.3))
        corners = tuple(self.place(0.5) for _ in range(self.random.integers(2, 7)))
        choices: list[Geometry] = [
            Box.model_construct(size_m=size),
            Sphere.model_construct(radius_m=size[0]),
            Cylinder.model_construct(radius_m=size[0], length_m=size[1]),
            Capsule.model_construct(radius_m=size[0], length_m=size[1]),
            Cone.model_construct(radius_m=size[0], length_m=size[1]),
            Ellipsoid.model_construct(radii_m=size),
            Plane.model_construct(size_m=size[:2]),
            Polyline.model_construct(polygons_m=(corners,), height_m=size[2]),
            Mesh.model_construct(sha256=self.rock.header.frame_id, name="", scale=size),
            Mesh.model_construct(sha256="0" * 64, name="", scale=size),
        ]
        return choices[self.random.integers(0, len(choices))]

    def turn(self) -> tuple[float, float, float, float]:
        x, y, z, w = map(float, self.random.normal(size=4))
        norm = math.hypot(x, y, z, w)
        spoilt = self.random.random() < 0.02
        return self.number(1.0) if spoilt else x / norm, y / norm, z / norm, w / norm

    def entity(self, name: str) -> Entity:
        if self.random.random() < 0.1:
            position = (self.number(0.5), -1.923, self.number(0.4))
            return panel(name, PANEL_TEXTURE.header.frame_id, position_m=position)
        shapes = tuple(
            Shape.model_construct(
                name=str(n), geometry=self.geometry(), position_m=(self.number(0.1), 0.0, 0.0),
                orientation_xyzw=self.turn(), material="paint",
                solid=bool(self.random.random() < 0.9),
            )
            for n in range(self.random.integers(1, 4))
        )  # fmt: skip
        way = None
        if self.random.random() < 0.25:
            places = tuple(self.place(3.0) for _ in range(self.random.integers(1, 4)))
            way = ScriptedPath.model_construct(
                waypoints_m=places, speed_m_s=self.number(1.0),
                loop=bool(self.random.integers(2)), yields=bool(self.random.integers(2)),
            )  # fmt: skip
        return crate(name).model_copy(
            update={
                "position_m": (*self.place(4.0), self.number(0.5)),
                "orientation_xyzw": self.turn(),
                "mass_kg": self.number(1.0) if self.random.random() < 0.5 else 0.0,
                "shapes": shapes,
                "path": way,
            }
        )

    def ask(self) -> None:
        """One more request: spawn, move or remove."""
        self.requests += 1
        name = f"thing{self.random.integers(0, 25)}"
        kind, there = self.random.random(), self.wanted.get(name)
        if there is not None and kind < 0.3:
            del self.wanted[name]
        elif there is not None and kind < 0.6:
            place = {"position_m": (*self.place(4.0), self.number(0.5))}
            self.wanted[name] = there.model_copy(update=place)
        else:
            self.wanted[name] = self.entity(name)

    def command(self) -> None:
        twist = msg.Twist(
            linear=msg.Vector3(self.number(0.4), self.number(0.1), 0.0),
            angular=msg.Vector3(0.0, 0.0, self.number(1.0) * self.random.choice([-1, 1])),
        )
        header = msg.header(self.stage.now_ns, "base_footprint")
        self.stage.deliver(CMD_VEL, msg.TwistStamped(header=header, twist=twist))

    def control(self) -> None:
        answers: list[SimulationControlReply] = []
        request = SimulationControl.model_construct(
            **SimulationControl(reset=self.random.choice(["all", "time"])).model_dump()
        )
        self.stage.inbox.ask(SIMULATION_CONTROL, request, answers.append)
        self.stage.turn()
        self.stage.now_ns = self.stage.node.now_ns

    def run(self, requests: int) -> SimulationStats:
        stage = self.stage
        stage.turn()
        while self.requests < requests:
            for _ in range(self.random.integers(1, 12)):
                self.ask()
            if self.random.random() < 0.02:
                self.control()
            start = time.process_time()
            told = stage.desire(*self.wanted.values())
            refused = {refusal.name for refusal in told.refused}
            stands = {entity.name: entity for entity in told.entities}
            assert refused | set(stands) == set(self.wanted)
            # As the spawner does: what was refused is taken back.
            for name in refused:
                if name in stands:
                    self.wanted[name] = stands[name]
                else:
                    del self.wanted[name]
            for _ in range(3):
                self.command()
                stage.turn()
                assert is_finite(stage)
            assert time.process_time() - start < MAX_S
            stage.sent = stage.sent[-200:]
        stats = stage.last(SIMULATION_STATS)
        stage.node.close()
        return stats


def test_whatever_is_asked_for_the_state_stays_finite() -> None:
    stats = [Fuzz(seed=11).run(200) for _ in range(2)]
    assert stats[0] == stats[1]
    assert stats[0].entities > 0


def fuzzed_mb(requests: int) -> tuple[float, float]:
    """Memory of this process after so many requests, and after as many others."""
    Fuzz(seed=12).run(requests)
    before_mb = resident_mb()
    Fuzz(seed=13).run(requests)
    return before_mb, resident_mb()


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("requests", [4_000, pytest.param(20_000, marks=pytest.mark.longest)])
def test_whatever_is_asked_for_the_state_stays_finite_for_long(requests: int) -> None:
    before_mb, after_mb = figures(__name__, f"fuzzed_mb({requests})", timeout_s=1800)
    assert after_mb - before_mb < 20.0


def test_a_set_of_another_revision_of_the_same_content_is_only_told(stage: Stage) -> None:
    told = stage.desire(*THINGS)
    assert stage.desire(*THINGS) == told.model_copy(update={"revision": told.revision + 1})
    assert isinstance(told, Entities)
