"""Mapping on simulated drives: the pose, the map and its loops, and a robot that is carried off."""

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import ArrayLike

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.maths.odometry_history import NO_ODOMETRY
from mazebot.common.messages.documents import Planar
from mazebot.common.messages.scan import Scan
from mazebot.mapping.loops.carried_off import CarriedOff
from mazebot.mapping.matching.occupancy import MapGrid
from mazebot.mapping.params import SlamParams
from mazebot.mapping.slam import CARRIED_OFF, NO_RETURNS, NOT_LATER, Slam
from tests.mapping.simulated import (
    LDS,
    SCAN_NS,
    SICK,
    Lidar,
    Step,
    box,
    drifted,
    errors,
    feed,
    log,
    office,
    office_way,
    ring,
    ring_way,
    scan,
    wall,
    way,
)

PARAMS = SlamParams()
ROOM = np.concatenate([box(0.0, 0.0, 4.0, 3.0), wall(2.0, 0.0, 2.0, 1.2), wall(0.0, 2.0, 0.9, 2.0)])
TOUR = way([(0.7, 0.7), (1.4, 1.6), (3.2, 1.8), (3.3, 0.7), (3.2, 2.3), (1.4, 2.4), (0.7, 0.7)])


def slam_of(steps: list[Step], params: SlamParams = PARAMS, lidar: Lidar = LDS) -> Slam:
    slam = Slam(params, steps[0].true)
    for _ in feed(slam, steps, lidar):
        pass
    return slam


def test_the_pose_stays_within_millimetres_where_odometry_drifts() -> None:
    steps = log(ROOM, TOUR, slip=0.1, noise_m_per_sqrt_m=0.05)
    assert drifted(steps, TOUR[0]) > 0.3
    off = errors(Slam(PARAMS, TOUR[0]), steps)
    assert np.percentile(off[:, 0], 95) < 0.01
    assert np.percentile(off[:, 1], 95) < math.radians(0.4)


def test_without_scan_matching_the_pose_is_odometrys() -> None:
    steps = log(ROOM, TOUR, slip=0.1, noise_m_per_sqrt_m=0.05)
    slam = Slam(SlamParams(use_scan_matching=False, do_loop_closing=False), TOUR[0])
    off = errors(slam, steps)
    assert off[-1, 0] == pytest.approx(drifted(steps, TOUR[0]), abs=1e-6)


def test_a_loop_is_closed_and_bends_the_map_straight() -> None:
    poses = ring_way()
    steps = log(ring(), poses, slip=0.1, noise_m_per_sqrt_m=0.05)
    slam = slam_of(steps)
    assert slam.loops >= 1
    assert slam.loops_rejected == 0
    assert math.hypot(slam.pose()[0].x_m - poses[-1].x_m, slam.pose()[0].y_m - poses[-1].y_m) < 0.02
    true = {step.stamp_ns: step.true for step in steps}
    document = slam.document(0)
    off = [
        math.hypot(node.pose.x_m - true[node.stamp_ns].x_m, node.pose.y_m - true[node.stamp_ns].y_m)
        for node in document.nodes
    ]
    assert max(off) < 0.03


def test_loops_that_agree_are_closed_however_sure_of_itself_odometry_is_said_to_be() -> None:
    """Where the walls of each pass stand on the floor of the other, the loops are right."""
    poses = ring_way()
    steps = log(ring(), poses, slip=0.05, noise_m_per_sqrt_m=0.03)
    sure = PARAMS.model_copy(
        update={
            "use_scan_matching": False,
            "odometry_translation_ratio": 0.03,
            "odometry_translation_std_m_per_sqrt_m": 0.01,
            "odometry_rotation_ratio": 0.03,
            "odometry_rotation_std_rad_per_sqrt_m": 0.08,
        }
    )
    assert drifted(steps, poses[0]) > 2.0
    slam = slam_of(steps, sure)
    assert slam.loops >= 3
    true = {step.stamp_ns: step.true for step in steps}
    off = [node.pose.se2().distance_m(true[node.stamp_ns]) for node in slam.document(0).nodes]
    assert np.mean(off) < 0.5


def test_a_known_place_makes_neither_graph_nor_map_grow() -> None:
    room = [(0.7, 0.7), (1.4, 1.6), (3.2, 1.8), (3.2, 2.3), (1.4, 2.4)]
    poses = way(room * 4)
    once = len(way([*room, room[0]]))
    steps = log(ROOM, poses, slip=0.05)
    slam = Slam(PARAMS, poses[0])
    counts = [(slam.keyframes, slam.map_version) for _ in feed(slam, steps)]
    assert counts[-1] == counts[once]


def test_a_robot_at_rest_does_not_drift() -> None:
    still = [TOUR[0]] * 300
    slam = Slam(PARAMS, TOUR[0])
    off = errors(slam, log(ROOM, still))
    assert slam.keyframes == 1
    assert off[-50:, 0].mean() < 0.004
    assert abs(off[-50:, 0].mean() - off[50:100, 0].mean()) < 0.002


def test_a_corridor_leaves_its_direction_to_odometry() -> None:
    corridor = np.array([[-20.0, 0.0, 40.0, 0.0], [-20.0, 1.5, 40.0, 1.5]])
    poses = way([(0.0, 0.75), (6.0, 0.75)])
    steps = log(corridor, poses)
    slam = Slam(PARAMS, poses[0])
    off = errors(slam, steps)
    assert off[:, 0].max() < 0.01
    std_m = np.sqrt(np.diag(slam.pose()[1]))
    assert std_m[0] > 5.0 * std_m[1]


def test_a_corridor_with_slip_is_sure_only_across() -> None:
    corridor = np.array([[-20.0, 0.0, 40.0, 0.0], [-20.0, 1.5, 40.0, 1.5]])
    poses = way([(0.0, 0.75), (6.0, 0.75)])
    slam = slam_of(log(corridor, poses, slip=0.1))
    pose = slam.pose()[0]
    assert pose.x_m - poses[-1].x_m == pytest.approx(0.6, abs=0.05)
    assert abs(pose.y_m - poses[-1].y_m) < 0.01
    edges = slam.graph.edges
    along, across = edges.covariance[:, 0, 0], edges.covariance[:, 1, 1]
    assert along.sum() > 20.0 * across.sum()


@pytest.mark.parametrize("slip", [-0.04, 0.04])
def test_a_scale_of_odometry_that_rooms_have_shown_holds_in_the_corridor_behind(
    slip: float,
) -> None:
    posts = [box(x, y, x + 0.3, y + 0.3) for x in range(1, 14, 3) for y in (-2, 2)]
    corridor = np.array([[15.0, -1.0, 200.0, -1.0], [15.0, 1.0, 200.0, 1.0]])
    ends = np.array([[0.0, -4.0, 15.0, -4.0], [0.0, 4.0, 15.0, 4.0], [0.0, -4.0, 0.0, 4.0]])
    poses = way([(0.5, 0.0), (75.0, 0.0)], speed_m_s=5.0)
    steps = log(np.concatenate([*posts, corridor, ends]), poses, SICK, slip=slip)
    assert drifted(steps, poses[0]) == pytest.approx(0.04 * 74.5, abs=0.1)
    assert errors(Slam(PARAMS, poses[0]), steps, SICK)[-1, 0] < 1.3


@pytest.mark.parametrize(
    "values",
    [
        # slam_toolbox's defaults.
        {"loop_match_minimum_chain_size": 10},
        {"correlation_search_space_resolution": 0.01},
        {"max_laser_range": 80.0},
    ],
)
def test_common_values_of_slam_toolbox_match_scans_and_close_loops(
    values: dict[str, float],
) -> None:
    poses = office_way()[::4]
    steps = log(office(), poses, SICK, slip=0.05, noise_m_per_sqrt_m=0.05)
    slam = slam_of(steps, SlamParams(**values), SICK)
    assert slam.loops >= 1
    true = {step.stamp_ns: step.true for step in steps}
    nodes = slam.document(0).nodes
    off = [node.pose.se2().distance_m(true[node.stamp_ns]) for node in nodes]
    assert np.percentile(off, 95) < 0.3


def cells_m(grid: MapGrid, value: int) -> tuple[Array, Array]:
    """(n,) x and y in the map of the middles of the cells with a value."""
    rows, columns = np.nonzero(grid.cells == value)
    middles_m = (np.array([columns, rows], np.float64) + 0.5) * grid.resolution_m
    return grid.origin.x_m + middles_m[0], grid.origin.y_m + middles_m[1]


def assert_within_room(x: Array, y: Array) -> None:
    assert min(x.min(), y.min()) > -0.05
    assert x.max() < 4.05
    assert y.max() < 3.05


def test_the_walls_of_the_map_are_where_the_walls_are() -> None:
    slam = slam_of(log(ROOM, TOUR, slip=0.1, noise_m_per_sqrt_m=0.05))
    grid = slam.grid()
    x, y = cells_m(grid, 100)
    spread = np.linspace(0.0, 1.0, 400)[:, None]
    points = np.concatenate([w[:2] + spread * (w[2:] - w[:2]) for w in ROOM])
    far = [
        np.hypot(points[:, 0] - px, points[:, 1] - py).min() for px, py in zip(x, y, strict=True)
    ]
    assert max(far) < 0.08
    # Every face that can be seen has an occupied cell.
    seen = points[(points[:, 0] > 0.1) & (points[:, 0] < 3.9)]
    missed = [np.hypot(x - px, y - py).min() > 0.1 for px, py in seen]
    assert np.mean(missed) < 0.03
    x, y = cells_m(grid, 0)
    assert_within_room(x, y)


def test_the_same_measurements_give_the_same_bytes() -> None:
    steps = log(ROOM, TOUR, slip=0.1, noise_m_per_sqrt_m=0.05)
    one, other = slam_of(steps), slam_of(steps)
    assert one.document(1).model_dump_json() == other.document(1).model_dump_json()
    assert one.grid().cells.tobytes() == other.grid().cells.tobytes()
    assert one.map_from_odom() == other.map_from_odom()


def test_a_restored_graph_is_the_same_and_goes_on() -> None:
    steps = log(ROOM, TOUR, slip=0.05)
    half = len(steps) // 2
    slam = slam_of(steps[:half])
    document = slam.document(7)
    on = Slam.restored(PARAMS, document)
    assert on.document(7) == document
    assert on.grid().cells.tobytes() == slam.grid().cells.tobytes()
    off = errors(on, steps[half:])
    assert off[:, 0].max() < 0.02
    assert on.keyframes > slam.keyframes


def test_a_restored_graph_goes_on_where_the_scan_leaves_a_direction_open() -> None:
    corridor = np.array([[-20.0, 0.0, 40.0, 0.0], [-20.0, 1.5, 40.0, 1.5]])
    steps = log(corridor, way([(0.0, 0.75), (6.0, 0.75)]))
    half = len(steps) // 2
    slam = slam_of(steps[:half])
    on = Slam.restored(PARAMS, slam.document(7))
    # Away from the last keyframe, so that the first scan becomes one.
    off = errors(on, steps[half + 8 :])
    assert off[:, 0].max() < 0.2
    assert on.keyframes > slam.keyframes
    assert np.isfinite(on.pose()[1]).all()
    assert np.isfinite(on.graph.edges.covariance).all()


def test_a_fixed_map_stays_as_it_is() -> None:
    steps = log(ROOM, TOUR, slip=0.05)
    half = len(steps) // 2
    document = slam_of(steps[:half]).document(7)
    on = Slam.restored(PARAMS, document)
    on.fixed = True
    off = errors(on, steps[half:])
    assert off[:, 0].max() < 0.02
    assert on.document(7).nodes == document.nodes


def test_where_a_new_robot_begins_is_corrected() -> None:
    steps = log(ROOM, TOUR)
    document = slam_of(steps).document(7)
    moved = document.map_from_odom.model_copy(
        update={"x_m": document.map_from_odom.x_m + 0.15, "y_m": document.map_from_odom.y_m - 0.1}
    )
    on = Slam.restored(PARAMS, document.model_copy(update={"map_from_odom": moved}))
    off = errors(on, steps[:20])
    assert off[0, 0] < 0.02


def test_nonsense_changes_nothing() -> None:
    steps = log(ROOM, TOUR)
    slam = slam_of(steps[:60])
    pose, version = slam.pose()[0], slam.graph_version
    last = steps[59]
    sensor = LDS.base_from_scan
    good = (0.0, LDS.increment_rad, 0.12, 3.5, sensor)
    # Not later, no odometry, not finite.
    assert not slam.scan(Scan(last.ranges_m, *good, stamp_ns=last.stamp_ns))
    assert not slam.scan(Scan(last.ranges_m, *good, stamp_ns=last.stamp_ns + 10**10))
    slam.odometry(last.stamp_ns + 1, SE2(math.nan, 0.0, 0.0))
    slam.odometry(last.stamp_ns - 5, SE2(9.0, 0.0, 0.0))
    later = last.stamp_ns + SCAN_NS
    assert not slam.scan(Scan(last.ranges_m, math.nan, LDS.increment_rad, 0.12, 3.5, sensor, later))
    assert not slam.scan(Scan(last.ranges_m, 0.0, math.inf, 0.12, 3.5, sensor, later))
    # In degrees.
    assert not slam.scan(Scan(last.ranges_m, 0.0, 1.0, 0.12, 3.5, sensor, later))
    assert (slam.pose()[0], slam.graph_version) == (pose, version)


@pytest.mark.parametrize(
    "ranges", [np.full(360, value) for value in (math.nan, math.inf, -math.inf, 0.01)] + [[]]
)
def test_a_scan_without_returns_leaves_the_pose_to_odometry(ranges: ArrayLike) -> None:
    steps = log(ROOM, TOUR)
    slam = slam_of(steps[:60])
    before = slam.pose()[0]
    stamp_ns = steps[60].stamp_ns
    slam.odometry(stamp_ns, steps[60].odom)
    slam.scan(
        Scan(
            np.array(ranges, np.float32),
            0.0,
            LDS.increment_rad,
            0.12,
            3.5,
            LDS.base_from_scan,
            stamp_ns,
        )
    )
    after = slam.pose()[0]
    assert after.distance_m(before @ (steps[59].odom.inverse() @ steps[60].odom)) < 1e-9


def test_the_first_scan_may_be_empty() -> None:
    steps = [
        dataclasses.replace(step, ranges_m=np.full(360, np.inf, np.float32)) if i == 0 else step
        for i, step in enumerate(log(ROOM, TOUR))
    ]
    off = errors(Slam(PARAMS, TOUR[0]), steps)
    assert off[-1, 0] < 0.02


@pytest.mark.parametrize("blank", [[math.inf] * 360, [math.nan] * 360, []])
@pytest.mark.parametrize("when", [slice(0, 6), slice(40, 60), slice(3, None, 7)])
def test_a_lidar_that_drops_out_draws_no_free_floor_behind_walls(
    blank: ArrayLike, when: slice
) -> None:
    steps = log(ROOM, TOUR)
    blanks = range(len(steps))[when]
    empty = np.array(blank, np.float32)
    slam = slam_of(
        [dataclasses.replace(s, ranges_m=empty) if i in blanks else s for i, s in enumerate(steps)]
    )
    assert dict(slam.left_out) == {NO_RETURNS: len(blanks)}
    assert slam.pose()[0].distance_m(steps[-1].true) < 0.02
    grid = slam.grid()
    x, y = cells_m(grid, 0)
    assert 10.0 < len(x) * grid.resolution_m**2 < 12.0
    assert_within_room(x, y)


def test_open_floor_is_mapped_where_nothing_returns() -> None:
    steps = log(wall(90.0, 0.0, 90.0, 1.0), TOUR)
    slam = slam_of(steps)
    assert slam.keyframes > 1
    assert 0 < slam.left_out[NO_RETURNS] <= 2_000_000_000 // SCAN_NS
    assert (slam.grid().cells == 0).sum() * slam.grid().resolution_m ** 2 > 38.0


def test_odometry_that_jumps_is_not_believed() -> None:
    steps = log(ROOM, TOUR)
    away = SE2(7.0, -3.0, 1.0)
    jumped = [
        step if i < 80 else dataclasses.replace(step, odom=away @ step.odom)
        for i, step in enumerate(steps)
    ]
    off = errors(Slam(PARAMS, TOUR[0]), jumped)
    assert off[85:, 0].max() < 0.03


def test_what_moves_away_is_cleared() -> None:
    poses = way([(0.7, 0.7), (1.4, 1.6), (3.0, 1.8)])
    with_box = np.concatenate([ROOM, box(2.9, 2.3, 3.2, 2.6)])
    random = np.random.default_rng(5)
    steps = log(ROOM, poses)
    steps = [
        dataclasses.replace(step, ranges_m=scan(with_box, step.true, LDS, random))
        if i < len(steps) // 3 else step
        for i, step in enumerate(steps)
    ]  # fmt: skip
    slam = slam_of(steps)
    grid = slam.grid()
    row = math.floor((2.31 - grid.origin.y_m) / grid.resolution_m)
    first, last = (math.floor((x - grid.origin.x_m) / grid.resolution_m) for x in (2.92, 3.18))
    assert (grid.cells[row, first:last] == 0).mean() >= 0.8


def test_who_has_walked_on_is_cleared_by_a_robot_that_stands_and_stays_none_of_the_map() -> None:
    here = SE2(0.7, 0.7, 0.3)
    random = np.random.default_rng(5)
    steps = log(ROOM, [here] * 100)

    def beside(x: float) -> Array:
        return np.concatenate([ROOM, box(x, 1.3, x + 0.2, 1.5)])

    def seen(step: Step, walls: Array) -> Step:
        return dataclasses.replace(step, ranges_m=scan(walls, step.true, LDS, random))

    # Who stood there when the map was begun is gone then, and walks to and fro from 5 s on.
    steps[:5] = [seen(step, beside(1.2)) for step in steps[:5]]
    steps[50:] = [
        seen(step, beside(0.5 + 0.02 * min(i % 40, 40 - i % 40)))
        for i, step in enumerate(steps[50:])
    ]
    slam = Slam(PARAMS, here)
    keyframes = []
    for i, _ in enumerate(feed(slam, steps, LDS)):
        if i in (4, 49, 99):
            grid = slam.grid()
            x, y = cells_m(grid, 100)
            occupied = (x > 0.4) & (x < 1.7) & (y > 1.2) & (y < 1.6)
            keyframes.append((slam.keyframes, bool(occupied.any())))
    assert keyframes[0] == (1, True)
    assert keyframes[1][1] is False
    assert keyframes[1] == keyframes[2]
    assert keyframes[2][0] <= 5


def test_a_pose_that_scans_left_behind_is_found_again() -> None:
    steps = log(ROOM, TOUR)
    # Odometry does not tell of a shift that is smaller than a jump.
    shift = SE2(0.2, -0.1, 0.3)
    shifted = [
        step if i < 100 else dataclasses.replace(step, odom=shift @ step.odom)
        for i, step in enumerate(steps)
    ]
    off = errors(Slam(PARAMS, TOUR[0]), shifted)
    assert off[105:, 0].max() < 0.03


@pytest.mark.parametrize("there", [SE2(10.6, 0.7, 1.0), SE2(11.1, 5.0, -2.0), SE2(20.3, 4.0, 1.5)])
def test_a_robot_that_was_carried_off_adds_nothing_to_the_map(there: SE2) -> None:
    """Nothing is known of the place but that it is another one; carried back, the map goes on."""
    rooms = [box(10.0, 0.0, 11.6, 8.0), wall(10.0, 3.0, 10.8, 3.0), box(20.0, 0.0, 20.6, 8.0)]
    elsewhere = np.concatenate(rooms)
    random = np.random.default_rng(5)
    first, last = 60, 100
    poses = TOUR[:first] + [TOUR[first]] * (last - first) + TOUR[first:]
    steps = [
        dataclasses.replace(step, ranges_m=scan(elsewhere, there, LDS, random))
        if first <= i < last else step
        for i, step in enumerate(log(ROOM, poses))
    ]  # fmt: skip
    slam = Slam(PARAMS, TOUR[0])
    lost, sizes = [], []
    for _ in feed(slam, steps):
        lost.append(slam.is_lost)
        sizes.append((slam.keyframes, slam.map_version))
    assert not any(lost[: first + 2])
    assert all(lost[first + 2 : last])
    assert len(set(sizes[first - 1 : last])) == 1
    assert last - first <= slam.left_out[CARRIED_OFF] <= last - first + 15
    assert not any(lost[last + 15 :])
    assert slam.pose()[0].distance_m(steps[-1].true) < 0.03


def carried(poses: list[SE2], then: list[SE2], walls: Array = ROOM) -> list[Step]:
    """A drive along poses, and along others to which the robot is carried, which odometry does not
    tell.
    """
    steps = log(walls, [*poses, *then])
    odom_from_map = steps[len(poses) - 1].odom @ then[0].inverse()
    return steps[: len(poses)] + [
        dataclasses.replace(step, odom=odom_from_map @ step.true) for step in steps[len(poses) :]
    ]


LATER = way([(3.2, 2.3), (1.4, 2.4), (1.2, 1.6), (3.2, 1.8), (3.3, 0.7), (3.2, 2.3)])


def test_a_robot_that_was_carried_off_is_found_where_it_has_moved_on_the_map() -> None:
    steps = carried(TOUR, LATER)
    slam = Slam(PARAMS, TOUR[0])
    off, lost = [], []
    for step in feed(slam, steps):
        off.append(slam.pose()[0].distance_m(step.true))
        lost.append(slam.is_lost)
    first = lost.index(True)
    assert len(TOUR) <= first <= len(TOUR) + 3
    found = lost.index(False, first)
    assert steps[first].true.distance_m(steps[found].true) < 2.0
    assert not any(lost[found:])
    assert max(off[found + 3 :]) < 0.04
    truth = slam_of(log(ROOM, TOUR)).grid()
    grid = slam.grid()
    assert grid.cells.shape == truth.cells.shape
    assert ((grid.cells == 100) != (truth.cells == 100)).sum() < 30


def test_along_a_corridor_that_fits_the_robot_is_not_back() -> None:
    """It was carried to where it is wider, and drove on to where it looks the same."""
    mapped = np.array([[-20.0, 0.0, 40.0, 0.0], [-20.0, 1.5, 40.0, 1.5]])
    wide = np.array([[-2.0, 10.0, 2.0, 10.0], [-2.0, 13.0, 2.0, 13.0]])
    narrow = np.array([[2.0, 10.75, 40.0, 10.75], [2.0, 12.25, 40.0, 12.25]])
    walls = np.concatenate([mapped, wide, narrow])
    there = way([(0.0, 0.75), (10.0, 0.75), (6.0, 0.75)])
    elsewhere = way([(0.0, 11.5), (6.0, 11.5)])
    slam = Slam(PARAMS, there[0])
    lost = [slam.is_lost for _ in feed(slam, carried(there, elsewhere, walls))]
    assert not any(lost[: len(there)])
    assert all(lost[len(there) + 3 :])
    assert slam.quality > 0.9


def test_where_two_places_look_alike_the_robot_stays_lost() -> None:
    """A room that looks the same turned by half."""
    room = np.concatenate([box(0.0, 0.0, 4.0, 3.0), wall(2.0, 0.0, 2.0, 1.0)])
    room = np.concatenate([room, wall(2.0, 3.0, 2.0, 2.0)])
    tour = way([(0.7, 0.7), (1.4, 1.5), (3.2, 1.5), (3.3, 0.7), (3.2, 2.3), (1.4, 1.5), (0.7, 2.3)])
    other = way([(3.3, 2.2), (3.3, 0.8), (2.6, 1.5), (1.2, 1.5), (0.8, 2.3)])
    slam = slam_of(carried(tour, other, room))
    assert slam.is_lost
    keyframes = slam.keyframes
    assert keyframes == slam_of(log(room, tour)).keyframes


def test_a_map_that_was_made_before_is_not_gone_on_with_from_a_wrong_pose() -> None:
    made = slam_of(log(ROOM, TOUR))
    document = made.document(0)
    for wrong in (SE2(0.0, 0.0, 0.0), SE2(1.5, 0.9, 1.2)):
        start = wrong @ LATER[0]
        steps = log(ROOM, LATER)
        planar = Planar(x_m=start.x_m, y_m=start.y_m, yaw_rad=start.yaw_rad)
        slam = Slam.restored(PARAMS, document.model_copy(update={"map_from_odom": planar}))
        lost = [slam.is_lost for _ in feed(slam, steps)]
        assert lost[2] == (wrong != SE2(0.0, 0.0, 0.0))
        assert not lost[-1]
        assert slam.pose()[0].distance_m(steps[-1].true) < 0.04


def test_boxes_that_come_around_a_robot_carry_it_nowhere() -> None:
    random = np.random.default_rng(5)
    here = TOUR[60]
    around = [here @ SE2(*at, 0.0) for at in ((0.35, 0.4), (-0.45, 0.4), (0.1, -0.5), (-0.6, -0.4))]
    boxes = [box(p.x_m - 0.2, p.y_m - 0.2, p.x_m + 0.2, p.y_m + 0.2) for p in around]
    crowded = np.concatenate([ROOM, *boxes])
    steps = [
        dataclasses.replace(step, ranges_m=scan(crowded, step.true, LDS, random))
        if i >= 60 else step
        for i, step in enumerate(log(ROOM, [*TOUR[:60], *[here] * 40]))
    ]  # fmt: skip
    slam = Slam(PARAMS, TOUR[0])
    fits = []
    for _ in feed(slam, steps):
        fits.append(slam.quality)
        assert not slam.is_lost
    assert fits[59] > 0.9
    assert fits[60] < 0.5


SPARSE_WAY = office_way()[::18]
"""A scan each 1.1 m or 80 degrees of turn."""


def sparse(jump_at: int | None = None, scan_s: float = 1.0) -> list[Step]:
    """The office by a SICK that scans seldom: 180 m in 170 scans."""
    steps = log(office(), SPARSE_WAY, SICK, slip=0.02, noise_m_per_sqrt_m=0.01)
    jump = SE2(3.0, -1.0, 0.4)
    return [
        dataclasses.replace(
            step,
            stamp_ns=round((i + 1) * scan_s * 1e9),
            odom=step.odom if jump_at is None or i < jump_at else jump @ step.odom,
        )
        for i, step in enumerate(steps)
    ]


@pytest.mark.parametrize("scan_s", [1.0, 0.1])
def test_scans_far_apart_close_their_loops_whatever_the_clock_says(scan_s: float) -> None:
    steps = sparse(scan_s=scan_s)
    assert drifted(steps, SPARSE_WAY[0]) > 2.0
    slam = slam_of(steps, lidar=SICK)
    assert slam.loops >= 1
    assert slam.jumps == []
    true = {step.stamp_ns: step.true for step in steps}
    off = [node.pose.se2().distance_m(true[node.stamp_ns]) for node in slam.document(0).nodes]
    assert np.mean(off) < 0.1


@pytest.mark.parametrize(("apart", "noise", "seed"), [(18, 0.03, 3), (30, 0.02, 2)])
def test_wheels_that_once_turn_far_more_than_usual_are_overruled_by_the_scan(
    apart: int, noise: float, seed: int
) -> None:
    # A scan each 1.1 or 1.8 m; the heading errs by 0.15 or 0.1 rad a square root metre.
    steps = log(office(), office_way(), SICK, slip=0.02, noise_m_per_sqrt_m=noise, seed=seed)
    steps = [
        dataclasses.replace(step, stamp_ns=(i + 1) * 10**9) for i, step in enumerate(steps[::apart])
    ]
    assert drifted(steps, steps[0].true) > 5.0
    slam = slam_of(steps, lidar=SICK)
    assert slam.loops >= 1
    assert slam.jumps == []
    true = {step.stamp_ns: step.true for step in steps}
    off = [node.pose.se2().distance_m(true[node.stamp_ns]) for node in slam.document(0).nodes]
    assert np.mean(off) < 0.2
    assert np.max(off) < 0.5


def test_a_jump_between_scans_far_apart_is_told_and_not_believed() -> None:
    steps = sparse(jump_at=60)
    slam = slam_of(steps, lidar=SICK)
    assert [jump.to_ns for jump in slam.jumps] == [steps[60].stamp_ns]
    true = {step.stamp_ns: step.true for step in steps}
    off = [node.pose.se2().distance_m(true[node.stamp_ns]) for node in slam.document(0).nodes]
    assert np.mean(off) < 0.15


def test_a_lidar_whose_beams_change_from_scan_to_scan_maps_as_well() -> None:
    """As the LDS-02's driver has it: 230 to 274 beams, gaps of NaN and 0, and no least range."""
    random = np.random.default_rng(2)
    slam = Slam(PARAMS, TOUR[0])
    off = []
    for i, step in enumerate(log(ROOM, TOUR, slip=0.05)):
        beams = int(random.integers(230, 275))
        lidar = Lidar(beams, float(random.uniform(0, 0.03)), math.tau / beams, 0.0, 100.0)
        ranges = scan(ROOM, step.true, lidar, random)
        ranges[random.random(beams) < 0.05] = np.nan
        ranges[random.random(beams) < 0.05] = 0.0
        slam.odometry(step.stamp_ns, step.odom)
        seen = Scan(
            ranges, lidar.angle_min_rad, lidar.increment_rad, 0.0, 100.0, lidar.base_from_scan,
            step.stamp_ns,
        )  # fmt: skip
        assert slam.scan(seen), i
        off.append(slam.pose()[0].distance_m(step.true))
    assert np.percentile(off, 95) < 0.01


def test_scans_that_are_not_used_are_counted_by_their_reason() -> None:
    steps = log(ROOM, TOUR[:20])
    slam = slam_of(steps)
    last = steps[-1]
    for stamp_ns in (last.stamp_ns, last.stamp_ns + 10**10):
        sensor = LDS.base_from_scan
        slam.scan(Scan(last.ranges_m, 0.0, LDS.increment_rad, 0.12, 3.5, sensor, stamp_ns))
    assert dict(slam.left_out) == {NOT_LATER: 1, NO_ODOMETRY: 1}


@pytest.mark.slow
def test_a_large_office_with_a_long_lidar_closes_its_loops() -> None:
    poses = office_way()
    steps = log(office(), poses, SICK, slip=0.05, noise_m_per_sqrt_m=0.05)
    assert drifted(steps, poses[0]) > 10.0
    slam = slam_of(steps, lidar=SICK)
    assert slam.loops >= 2
    true = {step.stamp_ns: step.true for step in steps}
    nodes = slam.document(0).nodes
    off = [node.pose.se2().distance_m(true[node.stamp_ns]) for node in nodes]
    assert np.percentile(off, 95) < 0.1


@pytest.mark.parametrize(("range_m", "apart"), [(4.0, 36), (5.0, 48)])
def test_a_lidar_that_sees_little_farther_than_its_scans_are_apart_shows_no_jumps(
    range_m: float, apart: int
) -> None:
    # Each third minute a scan each 0.4 m, and otherwise each 2.1 or 2.9 m.
    near = dataclasses.replace(SICK, range_max_m=range_m)
    steps = log(office(), office_way(), near, slip=0.02, noise_m_per_sqrt_m=0.01, seed=2)
    kept = [
        step for i, step in enumerate(steps[::6]) if i % (apart // 6) == 0 or (i // 60) % 3 == 0
    ]
    kept = [dataclasses.replace(step, stamp_ns=(i + 1) * 10**9) for i, step in enumerate(kept)]
    assert drifted(kept, kept[0].true) > 14.0
    slam = slam_of(kept, lidar=near)
    assert slam.jumps == []
    assert CARRIED_OFF not in slam.left_out
    true = {step.stamp_ns: step.true for step in kept}
    off = [node.pose.se2().distance_m(true[node.stamp_ns]) for node in slam.document(0).nodes]
    assert np.mean(off) < 1.5


def judged(fit: float, before: float | None, behind: float, free: float) -> CarriedOff:
    carried = CarriedOff(PARAMS)
    carried.judge(fit, before, lambda: behind, lambda: free)
    return carried


def test_only_what_contradicts_the_map_tells_that_a_robot_was_carried_off() -> None:
    assert judged(0.1, 0.8, 0.3, 0.6).is_possible
    assert judged(0.1, 0.8, 0.0, 0.6).is_possible
    assert judged(0.4, 0.8, 0.1, 0.0).is_possible
    # At the edge of the map, or after a long step, nothing fits that it saw before.
    assert not judged(0.0, 0.8, 0.0, 0.1).is_possible
    assert not judged(0.0, None, 0.3, 0.6).is_possible


def test_long_steps_do_not_confirm_that_a_robot_was_carried_off() -> None:
    for before, lost in ((0.1, True), (None, False)):
        carried = judged(0.1, 0.8, 0.3, 0.6)
        for _ in range(3):
            carried.judge(0.1, before, lambda: 0.3, lambda: 0.6)
        assert carried.is_certain == lost
