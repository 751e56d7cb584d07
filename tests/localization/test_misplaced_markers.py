"""Markers that hang elsewhere than the map says, while the scans fit the pose."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2, Array, rotation_from_rpy
from mazebot.localization.markers.marker_trust import marker_key
from tests.localization import offline

NEAR = np.diag([0.05, 0.05, 0.05]) ** 2


def moved(marker: Array, out_m: float = 0.0, aside_m: float = 0.0, turn_deg: float = 0.0) -> Array:
    """A marker out of its wall, along it, or turned about the vertical."""
    made = marker.copy()
    made[:3, 3] += out_m * marker[:3, 2] + aside_m * marker[:3, 0]
    made[:3, :3] = rotation_from_rpy(0.0, 0.0, math.radians(turn_deg)) @ marker[:3, :3]
    return made


def facing_a_marker(world: str, seed: int) -> offline.Robot:
    """A robot that knows its pose, with the world's first marker in view."""
    place, rng = offline.shipped(world), np.random.default_rng(seed)
    here = place.free_pose(rng)
    while not offline.marker_seen(place, here, place.markers[0], rng):
        here = place.free_pose(rng)
    made = offline.Robot(place, here, place.localization(seed), rng)
    made.loc.initialize(here, NEAR)
    made.sense()
    return made


def wander(
    made: offline.Robot, seconds: float, mapped: Mapping[int, Array], hung: Mapping[int, Array]
) -> tuple[set[str], float]:
    """Drive by scans and markers, some of which are mapped, or hang, elsewhere; returns the states
    and the largest error.
    """
    states: set[str] = set()
    worst_m = 0.0
    for step in range(round(seconds * 20)):
        made.wander()
        for index, marker in enumerate(made.place.markers if step % 2 else ()):
            seen = offline.marker_seen(made.place, made.pose, hung.get(index, marker), made.rng)
            known = mapped.get(index, marker)
            made.loc.marker(made.now_ns, known, seen, offline.BASE_FROM_CAMERA)
        states.add(made.loc.state)
        worst_m = max(worst_m, made.error()[0])
    return states, worst_m


HOUSE, CAMERA_HOUSE = "sim_house_enhanced", "sim_house_markers"


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("out_m", "aside_m", "turn_deg"),
    [(0.2, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 90.0)],
)
def test_a_marker_that_every_scan_contradicts_is_the_wrong_one(
    out_m: float, aside_m: float, turn_deg: float, seed: int
) -> None:
    made = facing_a_marker(HOUSE, seed)
    wrong = moved(made.place.markers[0], out_m, aside_m, turn_deg)
    states, worst_m = wander(made, 25.0, {0: wrong}, {})
    assert states == {"localized"}
    assert worst_m < 0.08
    assert list(made.loc.misplaced) == [marker_key(wrong)]
    seen = made.loc.misplaced[marker_key(wrong)]
    assert np.allclose(seen[:2, 3], made.place.markers[0][:2, 3], atol=0.1)


def test_two_markers_that_are_swapped_are_both_wrong() -> None:
    made = facing_a_marker(CAMERA_HOUSE, 1)
    first, second = made.place.markers[:2]
    states, worst_m = wander(made, 40.0, {0: second, 1: first}, {})
    assert states == {"localized"}
    assert worst_m < 0.08
    assert set(made.loc.misplaced) <= {marker_key(first), marker_key(second)}
    assert marker_key(second) in made.loc.misplaced


def test_it_is_used_again_when_it_hangs_where_the_map_has_it() -> None:
    made = facing_a_marker(HOUSE, 0)
    marker = made.place.markers[0]
    mapped = moved(marker, 0.2)
    x_m, y_m = (marker[:2, 3] + 1.2 * marker[:2, 2]).tolist()
    made.kidnap(SE2(x_m, y_m, math.atan2(-marker[1, 2], -marker[0, 2])))
    made.loc.initialize(made.pose, NEAR)
    for hung, misplaced in ((marker, [marker_key(mapped)]), (mapped, [])):
        for _ in range(100):
            made.drive(0.0, 0.0)
            seen = offline.marker_seen(made.place, made.pose, hung, made.rng)
            assert seen
            made.loc.marker(made.now_ns, mapped, seen, offline.BASE_FROM_CAMERA)
        assert list(made.loc.misplaced) == misplaced


def test_markers_that_are_right_stay_in_use_when_the_robot_is_carried_away() -> None:
    made = facing_a_marker(CAMERA_HOUSE, 3)
    for _ in range(4):
        made.kidnap(made.place.free_pose(made.rng))
        wander(made, 20.0, {}, {})
        assert not made.loc.misplaced
    assert made.loc.state == "localized"
    assert made.error()[0] < 0.05


def test_a_search_from_nothing_judges_markers_anew() -> None:
    made = facing_a_marker(HOUSE, 0)
    wander(made, 25.0, {0: moved(made.place.markers[0], 0.2)}, {})
    assert made.loc.misplaced
    made.loc.global_localization()
    assert not made.loc.misplaced
