"""A run in which the robot makes the map: what is kept of it, and how it is judged."""

from __future__ import annotations

import json
import logging
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.common.messages.slam_documents import (
    ExplorationStatus,
    GraphLandmark,
    GraphNode,
    GraphScan,
    PoseGraph,
)
from mazebot.common.world.map_files import read_map
from mazebot.common.world.marker_file import read_markers
from mazebot.recorder.judging.evaluation import RunEvaluation
from mazebot.recorder.keeping.run import map_folder as map_folder_module
from mazebot.recorder.keeping.run.map_folder import WRITE_PERIOD_NS, MapFolder
from tests.recorder.synthetic import (
    ERROR_M,
    Bench,
    Said,
    driving,
    marker_on_the_east_wall,
    opening,
    room,
    static_transforms,
)
from tests.recorder.test_node import recorder, summary_of

SECOND_NS = 1_000_000_000
ORIGIN = SE2(-2.1, -2.1, 0.0)


def slam_room() -> doc.World:
    return room().model_copy(update={"slam": True})


def grid(seen_m: float, origin: SE2 = ORIGIN, side: int = 84) -> msg.OccupancyGrid:
    """The room's map up to an x: free floor, the cells of its inner faces, and unknown beyond."""
    middle = 0.05 * (np.arange(side) + 0.5)
    x, y = np.meshgrid(origin.x_m + middle, origin.y_m + middle)
    far = np.maximum(abs(x), abs(y))
    cells = np.full(x.shape, -1, np.int8)
    cells[far < 1.975] = 100
    cells[far < 1.925] = 0
    cells[x > seen_m] = -1
    return msg.occupancy_grid(0, 0.05, origin, cells)


def graph(world: doc.World, nodes: int = 1) -> PoseGraph:
    marker = marker_on_the_east_wall()
    x, y, z = marker.position_m
    at = doc.Planar(x_m=1.0, y_m=0.0, yaw_rad=0.0)
    return PoseGraph(
        world_hash=world.hash,
        nodes=tuple(
            GraphNode(id=n, stamp_ns=0, pose=at, scan=GraphScan(points_mm="", sensor=at))
            for n in range(nodes)
        ),
        landmarks=(
            GraphLandmark(
                dictionary=marker.dictionary, marker_id=marker.marker_id,
                position_m=(x, y + 0.02, z), orientation_xyzw=marker.orientation_xyzw,
                std_m=0.01, sightings=3,
            ),
        ),
        loops=2,
    )  # fmt: skip


def without_map(world: doc.World) -> list[Said]:
    """As an opening is where mapping has not begun."""
    return [said for said in opening(world) if said[1] is not table.MAP]


def exploring(world: doc.World) -> list[Said]:
    """Four seconds, in which the map becomes whole."""
    said = list(driving(world, 4.0))
    for at_ns, topic, message in (
        (SECOND_NS, table.MAP, grid(0.0)),
        (SECOND_NS, table.POSE_GRAPH, graph(world)),
        (2 * SECOND_NS, table.EXPLORATION_STATUS, ExplorationStatus(state="exploring")),
        (3 * SECOND_NS, table.MAP, grid(9.0, SE2(-2.6, -3.1, 0.0), 110)),
        (3 * SECOND_NS + 1, table.POSE_GRAPH, graph(world, 2)),
        (3 * SECOND_NS + 2, table.EXPLORATION_STATUS, ExplorationStatus(state="complete")),
    ):
        index = next(i for i, one in enumerate(said) if one[0] > at_ns)
        said.insert(index, (at_ns, topic, message))
    return said


def test_a_run_that_makes_a_map_keeps_it_and_is_judged(tmp_path: Path) -> None:
    world = slam_room()
    bench = Bench(recorder(tmp_path))
    bench.say(without_map(world))
    bench.say(exploring(world))
    bench.node.close()
    (run,) = tmp_path.iterdir()
    mapping = summary_of(run)["mapping"]
    assert doc.MapEvaluation.model_validate(mapping)
    for name in ("walls_found", "walls_true", "coverage"):
        assert mapping[f"{name}_share"] == 1.0, name
    assert mapping["free_wrong_share"] == 0.0
    first, last = mapping["coverage"]
    assert first["coverage_share"] == pytest.approx(0.5, abs=0.02)
    assert (last["coverage_share"], last["time_s"]) == (1.0, pytest.approx(3.0, abs=0.15))
    # At 0.2 m/s on a circle.
    assert last["driven_m"] == pytest.approx(0.6, abs=0.05)
    assert mapping["milestones"] == [last] * 3
    assert mapping["trajectory_error_m"]["p95"] == pytest.approx(ERROR_M)
    assert mapping["aligned_error_m"]["max"] == pytest.approx(0.0, abs=1e-9)
    assert mapping["markers"]["found"] == 1
    assert mapping["markers"]["error_m"]["max"] == pytest.approx(0.02)
    assert (mapping["keyframes"], mapping["loops"], mapping["false_loops"]) == (2, 2, 0)
    assert mapping["exploration"] == "complete"
    assert mapping["explored_s"] == pytest.approx(3.0, abs=0.15)
    folder = run / "map"
    assert {path.name for path in folder.iterdir()} == {
        "map.yaml", "map.pgm", "markers.yaml", "pose_graph.json",
    }  # fmt: skip
    kept = read_map(folder / "map.yaml")
    assert kept.origin == SE2(-2.6, -3.1, 0.0)
    assert np.array_equal(kept.cells, msg.cells_from_grid(grid(9.0, kept.origin, 110)))
    (marker,) = read_markers(folder / "markers.yaml", world.walls).markers
    assert marker.position_m == pytest.approx((1.92, 0.02, 0.3))
    text = (folder / "pose_graph.json").read_text()
    assert PoseGraph.model_validate_json(text) == graph(world, 2)


def test_a_run_with_a_map_of_the_world_has_none_of_it(tmp_path: Path) -> None:
    world = room()
    bench = Bench(recorder(tmp_path))
    bench.say(opening(world))
    bench.say(driving(world, 0.5))
    bench.node.close()
    (run,) = tmp_path.iterdir()
    assert summary_of(run)["mapping"] is None
    assert not (run / "map").exists()


def test_an_interrupted_run_has_a_map_that_is_seconds_old(tmp_path: Path) -> None:
    world = slam_room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(without_map(world))
    (run,) = tmp_path.iterdir()
    for at_s in range(1, 12):
        now_ns = at_s * SECOND_NS
        bench.say([(now_ns, table.MAP, grid(9.0)), (now_ns, table.POSE_GRAPH, graph(world, at_s))])
        nodes = PoseGraph.model_validate_json((run / "map/pose_graph.json").read_text()).nodes
        assert at_s - len(nodes) <= WRITE_PERIOD_NS / SECOND_NS
    # Nothing new has come since, but what came must be written.
    bench.step(now_ns + WRITE_PERIOD_NS)
    nodes = PoseGraph.model_validate_json((run / "map/pose_graph.json").read_text()).nodes
    assert len(nodes) == 11
    bench.node.close()


def test_the_map_of_the_run_before_is_not_that_of_the_next_one(tmp_path: Path) -> None:
    world = slam_room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(without_map(world))
    bench.say(exploring(world))
    bench.say(driving(world, 1.0))
    bench.node.close()
    first, second = sorted(tmp_path.iterdir())
    assert (first / "map" / "map.yaml").exists()
    assert not (second / "map").exists()
    mapping = summary_of(second)["mapping"]
    assert (mapping["walls_found_share"], mapping["exploration"]) == (None, "")
    assert mapping["trajectory_error_m"]["p95"] == pytest.approx(ERROR_M)


def test_a_folder_that_was_removed_is_replaced_with_the_whole_map(tmp_path: Path) -> None:
    world = slam_room()
    bench = Bench(recorder(tmp_path, record=False))
    bench.say(without_map(world))
    bench.say(exploring(world))
    (run,) = tmp_path.iterdir()
    shutil.rmtree(run)
    clock = bench.node._setting.wall_clock_s  # type: ignore[attr-defined]
    clock.now_s += 3.0
    bench.step(5 * SECOND_NS)
    bench.node.close()
    (run,) = tmp_path.iterdir()
    assert len(list((run / "map").iterdir())) == 4


def test_a_full_disk_is_told_once_and_the_map_is_written_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    folder = MapFolder()

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(map_folder_module, "write_atomically", full)
        for at_s in range(0, 12, 3):
            folder.add_pose_graph(graph(room()))
            folder.write(tmp_path, at_s * SECOND_NS)
    assert caplog.text.count("No space left on device") == 1
    folder.write(tmp_path, 20 * SECOND_NS)
    assert (tmp_path / "map" / "pose_graph.json").exists()
    assert caplog.text.count("written again") == 1


def test_an_evaluation_goes_on_from_its_state() -> None:
    world = slam_room()

    def judged(said: list[Said], evaluation: RunEvaluation) -> RunEvaluation:
        take: dict[Any, Any] = {
            table.GROUND_TRUTH_ODOM: evaluation.add_ground_truth,
            table.AMCL_POSE: evaluation.add_estimate,
            table.MAP: evaluation.add_map,
            table.POSE_GRAPH: evaluation.add_pose_graph,
            table.EXPLORATION_STATUS: evaluation.add_exploration,
        }
        for _, topic, message in said:
            if topic in take:
                take[topic](message)
        return evaluation

    said = exploring(world)
    half = len(said) // 2
    whole = judged(said, RunEvaluation(world)).evaluation()
    values, arrays = judged(said[:half], RunEvaluation(world)).state()
    second = RunEvaluation(world)
    second.restore(json.loads(json.dumps(values)), arrays)
    again = judged(said[half:], second).evaluation()
    assert again.mapping is not None
    assert again.mapping == whole.mapping


def test_a_higher_lidar_looks_over_a_low_wall() -> None:
    low = doc.Wall(
        name="low", length_m=1.0, thickness_m=0.1, height_m=0.15, x_m=0.0, y_m=0.9, yaw_rad=0.0,
        material="plain",
    )  # fmt: skip
    plain = slam_room()
    evaluation = RunEvaluation(plain.model_copy(update={"walls": (*plain.walls, low)}))
    evaluation.add_map(grid(9.0))
    before = evaluation.evaluation().mapping
    assert before is not None
    assert before.walls_found_share is not None
    assert before.walls_found_share < 0.95
    transforms = static_transforms()
    scan = next(one for one in transforms.transforms if one.child_frame_id == "base_scan")
    scan.transform.translation.z = 0.2
    evaluation.add_static_transforms(transforms)
    after = evaluation.evaluation().mapping
    assert after is not None
    assert after.walls_found_share == 1.0
