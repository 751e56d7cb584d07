"""The scan agrees with geometry worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from services.common.documents import World
from services.common.frames import SE2
from services.common.topics import SCAN
from services.physics.bodies import Bodies
from services.physics.config import PhysicsConfig
from services.physics.robot_model import robot_model_from_urdf
from tests.physics.driver import HOUSE_WALLS, Driver, hit_distances_m, world

SCAN_OFFSET = SE2(-0.064, 0.0, 0.0)


def ranges_by_geometry(of: World, map_from_scan: SE2, samples: int) -> NDArray[np.float64]:
    """Distance along each ray to the nearest wall's rectangle, by the slab method; inf: none."""
    angles = map_from_scan.yaw_rad + np.arange(samples) * 2.0 * math.pi / samples
    nearest = np.full(samples, np.inf)
    for wall in of.walls:
        wall_from_scan = wall.map_from_wall().inverse() @ map_from_scan
        local = angles - wall.yaw_rad
        enter, leave = np.full(samples, -np.inf), np.full(samples, np.inf)
        for start, along, half in (
            (wall_from_scan.x_m, np.cos(local), wall.length_m / 2.0),
            (wall_from_scan.y_m, np.sin(local), wall.thickness_m / 2.0),
        ):
            with np.errstate(divide="ignore"):
                a, b = (-half - start) / along, (half - start) / along
            enter = np.maximum(enter, np.minimum(a, b))
            leave = np.minimum(leave, np.maximum(a, b))
        hit = (enter <= leave) & (enter >= 0.0)
        nearest = np.where(hit, np.minimum(nearest, enter), nearest)
    return nearest


def _scan(of: World, **config: object) -> tuple[NDArray[np.float64], SE2]:
    robot = Driver(**config).load(of)
    robot.wait(0.1)
    pose = robot.pose
    robot.node.close()
    return np.asarray(robot.last(SCAN).ranges, np.float64), pose


def test_agrees_with_geometry_to_a_millimetre() -> None:
    """Bullet's ray cast ends a few rays in ten thousand early, by up to 2 mm."""
    random = np.random.default_rng(3)
    errors_m = []
    for _ in range(20):
        start = (random.uniform(-1.6, 1.0), random.uniform(-1.5, 1.5), random.uniform(-3.1, 3.1))
        of = world(start=start)
        expected = ranges_by_geometry(of, SE2(*start) @ SCAN_OFFSET, 360)
        if expected.min() < 0.25:
            continue
        ranges, pose = _scan(of, scan_noise_m=0.0)
        expected = ranges_by_geometry(of, pose @ SCAN_OFFSET, 360)
        hit = expected < 3.5
        # A ray that grazes an edge may meet it or not.
        bounded = np.minimum(expected, 10.0)
        edge = np.abs(np.roll(bounded, 1) - bounded) > 0.05
        edge |= np.roll(edge, -1) | (np.abs(bounded - 3.5) < 1e-3)
        clear = hit & ~edge
        errors_m.append(np.abs(ranges[clear] - expected[clear]))
        assert np.isposinf(ranges[~hit & ~edge]).all()
    error_m = np.concatenate(errors_m)
    assert len(error_m) > 2_500
    assert np.mean(error_m < 1e-3) > 0.999
    assert error_m.max() < 3e-3


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


def test_noise_has_the_sigma_of_the_data_sheet() -> None:
    exact, _ = _scan(world(), scan_noise_m=0.0)
    noisy, _ = _scan(world(), scan_noise_m=0.01)
    both = np.isfinite(exact) & np.isfinite(noisy)
    noise = noisy[both] - exact[both]
    assert noise.std() == pytest.approx(0.01, rel=0.2)
    assert abs(noise.mean()) < 0.003


def test_too_near_is_minus_infinity() -> None:
    of = world(walls=[("Ahead", 0.6, 1.0, 0.0, math.pi / 2)])
    ranges, _ = _scan(of, scan_range_min_m=1.0, scan_noise_m=0.0)
    assert np.isneginf(ranges[0])


def test_does_not_see_the_robot_itself() -> None:
    ranges, _ = _scan(world(walls=()))
    assert np.isposinf(ranges).all()


def test_rays_go_through_the_robot_and_end_at_walls() -> None:
    model = robot_model_from_urdf(PhysicsConfig().robot_urdf())
    bodies = Bodies(world([("W", 2.0, 1.0, 0.0, math.pi / 2)]), model, wheel_torque_n_m=1.0)
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
