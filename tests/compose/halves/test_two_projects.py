"""Navigation in a Compose project of its own drives the simulator of another: docker/join.yaml."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

import pytest

from mazebot.bench.parts.bench_parts import worlds
from tests.cli.test_app import mazebot
from tests.compose.stack import Stack, stack_of, wait_until

pytestmark = pytest.mark.compose

FILES = "docker-compose.yaml", "docker/join.yaml"
REACHED_M = 0.25


@pytest.fixture(scope="module")
def simulator(person: int, image: str) -> Iterator[Stack]:
    with stack_of(person) as stack:
        started = stack.compose("up", "simulator-enhanced")
        assert started.returncode == 0, started.stdout
        yield stack


@pytest.fixture(scope="module")
def navigation(person: int, simulator: Stack) -> Iterator[Stack]:
    settings = {"COMPOSE_FILE": ":".join(FILES), "JOIN": simulator.project}
    with stack_of(person, settings) as stack:
        # It ends when navigation is there.
        started = stack.compose("up", "navigation-only")
        assert started.returncode == 0, started.stdout
        yield stack


def test_it_has_no_router_and_no_recorder_of_its_own(navigation: Stack) -> None:
    assert navigation.containers() == ["localization", "navigation", "navigation-only"]


def test_it_drives_to_the_goals_of_the_tour(simulator: Stack, navigation: Stack) -> None:
    wait_until(lambda: "navigation is active" in navigation.logs("navigation"), 30.0, "active")
    connect = ("--connect", simulator.endpoint)
    tour = worlds()["enhanced"].world.locations
    assert len(tour) == 4
    for place in tour:
        pose = map(str, (place.x_m, place.y_m, place.yaw_rad))
        driven = mazebot("goal", *pose, *connect, **simulator.signs_in)
        assert driven.returncode == 0, driven.stderr
        said = mazebot(
            "topic",
            "echo",
            "/ground_truth/odom",
            "--once",
            "--json",
            *connect,
            **simulator.signs_in,
        )
        at = json.loads(said.stdout)["pose"]["pose"]["position"]
        assert math.dist((at["x"], at["y"]), (place.x_m, place.y_m)) < REACHED_M, place.name


def test_where_nothing_is_joined_it_says_what_is_missing(person: int) -> None:
    with stack_of(person, {"COMPOSE_FILE": ":".join(FILES)}) as stack:
        refused = stack.compose("up", "navigation-only")
        assert refused.returncode != 0
        assert "JOIN must be the name of the project to join" in refused.stdout
