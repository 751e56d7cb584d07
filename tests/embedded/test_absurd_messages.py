"""Whatever finite numbers and whatever words come on whichever topic: no node ends by it."""

from __future__ import annotations

import random
import warnings
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mazebot.common.messages.topics import Topic, read_by
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox
from mazebot.localization.config import LocalizationConfig
from mazebot.localization.node import LocalizationNode
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.node import NavigationNode
from mazebot.perception.config import PerceptionConfig
from mazebot.perception.node import PerceptionNode
from mazebot.physics.config import PhysicsConfig
from mazebot.physics.node import PhysicsNode
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.node import RecorderNode
from tests.common.absurd import absurd_bytes
from tests.common.samples import SAMPLES
from tests.recorder.synthetic import driving, opening, room

STEP_NS = 50_000_000


def recorder(folder: Path) -> Node:
    config = RecorderConfig(recordings_dir=folder, compact_timeout_s=0.0, repair=False)
    seconds = iter(range(10_000_000))
    # Each step is late enough to bring everything to the disk.
    return RecorderNode(config, lambda: float(next(seconds)), datetime.now)


MAKERS: dict[str, Callable[[Path], Node]] = {
    "recorder": recorder,
    "localization": lambda _: LocalizationNode(LocalizationConfig()),
    "navigation": lambda _: NavigationNode(NavigationConfig()),
    "perception": lambda _: PerceptionNode(PerceptionConfig()),
    "physics": lambda _: PhysicsNode(PhysicsConfig(camera_enabled=False)),
}


class Victim:
    """A node that works, and to which anything may be said."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.inbox = Inbox(node)
        self.outbox = Outbox(node, lambda *_: None)
        self.now_ns = 0
        self._number = 0
        world = room()
        self._hash = world.hash
        said = [*opening(world), *driving(world, 2.0)]
        for now_ns, topic, message in said:
            if node.name in topic.readers:
                self.say(topic, message)
            if now_ns >= self.now_ns:
                self.now_ns = now_ns
                self.step()
        self.real = {
            topic: [message for _, one, message in said if one is topic] or [SAMPLES[topic]]
            for topic in read_by(node.name)
        }

    def say(self, topic: Topic[Any], message: Any) -> None:
        self._number += 1
        envelope = Envelope("test", self._number, self.now_ns, self._hash)
        self.inbox.deliver(topic, message, envelope)

    def step(self) -> None:
        self.now_ns += STEP_NS
        self.outbox.now_ns = self.now_ns
        self.node.step(self.now_ns, self.inbox, self.outbox)


@pytest.mark.parametrize("count", [
    150, pytest.param(1000, marks=pytest.mark.slow),
    pytest.param(3000, marks=[pytest.mark.slow, pytest.mark.longest]),
])  # fmt: skip
@pytest.mark.parametrize("name", MAKERS)
def test_no_message_ends_a_node(
    name: str, count: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    victim = Victim(MAKERS[name](tmp_path))
    topics = read_by(name)

    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.sampled_from(topics), st.integers(0, 2**32))
    def hears(topic: Topic[Any], seed: int) -> None:
        rng = random.Random(seed)
        for _ in range(4):
            data = absurd_bytes(topic, rng.choice(victim.real[topic]), rng)
            if data is not None:
                victim.say(topic, data)
        victim.step()

    with warnings.catch_warnings():
        # Numbers that overflow a float32 of a drawing are shown nowhere; the next one is.
        warnings.simplefilter("ignore", RuntimeWarning)
        hears()
        # It still works: nothing of it is broken.
        for topic, messages in victim.real.items():
            if topic.name in ("/odom", "/clock", "/camera/color/image_raw", "/cmd_vel"):
                victim.say(topic, messages[-1])
        victim.step()
        victim.node.close()
    assert not [one for one in caplog.messages if "cannot be drawn" in one]
