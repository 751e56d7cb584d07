from __future__ import annotations

import hashlib
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2, pose_matrix
from mazebot.common.messages import wire
from mazebot.common.messages.action_documents import (
    Empty,
    GetWorldsReply,
    LoadWorld,
    LoadWorldReply,
)
from mazebot.common.messages.documents import MappedMarker, World, WorldRequest, WorldStatus
from mazebot.common.messages.messages import OccupancyGrid, cells_from_grid, se2_from_pose
from mazebot.common.messages.slam_documents import GraphLandmark
from mazebot.common.messages.topics import (
    ASSETS,
    GET_WORLDS,
    LOAD_WORLD,
    MAP,
    WORLD,
    WORLD_REQUEST,
    WORLD_STATUS,
    Topic,
)
from mazebot.common.node.node import Envelope, Inbox, Outbox
from mazebot.common.problems import WorldError
from mazebot.common.world.map_files import write_map
from mazebot.common.world.marker_file import write_markers
from mazebot.common.world.placement import hang
from mazebot.worldgen.config import WorldgenConfig
from mazebot.worldgen.node import WorldgenNode
from mazebot.worldgen.recipe.loader import load_world
from tests.worldgen import folder


class Bench:
    """A node with its boxes."""

    def __init__(self, config: WorldgenConfig) -> None:
        self.node = WorldgenNode(config)
        self.inbox = Inbox(self.node)
        self.sent: list[tuple[Topic[object], object, Envelope]] = []
        self._outbox = Outbox(self.node, lambda *message: self.sent.append(message))
        self._sequence = 0

    def ask(
        self,
        world_name: str,
        use_aruco: bool = True,
        overrides: tuple[str, ...] = (),
        slam: bool = False,
        explore: bool = True,
    ) -> WorldStatus:
        """Ask for a world and return the answer; `sent` holds what came with it."""
        self.sent.clear()
        request = WorldRequest(
            world_name=world_name, use_aruco=use_aruco, overrides=overrides, slam=slam,
            explore=explore,
        )  # fmt: skip
        self.inbox.deliver(WORLD_REQUEST, request, Envelope("bringup", self._sequence, 0, ""))
        self._sequence += 1
        self.node.step(0, self.inbox, self._outbox)
        topic, answer, _ = self.sent[-1]
        assert topic is WORLD_STATUS
        assert isinstance(answer, WorldStatus)
        assert answer.request == request
        return answer

    def load(self, world_name: str, **options: Any) -> LoadWorldReply:
        """Load a world in the place of the one that runs; `sent` holds what came with it."""
        self.sent.clear()
        replies: list[LoadWorldReply] = []
        wanted = LoadWorld(world_name=world_name, **options)
        self.inbox.ask(LOAD_WORLD, wanted, replies.append)
        self.node.step(0, self.inbox, self._outbox)
        (reply,) = replies
        return reply

    def worlds(self) -> GetWorldsReply:
        """What there is."""
        replies: list[GetWorldsReply] = []
        self.inbox.ask(GET_WORLDS, Empty(), replies.append)
        self.node.step(0, self.inbox, self._outbox)
        (reply,) = replies
        return reply

    def after(self, before: Bench) -> Bench:
        """Started again, with the last word of the process before, as others have kept it."""
        status = [message for topic, message, _ in before.sent if topic is WORLD_STATUS][-1]
        assert isinstance(status, WorldStatus)
        self.inbox.deliver(WORLD_STATUS, status, Envelope("worldgen", 0, 0, ""))
        request = WorldRequest(world_name="room")
        self.inbox.deliver(WORLD_REQUEST, request, Envelope("bringup", 0, 0, ""))
        self.node.step(0, self.inbox, self._outbox)
        return self


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    folder.make(tmp_path)
    other = folder.room()
    other["name"] = "hall"
    other["wall_height_m"] = 2.0
    folder.write(tmp_path, "hall", other)
    return Bench(WorldgenConfig(worlds_dir=tmp_path))


def test_a_world_comes_with_its_textures_and_its_map(bench: Bench, tmp_path: Path) -> None:
    assert bench.node.waiting_for() == "a world request"
    status = bench.ask("room")
    assert [topic for topic, _, _ in bench.sent] == [ASSETS, WORLD, MAP, WORLD_STATUS]
    loaded = load_world("room", worlds_dir=tmp_path)
    (_, texture, _), (_, world, _), (_, grid, _), _ = bench.sent
    assert world == loaded.world
    assert (status.world_hash, status.error) == (loaded.world.hash, "")
    assert {envelope.world_hash for _, _, envelope in bench.sent} == {loaded.world.hash}
    assert texture.format == "png"  # type: ignore[attr-defined]
    sha256 = texture.header.frame_id  # type: ignore[attr-defined]
    assert hashlib.sha256(texture.data.tobytes()).hexdigest() == sha256  # type: ignore[attr-defined]
    assert loaded.assets == {sha256: texture.data.tobytes()}  # type: ignore[attr-defined]
    assert (cells_from_grid(grid) == loaded.map_cells).all()  # type: ignore[arg-type]
    assert bench.node.waiting_for() is None


def test_what_is_sent_survives_the_wire(bench: Bench) -> None:
    bench.ask("room")
    for topic, message, _ in bench.sent:
        data = wire.encode(topic, message)
        again = wire.decode(topic, data)
        wire.validate(topic, again)
        assert wire.encode(topic, again) == data


def test_the_same_world_may_be_asked_for_again(bench: Bench) -> None:
    first = bench.ask("room")
    assert bench.ask("room") == first
    assert [topic for topic, _, _ in bench.sent] == [WORLD_STATUS]


def test_overrides_make_another_world(bench: Bench) -> None:
    error = bench.ask("room", overrides=("wall_hight=2",)).error
    assert error.startswith("override wall_hight=2: wall_hight: unknown field: must be one of ")
    assert bench.ask("room", overrides=("wall_height=2",)).error == ""
    (world,) = [message for topic, message, _ in bench.sent if topic is WORLD]
    assert {wall.height_m for wall in world.walls} == {2.0}  # type: ignore[attr-defined]
    assert "must be the world that is running" in bench.ask("room").error


def test_a_path_is_no_name(bench: Bench, tmp_path: Path) -> None:
    for name in (f"{tmp_path}/room", f"{tmp_path}/room.yaml", "../room", "./room", "room.yaml"):
        assert bench.ask(name).error.endswith("must be one of hall, room")


def test_another_world_is_refused_and_the_first_stays(bench: Bench) -> None:
    running = bench.ask("room").world_hash
    for name, use_aruco in (("hall", True), ("room", False)):
        status = bench.ask(name, use_aruco)
        assert status.world_hash == running == bench.node.world_hash
        assert status.error.startswith(f"world_name: '{name}' (4 walls, ")
        assert "must be the world that is running, 'room' (4 walls, 1 markers" in status.error
        assert "stop that one first (docker compose down)" in status.error
        assert status.error.endswith(f"(mazebot sim load-world {name})")
        assert "\n" not in status.error
        assert [topic for topic, _, _ in bench.sent] == [WORLD_STATUS]
    assert bench.ask("room").error == ""


def test_a_world_is_loaded_in_the_place_of_another(bench: Bench, tmp_path: Path) -> None:
    first = bench.ask("room", slam=True)
    reply = bench.load("hall", overrides=("wall_height=3",))
    (world,) = [message for topic, message, _ in bench.sent if topic is WORLD]
    assert isinstance(world, World)
    assert {wall.height_m for wall in world.walls} == {3.0}
    # The robot makes its map as before.
    assert (world.slam, world.explore) == (True, True)
    assert MAP not in [topic for topic, _, _ in bench.sent]
    assert reply == LoadWorldReply(world_name="hall", world_hash=world.hash, is_new=True)
    assert reply.world_hash == bench.node.world_hash != first.world_hash
    assert bench.worlds() == GetWorldsReply(
        names=("hall", "room"), running="hall", running_hash=world.hash,
        start=world.start, locations=world.locations,
    )  # fmt: skip
    assert bench.ask("hall", overrides=("wall_height=3",), slam=True).error == ""
    assert "must be the world that is running, 'hall'" in bench.ask("room", slam=True).error


def test_a_world_that_cannot_be_loaded_leaves_the_one_that_runs(bench: Bench) -> None:
    running = bench.ask("room").world_hash
    for name, overrides, said in (
        ("cellar", (), "world_name: 'cellar': must be one of hall, room"),
        ("hall", ("wall_hight=2",), "override wall_hight=2: wall_hight: unknown field"),
    ):
        reply = bench.load(name, overrides=overrides)
        assert reply.error.startswith(said)
        assert (reply.world_name, reply.world_hash, reply.is_new) == ("room", running, False)
        assert bench.sent == []
    same = bench.load("room")
    assert same == LoadWorldReply(world_name="room", world_hash=running)
    assert bench.sent == []


def test_a_world_is_loaded_where_none_runs_yet(bench: Bench) -> None:
    assert bench.worlds() == GetWorldsReply(names=("hall", "room"))
    assert bench.load("hall").is_new
    assert [topic for topic, _, _ in bench.sent] == [ASSETS, WORLD, MAP, WORLD_STATUS]


def test_a_map_of_the_world_that_runs_does_not_become_one_of_another(tmp_path: Path) -> None:
    folder.make(tmp_path)
    bench = Bench(WorldgenConfig(worlds_dir=tmp_path, map_file=saved_map(tmp_path)))
    bench.ask("room")
    error = bench.load("room", use_aruco=False).error
    assert error.startswith(f"map_file: {tmp_path / 'map.yaml'}: is of the world that is running")


def test_a_worldgen_that_is_started_again_goes_on_with_the_world_that_was_loaded(
    bench: Bench, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bench.ask("room")
    loaded = bench.load("hall").world_hash
    again = Bench(WorldgenConfig(worlds_dir=tmp_path)).after(bench)
    assert again.node.world_hash == loaded
    statuses = [message for _, message, _ in again.sent if isinstance(message, WorldStatus)]
    assert {status.world_hash for status in statuses} == {loaded}
    assert [status.running for status in statuses] == [WorldRequest(world_name="hall")] * 2
    # That the process before had loaded what was requested at first is no error of anybody.
    assert "must be the world that is running, 'hall'" in statuses[-1].error
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]
    third = Bench(WorldgenConfig(worlds_dir=tmp_path)).after(again)
    assert third.node.world_hash == loaded


def test_a_world_that_is_gone_when_worldgen_is_started_again_is_told(
    bench: Bench, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bench.ask("room")
    bench.load("hall")
    (tmp_path / "hall.yaml").unlink()
    again = Bench(WorldgenConfig(worlds_dir=tmp_path)).after(bench)
    assert "cannot be loaded again: world_name: 'hall': must be one of room" in caplog.text
    # What was requested first runs then.
    assert again.worlds().running == "room"


def test_a_mistake_is_answered_and_logged_and_a_right_request_still_met(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "worldgen"):
        status = bench.ask("cellar")
        assert status.error == "world_name: 'cellar': must be one of hall, room"
        assert status.world_hash == ""
        assert bench.node.waiting_for() == f"a valid world request: {status.error}"
        assert bench.ask("hall").error == ""
    levels = [(record.levelname, record.name) for record in caplog.records]
    assert levels == [("ERROR", "worldgen"), ("INFO", "worldgen")]
    assert bench.ask("cellar").world_hash == bench.node.world_hash
    assert bench.node.waiting_for() is None


def test_the_node_reads_through_the_function_it_is_given() -> None:
    asked = []

    def load(*arguments: object) -> object:
        asked.append(arguments)
        raise WorldError("no")

    config = WorldgenConfig(worlds_dir=Path("worlds"), texture_base=Path("textures"))
    bench = Bench(config)
    bench.node = WorldgenNode(config, load=load)  # type: ignore[arg-type]
    bench.inbox = Inbox(bench.node)
    assert bench.ask("room", use_aruco=False).error == "no"
    assert asked == [("room", False, Path("worlds"), Path("textures"), ())]


def test_a_robot_that_maps_gets_no_map_and_the_world_says_so(bench: Bench) -> None:
    status = bench.ask("room", slam=True)
    assert status.error == ""
    assert [topic for topic, _, _ in bench.sent] == [ASSETS, WORLD, WORLD_STATUS]
    _, (_, world, _), _ = bench.sent
    assert isinstance(world, World)
    assert (world.slam, world.explore) == (True, True)
    assert world.hash == status.world_hash == world.content_hash()
    assert wire.decode(WORLD, wire.encode(WORLD, world)) == world
    assert bench.ask("room", slam=True).error == ""
    said = bench.ask("room").error
    assert said.startswith("slam: with a map: must be as 'room' is running, exploring")
    said = bench.ask("room", slam=True, explore=False).error
    assert said.startswith("slam: mapping without exploring: must be as 'room' is running")


def test_a_world_without_slam_is_hashed_as_before_there_was_any(bench: Bench) -> None:
    bench.ask("room")
    (world,) = [message for topic, message, _ in bench.sent if topic is WORLD]
    assert isinstance(world, World)
    assert {"slam", "explore", "mapped_markers"}.isdisjoint(world.model_dump())


def test_what_the_lidar_does_not_see_is_told_of_the_world_s_own_map_alone(tmp_path: Path) -> None:
    step = {"name": "step", "size_m": [0.5, 0.5, 0.04], "x_m": -1.0, "y_m": 0.0}
    folder.make(tmp_path, {**folder.room(), "boxes": [step]})
    hashes = set()
    for map_file, slam, known in (
        (None, False, 1),
        (None, True, 0),
        (saved_map(tmp_path), False, 0),
    ):
        bench = Bench(WorldgenConfig(worlds_dir=tmp_path, map_file=map_file))
        bench.ask("room", slam=slam)
        (world,) = [message for topic, message, _ in bench.sent if topic is WORLD]
        assert isinstance(world, World)
        assert len(world.unseen) == known
        assert world.hash == world.content_hash()
        assert ("unseen" in world.model_dump()) == bool(known)
        assert wire.decode(WORLD, wire.encode(WORLD, world)) == world
        hashes.add(world.hash)
    assert len(hashes) == 1


def saved_map(folder_: Path, markers: str = "") -> Path:
    """A map of 3 by 2 cells, and what lies beside it."""
    cells = np.array([[0, 100, -1], [0, 0, 100]], np.int8)
    if markers:
        (folder_ / "markers.yaml").write_text(markers)
    return write_map(folder_, "map", cells, 0.1, SE2(-1.0, 2.0, 0.0))


def test_a_saved_map_takes_the_place_of_the_world_s(tmp_path: Path) -> None:
    folder.make(tmp_path)
    map_file = saved_map(tmp_path)
    bench = Bench(WorldgenConfig(worlds_dir=tmp_path, map_file=map_file))
    bench.ask("room")
    _, (_, world, _), (_, grid, _), _ = bench.sent
    assert isinstance(world, World)
    assert isinstance(grid, OccupancyGrid)
    assert cells_from_grid(grid).tolist() == [[0, 100, -1], [0, 0, 100]]
    assert se2_from_pose(grid.info.origin) == SE2(-1.0, 2.0, 0.0)
    assert world.mapped_markers is None


def test_who_makes_a_map_is_given_none(tmp_path: Path) -> None:
    folder.make(tmp_path)
    bench = Bench(WorldgenConfig(worlds_dir=tmp_path, map_file=saved_map(tmp_path)))
    assert "must be without a map" in bench.ask("room", slam=True).error


def test_markers_beside_a_map_are_those_that_the_robot_knows(tmp_path: Path) -> None:
    folder.make(tmp_path)
    found = GraphLandmark(
        dictionary="DICT_4X4_100", marker_id=3, instance=0, position_m=(1.0, 2.0, 0.3),
        orientation_xyzw=(0.0, 0.0, 0.0, 1.0), std_m=0.01, sightings=4,
    )  # fmt: skip
    map_file = saved_map(tmp_path)
    write_markers(tmp_path / "map.markers.yaml", [found, found.model_copy(update={"instance": 1})])
    bench = Bench(WorldgenConfig(worlds_dir=tmp_path, map_file=map_file))
    bench.ask("room")
    (world,) = [message for topic, message, _ in bench.sent if topic is WORLD]
    assert isinstance(world, World)
    assert world.mapped_markers == (
        MappedMarker(
            dictionary="DICT_4X4_100", marker_id=3, position_m=(1.0, 2.0, 0.3),
            orientation_xyzw=(0.0, 0.0, 0.0, 1.0),
        ),
    )  # fmt: skip
    assert world.hash == world.content_hash()


def test_markers_of_a_recipe_hang_where_the_world_hangs_them(tmp_path: Path) -> None:
    folder.make(tmp_path)
    loaded = load_world("room", worlds_dir=tmp_path)
    (marker,) = loaded.world.markers
    text = yaml.safe_dump({"markers": [marker.model_dump(mode="json")]})
    bench = Bench(WorldgenConfig(worlds_dir=tmp_path, map_file=saved_map(tmp_path, text)))
    bench.ask("room")
    (world,) = [message for topic, message, _ in bench.sent if topic is WORLD]
    assert isinstance(world, World)
    assert world.mapped_markers is not None
    (known,) = world.mapped_markers
    wall = next(one for one in world.walls if one.name == marker.wall)
    panel = hang("", marker, wall, marker.size_m, 0.0)
    assert np.allclose(known.position_m, panel.centre_m)
    assert np.allclose(pose_matrix(known)[:3, 2], panel.normal)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("markers: 3", "markers: 3: must be a list of markers"),
        ("markers: [5]", "markers[0]: 5: must be a mapping"),
        ("markers: [{id: -1, dictionary: DICT_4X4_50, position_m: [0, 0, 0], "
         "orientation_xyzw: [0, 0, 0, 1]}]", "markers[0].id: -1"),
        ("markers: [{id: 1, dictionary: DICT_4X4_50, position_m: [0, .nan, 0], "
         "orientation_xyzw: [0, 0, 0, 1]}]", "markers[0].position_m[1]: nan"),
        # The map is 0.3 m by 0.2 m.
        ("markers: [{id: 1, dictionary: DICT_4X4_50, position_m: [12, 0, 0], "
         "orientation_xyzw: [0, 0, 0, 1]}]", "markers[0].position_m: [12.0, 0.0, 0.0]: must be"),
        ("markers: [{id: 1, wall: nowhere, side: left, height_m: 1.0}]",
         "markers[0].wall: 'nowhere': must be a wall of the world"),
    ],
)  # fmt: skip
def test_what_is_no_marker_is_refused_by_its_place(text: str, said: str, tmp_path: Path) -> None:
    folder.make(tmp_path)
    bench = Bench(WorldgenConfig(worlds_dir=tmp_path, map_file=saved_map(tmp_path, text)))
    error = bench.ask("room").error
    assert error.startswith(f"{tmp_path / 'markers.yaml'}:1: {said}"), error
    assert bench.node.waiting_for() is not None


def test_a_map_that_is_none_is_a_mistake_of_the_settings(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no_such\.yaml"):
        WorldgenNode(WorldgenConfig(map_file=tmp_path / "no_such.yaml"))
    assert WorldgenConfig.model_validate({"map_file": ""}).map_file is None


@pytest.mark.parametrize("offset_m", [0.0, 0.678, 5.8])
def test_a_map_that_does_not_fit_the_world_is_told_before_it_is_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, offset_m: float
) -> None:
    folder.make(tmp_path)
    room = load_world("room", worlds_dir=tmp_path)
    x_m, y_m, yaw_rad = room.map_origin
    origin = SE2(x_m + offset_m, y_m, yaw_rad)
    map_file = write_map(tmp_path, "saved", room.map_cells, 0.1, origin)
    bench = Bench(WorldgenConfig(worlds_dir=tmp_path, map_file=map_file))
    assert bench.ask("room").error == ""
    told = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert len(told) == bool(offset_m)
    for line in told:
        assert line.startswith(f"map {map_file} does not fit the world room: ")
        assert f"shifted by ({-offset_m:+.3f}, +0.000) m" in line
