import itertools
import sys
import threading
from typing import ClassVar

import numpy as np
import pytest

from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import CLOCK, CMD_VEL, CONTACTS, GOAL_POSE, IMU, SCAN
from mazebot.common.messages.wire import encode
from mazebot.common.node import node as node_module
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox, Trigger, random_generator
from tests.common.samples import SAMPLES


class Navigation(Node):
    name = "navigation"
    period_ns: ClassVar[int | None] = 50
    wakes = (GOAL_POSE,)

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        pass


class Recorder(Navigation):
    name = "recorder"
    depth = 8
    period_ns = None


SCAN_SAMPLE = SAMPLES[SCAN]
GOAL = SAMPLES[GOAL_POSE]


def envelope(sequence: int, source: str = "a", world: str = "") -> Envelope:
    return Envelope(source, sequence, 0, world)


def test_of_a_latest_topic_only_the_newest_is_kept() -> None:
    inbox = Inbox(Navigation())
    for number in range(3):
        inbox.deliver(SCAN, SCAN_SAMPLE, envelope(number))
    assert len(inbox.new(SCAN)) == 1
    assert inbox.new(SCAN) == []
    assert inbox.counts["/scan"].received == 3
    assert inbox.counts["/scan"].lost == 0


def test_a_node_may_keep_more() -> None:
    inbox = Inbox(Recorder())
    for number in range(20):
        inbox.deliver(SCAN, SCAN_SAMPLE, envelope(number))
    assert len(inbox.new(SCAN)) == 8


def test_every_message_of_an_every_topic_is_kept_in_order() -> None:
    inbox = Inbox(Recorder())
    contact = SAMPLES[CONTACTS]
    for number in range(100):
        inbox.deliver(
            CONTACTS,
            contact.model_copy(update={"time_s": float(number)}),
            envelope(number),
        )
    assert [c.time_s for c in inbox.new(CONTACTS)] == [float(n) for n in range(100)]


def test_of_a_flood_the_newest_are_kept_and_the_others_counted() -> None:
    inbox = Inbox(Navigation())
    goal = encode(GOAL_POSE, GOAL)
    for number in range(7584):
        inbox.deliver(GOAL_POSE, goal, envelope(number))
    arrivals = inbox.arrivals(GOAL_POSE)
    assert [arrival.sequence for _, arrival in arrivals] == list(range(6584, 7584))
    assert inbox.counts["/goal_pose"].rejected == {"queue full": 6584}
    assert inbox.counts["/goal_pose"].received == 7584


def test_no_more_bytes_wait_than_there_is_memory_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node_module, "MAX_WAITING_BYTES", 1000)
    inbox = Inbox(Navigation())
    for number in range(30):
        inbox.deliver(GOAL_POSE, bytes(100), envelope(number))
    inbox.deliver(SCAN, bytes(2000), envelope(0))
    assert not inbox.pending(SCAN)
    inbox.new(GOAL_POSE)
    assert inbox.counts["/goal_pose"].rejected == {"queue full": 20, "malformed": 10}
    inbox.deliver(SCAN, encode(SCAN, SCAN_SAMPLE), envelope(1))
    assert len(inbox.new(SCAN)) == 1


def test_sources_without_number_are_counted_and_forgotten() -> None:
    inbox = Inbox(Recorder())
    for number in range(3000):
        inbox.deliver(CLOCK, SAMPLES[CLOCK], envelope(0, f"source {number}"))
    assert inbox.counts["/clock"].sent == 3000
    assert len(inbox.counts["/clock"].last_sequence) == 1000


def test_counts_may_be_read_while_new_sources_and_reasons_come() -> None:
    inbox = Inbox(Recorder())
    stop = threading.Event()

    def deliver() -> None:
        for number in itertools.count():
            if stop.is_set():
                return
            inbox.deliver(CLOCK, SAMPLES[CLOCK], envelope(0, f"source {number}"))
            inbox.reject(CLOCK, f"reason {number % 50}")

    thread = threading.Thread(target=deliver)
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    thread.start()
    try:
        counts = inbox.counts["/clock"]
        for _ in range(2000):
            assert counts.sent >= 0
            assert all(count > 0 for count in counts.rejected.values())
    finally:
        stop.set()
        thread.join()
        sys.setswitchinterval(interval_s)


def test_gaps_in_a_source_are_counted_as_lost() -> None:
    inbox = Inbox(Recorder())
    for number in (0, 1, 5):
        inbox.deliver(CLOCK, SAMPLES[CLOCK], envelope(number))
    inbox.deliver(CLOCK, SAMPLES[CLOCK], envelope(0, "b"))
    assert inbox.counts["/clock"].lost == 3
    assert inbox.counts["/clock"].sent == 7


def test_a_source_that_has_ended_is_gone_until_it_is_back_whatever_comes_late() -> None:
    inbox = Inbox(Recorder())
    inbox.deliver(CLOCK, SAMPLES[CLOCK], envelope(0))
    assert not inbox.is_gone("a")
    inbox.leave("a")
    assert inbox.is_gone("a")
    inbox.come_back("b")
    inbox.deliver(CLOCK, SAMPLES[CLOCK], envelope(1))
    assert inbox.is_gone("a")
    inbox.come_back("a")
    assert not inbox.is_gone("a")


def test_bytes_are_decoded_and_garbage_is_counted() -> None:
    inbox = Inbox(Navigation())
    inbox.deliver(GOAL_POSE, b"\x00\x01\x00\x00garbage", envelope(0))
    inbox.deliver(GOAL_POSE, encode(GOAL_POSE, GOAL), envelope(1))
    assert len(inbox.new(GOAL_POSE)) == 1
    assert inbox.counts["/goal_pose"].rejected["malformed"] == 1


def test_a_message_of_another_world_is_dropped_and_counted() -> None:
    node = Navigation()
    node.world_hash = "now"
    inbox = Inbox(node)
    inbox.deliver(SCAN, SCAN_SAMPLE, envelope(0, world="before"))
    assert inbox.new(SCAN) == []
    assert inbox.counts["/scan"].rejected["other world"] == 1
    inbox.deliver(SCAN, SCAN_SAMPLE, envelope(1, world="now"))
    assert len(inbox.new(SCAN)) == 1


def test_a_node_reads_and_writes_only_what_the_table_says() -> None:
    inbox = Inbox(Navigation())
    with pytest.raises(KeyError):
        inbox.new(IMU)
    outbox = Outbox(Navigation(), lambda *_: None)
    with pytest.raises(PermissionError, match="/scan"):
        outbox.put(SCAN, SCAN_SAMPLE)


def test_what_is_not_finite_goes_no_further() -> None:
    sent: list[object] = []
    outbox = Outbox(Navigation(), lambda topic, message, _: sent.append(message))
    command = msg.TwistStamped(
        msg.header(0, ""), msg.Twist(msg.Vector3(np.nan, 0.0, 0.0), msg.Vector3(0.0, 0.0, 0.0))
    )
    outbox.put(CMD_VEL, command)
    assert sent == []
    assert outbox.rejected["/cmd_vel", "not finite"] == 1


def test_a_trigger_keeps_its_beat_and_wakes_on_messages() -> None:
    node = Navigation()
    inbox = Inbox(node)
    trigger = Trigger(node)
    due = [now for now in range(0, 200, 10) if trigger.due(now, inbox)]
    assert due == [0, 50, 100, 150]
    inbox.deliver(GOAL_POSE, GOAL, envelope(0))
    assert trigger.due(191, inbox)
    inbox.new(GOAL_POSE)
    assert not trigger.due(192, inbox)
    assert trigger.due(200, inbox)


def test_a_trigger_starts_anew_when_time_does() -> None:
    node = Navigation()
    inbox = Inbox(node)
    trigger = Trigger(node)
    assert trigger.due(10_000, inbox)
    assert trigger.due(0, inbox)
    assert trigger.due(50, inbox)


def test_streams_of_one_seed_differ_and_repeat() -> None:
    first = random_generator(7, "physics/lidar").random(4)
    assert np.array_equal(first, random_generator(7, "physics/lidar").random(4))
    assert not np.array_equal(first, random_generator(7, "physics/imu").random(4))
    assert not np.array_equal(first, random_generator(8, "physics/lidar").random(4))


def test_only_what_a_node_waits_for_wakes_its_loop() -> None:
    calls: list[int] = []
    inbox = Inbox(Navigation(), lambda: calls.append(1))
    inbox.deliver(SCAN, SCAN_SAMPLE, envelope(0))
    assert not calls
    inbox.deliver(GOAL_POSE, GOAL, envelope(0))
    assert len(calls) == 1


def test_time_wakes_a_periodic_node_once_a_period_and_where_it_begins_anew() -> None:
    node = Navigation()
    trigger, inbox = Trigger(node), Inbox(node)
    assert trigger.is_time(0)
    assert trigger.due(0, inbox)
    assert [now_ns for now_ns in range(100) if trigger.is_time(now_ns)] == list(range(50, 100))
    assert trigger.due(1000, inbox)
    assert not trigger.is_time(1049)
    assert trigger.is_time(0)
    assert not Trigger(Recorder()).is_time(10)
