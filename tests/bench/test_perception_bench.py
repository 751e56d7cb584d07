"""The bench of marker detection: its truth, and its figures on a few pictures."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from rich.console import Console

from mazebot.bench.parts import blank_pictures as blank
from mazebot.bench.parts import perception_bench as bench
from mazebot.bench.parts.perception_views import TrueMarker, Viewer, hidden
from mazebot.common.maths.frames import SE2
from mazebot.common.world.placement import panel_of


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    made = Viewer("sim_house_markers")
    yield made
    made.close()


def before(viewer: Viewer, marker_id: int, distance_m: float, turned_rad: float = 0.0) -> SE2:
    """A pose of the robot straight before a marker, turned away from it."""
    (marker,) = (one for one in viewer.markers if one.marker_id == marker_id)
    panel = panel_of(marker)
    place = panel.centre_m + distance_m * panel.normal
    yaw_rad = math.atan2(-panel.normal[1], -panel.normal[0]) + turned_rad
    return SE2(float(place[0]), float(place[1]), yaw_rad)


def ids(seen: tuple[TrueMarker, ...]) -> set[int]:
    return {one.marker.marker_id for one in seen}


def test_a_marker_straight_ahead_is_in_view(viewer: Viewer) -> None:
    for marker in viewer.markers:
        view = viewer.look(before(viewer, marker.marker_id, 0.9))
        (truth,) = (one for one in view.in_view if one.marker.marker_id == marker.marker_id)
        # The camera is before the robot's centre.
        assert truth.range_m == pytest.approx(0.9 - viewer.base_from_optical[0, 3], abs=0.02)
        assert truth.angle_rad < math.radians(10)


def test_a_marker_behind_a_wall_or_beside_the_picture_is_not(viewer: Viewer) -> None:
    for marker in viewer.markers:
        # From behind its own wall, through which nothing is seen.
        pose = before(viewer, marker.marker_id, -0.9, math.pi)
        assert marker.marker_id not in viewer.look(pose).partly
        aside = viewer.look(before(viewer, marker.marker_id, 0.9, math.radians(70)))
        assert marker.marker_id not in aside.partly


def test_a_marker_at_the_edge_of_the_picture_is_partly_in_view(viewer: Viewer) -> None:
    marker = viewer.markers[0]
    view = viewer.look(before(viewer, marker.marker_id, 0.9, math.radians(30)))
    assert marker.marker_id in view.partly
    assert marker.marker_id not in ids(view.in_view)


def test_a_triangle_hides_what_is_behind_it_alone() -> None:
    triangle = np.array([[(1.0, -1.0, -1.0), (1.0, 2.0, -1.0), (1.0, -1.0, 2.0)]])
    targets = np.array([(2.0, 0.0, 0.0), (0.9, 0.0, 0.0), (2.0, 4.0, 4.0), (-2.0, 0.0, 0.0)])
    assert hidden(np.zeros(3), targets, triangle).tolist() == [True, False, False, False]
    assert hidden(np.zeros(3), targets, triangle[:0]).tolist() == [False] * 4


def test_what_is_in_view_is_where_the_picture_shows_it(viewer: Viewer) -> None:
    generator = np.random.default_rng(3)
    for _ in range(5):
        pose = viewer.pose_before_a_marker(generator, (1.0, 2.0), (0.0, 0.5))
        assert pose is not None
        view = viewer.look(pose)
        grey = np.asarray(cv2.cvtColor(view.rgb, cv2.COLOR_RGB2GRAY), np.uint8)
        for truth in view.in_view:
            place = truth.camera_from_marker[:3, 3]
            of = viewer.intrinsics
            x, y = of.fx * place[0] / place[2] + of.cx, of.fy * place[1] / place[2] + of.cy
            # The code's own modules, which have both colours.
            r = round(of.fx * 0.1 * math.cos(truth.angle_rad) / place[2])
            around = grey[round(y) - r : round(y) + r, round(x) - r : round(x) + r]
            assert around.min() < 40
            assert around.max() > 200


def test_unwith_markers_worlds_have_no_markers() -> None:
    bare = Viewer("sim_house_markers", with_markers=False)
    assert bare.markers == ()
    bare.close()


def test_blank_pictures_are_of_every_kind_and_repeat() -> None:
    kinds = list(blank._MAKERS)
    first = [make(np.random.default_rng(1)) for make in blank._MAKERS.values()]
    again = [make(np.random.default_rng(1)) for make in blank._MAKERS.values()]
    for kind, one, two in zip(kinds, first, again, strict=True):
        assert one.shape == (480, 640), kind
        assert one.dtype == np.uint8
        assert one.std() > 5.0, kind
        assert (one == two).all(), kind


@pytest.mark.slow
def test_the_figures_are_those_of_a_detector_that_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "WORLDS", (("sim_house_markers", ()),))
    monkeypatch.setattr(blank, "WORLDS", ("sim_house", "sim_house_rooms"))
    figures = bench.perception_figures(96, 1)
    assert figures["markers_in_view"] >= 4
    assert figures["recall"] == 1.0
    assert figures["position_error_p95"] < 0.02
    assert figures["wrong_ids"]["used"] == 0
    assert sum(one["pictures"] for one in figures["wrong_ids"]["by_kind"].values()) == 96
    assert sum(one["markers_in_view"] for one in figures["bins"]) == figures["markers_in_view"]
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures
    console = Console(width=200, record=True)
    for table in bench.perception_tables(figures):
        console.print(table)
    assert "as rendered" in console.export_text()
    monkeypatch.setattr("mazebot.perception.detect.Detector.detect", lambda *_: [])
    blind = bench.perception_figures(12, 1)
    assert blind["recall"] == 0.0
    assert blind["position_error_p95"] is None
