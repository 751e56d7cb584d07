"""The layouts of the viewer: their names, what they show, and how one is put before a recording."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import DIAGNOSTICS, read_by
from mazebot.recorder.config import LayoutName, RecorderConfig
from mazebot.recorder.drawing.archetypes import DRAW, draw_start
from mazebot.recorder.drawing.layouts.layout_file import shown_in_layout
from mazebot.recorder.drawing.layouts.layouts import LAYOUTS, run_blueprint
from mazebot.recorder.drawing.layouts.views import Scene
from mazebot.recorder.stream.recording import Recording
from mazebot.recorder.stream.rerun_program import rerun_binary
from tests.common.samples import SAMPLES
from tests.recorder.drawing.test_archetypes import canvas_of, column, driven
from tests.recorder.synthetic import room

SCENE = Scene((np.array([-1.0, -2.0]), np.array([3.0, 4.0])), slam=True)
KINDS: dict[type, type] = {
    rr.TextDocument: rrb.TextDocumentView,
    rr.TextLog: rrb.TextLogView,
    rr.StateChange: rrb.StateTimelineView,
    rr.Points3D: rrb.Spatial3DView,
    rr.LineStrips3D: rrb.Spatial3DView,
    rr.Mesh3D: rrb.Spatial3DView,
    rr.Arrows3D: rrb.Spatial3DView,
    rr.GridMap: rrb.Spatial3DView,
    rr.Ellipsoids3D: rrb.Spatial3DView,
    rr.Pinhole: rrb.Spatial3DView,
    rr.LineStrips2D: rrb.Spatial2DView,
    rr.EncodedImage: rrb.Spatial2DView,
    rr.EncodedDepthImage: rrb.Spatial2DView,
}
"""The view that shows an archetype."""
UNSEEN = ("parameters/", "world/walls_above/", "world/bodies_above/", "world/ceiling")
"""A view for each service's configuration would be too many; and what would hide the rooms."""


def views_in(part: Any) -> list[Any]:
    """The views of a layout."""
    if not isinstance(part, rrb.Container):
        return [part]
    return [view for one in part.contents for view in views_in(one)]


def contents_of(view: Any) -> list[str]:
    """Its rules of what is in it; a view without any shows its origin."""
    contents = view.contents
    return [contents] if isinstance(contents, str) else list(contents)


def is_shown(path: str, view: Any) -> bool:
    """Whether an entity is in a view: the most particular rule that fits says it."""
    origin = str(view.origin or "/").rstrip("/")
    best, shown = -1, False
    for rule in contents_of(view):
        sign, _, name = rule.rpartition(" ")
        name = name.replace("$origin", origin)
        base = name.removesuffix("/**")
        fits = path == base or (name.endswith("/**") and path.startswith(f"{base}/"))
        if fits and len(name) > best:
            best, shown = len(name), sign != "-"
    return shown


def test_every_name_has_a_layout_and_the_first_is_the_default() -> None:
    assert set(get_args(LayoutName)) == set(LAYOUTS)
    assert RecorderConfig().layout == "overview"


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("scene", [SCENE, Scene(None)])
def test_a_layout_has_each_view_once(name: LayoutName, scene: Scene) -> None:
    rr.set_strict_mode(True)
    assert run_blueprint(scene, name) is not None
    names = [str(view.name) for view in views_in(LAYOUTS[name](scene))]
    assert len(set(names)) == len(names)
    assert "Events" in names


def test_all_that_is_drawn_can_be_seen_in_some_layout() -> None:
    views = [view for make in LAYOUTS.values() for view in views_in(make(SCENE))]
    canvas, paper = canvas_of(room().model_copy(update={"slam": True}))
    draw_start(canvas)
    canvas.camera = SAMPLES[next(one for one in DRAW if one.name.endswith("color/camera_info"))]
    for topic in read_by("recorder"):
        DRAW[topic](canvas, SAMPLES[topic])
    _, also = driven(2.0)
    wanted: list[tuple[str, type]] = [
        (path, rrb.TimeSeriesView) for path in {*paper.scalars, *also.scalars}
    ]
    for path, logged in [*paper.logged.items(), *also.logged.items()]:
        kinds = [KINDS[type(one)] for one in logged if type(one) in KINDS]
        wanted += [(path, kind) for kind in kinds]
    assert {kind for _, kind in wanted} == {rrb.TimeSeriesView, *KINDS.values()}
    unseen = {
        path
        for path, kind in wanted
        if not any(isinstance(view, kind) and is_shown(f"/{path}", view) for view in views)
    }
    assert not [path for path in unseen if not path.startswith(UNSEEN)]


def test_events_tell_of_goals_contacts_markers_and_faults_once() -> None:
    _, paper = driven(3.0)
    told = {
        path: [text for one in logged for text in column(one, "text").to_pylist()]
        for path, logged in paper.logged.items()
        if path.startswith("events/")
    }
    assert told["events/marker"] == ["marker 60 seen for the first time"]
    assert any(text.startswith("goal: ") for text in told["events/goal"])


def test_a_service_s_faults_are_events_and_its_start_is_none() -> None:
    canvas, paper = canvas_of(room())

    def report(stamp_s: int, message: str, **counts: int) -> None:
        values = [msg.KeyValue(key, str(count)) for key, count in counts.items()]
        status = msg.DiagnosticStatus(0, "mapping", message, "", values)
        array = msg.DiagnosticArray(msg.header(stamp_s * 1_000_000_000, ""), [status])
        DRAW[DIAGNOSTICS](canvas, array)

    rejected = "rejected /scan: not finite"
    report(1, "waiting for the world")
    report(2, "active")
    report(3, "active", **{rejected: 1})
    report(4, "active", **{rejected: 1})
    report(5, "active", **{rejected: 2})
    report(6, "waiting for /odom", **{rejected: 2})
    report(7, "active", **{rejected: 2})
    events = [column(one, "text")[0].as_py() for one in paper.logged["events/fault"]]
    assert events == [
        f"mapping: {rejected}",
        "mapping: waiting for /odom",
        "mapping: active again",
    ]
    states = [
        column(one, "state")[0].as_py()
        for one in paper.logged["diagnostics/mapping"]
        if isinstance(one, rr.StateChange)
    ]
    assert states == ["waiting", "active", "rejecting", "active", "rejecting", "waiting", "active"]
    assert [value for _, value in paper.scalars["performance/rejected/mapping"]][-1] == 2.0


def test_markers_are_drawn_by_their_state() -> None:
    _, paper = driven(3.0)
    labels = [
        label
        for one in paper.logged["aruco/markers"]
        if isinstance(one, rr.Points3D) and one.labels is not None
        for label in one.labels.as_arrow_array().to_pylist()
    ]
    assert labels == ["60 not seen", "60 detected"]


def test_a_run_s_extent_is_kept_in_its_recording() -> None:
    kept = Scene.from_properties(SCENE.properties())
    assert kept.slam
    assert kept.extent is not None
    assert np.concatenate(kept.extent).tolist() == [-1.0, -2.0, 3.0, 4.0]
    assert Scene.from_properties({"extent_m": "1 2 3"}) == Scene(None)
    assert Scene.from_properties({}) == Scene(None)


def test_a_recording_can_be_shown_in_another_layout(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    blueprint = run_blueprint(SCENE)
    recording = Recording(
        "a", path=path, live=None, blueprint=blueprint, properties=SCENE.properties()
    )
    recording.log("world/rooms", rr.Points3D([[1.0, 2.0, 3.0]]), static=True)
    recording.close()
    head, layout, rest = shown_in_layout([path], "drive", tmp_path)
    # First which recording it is, then the layout: a viewer drops one for an unknown recording.
    assert not RrdReader(head).blueprints()
    assert RrdReader(head).recordings() == RrdReader(path).recordings()
    assert RrdReader(layout).blueprints()
    # Without its own layout, which would be shown instead.
    assert RrdReader(path).blueprints()
    assert not RrdReader(rest).blueprints()
    assert "/world/rooms" in {chunk.entity_path for chunk in RrdReader(rest).stream()}
    for file in (head, rest):
        subprocess.run([str(rerun_binary()), "rrd", "verify", str(file)], check=True)


def test_of_a_damaged_recording_the_layout_comes_last(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    path.write_bytes(b"nothing")
    assert shown_in_layout([path], "drive", tmp_path) == [path, tmp_path / "layout.rbl"]
