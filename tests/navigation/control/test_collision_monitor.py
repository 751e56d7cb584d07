from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from mazebot.common.config import one_line
from mazebot.common.maths.frames import SE2, Array
from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.safety.collision_monitor import (
    NOTHING_MOVES,
    Action,
    CollisionMonitor,
    CollisionMonitorParams,
    PolygonParams,
    SourcePoints,
    VelocityPolygonParams,
    Watched,
    moved_points,
    moving_in_base,
)
from mazebot.navigation.control.track import Track
from mazebot.navigation.costmap.footprint import WAFFLE, signed_distance_m

PERIOD_NS = 50_000_000
RAYS = np.linspace(0.0, math.tau, 360, endpoint=False)
AHEAD = Velocity(0.46, 0.0)


@dataclass
class Unicycle:
    """A differential drive that follows commands within a waffle's accelerations."""

    map_from_base: SE2
    velocity: Velocity = STOP

    def drive(self, command: Velocity, seconds: float) -> None:
        """Advance while one command holds."""
        dt = seconds / 10
        for _ in range(10):
            v, w = self.velocity
            v = min(max(command.linear_m_s, v - 1.0 * dt), v + 1.0 * dt)
            w = min(max(command.angular_rad_s, w - 2.0 * dt), w + 2.0 * dt)
            self.velocity = Velocity(v, w)
            half = w * dt / 2.0
            step = SE2(v * dt * math.cos(half), v * dt * math.sin(half), w * dt)
            self.map_from_base = self.map_from_base @ step


def box(x_m: float, y_m: float, side_m: float = 0.2) -> Array:
    """Points on the outline of a box, 4 mm apart, as a lidar sees what is near."""
    along = np.linspace(-side_m / 2, side_m / 2, 51)
    edge = np.full_like(along, side_m / 2)
    sides = [(along, edge), (along, -edge), (edge, along), (-edge, along)]
    return np.concatenate([np.stack([x_m + a, y_m + b], axis=1) for a, b in sides])


def monitor(**polygons: PolygonParams) -> CollisionMonitor:
    """By default with the polygon that there is."""
    if not polygons:
        return CollisionMonitor(CollisionMonitorParams())
    return CollisionMonitor(CollisionMonitorParams(polygons=polygons))


def watched(
    watcher: CollisionMonitor, command: Velocity, points_m: Array, velocity: Velocity = STOP
) -> Watched:
    return watcher.step(0, command, velocity, {"scan": SourcePoints(0, points_m)})


def drive(
    watcher: CollisionMonitor,
    robot: Unicycle,
    command: Velocity,
    map_points_m: Array,
    seconds: float,
) -> float:
    """Drive with a scan each 0.1 s, by commands that the monitor lets through; the least distance
    of the footprint from the points.
    """
    least_m = math.inf
    pose = robot.map_from_base
    for i in range(int(seconds * 20)):
        if i % 2 == 0:
            seen_from, stamp_ns = robot.map_from_base, i * PERIOD_NS
            seen = moved_points(map_points_m, SE2(0.0, 0.0, 0.0), seen_from)
        here = moved_points(seen, seen_from, robot.map_from_base)
        now = watcher.step(
            i * PERIOD_NS, command, robot.velocity, {"scan": SourcePoints(stamp_ns, here)}
        )
        robot.drive(now.velocity, 0.05)
        pose = robot.map_from_base
        true_m = moved_points(map_points_m, SE2(0.0, 0.0, 0.0), pose)
        least_m = min(least_m, *(signed_distance_m(WAFFLE.points_m, x, y) for x, y in true_m))
    return least_m


def test_what_is_far_away_changes_nothing() -> None:
    now = watched(monitor(), AHEAD, box(1.5, 0.0), AHEAD)
    assert now.velocity == AHEAD
    assert now.state.action is Action.DO_NOTHING
    # Beside the way, 5 cm from the wheels.
    assert watched(monitor(), AHEAD, box(0.4, 0.31), AHEAD).velocity == AHEAD


def test_the_braking_distance_is_kept_and_no_more() -> None:
    robot = Unicycle(SE2(0.0, 0.0, 0.0))
    least_m = drive(monitor(), robot, AHEAD, box(1.5, 0.0), 6.0)
    assert 0.0 < least_m < 0.03
    assert robot.velocity == STOP


@pytest.mark.parametrize(
    "command", [Velocity(0.4, 0.6), Velocity(-0.3, 0.0), Velocity(0.2, -1.5), Velocity(-0.2, 1.0)]
)
def test_it_touches_nothing_on_any_arc(command: Velocity) -> None:
    random = np.random.default_rng(8)
    for _ in range(6):
        distance_m, angle = random.uniform(0.45, 0.8), random.uniform(-math.pi, math.pi)
        thing = box(distance_m * math.cos(angle), distance_m * math.sin(angle))
        robot = Unicycle(SE2(0.0, 0.0, 0.0))
        assert drive(monitor(), robot, command, thing, 5.0) > 0.0


def test_a_turn_on_the_spot_stops_before_its_corner_touches() -> None:
    # Beside the robot, where its rear corner comes by.
    thing = box(-0.1, -0.3)
    robot = Unicycle(SE2(0.0, 0.0, 0.0))
    least_m = drive(monitor(), robot, Velocity(0.0, 1.5), thing, 3.0)
    assert 0.0 < least_m < 0.03
    assert robot.map_from_base.yaw_rad < 1.5
    free = Unicycle(SE2(0.0, 0.0, 0.0))
    drive(monitor(), free, Velocity(0.0, 1.5), box(-0.1, -0.36), 1.0)
    assert free.map_from_base.yaw_rad > 0.9


def stands_when_it_comes_by(predicts: bool) -> bool:
    """Whether the robot is standing when a post that crosses its way, and stops for nobody, touches
    it or is gone.
    """
    watcher, robot = monitor(), Unicycle(SE2(0.0, 0.0, 0.0), AHEAD)
    angles = np.linspace(0.0, math.tau, 40, endpoint=False)
    ring = 0.1 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for i in range(60):
        post = Track(1, 0.75, -0.75 + 0.5 * 0.05 * i, 0.0, 0.5, 0.1)
        points_m = ring + np.array([post.x_m, post.y_m])
        seen = moved_points(points_m, SE2(0.0, 0.0, 0.0), robot.map_from_base)
        moving = moving_in_base([post], robot.map_from_base) if predicts else NOTHING_MOVES
        touches = min(signed_distance_m(WAFFLE.points_m, x, y) for x, y in seen) <= 0.0
        if touches:
            return robot.velocity.linear_m_s < 0.02
        scan = {"scan": SourcePoints(i * PERIOD_NS, seen)}
        now = watcher.step(i * PERIOD_NS, AHEAD, robot.velocity, scan, moving)
        robot.drive(now.velocity, 0.05)
    return True


def test_what_is_known_to_cross_the_way_finds_the_robot_standing() -> None:
    assert stands_when_it_comes_by(predicts=True)
    assert not stands_when_it_comes_by(predicts=False)


def test_it_does_not_hold_a_robot_that_gets_out_of_the_way_by_going_on() -> None:
    # From behind and aside it comes to where the robot would stand, but no more is.
    post = Track(1, -0.25, 0.5, 0.0, -0.5, 0.1)
    ring = moved_points(box(0.0, 0.0, 0.15), SE2(post.x_m, post.y_m, 0.0), SE2(0.0, 0.0, 0.0))
    scan, moving = {"scan": SourcePoints(0, ring)}, moving_in_base([post], SE2(0.0, 0.0, 0.0))
    assert monitor().step(0, AHEAD, AHEAD, scan, moving).velocity == AHEAD


def test_it_does_not_hold_a_robot_that_is_met_where_it_stands() -> None:
    # Both of its ways are as bad; it may leave, and not drive into what comes.
    post = Track(1, 0.0, 0.33, 0.0, -0.5, 0.1)
    ring = moved_points(box(0.0, 0.0, 0.15), SE2(post.x_m, post.y_m, 0.0), SE2(0.0, 0.0, 0.0))
    scan, moving = {"scan": SourcePoints(0, ring)}, moving_in_base([post], SE2(0.0, 0.0, 0.0))
    assert monitor().step(0, AHEAD, STOP, scan, moving).velocity == AHEAD
    ahead = Track(1, 0.35, 0.0, -0.5, 0.0, 0.1)
    ring = moved_points(box(0.0, 0.0, 0.15), SE2(ahead.x_m, ahead.y_m, 0.0), SE2(0.0, 0.0, 0.0))
    scan, moving = {"scan": SourcePoints(0, ring)}, moving_in_base([ahead], SE2(0.0, 0.0, 0.0))
    assert monitor().step(0, AHEAD, AHEAD, scan, moving).velocity == STOP


def test_what_was_seen_a_while_ago_has_moved_since() -> None:
    thing = np.array([[0.5 + 0.01 * i, 0.0] for i in range(8)])
    moving = moving_in_base([Track(1, 1.5, 0.5, -0.9, 0.0, 0.1)], SE2(1.0, 0.5, 0.0))
    zone = PolygonParams(type="circle", radius=0.3, action_type="stop")
    for age_ns, stops in ((0, False), (400_000_000, True)):
        scan = {"scan": SourcePoints(1_000_000_000 - age_ns, thing)}
        now = monitor(zone=zone).step(1_000_000_000, AHEAD, STOP, scan, moving)
        assert (now.velocity == STOP) is stops


def test_tracks_are_seen_from_the_robot() -> None:
    moving = moving_in_base([Track(1, 2.0, 1.0, 0.0, -0.5, 0.2)], SE2(1.0, 1.0, math.pi / 2))
    assert moving == pytest.approx(np.array([[0.0, -1.0, 0.2, -0.5, 0.0]]))


def test_a_robot_at_a_wall_can_leave_it() -> None:
    touching = np.stack([np.full(41, 0.0665), np.linspace(-0.2, 0.2, 41)], axis=1)
    watcher = monitor()
    assert watched(watcher, Velocity(0.1, 0.0), touching).velocity == STOP
    assert watched(watcher, Velocity(-0.1, 0.0), touching).velocity == Velocity(-0.1, 0.0)
    robot = Unicycle(SE2(0.0, 0.0, 0.0))
    drive(watcher, robot, Velocity(-0.2, 0.0), touching, 2.0)
    assert robot.map_from_base.x_m < -0.2


def test_it_does_not_creep_into_what_it_touches() -> None:
    touching = np.stack([np.full(41, 0.072), np.linspace(-0.2, 0.2, 41)], axis=1)
    robot = Unicycle(SE2(0.0, 0.0, 0.0))
    drive(monitor(), robot, Velocity(0.02, 0.0), touching, 20.0)
    assert robot.map_from_base.x_m < 0.003


def test_a_stop_zone_stops_and_says_where_and_why() -> None:
    zone = PolygonParams(type="circle", radius=0.4, action_type="stop")
    now = watched(monitor(Stop=zone), AHEAD, box(0.4, 0.0))
    assert now.velocity == STOP
    assert now.state.action is Action.STOP
    assert (now.state.polygon_name, now.state.source) == ("Stop", "scan")
    assert now.state.place_m == pytest.approx((0.3, 0.0))
    assert "scan" in now.state.reason
    assert "(0.30, 0.00)" in now.state.reason
    assert watched(monitor(Stop=zone), AHEAD, box(0.6, 0.0)).velocity == AHEAD


def test_a_stop_zone_does_not_hold_a_robot_that_moves_away() -> None:
    zone = PolygonParams(type="circle", radius=0.4, action_type="stop")
    behind = box(-0.4, 0.0)
    now = watched(monitor(Stop=zone), AHEAD, behind)
    assert now.velocity == pytest.approx((0.15, 0.0))
    assert now.state.action is Action.LIMIT
    assert watched(monitor(Stop=zone), Velocity(-0.1, 0.0), behind).velocity == STOP
    robot = Unicycle(SE2(0.0, 0.0, 0.0))
    drive(monitor(Stop=zone), robot, AHEAD, behind, 4.0)
    assert robot.map_from_base.x_m > 0.5


def test_slowdown_limit_and_approach_scale_the_whole_command() -> None:
    command = Velocity(0.4, 0.8)
    near = box(0.5, 0.0)
    circle: dict[str, Any] = {"type": "circle", "radius": 0.5}
    slow = PolygonParams(**circle, action_type="slowdown", slowdown_ratio=0.25)
    now = watched(monitor(zone=slow), command, near)
    assert now.velocity == pytest.approx((0.1, 0.2))
    assert now.state.action is Action.SLOWDOWN
    limit = PolygonParams(**circle, action_type="limit", linear_limit=0.3, angular_limit=0.2)
    now = watched(monitor(zone=limit), command, near)
    assert now.velocity == pytest.approx((0.1, 0.2))
    assert now.state.action is Action.LIMIT
    approach = PolygonParams(action_type="approach", min_points=1, time_before_collision=2.0)
    # Its front, with the margin of 1 cm, is 0.3215 m away: 1.61 s at 0.2 m/s.
    now = watched(monitor(zone=approach), Velocity(0.2, 0.0), box(0.5, 0.0))
    assert now.velocity.linear_m_s == pytest.approx(0.2 * 0.3215 / 0.2 / 2.0, abs=1e-6)
    assert now.state.action is Action.APPROACH


def test_the_most_restrictive_zone_wins() -> None:
    slow = PolygonParams(type="circle", radius=0.8, action_type="slowdown")
    stop = PolygonParams(type="circle", radius=0.4, action_type="stop")
    zones = {"slow": slow, "stop": stop}
    for order in (("slow", "stop"), ("stop", "slow")):
        both = {name: zones[name] for name in order}
        now = watched(monitor(**both), AHEAD, box(0.4, 0.0))
        assert now.state.polygon_name == "stop"
        now = watched(monitor(**both), AHEAD, box(0.7, 0.0))
        assert now.state.polygon_name == "slow"


def test_few_points_are_noise() -> None:
    zone = PolygonParams(type="circle", radius=0.4, action_type="stop")
    assert watched(monitor(zone=zone), AHEAD, np.full((3, 2), 0.2)).velocity == AHEAD
    assert watched(monitor(zone=zone), AHEAD, np.full((4, 2), 0.2)).velocity == STOP
    ahead = np.array([[0.2, y] for y in (-0.01, 0.0, 0.01)])
    assert watched(monitor(), AHEAD, ahead).velocity == AHEAD


def test_points_must_come_and_go_for_several_steps() -> None:
    zone = PolygonParams(
        type="circle", radius=0.4, action_type="stop",
        trigger_consecutive_points=2, release_consecutive_points=3,
    )  # fmt: skip
    watcher = monitor(zone=zone)
    near, far = np.full((4, 2), 0.2), np.empty((0, 2))
    seen = [near, far, near, near, far, far, near, far, far, far]
    moving = [watched(watcher, AHEAD, points).velocity != STOP for points in seen]
    assert moving == [True, True, True, False, False, False, False, False, False, True]


def test_a_velocity_polygon_depends_on_the_command() -> None:
    square = ((0.5, 0.3), (-0.3, 0.3), (-0.3, -0.3), (0.5, -0.3))
    forward = VelocityPolygonParams(
        points=square, linear_min=0.0, linear_max=1.0, theta_min=-2.0, theta_max=2.0
    )
    zone = PolygonParams(
        type="velocity_polygon", velocity_polygons={"forward": forward}, action_type="stop"
    )
    assert watched(monitor(zone=zone), AHEAD, box(0.5, 0.0)).velocity == STOP
    assert watched(monitor(zone=zone), Velocity(-0.2, 0.0), box(-0.3, 0.0)).velocity != STOP


def test_a_source_that_is_missing_or_too_old_stops_until_it_is_back() -> None:
    watcher = monitor()
    clear = np.empty((0, 2))
    assert watcher.step(0, AHEAD, STOP, {}).velocity == STOP
    fresh = watcher.step(500_000_000, AHEAD, STOP, {"scan": SourcePoints(0, clear)})
    assert fresh.velocity == AHEAD
    stale = watcher.step(600_000_000, AHEAD, AHEAD, {"scan": SourcePoints(0, clear)})
    assert stale.velocity == STOP
    assert (stale.state.polygon_name, stale.state.source) == ("invalid source", "scan")
    assert "0.60 s" in stale.state.reason
    back = watcher.step(650_000_000, AHEAD, STOP, {"scan": SourcePoints(640_000_000, clear)})
    assert back.velocity == AHEAD


def test_zero_is_repeated_for_a_while_and_then_no_more() -> None:
    watcher = CollisionMonitor(CollisionMonitorParams(stop_pub_timeout=1.0))
    scan = {"scan": SourcePoints(0, np.empty((0, 2)))}
    shown = [watcher.step(i * 500_000_000, STOP, STOP, scan).publish for i in range(4)]
    assert shown == [True, True, True, False]


def test_a_command_that_is_no_number_stops() -> None:
    now = watched(monitor(), Velocity(math.nan, 0.0), np.empty((0, 2)))
    assert now.velocity == STOP
    assert "number" in now.state.reason


def test_switched_off_it_changes_nothing() -> None:
    watcher = CollisionMonitor(CollisionMonitorParams(enabled=False))
    assert watched(watcher, AHEAD, box(0.2, 0.0), AHEAD).velocity == AHEAD
    watcher.enabled = True
    assert watched(watcher, AHEAD, box(0.2, 0.0), AHEAD).velocity == STOP


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"type": "circle"}, "radius"),
        ({"type": "velocity_polygon"}, "velocity_polygons"),
        ({"min_points": 0}, "min_points"),
        ({"slowdown_ratio": 1.5}, "slowdown_ratio"),
        ({"time_before_collision": -1.0}, "time_before_collision"),
        ({"points": ((0.1, 0.1), (0.2, 0.1))}, "points"),
        ({"action_type": "approach", "points": ((0.3, 0.3), (0.3, -0.3), (0.0, -0.3))}, "points"),
    ],
)
def test_a_polygon_that_is_none_is_refused_by_its_field(wrong: dict[str, Any], field: str) -> None:
    with pytest.raises(ValidationError) as caught:
        PolygonParams(**{"action_type": "stop", **wrong})
    assert one_line(caught.value).removeprefix("(whole): ").startswith(field)
