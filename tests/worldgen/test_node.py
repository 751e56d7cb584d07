from __future__ import annotations

import hashlib
import logging
from pathlib import Path

import pytest

from services.common.bus import wire
from services.common.node.documents import WorldRequest, WorldStatus
from services.common.node.messages import cells_from_grid
from services.common.node.node import Envelope, Inbox, Outbox
from services.common.node.topics import ASSETS, MAP, WORLD, WORLD_REQUEST, WORLD_STATUS, Topic
from services.common.problems import WorldError
from services.worldgen.config import WorldgenConfig
from services.worldgen.node import WorldgenNode
from services.worldgen.recipe.loader import load_world
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
        self, world_name: str, use_aruco: bool = True, overrides: tuple[str, ...] = ()
    ) -> WorldStatus:
        """Ask for a world and return the answer; `sent` holds what came with it."""
        self.sent.clear()
        request = WorldRequest(world_name=world_name, use_aruco=use_aruco, overrides=overrides)
        self.inbox.deliver(WORLD_REQUEST, request, Envelope("bringup", self._sequence, 0, ""))
        self._sequence += 1
        self.node.step(0, self.inbox, self._outbox)
        topic, answer, _ = self.sent[-1]
        assert topic is WORLD_STATUS
        assert isinstance(answer, WorldStatus)
        assert answer.request == request
        return answer


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
        assert status.error.endswith("stop that one first (docker compose down)")
        assert "\n" not in status.error
        assert [topic for topic, _, _ in bench.sent] == [WORLD_STATUS]
    assert bench.ask("room").error == ""


def test_a_mistake_is_answered_and_logged_and_a_right_request_still_met(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "worldgen"):
        status = bench.ask("cellar")
        assert status.error == "world_name: 'cellar': must be one of hall, room"
        assert status.world_hash == ""
        assert bench.node.waiting_for() == f"another world to be asked for: {status.error}"
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
