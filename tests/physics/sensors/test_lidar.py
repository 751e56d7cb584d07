"""The scan agrees with geometry worked out by hand."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    SCAN_FRAME,
    SE2,
    Array,
    inverse_matrix,
    pose_matrix,
    quaternion_from_rotation,
    rotation_from_rpy,
    transform_matrix,
)
from mazebot.common.messages.documents import (
    Body,
    BodyEntity,
    Cylinder,
    Entities,
    ScriptedPath,
    Shape,
    World,
)
from mazebot.common.messages.topics import DESIRED_ENTITIES, SCAN
from mazebot.common.node.node import random_generator
from mazebot.physics.bodies.bodies import Bodies
from mazebot.physics.bodies.robot_model import robot_model_from_urdf
from mazebot.physics.config import PhysicsConfig
from mazebot.physics.sensors.lidar import Lidar, lidar_figures
from mazebot.worldgen.recipe.loader import load_world
from tests.physics.driver import HOUSE_WALLS, Driver, hit_distances_m, world

MODEL = robot_model_from_urdf(PhysicsConfig().robot_urdf())
FOOTPRINT_FROM_SCAN = MODEL.transform(BASE_FOOTPRINT_FRAME, SCAN_FRAME)


def boxes_by_geometry(
    map_from_boxes: Array, half_extents_m: Array, origin: Array, ways: Array
) -> Array:
    """(r,) distance along each ray to the nearest of (b,) boxes, by the slab method; inf: none.

    A box around the origin is not met.
    """
    box_from_map = map_from_boxes[:, :3, :3].transpose(0, 2, 1)
    start = np.einsum("bij,bj->bi", box_from_map, origin - map_from_boxes[:, :3, 3])
    along = np.einsum("bij,rj->bri", box_from_map, ways)
    with np.errstate(divide="ignore", invalid="ignore"):
        low = (-half_extents_m - start)[:, None] / along
        high = (half_extents_m - start)[:, None] / along
    enter = np.nan_to_num(np.minimum(low, high), nan=-np.inf).max(axis=2)
    leave = np.nan_to_num(np.maximum(low, high), nan=np.inf).min(axis=2)
    met = np.where((enter <= leave) & (enter >= 0.0), enter, np.inf)
    return np.asarray(met.min(axis=0, initial=np.inf))


def cylinders_by_geometry(
    map_from_cylinders: Array, radii_m: Array, lengths_m: Array, origin: Array, ways: Array
) -> Array:
    """(r,) the same for (c,) cylinders: the nearest point of their round sides and their ends."""
    cylinder_from_map = map_from_cylinders[:, :3, :3].transpose(0, 2, 1)
    start = np.einsum("cij,cj->ci", cylinder_from_map, origin - map_from_cylinders[:, :3, 3])
    along = np.einsum("cij,rj->cri", cylinder_from_map, ways)
    x, y, z = (start[:, [axis]] for axis in range(3))
    ux, uy, uz = along[..., 0], along[..., 1], along[..., 2]
    radius, half = radii_m[:, None], lengths_m[:, None] / 2.0
    around = (np.hypot(x, y) <= radius) & (np.abs(z) <= half)
    nearest = np.full(uz.shape, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b, c = ux * ux + uy * uy, ux * x + uy * y, x * x + y * y - radius * radius
        root = np.sqrt(b * b - a * c)
        for side in ((-b - root) / a, (-b + root) / a):
            met = (side >= 0.0) & (np.abs(z + side * uz) <= half)
            nearest = np.where(met, np.minimum(nearest, side), nearest)
        for end in ((-half - z) / uz, (half - z) / uz):
            met = (end >= 0.0) & (np.hypot(x + end * ux, y + end * uy) <= radius)
            nearest = np.where(met, np.minimum(nearest, end), nearest)
    return np.asarray(np.where(around, np.inf, nearest).min(axis=0, initial=np.inf))


class Geometry:
    """A world's walls and cylinders, worked out from its document."""

    def __init__(self, of: World) -> None:
        walls = [wall.map_from_wall().matrix(wall.height_m / 2.0) for wall in of.walls]
        sizes = [(wall.length_m, wall.thickness_m, wall.height_m) for wall in of.walls]
        self._map_from_walls = np.array(walls).reshape(-1, 4, 4)
        self._half_extents_m = np.array(sizes).reshape(-1, 3) / 2.0
        shapes = [(thing, shape) for thing in of.bodies for shape in thing.shapes]
        poses = [pose_matrix(thing) @ pose_matrix(shape) for thing, shape in shapes]
        self._map_from_cylinders = np.array(poses).reshape(-1, 4, 4)
        cylinders = [cast("Cylinder", shape.geometry) for _, shape in shapes]
        self._radii_m = np.array([cylinder.radius_m for cylinder in cylinders])
        self._lengths_m = np.array([cylinder.length_m for cylinder in cylinders])

    def ranges_m(self, map_from_scan: Array, angles_rad: Array) -> Array:
        """(r,) distance along each ray of a scan to the nearest of them; inf: none."""
        flat = np.stack([np.cos(angles_rad), np.sin(angles_rad), 0.0 * angles_rad], axis=1)
        origin, ways = map_from_scan[:3, 3], flat @ map_from_scan[:3, :3].T
        return np.minimum(
            boxes_by_geometry(self._map_from_walls, self._half_extents_m, origin, ways),
            cylinders_by_geometry(
                self._map_from_cylinders, self._radii_m, self._lengths_m, origin, ways
            ),
        )


class Standing:
    """What a lidar asks of bodies, with a robot that stands where a test puts it."""

    def __init__(self, of: World) -> None:
        bodies = Bodies(of, MODEL, wheel_torque_n_m=1.0)
        self.solid_groups = bodies.solid_groups
        self._map_from_groups = bodies.map_from_groups()
        bodies.close()
        self.map_from_base = np.eye(4)

    def map_from_groups(self) -> Array:
        return self._map_from_groups

    def map_from_footprint(self) -> Array:
        return self.map_from_base


def lidar_on(bodies: Standing, profile: str = "lds01", **config: object) -> Lidar:
    settings = PhysicsConfig.model_validate({"scan_profile": profile, **config})
    return Lidar(
        cast("Bodies", bodies),
        FOOTPRINT_FROM_SCAN,
        lidar_figures(settings),
        random_generator(1, ""),
    )


def random_pose(random: np.random.Generator, within_m: Array, tilt_rad: float) -> Array:
    """Of a robot on the floor or, with a tilt, above it: (4, 4) in an area (2, 2) of the map."""
    roll, pitch = random.uniform(-tilt_rad, tilt_rad, 2)
    x, y = random.uniform(within_m[0], within_m[1])
    z = random.uniform(0.0, tilt_rad)
    turn = rotation_from_rpy(roll, pitch, random.uniform(-math.pi, math.pi))
    return transform_matrix(turn, (x, y, z))


def house(name: str) -> World:
    return load_world(name).world


def columns() -> World:
    """Twelve walls and twenty cylinders that stand, lie and lean; five of them could move."""
    random = np.random.default_rng(5)
    bodies = []
    for number in range(20):
        roll, pitch = random.uniform(-math.pi, math.pi, 2) * (number % 3) / 2.0
        x, y = random.uniform(-3.0, 3.0, 2)
        size = Cylinder(
            radius_m=float(random.uniform(0.03, 0.4)), length_m=float(random.uniform(0.05, 2.0))
        )
        bodies.append(
            Body(
                name=f"Cylinder_{number}",
                mass_kg=1.0 if number < 5 else 0.0,
                position_m=(float(x), float(y), float(random.uniform(0.0, 0.4))),
                orientation_xyzw=quaternion_from_rotation(rotation_from_rpy(roll, pitch, 0.0)),
                shapes=(Shape(name="shape", geometry=size, material="plain"),),
            )
        )
    draft = world().model_copy(update={"bodies": tuple(bodies)})
    return draft.model_copy(update={"hash": draft.content_hash()})


def check_against_geometry(of: World, poses: int, rays: int, profile: str = "lds01") -> None:
    """Half of the poses are level, half are tilted; of each scan so many rays are looked at."""
    random = np.random.default_rng(11)
    bodies, geometry = Standing(of), Geometry(of)
    lidar = lidar_on(bodies, profile, scan_noise_m=0.0, scan_noise_share=0.0, scan_resolution_m=0.0)
    figures = lidar_figures(PhysicsConfig.model_validate({"scan_profile": profile}))
    corners = np.array([(wall.x_m, wall.y_m) for wall in of.walls])
    area = np.stack([corners.min(axis=0), corners.max(axis=0)])
    echoes = 0
    for number in range(poses):
        bodies.map_from_base = random_pose(random, area, 0.3 * (number % 2))
        chosen = random.choice(figures.samples, rays, replace=False)
        angles = chosen * 2.0 * math.pi / figures.samples
        expected = geometry.ranges_m(bodies.map_from_base @ FOOTPRINT_FROM_SCAN, angles)
        expected[expected < figures.range_min_m] = -np.inf
        expected[expected > figures.range_max_m] = np.inf
        found = np.asarray(lidar.read(0).ranges, np.float64)[chosen]
        with np.errstate(invalid="ignore"):
            agree = (found == expected) | (np.abs(found - expected) < 1e-3)
        assert agree.all(), (bodies.map_from_base, chosen[~agree], found[~agree], expected[~agree])
        echoes += int(np.isfinite(found).sum())
    assert echoes > poses * rays / 4


WORLDS = {
    "original": lambda: house("sim_house"),
    "enhanced": lambda: house("sim_house_enhanced"),
    "columns": columns,
}


@pytest.mark.parametrize("name", WORLDS)
def test_scans_agree_with_geometry_to_a_millimetre(name: str) -> None:
    check_against_geometry(WORLDS[name](), poses=400, rays=24)


@pytest.mark.slow
@pytest.mark.parametrize("poses", [2_500, pytest.param(10_000, marks=pytest.mark.longest)])
@pytest.mark.parametrize("profile", ["lds01", "gazebo"])
@pytest.mark.parametrize("name", WORLDS)
def test_thousands_of_scans_agree_with_geometry(name: str, profile: str, poses: int) -> None:
    check_against_geometry(WORLDS[name](), poses, 60, profile)


def test_what_is_met_does_not_depend_on_the_order_of_the_solids() -> None:
    random = np.random.default_rng(3)
    bodies = Standing(columns())
    still, *moving = bodies.solid_groups
    others = Standing(columns())
    others.solid_groups = (tuple(still[i] for i in random.permutation(len(still))), *moving)
    for _ in range(50):
        bodies.map_from_base = random_pose(random, np.array([[-3, -3], [3, 3]]), 0.2)
        others.map_from_base = bodies.map_from_base
        first, second = lidar_on(bodies).read(0).ranges, lidar_on(others).read(0).ranges
        assert first.tobytes() == second.tobytes()


def _scan(of: World, **config: object) -> tuple[NDArray[np.float64], SE2]:
    robot = Driver(**config).load(of)
    robot.wait(0.1)
    pose = robot.pose
    robot.node.close()
    return np.asarray(robot.last(SCAN).ranges, np.float64), pose


def test_first_ray_looks_ahead_and_the_next_ones_turn_left() -> None:
    of = world(walls=[("Ahead", 0.6, 1.0, 0.0, math.pi / 2), ("Left", 0.6, 0.0, 2.0, 0.0)])
    ranges, _ = _scan(of, scan_noise_m=0.0)
    assert ranges[0] == pytest.approx(1.0 - 0.075 + 0.064, abs=2e-3)
    assert ranges[90] == pytest.approx(2.0 - 0.075, abs=2e-3)
    assert np.isposinf(ranges[[180, 270]]).all()


def test_message_says_what_it_holds() -> None:
    robot = Driver().load(world())
    robot.wait(0.3)
    scans = robot.all(SCAN)
    scan = scans[0]
    assert len(scans) == 3
    assert scan.header.frame_id == "base_scan"
    assert scan.angle_min == 0.0
    assert scan.angle_increment == pytest.approx(2.0 * math.pi / 360)
    assert scan.angle_max == pytest.approx(359 * 2.0 * math.pi / 360)
    assert (scan.range_min, scan.range_max) == pytest.approx((0.12, 3.5))
    assert scan.ranges.dtype == np.float32
    assert scan.scan_time == pytest.approx(0.1)


def _noise(profile: str, away_m: float, scans: int = 40) -> NDArray[np.float64]:
    """Of the rays that meet a round wall, all at one distance."""
    column = Cylinder(radius_m=0.5, length_m=2.0)
    turns = np.arange(64) * 2.0 * math.pi / 64
    posts = tuple(
        Body(
            name=f"Post_{index}",
            position_m=(
                float((away_m + 0.5) * np.cos(turn)),
                float((away_m + 0.5) * np.sin(turn)),
                0.0,
            ),
            shapes=(Shape(name="shape", geometry=column, material="plain"),),
        )
        for index, turn in enumerate(turns)
    )
    draft = world(walls=()).model_copy(update={"bodies": posts})
    bodies = Standing(draft.model_copy(update={"hash": draft.content_hash()}))
    bodies.map_from_base = inverse_matrix(FOOTPRINT_FROM_SCAN)
    # Rounded, it would be off by a half of the resolution itself.
    plain = {"scan_noise_m": 0.0, "scan_noise_share": 0.0, "scan_resolution_m": 0.0}
    exact = lidar_on(bodies, profile, **plain).read(0).ranges
    straight = np.abs(exact - away_m) < 0.02 * away_m
    lidar = lidar_on(bodies, profile)
    scans_m = np.array([lidar.read(0).ranges for _ in range(scans)], np.float64)
    return np.asarray(scans_m[:, straight] - exact[straight], np.float64)


@pytest.mark.parametrize(
    ("profile", "away_m", "sigma_m"),
    [
        ("lds01", 0.5, 0.01),
        ("lds01", 3.0, 0.01),
        ("lds02", 0.25, 0.01 / 3.0),
        ("lds02", 3.0, 0.03),
        ("lds02", 5.5, 0.055),
        ("gazebo", 10.0, 0.01),
    ],
)
def test_noise_has_the_sigma_of_the_profile(profile: str, away_m: float, sigma_m: float) -> None:
    noise = _noise(profile, away_m)
    assert noise.size > 1_000
    assert noise.std() == pytest.approx(sigma_m, rel=0.07)
    assert abs(noise.mean()) < 4.0 * sigma_m / math.sqrt(noise.size)


def test_ranges_are_whole_multiples_of_the_resolution() -> None:
    ranges, _ = _scan(world(), scan_resolution_m=0.02)
    found = ranges[np.isfinite(ranges)] / 0.02
    assert len(found) > 100
    assert found == pytest.approx(np.round(found), abs=1e-4)


def test_too_near_is_minus_infinity() -> None:
    of = world(walls=[("Ahead", 0.6, 1.0, 0.0, math.pi / 2)])
    ranges, _ = _scan(of, scan_range_min_m=1.0, scan_noise_m=0.0)
    assert np.isneginf(ranges[0])


@pytest.mark.parametrize("profile", ["lds01", "lds02", "gazebo"])
def test_every_range_is_within_the_limits_or_infinite(profile: str) -> None:
    """At the limits too, with much noise; and never a number that is none."""
    random = np.random.default_rng(4)
    bodies = Standing(columns())
    lidar = lidar_on(bodies, profile, scan_noise_m=0.5, scan_noise_share=0.2)
    figures = lidar_figures(PhysicsConfig.model_validate({"scan_profile": profile}))
    kinds: set[str] = set()
    for _ in range(100):
        bodies.map_from_base = random_pose(random, np.array([[-3, -3], [3, 3]]), 0.5)
        scan = lidar.read(0)
        finite = scan.ranges[np.isfinite(scan.ranges)]
        assert not np.isnan(scan.ranges).any()
        assert (finite >= scan.range_min).all()
        assert (finite <= scan.range_max).all()
        kinds.add("echo" if len(finite) else "")
        kinds.add("none" if np.isposinf(scan.ranges).any() else "")
        kinds.add("near" if np.isneginf(scan.ranges).any() else "")
    assert kinds >= ({"echo", "none"} if figures.range_min_m < 0.01 else {"echo", "none", "near"})


def test_noise_is_only_on_echoes_and_does_not_depend_on_them() -> None:
    nothing, wall = world(walls=()), world(walls=[("Ahead", 0.6, 1.0, 0.0, math.pi / 2)])
    two = world(walls=[("Ahead", 0.6, 1.0, 0.0, math.pi / 2), ("Behind", 0.6, -2.0, 0.0, 1.57)])
    empty, _ = _scan(nothing)
    assert np.isposinf(empty).all()
    (one, _), (both, _) = _scan(wall), _scan(two)
    seen = np.isfinite(one)
    assert (one[seen] == both[seen]).all()


def test_does_not_see_the_robot_itself() -> None:
    ranges, _ = _scan(world(walls=()))
    assert np.isposinf(ranges).all()


def test_rays_go_through_the_robot_and_end_at_walls() -> None:
    bodies = Bodies(world([("W", 2.0, 1.0, 0.0, math.pi / 2)]), MODEL, wheel_torque_n_m=1.0)
    starts = np.array([[-1.0, 0.0, 0.06], [-1.0, 0.144, 0.033], [-1.0, 0.0, 2.0]])
    found = hit_distances_m(bodies, starts, starts + np.array([4.0, 0.0, 0.0]))
    assert found == pytest.approx([1.925, 1.925, math.inf])
    bodies.close()


def test_another_seed_draws_other_noise() -> None:
    first, _ = _scan(world(HOUSE_WALLS), seed=1)
    second, _ = _scan(world(HOUSE_WALLS), seed=2)
    same, _ = _scan(world(HOUSE_WALLS), seed=1)
    assert (first == same).all()
    assert (first != second).any()


def test_sees_what_is_spawned_moved_and_removed_in_the_next_scan() -> None:
    of = world(walls=[("Ahead", 0.6, 2.0, 0.0, math.pi / 2)])
    robot = Driver(scan_noise_m=0.0, scan_resolution_m=0.0).load(of)
    shape = Shape(name="all", geometry=Cylinder(radius_m=0.1, length_m=1.0), material="")

    def ahead_m(revision: int, *places: tuple[float, float], mass_kg: float = 0.0) -> float:
        entities = tuple(
            BodyEntity(
                name=f"post_{index}", position_m=(x, y, 0.5), shapes=(shape,), mass_kg=mass_kg
            )
            for index, (x, y) in enumerate(places)
        )
        wanted = Entities(world_hash=of.hash, revision=revision, entities=entities)
        robot.deliver(DESIRED_ENTITIES, wanted)
        robot.wait(0.1)
        return float(robot.last(SCAN).ranges[0])

    wall_m = 2.0 - 0.075 + 0.064
    assert ahead_m(1) == pytest.approx(wall_m, abs=1e-3)
    assert ahead_m(2, (1.0, 0.0)) == pytest.approx(1.0 - 0.1 + 0.064, abs=1e-3)
    assert ahead_m(3, (1.5, 0.0)) == pytest.approx(1.5 - 0.1 + 0.064, abs=1e-3)
    assert ahead_m(4, (1.5, 1.0), (1.2, 0.0)) == pytest.approx(1.2 - 0.1 + 0.064, abs=1e-3)
    assert ahead_m(5, (1.5, 1.0)) == pytest.approx(wall_m, abs=1e-3)
    assert ahead_m(6, (0.8, 0.0), mass_kg=5.0) == pytest.approx(0.8 - 0.1 + 0.064, abs=1e-3)
    assert ahead_m(7) == pytest.approx(wall_m, abs=1e-3)
    robot.node.close()


def test_sees_what_moves_along_its_path_where_it_is() -> None:
    robot = Driver(scan_noise_m=0.0, scan_resolution_m=0.0).load(world(walls=()))
    simulation = robot.node._simulation
    assert simulation is not None
    shape = Shape(name="all", geometry=Cylinder(radius_m=0.1, length_m=1.0), material="")
    path = ScriptedPath(waypoints_m=((1.0, -1.0),), speed_m_s=0.5)
    patrol = BodyEntity(name="patrol", position_m=(1.0, 1.0, 0.51), shapes=(shape,), path=path)
    wanted = Entities(world_hash=robot.node.world_hash, revision=1, entities=(patrol,))
    robot.deliver(DESIRED_ENTITIES, wanted)
    seen = set()
    for _ in range(20):
        robot.sent.clear()
        while not robot.all(SCAN):
            robot.turn()
        ranges = np.asarray(robot.last(SCAN).ranges, np.float64)
        ray = int(np.argmin(ranges))
        (pose,) = simulation.bodies.map_from_movers()
        away = pose[:2, 3] - (simulation.bodies.map_from_footprint() @ FOOTPRINT_FROM_SCAN)[:2, 3]
        assert ranges[ray] == pytest.approx(np.hypot(*away) - 0.1, abs=2e-3)
        bearing = math.degrees(math.atan2(away[1], away[0]))
        assert abs((ray - bearing + 180.0) % 360.0 - 180.0) <= 1.0
        seen.add(ray)
    assert len(seen) > 10
    robot.node.close()


def test_lost_rays_are_a_share_at_random_and_look_like_no_echo() -> None:
    def ranges(**config: object) -> NDArray[np.float64]:
        bodies = Bodies(columns(), MODEL, 1.0)
        try:
            lidar = lidar_on(cast("Any", bodies), **cast("Any", config))
            return np.stack([lidar.read(number).ranges for number in range(20)])
        finally:
            bodies.close()

    whole, thinned = ranges(), ranges(scan_dropout=0.3)
    lost = np.isfinite(whole) & np.isposinf(thinned)
    assert lost.sum() / np.isfinite(whole).sum() == pytest.approx(0.3, abs=0.03)
    assert not (lost[0] & lost[1]).all()
    assert np.isposinf(ranges(scan_dropout=1.0)).all()
    kept = np.isfinite(thinned[0])
    assert np.array_equal(thinned[0][kept], whole[0][kept])
