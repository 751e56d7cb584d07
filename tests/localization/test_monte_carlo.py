"""Monte Carlo localisation on exact scans of the real house."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.maths.frames import (
    LINK_FROM_OPTICAL,
    SE2,
    Array,
    inverse_matrix,
    rotation_from_rpy,
    transform_matrix,
    wrap_angle,
)
from mazebot.common.messages.scan import Scan
from mazebot.localization.likelihood_field import LikelihoodField, likelihood_field
from mazebot.localization.messages import cloud_message
from mazebot.localization.monte_carlo import Localization, LocalizationParams, MarkerCandidate
from mazebot.localization.particle_filter import (
    OdometryNoise,
    kld_sample_size,
    low_variance_resample,
    mean_and_covariance,
    odometry_motion,
    smoothed,
)
from mazebot.localization.particle_set import ParticleSet
from tests.navigation import house_tour as sim

START_COVARIANCE = np.diag([0.05, 0.05, 0.05]) ** 2
SURE = np.diag([0.02, 0.02, 0.02]) ** 2
STEP_NS = 100_000_000
BASE_FROM_CAMERA = transform_matrix(np.eye(3), (0.07, 0.0, 0.2)) @ LINK_FROM_OPTICAL
MARKER_COVARIANCE = np.diag([0.01, 0.01, 0.02, 0.1, 0.1, 0.1]) ** 2
# On the east face of Wall_14, looking along +x.
MAP_FROM_MARKER = transform_matrix(
    rotation_from_rpy(math.pi / 2, 0.0, math.pi / 2), (-1.803, 0.427, 0.25)
)


def localization(seed: int = 1, **params: float) -> Localization:
    world = sim.house()
    return Localization(
        LocalizationParams.model_validate(params),
        world.map_cells,
        world.world.map_resolution_m,
        world.map_origin,
        np.random.default_rng(seed),
    )


def feed(loc: Localization, stamp_ns: int, ranges_m: NDArray[np.float32]) -> bool:
    return loc.scan(
        Scan(
            ranges_m,
            0.0,
            sim.ANGLE_INCREMENT_RAD,
            sim.RANGE_MIN_M,
            sim.RANGE_MAX_M,
            sim.BASE_FROM_SCAN,
            stamp_ns,
        )
    )


@dataclass
class Track:
    """What came out of a drive, a row for each sample of odometry."""

    position_error_m: list[float] = field(default_factory=list)
    yaw_error_rad: list[float] = field(default_factory=list)
    squared_mahalanobis: list[float] = field(default_factory=list)
    jump_m: list[float] = field(default_factory=list)
    scan_match: list[float] = field(default_factory=list)
    poses: list[SE2] = field(default_factory=list)


def drive(loc: Localization, drive: sim.Drive, seed: int = 0, clutter: float = 0.0) -> Track:
    """Follow a drive; each scan arrives after the sample of odometry that follows it."""
    rng = np.random.default_rng(seed)
    track = Track()
    waiting = 0
    for i, (odom_from_base, true) in enumerate(
        zip(sim.slipping_odometry(drive.poses, rng), drive.poses, strict=True)
    ):
        stamp_ns = i * sim.ODOMETRY_NS
        loc.odometry(stamp_ns, odom_from_base)
        while waiting < len(drive.scan_exact_m) and drive.scan_stamps_ns[waiting] <= stamp_ns:
            ranges_m = sim.as_ranges(drive.scan_exact_m[waiting], rng)
            blocked = rng.random(len(ranges_m)) < clutter
            near_m = rng.uniform(0.3, 3.0, len(ranges_m)).astype(np.float32)
            ranges_m = np.where(blocked, np.minimum(ranges_m, near_m), ranges_m)
            before = loc.pose()[0]
            feed(loc, drive.scan_stamps_ns[waiting], ranges_m)
            track.jump_m.append(loc.pose()[0].distance_m(before))
            waiting += 1
        pose, covariance = loc.pose()
        error = np.array(
            [pose.x_m - true.x_m, pose.y_m - true.y_m, wrap_angle(pose.yaw_rad - true.yaw_rad)]
        )
        track.position_error_m.append(float(np.hypot(error[0], error[1])))
        track.yaw_error_rad.append(abs(float(error[2])))
        track.squared_mahalanobis.append(float(error @ np.linalg.solve(covariance, error)))
        track.scan_match.append(loc.scan_match)
        track.poses.append(pose)
    return track


@cache
def tour_track() -> Track:
    loc = localization()
    loc.initialize(SE2(0.0, 0.0, 0.0), START_COVARIANCE)
    return drive(loc, sim.tour())


def marker_seen_from(
    map_from_base: SE2, rng: np.random.Generator, flipped_score: float = 0.2
) -> list[MarkerCandidate]:
    """The right solution, noisy, and the one that is tilted to the other side of the ray."""
    map_from_camera = map_from_base.matrix() @ BASE_FROM_CAMERA
    right = inverse_matrix(map_from_camera) @ MAP_FROM_MARKER
    right[:3, 3] += rng.standard_normal(3) * 0.01
    ray = right[:3, 3] / np.linalg.norm(right[:3, 3])
    mirror = 2.0 * np.outer(ray, ray) - np.eye(3)
    flipped = right.copy()
    flipped[:3, :3] = mirror @ right[:3, :3] @ np.diag([-1.0, -1.0, 1.0])
    return [
        (right, MARKER_COVARIANCE, 1.0 - flipped_score),
        (flipped, MARKER_COVARIANCE, flipped_score),
    ]


class TestTour:
    def test_error_stays_within_three_centimetres_and_a_degree(self) -> None:
        track = tour_track()
        assert np.percentile(track.position_error_m, 95) < 0.03
        assert max(track.position_error_m) < 0.06
        assert np.percentile(track.yaw_error_rad, 95) < math.radians(1.0)

    def test_no_scan_moves_the_pose_by_more_than_two_centimetres(self) -> None:
        assert max(tour_track().jump_m) < 0.02

    def test_scans_fit_the_map_all_the_way(self) -> None:
        assert min(tour_track().scan_match) > 0.95

    def test_covariance_is_neither_too_sure_nor_too_shy(self) -> None:
        # The mean of a squared Mahalanobis distance in three dimensions is 3.
        assert 0.5 < np.mean(tour_track().squared_mahalanobis) < 4.0

    def test_odometry_alone_would_be_lost(self) -> None:
        # Or the tour would test nothing.
        poses = sim.tour().poses
        odometry = sim.slipping_odometry(poses, np.random.default_rng(0))
        map_from_odom = poses[0] @ odometry[0].inverse()
        errors = [
            (map_from_odom @ odom).distance_m(true)
            for odom, true in zip(odometry, poses, strict=True)
        ]
        assert max(errors) > 0.3

    def test_people_in_the_way_of_a_third_of_the_beams_do_no_harm(self) -> None:
        loc = localization()
        loc.initialize(SE2(0.0, 0.0, 0.0), START_COVARIANCE)
        track = drive(loc, sim.tour(stations=2), clutter=0.33)
        assert max(track.position_error_m) < 0.06
        assert min(track.scan_match) > 0.65


class TestDeterminism:
    def test_same_seed_same_bits(self) -> None:
        first, second, other = (localization(seed) for seed in (5, 5, 6))
        for loc in (first, second, other):
            loc.initialize(SE2(0.0, 0.0, 0.0), START_COVARIANCE)
            drive(loc, sim.tour(stations=1))
        assert first.particles().tobytes() == second.particles().tobytes()
        assert first.pose()[0] == second.pose()[0]
        assert first.particles().tobytes() != other.particles().tobytes()


class TestConvergence:
    @pytest.mark.parametrize("seed", range(6))
    def test_from_thirty_centimetres_and_twenty_degrees_away(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        bearing = rng.uniform(-math.pi, math.pi)
        wrong = SE2(
            0.3 * math.cos(bearing), 0.3 * math.sin(bearing), math.radians(20.0) * (-1) ** seed
        )
        loc = localization(seed)
        loc.initialize(wrong, np.diag([0.2, 0.2, math.radians(15.0)]) ** 2)
        assert not loc.converged
        track = drive(loc, sim.tour(stations=1), seed)
        assert loc.converged
        one_second = 30
        assert track.position_error_m[0] > 0.25
        assert max(track.position_error_m[2 * one_second :]) < 0.05
        assert max(track.yaw_error_rad[2 * one_second :]) < math.radians(1.5)

    def test_fewer_particles_are_kept_once_the_pose_is_certain(self) -> None:
        loc = localization()
        loc.initialize(SE2(0.0, 0.0, 0.0), np.diag([0.2, 0.2, 0.2]) ** 2)
        assert len(loc.particles()) == 2000
        drive(loc, sim.tour(stations=1))
        assert len(loc.particles()) == 500


class TestAtRest:
    def test_a_minute_at_rest_neither_moves_the_pose_nor_makes_it_certain(self) -> None:
        here = SE2(-0.178, 3.322, 0.785)
        loc = localization()
        loc.initialize(here, SURE)
        rng = np.random.default_rng(3)
        used = 0
        for i in range(600):
            loc.odometry(i * STEP_NS, SE2(0.0, 0.0, 0.0))
            used += feed(loc, i * STEP_NS, sim.scan_at(here, rng))
        pose, covariance = loc.pose()
        assert used == pytest.approx(60, abs=2)
        assert pose.distance_m(here) < 0.03
        assert np.sqrt(np.diag(covariance))[:2].min() > 0.01
        assert len(np.unique(loc.particles(), axis=0)) == len(loc.particles())

    def test_an_uncertain_pose_is_found_at_rest_within_a_second(self) -> None:
        here = SE2(-0.178, 3.322, 0.785)
        loc = localization()
        loc.initialize(here @ SE2(-0.2, 0.2, 0.3), np.diag([0.25, 0.25, 0.25]) ** 2)
        rng = np.random.default_rng(3)
        for i in range(10):
            loc.odometry(i * STEP_NS, SE2(0.0, 0.0, 0.0))
            feed(loc, i * STEP_NS, sim.scan_at(here, rng))
        assert loc.converged
        assert loc.pose()[0].distance_m(here) < 0.03


class TestKidnapping:
    def test_scan_match_falls_within_a_second_and_stays_low(self) -> None:
        there = SE2(3.322, -0.178, 1.571)
        loc = localization()
        loc.initialize(SE2(0.0, 0.0, 0.0), SURE)
        rng = np.random.default_rng(3)
        match = []
        for i in range(60):
            loc.odometry(i * STEP_NS, SE2(0.0, 0.0, 0.0))
            feed(loc, i * STEP_NS, sim.scan_at(SE2(0.0, 0.0, 0.0) if i < 20 else there, rng))
            match.append(loc.scan_match)
        assert min(match[:20]) > 0.95
        assert max(match[30:]) < 0.6

    def test_a_marker_in_view_brings_the_robot_back(self) -> None:
        there = SE2(-0.9, 0.3, math.radians(170.0))
        loc = localization()
        loc.initialize(SE2(3.322, -0.178, 1.571), SURE)
        rng = np.random.default_rng(3)
        for i in range(50):
            loc.odometry(i * STEP_NS, SE2(0.0, 0.0, 0.0))
            feed(loc, i * STEP_NS, sim.scan_at(there, rng))
            loc.marker(i * STEP_NS, MAP_FROM_MARKER, marker_seen_from(there, rng), BASE_FROM_CAMERA)
        assert loc.pose()[0].distance_m(there) < 0.05
        assert loc.converged
        assert loc.scan_match > 0.9


class TestMarker:
    HERE = SE2(-0.6, 0.5, math.radians(175.0))

    def drifted(self, offset: SE2, std: float) -> Localization:
        loc = localization(roughening_m=0.01, roughening_rad=0.01)
        loc.initialize(self.HERE @ offset, np.diag([std, std, std]) ** 2)
        loc.odometry(0, SE2(0.0, 0.0, 0.0))
        return loc

    def see(self, loc: Localization, candidates: list[MarkerCandidate], times: int) -> bool:
        used = False
        for i in range(times):
            loc.odometry(i * STEP_NS + 1, SE2(0.0, 0.0, 0.0))
            used |= loc.marker(i * STEP_NS + 1, MAP_FROM_MARKER, candidates, BASE_FROM_CAMERA)
        return used

    @pytest.mark.parametrize("flipped_score", [0.2, 0.8])
    def test_corrects_a_drifted_pose_though_one_solution_is_wrong(
        self, flipped_score: float
    ) -> None:
        loc = self.drifted(SE2(0.2, -0.15, 0.15), 0.2)
        rng = np.random.default_rng(3)
        before = loc.pose()[0].distance_m(self.HERE)
        candidates = marker_seen_from(self.HERE, rng, flipped_score)
        assert self.see(loc, candidates, 10)
        pose, covariance = loc.pose()
        assert pose.distance_m(self.HERE) < 0.4 * before
        assert abs(wrap_angle(pose.yaw_rad - self.HERE.yaw_rad)) < 0.1
        assert covariance[0, 0] < 0.2**2 / 2

    def test_the_wrong_solution_alone_does_not_move_a_certain_pose(self) -> None:
        loc = self.drifted(SE2(0.0, 0.0, 0.0), 0.03)
        wrong = marker_seen_from(SE2(-0.6, 1.9, math.radians(-120.0)), np.random.default_rng(3))
        self.see(loc, wrong, 10)
        assert loc.pose()[0].distance_m(self.HERE) < 0.02

    def test_a_sighting_older_than_the_last_update_counts_where_it_was_made(self) -> None:
        loc = self.drifted(SE2(0.0, 0.0, 0.0), 0.03)
        seen = marker_seen_from(self.HERE, np.random.default_rng(3), flipped_score=0.0)
        moved = SE2(0.4, 0.0, 0.5)
        for i in range(1, 11):
            loc.odometry(i * STEP_NS, SE2(0.04 * i, 0.0, 0.05 * i))
        later = self.HERE @ moved
        now_seen = marker_seen_from(later, np.random.default_rng(4), flipped_score=0.0)
        # Another marker, as near to this one as can be.
        other = MAP_FROM_MARKER.copy()
        other[0, 3] += 1e-6
        assert loc.marker(10 * STEP_NS, other, now_seen, BASE_FROM_CAMERA)
        _, sure = loc.pose()
        assert loc.marker(0, MAP_FROM_MARKER, seen, BASE_FROM_CAMERA)
        pose, surer = loc.pose()
        assert pose.distance_m(later) < 0.05
        # Taken for one from here it would be an outlier, and say nothing.
        assert surer[2, 2] < 0.9 * sure[2, 2]

    def test_what_is_not_finite_is_no_sighting(self) -> None:
        loc = self.drifted(SE2(0.0, 0.0, 0.0), 0.1)
        before = loc.particles()
        broken = np.full((4, 4), np.nan)
        good = marker_seen_from(self.HERE, np.random.default_rng(3))[0][0]
        bad: list[MarkerCandidate] = [
            (broken, MARKER_COVARIANCE, 1.0),
            (good, np.full((6, 6), np.inf), 1.0),
            (good, -MARKER_COVARIANCE * 1e3, 1.0),
            (good, np.diag([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]), 1.0),
            (good, MARKER_COVARIANCE, math.nan),
        ]
        for candidate in bad:
            assert not loc.marker(0, MAP_FROM_MARKER, [candidate], BASE_FROM_CAMERA)
        assert not loc.marker(0, MAP_FROM_MARKER, [], BASE_FROM_CAMERA)
        assert np.array_equal(loc.particles(), before)


class TestScans:
    @pytest.mark.parametrize(
        "nothing", [*([one] * 360 for one in (np.inf, -np.inf, np.nan, 0.0, 3.5)), []]
    )
    def test_a_scan_without_returns_changes_nothing(self, nothing: list[float]) -> None:
        loc = localization()
        loc.initialize(SE2(0.0, 0.0, 0.0), SURE)
        loc.odometry(0, SE2(0.0, 0.0, 0.0))
        before = loc.particles()
        assert not feed(loc, 0, np.array(nothing, np.float32))
        assert np.array_equal(loc.particles(), before)
        assert loc.scan_match == 1.0

    def test_on_open_floor_odometry_alone_tells_the_way(self) -> None:
        loc = Localization(
            LocalizationParams(), np.zeros((20, 20), np.int8), 0.05, SE2(-0.5, -0.5, 0.0),
            np.random.default_rng(0),
        )  # fmt: skip
        loc.initialize(SE2(1.0, 2.0, 0.0), SURE)
        spread_m2 = loc.pose()[1][0, 0]
        for i in range(100):
            loc.odometry(i * STEP_NS, SE2(0.05 * i, 0.0, 0.0))
            assert not feed(loc, i * STEP_NS, np.full(360, np.inf, np.float32))
        pose, covariance = loc.pose()
        assert pose == pytest.approx((5.95, 2.0, 0.0))
        assert loc.state == "localized"
        assert loc.scan_match == 1.0
        # Its scale is 4 % off, and each step's own error is added: all of them at once would be
        # worth 0.7 m.
        assert 0.15 < math.sqrt(covariance[0, 0] - spread_m2) < 0.3
        assert np.std(loc.particles()[:, 0]) == pytest.approx(math.sqrt(covariance[0, 0]), rel=0.3)

    def test_without_any_scan_the_spread_grows_with_the_way(self) -> None:
        loc = localization()
        loc.initialize(SE2(0.0, 0.0, 0.0), SURE)
        stds = []
        for i in range(201):
            loc.odometry(i * STEP_NS, SE2(0.05 * i, 0.0, 0.0))
            if i in (100, 200):
                stds.append(math.sqrt(loc.pose()[1][0, 0]))
        # A wrong scale does not average out: twice the way, nearly twice the error.
        assert 0.15 < stds[0] < 0.3
        assert 1.5 * stds[0] < stds[1] < 2.2 * stds[0]
        assert np.std(loc.particles()[:, 0]) > 0.25

    def test_two_places_are_two_clusters_each_with_its_own_spread(self) -> None:
        here, there = SE2(-0.178, 3.322, 0.785), SE2(3.322, -0.178, 1.571)
        loc = localization()
        off = np.array(there) - np.array(here)
        off /= 2.0
        # A narrow ridge between two poses; the scan fits only near its ends.
        loc.initialize(here, 4.0 * np.outer(off, off) + SURE)
        loc.odometry(0, SE2(0.0, 0.0, 0.0))
        feed(loc, 0, sim.scan_at(here))
        clusters = loc._set.clusters()
        assert clusters[0][0] == pytest.approx(loc.hypotheses()[0, 3])
        assert clusters[0][2][0, 0] < 0.2
        assert 0.7 < sum(share for share, _, _ in clusters) < 1.0 + 1e-9

    def test_a_few_returns_among_none_still_correct_the_pose(self) -> None:
        here = SE2(0.0, 0.0, 0.0)
        loc = localization()
        loc.initialize(SE2(0.1, 0.1, 0.0), np.diag([0.1, 0.1, 0.02]) ** 2)
        rng = np.random.default_rng(3)
        for i in range(30):
            ranges_m = sim.scan_at(here, rng)
            ranges_m[np.arange(360) % 12 != 0] = np.inf
            loc.odometry(i * STEP_NS, SE2(0.0, 0.0, 0.0))
            feed(loc, i * STEP_NS, ranges_m)
        assert loc.pose()[0].distance_m(here) < 0.05

    def test_a_scan_between_two_samples_of_odometry_counts_at_its_own_time(self) -> None:
        start = SE2(-0.178, 3.0, 0.3)
        turned = SE2(0.0, 0.0, 0.5)
        loc = localization()
        loc.initialize(start, SURE)
        loc.odometry(0, SE2(0.0, 0.0, 0.0))
        loc.odometry(2 * STEP_NS, turned)
        assert feed(loc, STEP_NS, sim.scan_at(start @ SE2(0.0, 0.0, 0.25)))
        pose = loc.pose()[0]
        assert pose.yaw_rad == pytest.approx(0.8, abs=0.03)
        assert loc.scan_match == 1.0

    def test_a_scan_older_than_the_last_update_counts_where_it_was_made(self) -> None:
        start = SE2(-0.6, 0.5, math.radians(175.0))
        moved = SE2(0.3, 0.0, 0.4)
        loc = localization()
        loc.initialize(start, SURE)
        loc.odometry(0, SE2(0.0, 0.0, 0.0))
        loc.odometry(STEP_NS, moved)
        seen = marker_seen_from(start @ moved, np.random.default_rng(3))
        assert loc.marker(STEP_NS, MAP_FROM_MARKER, seen, BASE_FROM_CAMERA)
        assert feed(loc, 0, sim.scan_at(start))
        assert loc.pose()[0].distance_m(start @ moved) < 0.04
        assert loc.scan_match > 0.95

    def test_what_was_seen_before_the_robot_was_put_elsewhere_is_left_out(self) -> None:
        loc = localization()
        loc.initialize(SE2(0.0, 0.0, 0.0), SURE)
        for i in range(3):
            loc.odometry(i * STEP_NS, SE2(0.0, 0.0, 0.0))
        loc.initialize(SE2(3.322, -0.178, 1.571), SURE)
        assert not feed(loc, STEP_NS, sim.scan_at(SE2(0.0, 0.0, 0.0)))
        assert feed(loc, 2 * STEP_NS, sim.scan_at(SE2(3.322, -0.178, 1.571)))

    def test_a_scan_long_after_the_last_odometry_is_left_out(self) -> None:
        loc = localization()
        loc.initialize(SE2(0.0, 0.0, 0.0), SURE)
        loc.odometry(0, SE2(0.0, 0.0, 0.0))
        assert not feed(loc, 10 * STEP_NS, sim.scan_at(SE2(0.0, 0.0, 0.0)))

    def test_a_scan_from_before_the_first_odometry_is_left_out(self) -> None:
        loc = localization()
        loc.initialize(SE2(0.0, 0.0, 0.0), SURE)
        loc.odometry(5 * STEP_NS, SE2(0.0, 0.0, 0.0))
        assert not feed(loc, STEP_NS, sim.scan_at(SE2(0.0, 0.0, 0.0)))

    def test_nothing_is_used_before_the_initial_pose(self) -> None:
        loc = localization()
        loc.odometry(0, SE2(0.0, 0.0, 0.0))
        assert not feed(loc, 0, sim.scan_at(SE2(0.0, 0.0, 0.0)))
        assert not loc.initialized
        with pytest.raises(RuntimeError, match="no initial pose"):
            loc.pose()


class TestMistakes:
    @pytest.mark.parametrize(
        ("pose", "covariance", "reason"),
        [
            (SE2(math.nan, 0.0, 0.0), np.eye(3), "initial pose"),
            (SE2(0.0, 0.0, 0.0), np.full((3, 3), np.inf), "covariance"),
            (SE2(0.0, 0.0, 0.0), -np.eye(3), "negative variance"),
        ],
    )
    def test_an_initial_pose_that_is_none_is_refused(
        self, pose: SE2, covariance: Array, reason: str
    ) -> None:
        with pytest.raises(ValueError, match=reason):
            localization().initialize(pose, covariance)


class TestLikelihoodField:
    def field(self, origin: SE2) -> tuple[Array, Array]:
        cells = np.zeros((40, 60), np.int8)
        cells[10:14, :] = 100
        made = likelihood_field(
            cells, 0.05, origin, z_hit=0.9, z_rand=0.1, sigma_hit_m=0.04, max_distance_m=2.0,
            wall_inset_cells=0.5, range_max_m=3.5,
        )  # fmt: skip
        return made.distance_m.astype(np.float64), made.log_likelihood.astype(np.float64)

    def test_open_floor_around_costs_nothing(self) -> None:
        cells = np.zeros((300, 500), np.int8)
        cells[100:104, 200:260] = 100

        def made(part: NDArray[np.int8], origin: SE2) -> LikelihoodField:
            return likelihood_field(
                part, 0.05, origin, z_hit=0.9, z_rand=0.1, sigma_hit_m=0.04, max_distance_m=2.0,
                wall_inset_cells=0.5, range_max_m=3.5,
            )  # fmt: skip

        wide = made(cells, SE2(1.0, 2.0, 0.5))
        tight = made(cells[59:145, 159:301], SE2(1.0, 2.0, 0.5) @ SE2(7.95, 2.95, 0.0))
        assert np.array_equal(wide.distance_m, tight.distance_m)
        assert wide.map_from_field == pytest.approx(tight.map_from_field)
        assert wide.distance_m[0].min() == pytest.approx(2.0)

    def test_zero_lies_half_a_cell_inside_the_wall_and_grows_with_distance(self) -> None:
        distance_m, log_likelihood = self.field(SE2(0.0, 0.0, 0.0))
        column = distance_m[:, 120]
        y_m = (np.arange(len(column)) + 0.5) * 0.0125
        # The wall's cells reach from 0.5 to 0.7 m.
        assert np.interp(0.675, y_m, column) == pytest.approx(0.0, abs=0.002)
        assert np.interp(1.675, y_m, column) == pytest.approx(1.0, abs=0.005)
        assert np.interp(0.525, y_m, column) == pytest.approx(0.0, abs=0.002)
        assert np.interp(0.6, y_m, column) < -0.05
        best = log_likelihood[:, 120].argmax() * 0.0125
        assert best == pytest.approx(0.525, abs=0.02) or best == pytest.approx(0.675, abs=0.02)

    def test_the_table_of_a_large_map_is_no_larger_than_can_be_made(self) -> None:
        cells = np.zeros((1000, 1200), np.int8)
        cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = 100
        made = likelihood_field(
            cells, 0.05, SE2(0.0, 0.0, 0.0), z_hit=0.9, z_rand=0.1, sigma_hit_m=0.04,
            max_distance_m=2.0, wall_inset_cells=0.5, range_max_m=3.5,
        )  # fmt: skip
        assert made.distance_m.size <= 8_000_000
        assert made.cell_m == pytest.approx(0.025)

    def test_a_turned_map_gives_the_same_pose(self) -> None:
        world = sim.house()
        turned = SE2(1.0, 2.0, 0.7)
        loc = Localization(
            LocalizationParams(), world.map_cells, 0.05, turned @ world.map_origin,
            np.random.default_rng(1),
        )  # fmt: skip
        here = SE2(-0.178, 3.322, 0.785)
        loc.initialize(turned @ (here @ SE2(0.05, 0.05, 0.05)), np.diag([0.1, 0.1, 0.1]) ** 2)
        for i in range(20):
            loc.odometry(i * STEP_NS, SE2(0.0, 0.0, 0.0))
            feed(loc, i * STEP_NS, sim.scan_at(here))
        assert loc.pose()[0].distance_m(turned @ here) < 0.03
        assert loc.scan_match > 0.9


class TestParticles:
    def test_resampling_keeps_each_in_proportion_to_its_weight(self) -> None:
        weights = np.array([0.5, 0.0, 0.3, 0.2])
        counts = np.bincount(low_variance_resample(weights, 0.5, 1000), minlength=4)
        assert counts == pytest.approx([500, 0, 300, 200], abs=1)

    @pytest.mark.parametrize("times", [1, 40])
    def test_smoothing_copies_leaves_mean_and_covariance_as_they_were(self, times: int) -> None:
        rng = np.random.default_rng(0)
        root = np.array([[0.2, 0.0, 0.0], [0.1, 0.05, 0.0], [0.02, 0.01, 0.03]])
        states = rng.standard_normal((1000, 3)) @ root.T + np.array([1.0, 2.0, math.pi])
        made = states
        uniform = np.full(1000, 1e-3)
        for _ in range(times):
            chosen = low_variance_resample(uniform, float(rng.random()), 1000)
            made = smoothed(made, chosen, 0.3, np.zeros(3), rng.standard_normal((1000, 3)))
        assert len(np.unique(made, axis=0)) == 1000
        assert np.abs(made[:, 2]).max() <= math.pi
        made[:, 2] %= 2.0 * math.pi
        assert made.mean(axis=0) == pytest.approx(states.mean(axis=0), abs=0.06)
        std = np.sqrt(np.diag(np.cov(made.T)))
        assert std == pytest.approx(np.sqrt(np.diag(np.cov(states.T))), rel=0.25)
        assert np.corrcoef(made.T) == pytest.approx(np.corrcoef(states.T), abs=0.15)

    def test_the_covariance_of_two_groups_includes_both(self) -> None:
        particles = ParticleSet(LocalizationParams(), np.random.default_rng(1))
        particles.begin(SE2(0.3, 0.3, 0.4), np.diag([0.02, 0.02, 0.02]) ** 2)
        half = len(particles.poses) // 2
        particles.poses[half:] += (4.0, 0.0, 3.0)
        particles.weigh(np.where(np.arange(len(particles.poses)) < half, 0.4, 0.0))
        assert 0.5 < particles.share < 0.7
        assert particles.pose.x_m == pytest.approx(0.3, abs=0.05)
        # Four metres away with probability 0.4.
        assert math.sqrt(particles.covariance[0, 0]) == pytest.approx(2.53, abs=0.1)
        assert math.sqrt(particles.covariance[1, 1]) < 0.05

    def test_mean_heading_is_circular(self) -> None:
        particles = np.array([[0.0, 0.0, math.pi - 0.1], [2.0, 0.0, -math.pi + 0.1]])
        mean, covariance = mean_and_covariance(particles, np.array([0.5, 0.5]))
        assert abs(mean.yaw_rad) == pytest.approx(math.pi)
        assert covariance[2, 2] == pytest.approx(0.01)
        assert covariance[0, 0] == pytest.approx(1.0)

    def test_driving_backwards_is_no_half_turn(self) -> None:
        noise = OdometryNoise(0.1, 0.0, 0.1, 0.1)
        forwards = odometry_motion(SE2(0.2, 0.0, 0.0), noise)
        backwards = odometry_motion(SE2(-0.2, 0.0, 0.0), noise)
        assert backwards.rotation1_std_rad == pytest.approx(forwards.rotation1_std_rad)
        assert backwards.translation_std_m == pytest.approx(forwards.translation_std_m)

    def test_more_spread_asks_for_more_particles(self) -> None:
        rng = np.random.default_rng(0)
        sizes = [
            kld_sample_size(rng.standard_normal((2000, 3)) * spread, 0.1, 0.2, 0.05, 2.33)
            for spread in (0.01, 0.1, 1.0)
        ]
        assert sizes[0] < sizes[1] < sizes[2]


def test_no_particles_are_an_empty_cloud() -> None:
    assert cloud_message(7, np.empty((0, 3))).poses == []
    assert len(cloud_message(7, np.zeros((1201, 3))).poses) == 401
