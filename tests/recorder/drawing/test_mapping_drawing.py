"""How a run that makes a map is drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.recorder.drawing.archetypes import DRAW, draw_start
from mazebot.recorder.drawing.layouts.layouts import run_blueprint
from mazebot.recorder.drawing.layouts.views import Scene
from mazebot.recorder.drawing.mapping_drawing import (
    SLAM_SERIES,
    draw_map_evaluation,
    draw_true_walls,
)
from mazebot.recorder.drawing.text_drawing import draw_evaluation
from tests.common.samples import SAMPLES
from tests.recorder.drawing.test_archetypes import Paper, canvas_of, column
from tests.recorder.synthetic import room


def slam_canvas() -> tuple[Any, Paper]:
    return canvas_of(room().model_copy(update={"slam": True}))


def test_a_map_that_grows_is_drawn_where_its_new_origin_says() -> None:
    canvas, paper = slam_canvas()
    for at_s, (corner, side) in enumerate(((SE2(0.0, 0.0, 0.0), 4), (SE2(-1.0, -0.5, 0.0), 40))):
        canvas.now_ns = at_s * 1_000_000_000
        cells = np.full((side, 2 * side), -1, np.int8)
        DRAW[table.MAP](canvas, msg.occupancy_grid(0, 0.05, corner, cells))
    pictures = [one for one in paper.logged["map"] if type(one).__name__ == "GridMap"]
    places = [column(one, "translation").to_pylist()[0][:2] for one in pictures]
    assert places == [pytest.approx([0.0, 0.0]), pytest.approx([-1.0, -0.5])]
    sizes = [column(one, "format").to_pylist()[0] for one in pictures]
    assert [(size["width"], size["height"]) for size in sizes] == [(8, 4), (80, 40)]


def test_the_graph_shows_its_edges_by_kind_and_its_markers_by_id() -> None:
    canvas, paper = slam_canvas()
    DRAW[table.POSE_GRAPH](canvas, SAMPLES[table.POSE_GRAPH])
    drawn = {
        name: column(paper.logged[f"pose_graph/{name}"][-1], "strips").to_pylist()
        for name in ("odometry", "loop", "marker")
    }
    assert [len(strips) for strips in drawn.values()] == [1, 0, 1]
    assert drawn["odometry"][0] == [pytest.approx([0, 0, 0.08]), pytest.approx([1, 0, 0.08])]
    assert drawn["marker"][0][1] == pytest.approx([0.0, 1.0, 0.3])
    assert len(column(paper.logged["pose_graph/nodes"][-1], "positions")) == 2
    assert column(paper.logged["pose_graph/landmarks/names"][-1], "labels").to_pylist() == ["60"]
    # It faces along its z axis: the world's -x.
    blue = column(paper.logged["pose_graph/landmarks"][-1], "vectors").to_pylist()[2]
    assert blue == pytest.approx([-0.2, 0.0, 0.0], abs=1e-6)


def test_an_edge_to_what_is_not_there_is_left_out() -> None:
    canvas, paper = slam_canvas()
    graph = SAMPLES[table.POSE_GRAPH]
    bare = graph.model_copy(update={"nodes": graph.nodes[:1], "landmarks": ()})
    DRAW[table.POSE_GRAPH](canvas, bare)
    for kind in ("odometry", "marker"):
        assert len(column(paper.logged[f"pose_graph/{kind}"][-1], "strips")) == 0


def test_frontiers_come_and_go_in_their_own_colours() -> None:
    canvas, paper = slam_canvas()
    strip = msg.line_strip(
        0, "map", "frontier", 0, np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 0.0]]), 0.1,
        (1.0, 0.5, 0.0, 1.0),
    )  # fmt: skip
    strip.type = msg.Marker.POINTS
    DRAW[table.FRONTIERS](canvas, msg.marker_array([strip]))
    points = paper.logged["explore/frontiers"][-1]
    assert column(points, "positions").to_pylist() == [[0.0, 0.0, 0.0], [1.0, 2.0, 0.0]]
    assert set(column(points, "colors").to_pylist()) == {0xFF8000FF}
    strip.points = []
    DRAW[table.FRONTIERS](canvas, msg.marker_array([strip]))
    assert len(column(paper.logged["explore/frontiers"][-1], "positions")) == 0


def test_only_runs_that_make_a_map_have_its_plots_and_its_layout() -> None:
    canvas, paper = slam_canvas()
    draw_start(canvas)
    for topic in (table.POSE_GRAPH, table.EXPLORATION_STATUS):
        DRAW[topic](canvas, SAMPLES[topic])
    judged = doc.MapEvaluation(coverage_share=0.5, walls_found_share=0.25, walls_true_share=1.0)
    draw_map_evaluation(canvas, judged)
    assert set(SLAM_SERIES) <= set(paper.logged)
    assert set(paper.scalars) == set(SLAM_SERIES)
    assert paper.scalars["mapping/coverage_percent"] == [(0, 50.0)]
    plain, plain_paper = canvas_of(room())
    draw_start(plain)
    assert not set(SLAM_SERIES) & set(plain_paper.logged)
    extent = np.zeros(2), np.ones(2)
    names = [_names(run_blueprint(Scene(extent, slam)).root_container) for slam in (False, True)]
    assert set(names[1]) - set(names[0]) == {"mapping", "Mapped (%)", "Frontiers", "Pose graph"}


def test_true_walls_are_lines_above_the_map() -> None:
    canvas, paper = slam_canvas()
    draw_true_walls(canvas, np.array([[[0.0, 1.0], [2.0, 1.0]]]))
    strips = column(paper.logged["mapping/true_walls"][-1], "strips").to_pylist()
    assert strips == [[pytest.approx([0.0, 1.0, 0.03]), pytest.approx([2.0, 1.0, 0.03])]]


def test_the_figures_of_the_map_are_in_the_results() -> None:
    canvas, paper = slam_canvas()
    steps = (doc.CoverageStep(time_s=61.0, driven_m=12.3, coverage_share=0.9012),) * 2
    judged = doc.MapEvaluation(
        walls_found_share=0.987, coverage_share=0.9012, milestones=steps, exploration="exploring",
        trajectory_error_m=doc.TrajectoryError(rmse=0.01, p95=0.02, max=0.03),
    )  # fmt: skip
    draw_evaluation(canvas, doc.Evaluation(mapping=judged))
    (text,) = column(paper.logged["evaluation"][-1], "text").to_pylist()
    for said in (
        "# Exploration: exploring",
        "| walls found | 98.7% within 0.10 m |",
        "|  | 90% at 61 s and 12.3 m |",
        "| path error | rmse 0.010 m, p95 0.020 m, max 0.030 m |",
        "- contacts: 0",
    ):
        assert said in text.splitlines(), text
    # Not at each step, but at the end whenever that is.
    draw_evaluation(canvas, doc.Evaluation(mapping=judged))
    assert len(paper.logged["evaluation"]) == 1
    draw_evaluation(canvas, doc.Evaluation(mapping=judged), final=True)
    assert len(paper.logged["evaluation"]) == 2


def _names(part: Any) -> list[str]:
    """Of all views in a container."""
    inside = getattr(part, "contents", None)
    if isinstance(inside, list | tuple) and inside and not isinstance(inside[0], str):
        return [name for one in inside for name in _names(one)]
    return [part.name] if part.name else []
