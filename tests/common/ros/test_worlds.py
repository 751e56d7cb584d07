"""The services of simulation_interfaces that tell of worlds and load one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest

from mazebot.common.messages import action_documents as act
from mazebot.common.messages.documents import Location, Planar
from mazebot.common.messages.topics import GET_MODELS, GET_WORLDS, LOAD_WORLD, Query
from tests.common.ros.test_simulation import answer

OK, NOT_FOUND, FEATURE_UNSUPPORTED, NO_RESOURCE, UNSUPPORTED_FORMAT = 1, 2, 0, 102, 101
PARSE_ERROR, NO_WORLD_LOADED, OPERATION_FAILED = 103, 101, 4


MODELS = ("crate", "post")


class Worldgen:
    """Knows two worlds."""

    def __init__(self, running: str = "hall") -> None:
        self.running = running
        self.error = ""
        self.place = "door"

    def __call__(self, query: Query[Any, Any], document: Any) -> Any:
        if query is GET_WORLDS:
            return act.GetWorldsReply(
                names=("hall", "room"), running=self.running, running_hash="abc",
                start=Planar(x_m=1.0, y_m=2.0, yaw_rad=0.0),
                locations=(Location(name=self.place, x_m=3.0, y_m=4.0, yaw_rad=math.pi),),
            )  # fmt: skip
        if query is GET_MODELS:
            return act.GetModelsReply(error=self.error, names=() if self.error else MODELS)
        assert query is LOAD_WORLD
        if not self.error:
            self.running = document.world_name
        return act.LoadWorldReply(
            world_name=self.running, world_hash="def", is_new=True, error=self.error
        )


@pytest.mark.parametrize("distro", ["jazzy", "lyrical"])
def test_a_world_is_loaded_by_both_forms_of_the_request(distro: str) -> None:
    worldgen = Worldgen()
    form = {"world_resource": {"uri": "room"}} if distro == "lyrical" else {"uri": "room"}
    response = answer("/load_world", form, worldgen, distro)
    assert (response.result.result, worldgen.running) == (OK, "room")
    assert (response.world.name, response.world.world_resource.uri) == ("room", "room")
    assert response.world.description == "hash def"


@pytest.mark.parametrize(
    ("values", "code", "text"),
    [
        ({}, NO_RESOURCE, "uri: must be the name of a world"),
        ({"resource_string": "<sdf/>"}, UNSUPPORTED_FORMAT, "resource_string: must be empty"),
        ({"uri": "cellar"}, NOT_FOUND, "said by worldgen"),
        ({"uri": "room"}, PARSE_ERROR, "said by worldgen"),
    ],
)
def test_what_cannot_be_loaded_says_why(values: Mapping[str, Any], code: int, text: str) -> None:
    worldgen = Worldgen()
    worldgen.error = "said by worldgen"
    response = answer("/load_world", values, worldgen)
    assert response.result.result == code
    assert text in response.result.error_message
    assert worldgen.running == "hall"


def test_the_worlds_and_the_one_that_runs_are_told() -> None:
    response = answer("/get_available_worlds", {}, Worldgen())
    assert response.result.result == OK
    assert [world.name for world in response.worlds] == ["hall", "room"]
    assert [world.world_resource.uri for world in response.worlds] == ["hall", "room"]
    response = answer("/get_current_world", {}, Worldgen())
    assert (response.result.result, response.world.name) == (OK, "hall")
    response = answer("/get_current_world", {}, Worldgen(running=""))
    assert response.result.result == NO_WORLD_LOADED


@pytest.mark.parametrize(
    "values", [{"additional_sources": ["file:///worlds"]}, {"filter": {"tags": ["indoor"]}}]
)
def test_other_sources_and_tags_are_refused_by_name(values: Mapping[str, Any]) -> None:
    response = answer("/get_available_worlds", values, Worldgen())
    assert response.result.result == FEATURE_UNSUPPORTED
    assert "must be empty" in response.result.error_message


def test_the_start_and_the_places_of_a_world_are_named_poses() -> None:
    response = answer("/get_named_poses", {}, Worldgen())
    assert response.result.result == OK
    found = {one.name: one for one in response.poses}
    assert {name: one.tags for name, one in found.items()} == {
        "start": ["spawn"], "door": ["navigation_goal"],
    }  # fmt: skip
    door = found["door"].pose
    assert (door.position.x, door.position.y, door.position.z) == (3.0, 4.0, 0.0)
    assert door.orientation.z == pytest.approx(1.0)
    worldgen = Worldgen()
    worldgen.place = "start"
    named = answer("/get_named_poses", {}, worldgen)
    assert [one.name for one in named.poses] == ["robot_start", "start"]
    goals = answer("/get_named_poses", {"tags": {"tags": ["navigation_goal"]}}, Worldgen())
    assert [one.name for one in goals.poses] == ["door"]
    response = answer("/get_named_poses", {}, Worldgen(running=""))
    assert response.result.result == OPERATION_FAILED


@pytest.mark.parametrize("distro", ["jazzy", "lyrical"])
def test_models_are_told_as_each_distribution_spawns_them(distro: str) -> None:
    response = answer("/get_spawnables", {}, Worldgen(), distro)
    uris = [
        one.entity_resource.uri if distro == "lyrical" else one.uri for one in response.spawnables
    ]
    assert (response.result.result, uris) == (OK, ["model://crate", "model://post"])
    worldgen = Worldgen()
    worldgen.error = "2 of 300 models are read: ask again for all of them"
    unread = answer("/get_spawnables", {}, worldgen, distro)
    assert (unread.result.result, len(unread.spawnables)) == (OPERATION_FAILED, 0)
    elsewhere = answer("/get_spawnables", {"sources": ["https://x"]}, Worldgen(), distro)
    assert elsewhere.result.result == FEATURE_UNSUPPORTED
