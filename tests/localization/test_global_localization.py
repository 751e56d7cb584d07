"""A pose found from nothing, found wrong, and found again."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.localization.beam_model import ScanView, judge, scan_view
from mazebot.localization.global_search.global_search import global_search, search_map
from mazebot.localization.messages import cloud_message
from mazebot.localization.monte_carlo import Localization
from tests.localization import offline
from tests.localization.test_beam_model import rays

NEAR = np.diag([0.05, 0.05, 0.05]) ** 2


def house() -> offline.Place:
    return offline.shipped("sim_house")


def robot(place: offline.Place, seed: int, camera: bool = False) -> offline.Robot:
    rng = np.random.default_rng(seed)
    loc = place.localization(seed)
    return offline.Robot(place, place.free_pose(rng), loc, rng, camera=camera)


def at_known_pose(place: offline.Place, seed: int, camera: bool = False) -> offline.Robot:
    made = robot(place, seed, camera)
    made.loc.initialize(made.pose, NEAR)
    made.sense()
    return made


def seconds_until(made: offline.Robot, state: str, limit_s: float) -> float:
    """Simulated time that the robot wanders until the filter's state."""
    begin_ns = made.now_ns
    while made.loc.state != state:
        made.wander()
        assert (made.now_ns - begin_ns) * 1e-9 < limit_s, (made.loc.state, made.loc.reasons)
    return (made.now_ns - begin_ns) * 1e-9


def seen_from(place: offline.Place, here: SE2) -> ScanView:
    """A scan without noise."""
    ranges_m = place.ranges(here)
    ranges_m[ranges_m > offline.RANGE_MAX_M] = np.inf
    scan = Scan(
        ranges_m.astype(np.float32), 0.0, math.tau / offline.BEAMS, 0.12, 3.5,
        offline.BASE_FROM_SCAN,
    )  # fmt: skip
    return scan_view(scan, 90)


class TestSearch:
    @pytest.mark.parametrize("seed", range(5))
    def test_the_true_pose_is_among_the_best(self, seed: int) -> None:
        place = house()
        rng = np.random.default_rng(seed)
        here = place.free_pose(rng)
        seen = seen_from(place, here)
        over = rays(place)
        table = search_map(place.cells, place.resolution_m, over)
        poses, _, likelihoods = global_search(table, over, seen, 200)
        near = [SE2(*pose).distance_m(here) < 0.06 for pose in poses]
        assert any(near[:5])
        assert likelihoods[near.index(True)] >= judge(over, np.array([here]), seen)[1][0] - 3.0
        assert (np.diff(likelihoods) <= 0.0).all()

    def test_around_a_pose_it_finds_what_the_whole_map_has_there(self) -> None:
        place, rng = house(), np.random.default_rng(4)
        over = rays(place)
        table = search_map(place.cells, place.resolution_m, over)
        pose = place.free_pose(rng)
        seen = seen_from(place, pose)
        _, _, (best, *_) = global_search(table, over, seen, 200)
        guess = pose @ SE2(0.4, -0.5, 0.0)
        found, _, (likelihood, *_) = global_search(table, over, seen, 200, table.around(guess, 1.0))
        assert likelihood == best
        assert SE2(*found[0]).distance_m(pose) < 0.05
        # A position of the table is drawn to the walls by less than this.
        assert np.abs(found[:, :2] - np.array(guess[:2])).max() < 1.5
        nowhere = table.around(SE2(1e6, 1e6, 0.0), 1.0)
        assert len(global_search(table, over, seen, 200, nowhere)[0]) == 0
        assert table.around(pose, math.inf) == tuple(slice(0, n) for n in table.free.shape)

    def test_a_scan_without_returns_gives_no_pose(self) -> None:
        place = house()
        over = rays(place)
        table = search_map(place.cells, place.resolution_m, over)
        nothing = np.full(360, np.inf, np.float32)
        seen = scan_view(Scan(nothing, 0.0, math.tau / 360, 0.12, 3.5, SE2(0.0, 0.0, 0.0)), 90)
        assert len(global_search(table, over, seen, 200)[0]) == 0


class TestFromNothing:
    @pytest.mark.parametrize("seed", range(4))
    def test_the_house_tells_where_the_robot_is(self, seed: int) -> None:
        made = robot(house(), seed)
        assert made.loc.state == "uninitialized"
        made.loc.global_localization()
        assert (made.loc.state, made.loc.wants_motion) == ("searching", True)
        assert not made.loc.initialized
        seconds_until(made, "localized", 20.0)
        for _ in range(20):
            made.wander()
        assert made.error()[0] < 0.05
        assert made.loc.quality > 0.9
        assert not made.loc.wants_motion

    def test_a_robot_that_stands_is_not_sure(self) -> None:
        made = robot(house(), 1)
        made.loc.global_localization()
        for _ in range(100):
            made.drive(0.0, 0.0)
        assert made.loc.state == "searching"
        assert made.loc.pose()[1][0, 0] >= 0.01

    def test_a_room_that_looks_the_same_from_both_ends_leaves_two_poses(self) -> None:
        made = robot(offline.rectangle(6.0, 4.0), 3)
        made.loc.global_localization()
        for _ in range(300):
            made.wander()
        poses = made.loc.hypotheses()
        assert made.loc.state == "searching"
        assert len(poses) == 2
        assert poses[:, 3].sum() == pytest.approx(1.0)
        assert poses[0, 3] < 0.99
        assert poses[0, :2] == pytest.approx(-poses[1, :2], abs=0.1)
        spread = math.sqrt(np.linalg.eigvalsh(made.loc.pose()[1][:2, :2])[-1])
        assert made.error()[0] < 3.0 * spread

    def test_boxes_that_are_not_in_the_map_do_no_harm(self) -> None:
        made = robot(house(), 7)
        x, y = made.pose.x_m, made.pose.y_m
        made.obstacles = np.concatenate(
            [offline.box_faces(x + dx, y + dy, 0.4, 0.3, 0.3) for dx, dy in ((1, 0.4), (-0.8, -1))]
        )
        made.loc.global_localization()
        seconds_until(made, "localized", 30.0)
        assert made.error()[0] < 0.1

    def test_same_seed_same_bits(self) -> None:
        poses = []
        for _ in range(2):
            made = robot(house(), 2)
            made.loc.global_localization()
            for _ in range(120):
                made.wander()
            poses.append(made.loc.particles().tobytes())
        assert poses[0] == poses[1]

    @pytest.mark.parametrize("seed", [1, 4])
    def test_few_scans_and_bad_odometry_between_them_refute_no_right_pose(self, seed: int) -> None:
        """The right pose is drawn back to the walls at each scan, wherever odometry has it."""
        place, rng = offline.shipped("maze_rooms"), np.random.default_rng(seed)
        made = offline.Robot(
            place, place.free_pose(rng), place.localization(seed), rng, slip=0.2, noise=1.0
        )
        made.loc.global_localization()
        for i in range(400):
            made.lidar = i % 40 == 39
            made.wander(0.4)
            if made.loc.state == "localized":
                break
        assert made.loc.state == "localized", made.loc.reasons
        assert made.error()[0] < 0.2


class TestMarkers:
    def place(self) -> offline.Place:
        return offline.shipped("sim_house_markers")

    def facing(self, place: offline.Place, seed: int) -> SE2:
        """A free pose from which a marker is in view."""
        rng = np.random.default_rng(seed)
        while True:
            here = place.free_pose(rng)
            if any(offline.marker_seen(place, here, marker, rng) for marker in place.markers):
                return here

    def test_in_view_they_tell_a_standing_robot_where_it_is(self) -> None:
        place = self.place()
        made = robot(place, 4, camera=True)
        made.pose = self.facing(place, 1)
        made.loc.global_localization()
        for _ in range(60):
            made.drive(0.0, 0.0)
        assert made.loc.state == "localized"
        assert made.error()[0] < 0.06

    def test_a_kidnapping_is_mended_before_the_lidar_notices(self) -> None:
        place = self.place()
        made = at_known_pose(place, 5, camera=True)
        for _ in range(60):
            made.wander()
        made.kidnap(self.facing(place, 9))
        assert made.error()[0] > 0.5
        for _ in range(16):
            made.drive(0.0, 0.0)
        assert made.loc.state == "localized"
        assert made.error()[0] < 0.1

    def test_one_that_hangs_elsewhere_than_the_map_says_makes_no_one_lost(self) -> None:
        place = self.place()
        made = at_known_pose(place, 6, camera=False)
        moved = np.eye(4)
        moved[:2, 3] = (0.9, 0.5)
        states = set()
        for i in range(200):
            made.wander()
            if i % 2:
                for marker in place.markers:
                    seen = offline.marker_seen(place, made.pose, marker, made.rng)
                    made.loc.marker(made.now_ns, moved @ marker, seen, offline.BASE_FROM_CAMERA)
            states.add(made.loc.state)
        assert states == {"localized"}


class TestKidnapped:
    @pytest.mark.parametrize("seed", range(3))
    def test_it_is_noticed_and_the_pose_found_again(self, seed: int) -> None:
        made = at_known_pose(house(), seed)
        for _ in range(60):
            made.wander()
        before = made.pose
        while made.pose.distance_m(before) < 1.5:
            made.kidnap(made.place.free_pose(made.rng))
        assert seconds_until(made, "searching", 10.0) > 0.5
        assert made.loc.reasons
        seconds_until(made, "localized", 30.0)
        for _ in range(20):
            made.wander()
        assert made.error()[0] < 0.05

    def test_turned_by_a_quarter_on_the_spot(self) -> None:
        made = at_known_pose(house(), 11)
        for _ in range(60):
            made.wander()
        made.kidnap(made.pose @ SE2(0.0, 0.0, math.pi / 2))
        seconds_until(made, "searching", 10.0)
        seconds_until(made, "localized", 30.0)
        assert made.error()[1] < 0.1

    @pytest.mark.parametrize(("world", "seed"), [("sim_house", 11), ("maze_rooms", 0)])
    def test_it_is_noticed_while_the_robot_stands(self, world: str, seed: int) -> None:
        """Many beams end before the map's walls, as beside a thing; elsewhere all end at walls."""
        made = at_known_pose(offline.shipped(world), seed)
        for _ in range(60):
            made.wander()
        before = made.pose
        while made.pose.distance_m(before) < 1.5:
            made.kidnap(made.place.free_pose(made.rng))
        for _ in range(100):
            made.drive(0.0, 0.0)
            if made.loc.state != "localized":
                break
        assert made.loc.state != "localized", made.loc.reasons

    def test_it_is_noticed_where_hardly_a_beam_contradicts_the_pose(self) -> None:
        """One of three of the beams ends at walls, the others before them: at the right pose, all
        end at walls.
        """
        made = robot(offline.shipped("maze_rooms"), 1)
        made.kidnap(SE2(-4.98, 6.12, 2.37))
        made.loc.initialize(made.pose, NEAR)
        for _ in range(200):
            made.drive(0.0, 0.0)
        assert made.loc.state == "localized"
        made.kidnap(SE2(2.92, 9.63, -0.84))
        for _ in range(100):
            made.drive(0.0, 0.0)
            if made.loc.state != "localized":
                break
        assert made.loc.state != "localized", made.loc.reasons

    @pytest.mark.parametrize("seed", range(3))
    def test_pushed_it_is_found_there_where_two_places_look_alike(self, seed: int) -> None:
        """A room that looks the same from both ends: people push a robot more often than they carry
        it to the one other place.
        """
        made = at_known_pose(offline.rectangle(6.0, 4.0), seed)
        for _ in range(60):
            made.wander()
        made.kidnap(made.pose @ SE2(0.1, 0.15, 0.8))
        seconds_until(made, "searching", 10.0)
        seconds_until(made, "localized", 40.0)
        assert made.error()[0] < 0.1
        assert made.error()[1] < 0.1

    @pytest.mark.parametrize("seed", range(3))
    def test_carried_far_no_wrong_one_of_two_places_is_trusted(self, seed: int) -> None:
        made = at_known_pose(offline.rectangle(6.0, 4.0), seed)
        for _ in range(60):
            made.wander()
        before, there = made.pose, made.pose
        while (
            min(there.distance_m(before), SE2(-there.x_m, -there.y_m, 0.0).distance_m(before)) < 2
        ):
            there = made.place.free_pose(made.rng)
        made.kidnap(there)
        seconds_until(made, "searching", 10.0)
        for _ in range(600):
            made.wander()
            assert made.loc.state == "searching" or made.error()[0] < 0.1

    def test_a_wrong_initial_pose_is_mended(self) -> None:
        made = robot(house(), 12)
        made.loc.initialize(made.place.free_pose(np.random.default_rng(99)), NEAR)
        made.sense()
        seconds_until(made, "searching", 10.0)
        seconds_until(made, "localized", 30.0)
        assert made.error()[0] < 0.1

    def test_boxes_that_move_raise_no_alarm(self) -> None:
        made = at_known_pose(house(), 14)
        rng = np.random.default_rng(5)
        homes = [made.place.free_pose(rng) for _ in range(8)]
        for i in range(600):
            swing = [0.6 * math.sin(0.05 * i + k) for k in range(8)]
            boxes = [
                offline.box_faces(home.x_m + off, home.y_m - off, home.yaw_rad, 0.4, 0.4)
                for home, off in zip(homes, swing, strict=True)
            ]
            here = np.array([made.pose.x_m, made.pose.y_m])
            apart = [box for box in boxes if np.abs(box[:, :2] - here).max(axis=1).min() > 0.5]
            made.obstacles = np.concatenate([np.empty((0, 4)), *apart])
            made.wander()
            assert made.loc.state == "localized", made.loc.reasons
        assert made.error()[0] < 0.06

    def test_a_third_of_the_rays_lost_raises_none(self) -> None:
        made = at_known_pose(house(), 15)
        made.lost_rays = 0.3
        for _ in range(300):
            made.wander()
            assert made.loc.state == "localized", made.loc.reasons
        assert made.error()[0] < 0.06


def boxes_around(pose: SE2, gap_m: float) -> np.ndarray:
    """Faces of three boxes ahead and on both sides of a robot."""
    faces = []
    for turn in (0.0, math.pi / 2.0, -math.pi / 2.0):
        there = pose @ SE2(0.0, 0.0, turn) @ SE2(gap_m + 0.15, 0.0, 0.0)
        faces.append(offline.box_faces(*there, 0.3, 2.0 * gap_m))
    return np.concatenate(faces)


class TestBeside:
    """The pose is beside the estimate: the map is not searched for a robot that is not lost."""

    @pytest.mark.parametrize("seed", [1, 3, 4, 6])
    def test_a_robot_that_was_pushed_and_turned_a_little_is_never_lost(self, seed: int) -> None:
        made = at_known_pose(house(), seed)
        for _ in range(60):
            made.wander()
        made.kidnap(made.pose @ SE2(0.15, 0.1, 0.35))
        for i in range(100):
            made.wander()
            assert made.loc.state == "localized", made.loc.reasons
            assert i < 40 or made.error()[0] < 0.1
            assert i < 40 or made.error()[1] < 0.1

    def test_a_wide_estimate_is_drawn_to_the_one_pose_that_a_scan_fits(self) -> None:
        """Too few particles are near it: they would take many scans to get there."""
        at_once = 0
        for seed in range(6):
            rng = np.random.default_rng(seed)
            place = house()
            begin = place.free_pose(rng)
            made = offline.Robot(place, begin, place.localization(seed), rng, slip=0.1, noise=0.5)
            made.loc.initialize(made.pose, NEAR)
            made.sense()
            made.lidar = False
            for _ in range(641):
                made.wander()
            assert made.error()[0] > 0.2
            made.lidar = True
            made.wander()
            at_once += made.error()[0] < 0.1
        assert at_once >= 4

    def test_a_pose_that_could_be_anywhere_is_not_called_known(self) -> None:
        """A long corridor shows nothing of the place along it."""
        place = offline.rectangle(60.0, 2.0)
        rng = np.random.default_rng(2)
        made = offline.Robot(place, SE2(0.0, 0.0, 0.0), place.localization(2), rng)
        made.loc.initialize(made.pose, np.diag([5.0, 0.05, 0.05]) ** 2)
        made.sense()
        for _ in range(100):
            made.drive(0.2, 0.0)
        assert made.loc.state == "searching"
        assert "standard deviation" in made.loc.reasons[0]


class TestBesideLargeThings:
    """A U of boxes that the map does not have, in a hall."""

    PLACE = offline.rectangle(12.0, 9.0, ((-3.0, 0.0),))

    @pytest.mark.parametrize("seed", range(3))
    def test_a_right_pose_is_kept(self, seed: int) -> None:
        made = at_known_pose(self.PLACE, seed)
        for _ in range(40):
            made.wander()
        made.obstacles = boxes_around(made.pose, 0.6 + 0.15 * seed)
        for i in range(160):
            made.drive(0.0, 0.5 * math.sin(0.1 * i))
            assert made.loc.state == "localized", made.loc.reasons
        assert made.error()[0] < 0.2

    @pytest.mark.parametrize("seed", range(2))
    def test_a_right_initial_pose_is_confirmed_where_the_walls_are_seen(self, seed: int) -> None:
        made = robot(self.PLACE, seed)
        made.obstacles = boxes_around(made.pose, 0.7)
        made.loc.initialize(made.pose, NEAR)
        for _ in range(20):
            made.drive(0.0, 0.0)
        assert made.loc.hypotheses()[0, 3] > 0.9
        while made.loc.state != "localized":
            assert made.loc.wants_motion
            made.drive(-0.2, 0.0)
            assert made.error()[0] < 0.2
        assert made.loc.reasons == ("the scans match the map",)


class TestFirstVerdict:
    """On an initial pose, by the first scans."""

    def verdict(self, made: offline.Robot, given: SE2) -> str:
        made.loc.initialize(given, NEAR)
        assert made.loc.state == "uninitialized"
        assert not made.loc.wants_motion
        for _ in range(12):
            made.drive(0.0, 0.0)
            if made.loc.state != "uninitialized":
                break
        return made.loc.state

    @pytest.mark.parametrize("seed", range(3))
    def test_one_scan_confirms_a_right_one(self, seed: int) -> None:
        made = robot(house(), seed)
        made.loc.initialize(made.pose @ SE2(0.04, -0.03, 0.02), NEAR)
        made.sense()
        assert made.loc.state == "localized"
        assert made.loc.reasons == ("the scans match the map",)

    def test_one_that_is_far_off_is_never_called_localized(self) -> None:
        for seed, off_m in ((1, 0.85), (2, 0.9), (3, 4.8)):
            made = robot(house(), seed)
            given = SE2(made.pose.x_m + off_m, made.pose.y_m, made.pose.yaw_rad)
            assert self.verdict(made, given) == "searching"
            seconds_until(made, "localized", 20.0)
            assert made.error()[0] < 0.1

    def test_on_the_map_of_another_world_there_is_none(self) -> None:
        maze = offline.shipped("maze_rooms")
        rng = np.random.default_rng(1)
        made = offline.Robot(house(), house().free_pose(rng), maze.localization(1), rng)
        assert self.verdict(made, maze.free_pose(rng)) == "searching"
        for _ in range(80):
            made.wander()
            assert made.loc.state == "searching", made.loc.reasons

    def test_a_pose_off_by_what_was_said_is_drawn_to_the_true_one(self) -> None:
        made = robot(house(), 4)
        made.loc.initialize(made.pose @ SE2(0.3, -0.3, 0.1), np.diag([0.4, 0.4, 0.1]) ** 2)
        for _ in range(12):
            made.drive(0.0, 0.0)
        assert made.loc.state == "localized"
        assert made.error()[0] < 0.1

    def test_where_nothing_is_in_range_the_given_pose_holds(self) -> None:
        made = robot(offline.rectangle(9.0, 9.0), 3)
        made.loc.initialize(SE2(0.0, 0.0, 0.0), NEAR)
        made.kidnap(SE2(0.0, 0.0, 0.0))
        assert made.loc.state == "localized"
        assert made.loc.reasons[0].startswith("no wall is in range")


class TestBeyondTheMap:
    """A half of the house was cut from the map."""

    def place(self) -> offline.Place:
        cells = house().cells.copy()
        cells[:, cells.shape[1] // 2 :] = -1
        return dataclasses.replace(house(), cells=cells)

    @pytest.mark.parametrize("seed", range(2))
    def test_no_pose_is_trusted_there(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        here = house().free_pose(rng)
        while here.x_m < 1.5:
            here = house().free_pose(rng)
        made = offline.Robot(house(), here, self.place().localization(seed), rng)
        made.loc.global_localization()
        for _ in range(200):
            made.wander()
            assert made.loc.state == "searching" or made.error()[0] < 0.1

    def test_what_is_not_mapped_moves_no_particle_and_ends_the_trust(self) -> None:
        place = offline.rectangle(30.0, 2.0)
        cells = place.cells.copy()
        cells[:, 200:] = -1
        known = dataclasses.replace(place, cells=cells)
        made = at_known_pose(known, 3)
        made.pose = SE2(-8.0, 0.0, 0.0)
        made.loc.initialize(made.pose, NEAR)
        made.sense()
        assert made.loc.state == "localized"
        inside = []
        while made.loc.state == "localized" and made.pose.x_m < 13.0:
            made.drive(0.4, 0.0)
            inside.append(made.squared_mahalanobis() < 7.815)
        assert np.mean(inside) > 0.85
        assert 2.0 < made.pose.x_m < 13.0
        assert "come from where the map shows nothing" in made.loc.reasons[0]


class TestNothingToFind:
    def test_a_map_without_walls_gives_no_pose_and_no_error(self) -> None:
        empty = dataclasses.replace(house(), cells=np.zeros_like(house().cells))
        rng = np.random.default_rng(0)
        made = offline.Robot(house(), house().free_pose(rng), empty.localization(0), rng)
        made.loc.global_localization()
        for _ in range(40):
            made.wander()
        assert made.loc.state == "searching"
        assert len(made.loc.particles()) == 0
        assert len(cloud_message(0, made.loc.particles()).poses) == 0
        assert made.loc.reasons[1].startswith("no pose on the map matches the scans")


class TestConsistency:
    """The truth lies inside the ellipse of 95 % at least nine times of ten."""

    def share_inside(self, place: offline.Place, seeds: int, slip: float = 0.02) -> float:
        inside, count = 0, 0
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            made = offline.Robot(
                place, place.free_pose(rng), place.localization(seed), rng, slip=slip
            )
            made.loc.initialize(made.pose @ SE2(*(rng.standard_normal(3) * 0.03)), NEAR)
            made.sense()
            for _ in range(800):
                made.wander(0.4)
                assert made.loc.state == "localized", made.loc.reasons
                inside += made.squared_mahalanobis() < 7.815
                count += 1
        return inside / count

    def test_along_a_corridor_without_features(self) -> None:
        assert self.share_inside(offline.rectangle(30.0, 2.0), 2) >= 0.9

    def test_in_a_hall_where_nothing_returns(self) -> None:
        assert self.share_inside(offline.rectangle(20.0, 20.0), 2) >= 0.9

    def test_one_wall_alone_is_matched_at_its_near_face(self) -> None:
        place = offline.rectangle(24.0, 24.0)
        begin = SE2(-3.0, 10.8, 0.0)
        for seed in range(3):
            made = offline.Robot(
                place, begin, place.localization(seed), np.random.default_rng(seed)
            )
            made.loc.initialize(begin @ SE2(0.0, 0.12, 0.0), np.diag([0.1, 0.12, 0.03]) ** 2)
            for _ in range(200):
                made.drive(0.4, 0.0)
            assert abs(made.loc.map_from_base().y_m - made.pose.y_m) < 0.05

    @pytest.mark.slow
    @pytest.mark.parametrize("slip", [0.02, 0.1])
    def test_over_many_drives(self, slip: float) -> None:
        for place in (
            offline.rectangle(30.0, 2.0),
            offline.rectangle(20.0, 20.0),
            offline.rectangle(20.0, 20.0, ((-5, -5), (5, -5), (0, 3), (-4, 6))),
            house(),
        ):
            assert self.share_inside(place, 5, slip) >= 0.9


@pytest.mark.slow
class TestManyStarts:
    @pytest.mark.parametrize(
        ("name", "overrides", "count", "limit_s"),
        [
            ("sim_house", (), 40, 60.0),
            ("sim_house_markers", (), 40, 20.0),
            ("maze", ("maze.rows=10", "maze.columns=10", "maze.braiding=0.5"), 40, 90.0),
        ],
    )
    def test_found_and_never_wrong_and_certain(
        self, name: str, overrides: tuple[str, ...], count: int, limit_s: float
    ) -> None:
        place = offline.shipped(name, *overrides)
        found = 0
        for seed in range(count):
            made = robot(place, seed, camera="markers" in name)
            made.loc.global_localization()
            while made.now_ns < limit_s * 1e9 and made.loc.state != "localized":
                made.wander()
            if made.loc.state == "localized":
                assert made.error()[0] < 0.3, (seed, made.error())
                found += made.error()[0] < 0.1
        assert found >= 0.98 * count


def test_nothing_is_known_before_a_pose_is_given_or_sought() -> None:
    loc: Localization = house().localization(0)
    assert (loc.state, loc.quality, loc.wants_motion) == ("uninitialized", 0.0, False)
    assert len(loc.hypotheses()) == 0
    assert loc.reasons == ("no initial pose was given",)
