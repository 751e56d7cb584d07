"""What beams say about a pose."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages.scan import Scan
from mazebot.localization.beam_model import (
    HIT,
    MISFIT,
    MISSING,
    OPEN,
    SHORT,
    THROUGH,
    UNMAPPED,
    RayMap,
    ScanView,
    consistencies,
    in_wall,
    judge,
    mapped_returns,
    moved_view,
    qualities,
    scan_view,
)
from mazebot.localization.global_search.scan_matching import refine
from mazebot.localization.likelihood_field import likelihood_field
from tests.localization import offline

ROOM = offline.rectangle(4.0, 3.0)
LONG = offline.rectangle(20.0, 3.0)
BEHIND = SE2(0.0, 2.5, 0.0)
"""In the yard, behind the room's wall."""


def rays(place: offline.Place) -> RayMap:
    field = likelihood_field(
        place.cells, place.resolution_m, place.origin, z_hit=0.9, z_rand=0.1, sigma_hit_m=0.04,
        max_distance_m=2.0, wall_inset_cells=0.5, range_max_m=3.5,
    )  # fmt: skip
    return RayMap.of(place.cells, place.resolution_m, place.origin, field, 0.5, 0.1)


def view(
    place: offline.Place, pose: SE2, more: Array | None = None, lost: tuple[int, ...] = ()
) -> ScanView:
    ranges_m = place.ranges(pose, more)
    ranges_m[ranges_m > offline.RANGE_MAX_M] = np.inf
    ranges_m[list(lost)] = np.inf
    return scan_view(
        Scan(
            ranges_m.astype(np.float32),
            0.0,
            math.tau / offline.BEAMS,
            offline.RANGE_MIN_M,
            offline.RANGE_MAX_M,
            offline.BASE_FROM_SCAN,
        ),
        90,
    )


def counts_at(place: offline.Place, pose: SE2, seen: ScanView) -> Array:
    return np.asarray(judge(rays(place), np.array([pose]), seen)[0][0])


def quality_at(place: offline.Place, pose: SE2, seen: ScanView) -> float:
    return float(qualities(judge(rays(place), np.array([pose]), seen)[0], 0.35)[0])


class TestBeams:
    def test_at_the_true_pose_each_is_a_hit_or_open(self) -> None:
        here = SE2(0.3, -0.4, 0.7)
        counts = counts_at(LONG, here, view(LONG, here))
        assert counts[HIT] > 20
        assert counts[OPEN] > 20
        assert counts[[SHORT, MISFIT, THROUGH, MISSING]].sum() == 0

    def test_a_box_in_the_way_shortens_some(self) -> None:
        here = SE2(0.0, 0.0, 0.0)
        seen = view(ROOM, here, offline.box_faces(0.8, 0.0, 0.3, 0.4, 0.4))
        counts = counts_at(ROOM, here, seen)
        assert counts[SHORT] > 5
        assert counts[[THROUGH, MISSING]].sum() == 0
        assert quality_at(ROOM, here, seen) == 1.0

    def test_where_the_map_has_a_wall_and_nothing_returns_they_are_missing(self) -> None:
        seen = view(LONG, SE2(0.0, 0.0, 0.0))
        counts = counts_at(LONG, SE2(8.5, 0.0, 0.0), seen)
        assert counts[MISSING] > 5
        assert quality_at(LONG, SE2(8.5, 0.0, 0.0), seen) < 0.9

    def test_from_a_pose_behind_the_wall_they_pass_through_it(self) -> None:
        seen = view(ROOM, SE2(0.0, 0.0, 0.0))
        counts = counts_at(ROOM, BEHIND, seen)
        assert counts[THROUGH] > 20
        assert quality_at(ROOM, BEHIND, seen) < 0.4

    def test_a_few_centimetres_off_none_passes_through_a_wall(self) -> None:
        here = SE2(1.5, 1.0, 0.7)
        counts = counts_at(ROOM, here @ SE2(0.05, -0.04, 0.03), view(ROOM, here))
        assert counts[THROUGH] == 0

    def test_the_far_face_of_a_wall_fits_less_than_the_near_one(self) -> None:
        # One long wall alone: moved through half of it, the beams end at its other face.
        wall = offline.rectangle(30.0, 30.0)
        here = SE2(0.0, 13.0, 0.0)
        beyond = SE2(0.0, 13.11, 0.0)
        _, likelihoods = judge(rays(wall), np.array([here, beyond]), view(wall, here))
        assert likelihoods[0] > likelihoods[1] + 3.0

    def test_nothing_seen_where_nothing_is_contradicts_nothing(self) -> None:
        hall = offline.rectangle(20.0, 20.0)
        seen = view(hall, SE2(0.0, 0.0, 0.0))
        assert seen.returns == 0
        assert quality_at(hall, SE2(2.0, 1.0, 0.5), seen) == 1.0
        assert quality_at(hall, SE2(9.0, 9.0, 0.5), seen) == 0.0

    def test_beams_without_a_return_count_by_their_number_though_thinned_apart(self) -> None:
        here = SE2(0.0, 0.0, 0.0)
        seen = view(ROOM, here, lost=tuple(i for i in range(360) if i % 10))
        counts = counts_at(ROOM, here, seen)
        assert counts[MISSING] / counts[HIT] == pytest.approx(9.0, rel=0.1)

    def test_large_things_that_are_not_on_the_map_contradict_nothing(self) -> None:
        here = SE2(0.0, 0.0, 0.0)
        seen = view(ROOM, here, offline.box_faces(0.0, 0.0, 0.0, 1.4, 1.4))
        counts = judge(rays(ROOM), np.array([here, BEHIND]), seen)[0]
        assert counts[0, SHORT] == seen.returns
        assert consistencies(counts)[0] == 1.0
        seen = view(ROOM, here)
        counts = judge(rays(ROOM), np.array([here, BEHIND]), seen)[0]
        assert consistencies(counts)[1] < 0.4

    def test_returns_from_where_the_map_shows_nothing_say_nothing(self) -> None:
        cells = LONG.cells.copy()
        cells[:, 200:] = -1
        known = dataclasses.replace(LONG, cells=cells)
        here = SE2(-0.8, 0.0, 0.0)
        seen = view(LONG, here)
        counts = judge(rays(known), np.array([here]), seen)[0]
        assert counts[0, UNMAPPED] > 10
        assert counts[0, [SHORT, MISFIT, THROUGH, MISSING]].sum() == 0
        assert consistencies(counts)[0] == 1.0
        assert qualities(counts, 0.35)[0] == pytest.approx(counts[0, HIT] / seen.returns)
        mapped = mapped_returns(rays(known), here, seen)
        assert mapped.sum() == counts[0, HIT]
        assert seen.points_m[~mapped, 0].min() > 0.3


class TestScanView:
    def test_what_is_too_near_or_no_number_says_nothing(self) -> None:
        ranges_m = np.array([1.0, -np.inf, np.nan, 0.05, np.inf, 3.5], np.float32)
        seen = scan_view(Scan(ranges_m, 0.0, 0.1, 0.12, 3.5, SE2(0.0, 0.0, 0.0)), 90)
        assert seen.returns == 1
        assert len(seen.directions) == 3

    def test_moved_it_is_that_of_another_frame(self) -> None:
        here, there = SE2(0.3, -0.4, 0.7), SE2(0.5, 0.1, -0.2)
        seen = moved_view(view(ROOM, here), there.inverse() @ here)
        assert counts_at(ROOM, there, seen)[HIT] == seen.returns


class TestInWall:
    def test_in_a_wall_and_beside_it(self) -> None:
        poses = np.array([SE2(2.07, 0.0, 0.0), SE2(1.5, 0.0, 0.0)])
        assert in_wall(rays(ROOM), poses, 0.05).tolist() == [True, False]


class TestRefine:
    def test_a_pose_near_the_true_one_is_drawn_to_it(self) -> None:
        here = SE2(0.6, -0.4, 0.7)
        off = here @ SE2(0.15, -0.1, 0.12)
        poses, _ = refine(
            rays(ROOM).field, np.array([off]), view(ROOM, here).points_m, prior_std_m=0.5,
            prior_std_rad=0.5, return_std_m=0.1,
        )  # fmt: skip
        assert SE2(*poses[0]).distance_m(here) < 0.03
        assert poses[0, 2] == pytest.approx(here.yaw_rad, abs=0.01)

    def test_along_a_corridor_it_stays_where_it_was(self) -> None:
        here = SE2(0.0, 0.0, 0.0)
        poses, information = refine(
            rays(LONG).field, np.array([SE2(0.2, 0.1, 0.0)]), view(LONG, here).points_m,
            prior_std_m=0.1, prior_std_rad=0.1, return_std_m=0.1,
        )  # fmt: skip
        assert poses[0, 0] == pytest.approx(0.2, abs=0.02)
        assert poses[0, 1] == pytest.approx(0.0, abs=0.03)
        assert information[0, 1, 1] > 10.0 * information[0, 0, 0]
