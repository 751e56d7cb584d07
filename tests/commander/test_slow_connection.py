"""A `Navigator` of a running stack, whose messages arrive one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import pytest

from mazebot.commander.navigator import Navigator
from mazebot.common.client.robot import Receive, Robot, RobotError, ignore
from mazebot.common.messages.documents import Location, NavigationStatus
from mazebot.common.messages.topics import (
    AMCL_POSE,
    GLOBAL_COSTMAP,
    LOCAL_COSTMAP,
    NAVIGATION_STATUS,
    WORLD,
    Topic,
)
from mazebot.common.node.node import Envelope
from tests.common.samples import SAMPLES
from tests.physics.driver import world

PLACE = Location(name="hall", x_m=1.0, y_m=2.0, yaw_rad=0.0)
ACTIVE = NavigationStatus(localization_active=True, navigation_active=True)
LATCHED: list[tuple[Topic[Any], Any]] = [
    (NAVIGATION_STATUS, ACTIVE),
    (WORLD, world().model_copy(update={"locations": (PLACE,)})),
    (GLOBAL_COSTMAP, SAMPLES[GLOBAL_COSTMAP]),
]
SENT = [*LATCHED, (AMCL_POSE, SAMPLES[AMCL_POSE]), (LOCAL_COSTMAP, SAMPLES[LOCAL_COSTMAP])]


class Slow(Robot):
    """Gets one message each time that it waits."""

    def __init__(self, messages: Iterable[tuple[Topic[Any], Any]], is_paused: bool) -> None:
        self._coming = list(messages)
        self._is_paused = is_paused
        self._now_ns = 0
        self._latest: dict[str, Any] = {}
        self._watching: list[tuple[frozenset[str], Receive]] = []

    def ask(self, *_: Any) -> Any:
        raise AssertionError

    def publish(self, *_: Any) -> None:
        raise AssertionError

    def watch(self, topics: Iterable[Topic[Any]], receive: Receive = ignore) -> Callable[[], None]:
        self._watching.append((frozenset(topic.name for topic in topics), receive))
        return lambda: None

    def latest(self, topic: Topic[Any]) -> Any:
        return self._latest.get(topic.name)

    def alive(self) -> Mapping[str, frozenset[str]]:
        return {}

    def now_ns(self) -> int:
        return self._now_ns

    def close(self) -> None:
        pass

    def wait(self, seconds: float, _: Callable[[], bool] = lambda: False) -> None:
        self._now_ns += 0 if self._is_paused else round(seconds * 1e9)
        if not self._coming:
            return
        topic, message = self._coming.pop(0)
        self._latest[topic.name] = message
        for names, receive in self._watching:
            if topic.name in names:
                receive(topic, message, Envelope("", 0, 0, ""))


def test_an_active_stack_is_known_as_a_whole() -> None:
    navigator = Navigator(Slow(SENT, is_paused=False))
    navigator.waitUntilNav2Active()
    assert navigator.getPose() is not None
    assert navigator.getGlobalCostmap() is not None
    assert navigator.getLocalCostmap() is not None
    assert navigator.locations() == {"hall": PLACE}


def test_the_pose_of_a_paused_robot_is_not_waited_for() -> None:
    navigator = Navigator(Slow(LATCHED, is_paused=True))
    navigator.waitUntilNav2Active()
    assert navigator.getPose() is None
    assert navigator.locations() == {"hall": PLACE}


def test_what_does_not_come_is_named() -> None:
    navigator = Navigator(Slow(SENT[:1], is_paused=False))
    with pytest.raises(TimeoutError, match=r"after 2 s waiting for the world$"):
        navigator.waitUntilNav2Active(timeout_s=2.0)


def test_the_places_are_those_of_the_world_that_is_on_its_way() -> None:
    assert Navigator(Slow(SENT[1:2], is_paused=False)).locations() == {"hall": PLACE}
    with pytest.raises(RobotError, match=r"^/world: no world within 0.05 s$"):
        Navigator(Slow([], is_paused=False), timeout_s=0.05).locations()
