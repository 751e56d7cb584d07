"""Maps that a user asks the recorder for, as of Nav2's map_saver."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import SaveMap, SaveMapReply
from mazebot.common.messages.topics import MAP, SAVE_MAP
from mazebot.common.world.map_files import read_map
from mazebot.common.world.marker_file import read_markers
from mazebot.mapping.graph.graph_file import load_graph
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.node import RecorderNode
from tests.recorder.synthetic import Bench, Said, WallClock, driving, opening, room
from tests.recorder.test_mapping_run import exploring, slam_room, without_map

CELLS = np.array([[0, 100, -1, 20], [24, 25, 64, 66]], np.int8)


@pytest.fixture
def empty(tmp_path: Path) -> Iterator[Bench]:
    config = RecorderConfig(recordings_dir=tmp_path, out_dir=tmp_path / "run", video=False)
    bench = Bench(RecorderNode(config, WallClock()))
    yield bench
    bench.node.close()


@pytest.fixture
def bench(empty: Bench) -> Bench:
    world = room()
    empty.say([*opening(world), *driving(world, 0.5)])
    grid = msg.occupancy_grid(0, 0.05, SE2(0.0, 0.0, 0.0), CELLS)
    later: list[Said] = [(600_000_000, MAP, grid)]
    empty.say(later)
    return empty


def saved(bench: Bench, at_ns: int = 700_000_000, **fields: Any) -> SaveMapReply:
    replies: list[SaveMapReply] = []
    assert bench.inbox.ask(SAVE_MAP, SaveMap(**fields), replies.append)
    bench.step(at_ns)
    (reply,) = replies
    return reply


def test_it_is_written_as_map_saver_does(bench: Bench, tmp_path: Path) -> None:
    reply = saved(bench, name="kitchen")
    folder = tmp_path / "run" / "saved_maps"
    assert reply.files == (str(folder / "kitchen.yaml"), str(folder / "kitchen.pgm"))
    assert (reply.result, reply.error) == (0, "")
    assert read_map(folder / "kitchen.yaml").cells.tolist() == [[0, 100, -1, 0], [0, 0, -1, 100]]


def test_thresholds_say_what_is_free_and_what_is_occupied(bench: Bench) -> None:
    # Of single precision, as in ROS 2's request.
    few: dict[str, Any] = {
        "free_thresh": float(np.float32(0.2)),
        "occupied_thresh": float(np.float32(0.66)),
    }
    found = read_map(Path(saved(bench, name="strict", image_format="png", **few).files[0]))
    assert found.cells.tolist() == [[0, 100, -1, 0], [-1, -1, -1, 100]]


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"name": "../kitchen"}, "must be a file name without folders"),
        ({"name": "/tmp/kitchen"}, "must be a file name without folders"),
        ({"name": ""}, "must be a file name without folders"),
        ({"name": "a", "mode": "quaternary"}, "must be trinary, scale or raw"),
        ({"name": "a", "image_format": "jpeg"}, "must be pgm, png or bmp"),
        ({"name": "a", "free_thresh": 0.7}, "must be 0 <= free_thresh < occupied_thresh <= 1"),
        ({"name": "a", "needs_pose_graph": True}, "there is no pose graph"),
        ({"name": "a", "topic": "/global_costmap/costmap"}, "must be /map"),
    ],
)
def test_what_cannot_be_written_is_refused(
    bench: Bench, tmp_path: Path, fields: dict[str, Any], words: str
) -> None:
    reply = saved(bench, **fields)
    assert (reply.files, reply.result) == ((), 255)
    assert words in reply.error
    assert "\n" not in reply.error
    assert not (tmp_path / "run" / "saved_maps").exists()
    # The service goes on.
    assert saved(bench, name="kitchen").error == ""


def test_without_a_run_there_is_no_map(empty: Bench) -> None:
    reply = saved(empty, name="kitchen")
    assert (reply.result, reply.error) == (1, "waiting for a world")


def test_a_run_that_was_removed_does_not_come_back(bench: Bench, tmp_path: Path) -> None:
    shutil.rmtree(tmp_path / "run")
    assert "was removed" in saved(bench, name="kitchen").error
    assert not (tmp_path / "run").exists()


def test_where_the_robot_makes_the_map_its_pose_graph_is_saved_too(
    empty: Bench, tmp_path: Path
) -> None:
    world = slam_room()
    empty.say(without_map(world))
    empty.say(exploring(world))
    reply = saved(empty, 4_100_000_000, name="made", needs_pose_graph=True)
    folder = tmp_path / "run" / "saved_maps"
    names = ("made.yaml", "made.pgm", "made.pose_graph.json", "made.markers.yaml")
    assert reply.files == tuple(str(folder / name) for name in names)
    assert len(load_graph(folder / "made.pose_graph.json").nodes) == 2
    assert len(read_markers(folder / "made.markers.yaml", ()).markers) == 1
