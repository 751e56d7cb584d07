"""Lockstep over a bus that is slow and out of order, in one process."""

import random
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from mazebot.common.bus import lockstep as steps
from mazebot.common.bus.lockstep import (
    MAPPERS,
    HeldInbox,
    Ledger,
    Lockstep,
    LockstepError,
    Participant,
    Turn,
    TurnEnd,
)
from mazebot.common.config import ServiceConfig
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    GetEntities,
    SimulationControl,
    SimulationControlReply,
)
from mazebot.common.messages.topics import (
    CMD_VEL,
    DIAGNOSTICS,
    ENTITIES,
    GET_ENTITIES,
    GOAL_POSE,
    NAVIGATION_STATUS,
    PARAMETERS,
    SERVICES,
    SIMULATION_CONTROL,
    TF,
    TF_STATIC,
    Delivery,
    Topic,
)
from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.common.node.node import ClockNode, Envelope, Inbox, Node, Outbox
from tests.common.samples import SAMPLES

STEP_NS = 1_000_000
DEADLINE_S = 20.0

Log = list[tuple[str, int, list[str]]]


def frames(writer: str, count: int) -> msg.TFMessage:
    return msg.TFMessage(
        transforms=[msg.transform_stamped(0, writer, f"{writer}_{count}", np.eye(4))]
    )


class Physics(ClockNode):
    name = "physics"
    _config = ServiceConfig()

    def __init__(self, log: Log) -> None:
        self.log = log
        self.now_ns = 0
        self.count = 0

    def next_step_ns(self) -> int | None:
        return None if self.paused else self.now_ns + STEP_NS

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        for request in inbox.requests(SIMULATION_CONTROL):
            self.paused = bool(request.message.pause)
            request.respond(SimulationControlReply())
        if self.paused:
            return
        self.now_ns = now_ns
        self.log.append((self.name, now_ns, ["twist"] * len(inbox.new(CMD_VEL))))
        self.count += 1
        outbox.put(TF, frames(self.name, self.count))
        if self.count == 1:
            outbox.put(TF_STATIC, frames(self.name, 0))


class Localization(Node):
    name = "localization"
    _config = ServiceConfig()
    period_ns = 3 * STEP_NS

    def __init__(self) -> None:
        self.count = 0

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        self.count += 1
        outbox.put(TF, frames(self.name, self.count))


class Navigation(Node):
    name = "navigation"
    _config = ServiceConfig()
    period_ns = 3 * STEP_NS
    wakes = (GOAL_POSE,)

    def __init__(self, log: Log) -> None:
        self.log = log
        self.count = 0

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        self.log.append((self.name, now_ns, ["goal"] * len(inbox.new(GOAL_POSE))))
        self.count += 1
        outbox.put(CMD_VEL, SAMPLES[CMD_VEL])
        if self.count % 3 == 0:
            outbox.put(NAVIGATION_STATUS, SAMPLES[NAVIGATION_STATUS])


class Recorder(Node):
    name = "recorder"
    _config = ServiceConfig()
    period_ns = 10 * STEP_NS
    wakes = (NAVIGATION_STATUS,)
    depth = 64

    def __init__(self, log: Log) -> None:
        self.log = log

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        seen = [str(len(inbox.new(NAVIGATION_STATUS)))]
        seen += [one.service for one in inbox.new(PARAMETERS)]
        seen += [one.status[0].name for one in inbox.new(DIAGNOSTICS)]
        for transforms in inbox.new(TF):
            seen += [entry.child_frame_id for entry in transforms.transforms]
        self.log.append((self.name, now_ns, seen))


class Bringup(Node):
    name = "bringup"
    _config = ServiceConfig()
    period_ns = 10 * STEP_NS
    ends_ns = 60 * STEP_NS

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        if now_ns == 20 * STEP_NS:
            outbox.put(GOAL_POSE, SAMPLES[GOAL_POSE])
        if now_ns >= self.ends_ns:
            self.exit_code = 0


class Quiet(Node):
    """Steps where it is asked something, and says nothing."""

    _config = ServiceConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        if self.name == "spawner":
            for request in inbox.requests(GET_ENTITIES):
                request.respond(SAMPLES[ENTITIES])


class Worldgen(Quiet):
    name = "worldgen"


class Spawner(Quiet):
    name = "spawner"


class Perception(Quiet):
    name = "perception"


def build(log: Log) -> list[Node]:
    return [
        Worldgen(), Physics(log), Spawner(), Perception(), Localization(), Navigation(log),
        Recorder(log), Bringup(),
    ]  # fmt: skip


class SlowBus:
    """Brings messages at its own leisure: in order on one topic of one source, else in any."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._ways: dict[tuple[str, str, str], deque[tuple[Topic[Any], Any, Envelope]]] = {}
        self._lock = threading.Lock()
        self._closed = False
        self._latched: list[tuple[Topic[Any], Any, Envelope]] = []
        self.inboxes: dict[str, HeldInbox] = {}
        self.lost: set[str] = set()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def join(self, name: str, inbox: HeldInbox) -> None:
        """Take in a reader, who gets what is latched."""
        self.inboxes[name] = inbox
        for sent in self._latched:
            if name in sent[0].readers:
                self._set_out(name, *sent)

    def send(self, topic: Topic[Any], message: Any, envelope: Envelope) -> None:
        if topic.delivery is Delivery.LATCHED:
            self._latched.append((topic, message, envelope))
        for reader in topic.readers:
            if reader in self.inboxes and topic.name not in self.lost:
                self._set_out(reader, topic, message, envelope)

    def _set_out(self, reader: str, topic: Topic[Any], message: Any, envelope: Envelope) -> None:
        with self._lock:
            way = self._ways.setdefault((reader, topic.name, envelope.source), deque())
            way.append((topic, message, envelope))

    def _run(self) -> None:
        while not self._closed:
            with self._lock:
                ways = [key for key, way in self._ways.items() if way]
                if ways:
                    key = self._random.choice(ways)
                    self.inboxes[key[0]].deliver(*self._ways[key].popleft())
            time.sleep(0)

    def drain(self) -> None:
        """Wait until nothing is on its way."""
        deadline_s = time.monotonic() + DEADLINE_S
        while any(self._ways.values()):
            assert time.monotonic() < deadline_s
            time.sleep(0.001)

    def close(self) -> None:
        self._closed = True
        self._thread.join()


class Stack:
    """Services on a slow bus, and physics that gives them their turns."""

    def __init__(self, nodes: list[Node], seed: int = 0, timeout_s: float = 5.0) -> None:
        self.bus = SlowBus(seed)
        self.participants: dict[str, Participant] = {}
        self.calls: list[tuple[str, str]] = []
        self.turns: list[tuple[str, Turn]] = []
        self.silent: set[str] = set()
        self.silence_s = 0.0
        self.unmatched: set[str] = set()
        self.sources: dict[str, str] = {}
        self._random = random.Random(seed)
        for node in nodes:
            self.add(node)
        (clock,) = (node for node in nodes if isinstance(node, ClockNode))
        outbox = self.outboxes[clock.name]
        self.lockstep = Lockstep(
            clock, self.bus.inboxes[clock.name], outbox, self.sources[clock.name], self.ask,
            self.matched(clock.name), timeout_s,
        )  # fmt: skip

    outboxes: dict[str, Outbox]

    def add(self, node: Node) -> str:
        """Put a service on the bus; its source."""
        source = f"{self._random.getrandbits(64):016x}"
        call = (node.name, source)
        inbox = HeldInbox(node, lambda: self.calls.append(call))
        self.bus.join(node.name, inbox)
        outbox = Outbox(node, self.bus.send, source)
        self.outboxes = {**getattr(self, "outboxes", {}), node.name: outbox}
        self.sources[node.name] = source
        self.participants[node.name] = Participant(node, inbox, outbox, self.matched(node.name))
        outbox.put(PARAMETERS, node.parameters())
        return source

    def matched(self, name: str) -> Callable[[Any], bool]:
        return lambda _: name not in self.unmatched

    def ask(self, service: str, source: str, turn: Turn) -> TurnEnd | None:
        """As over the wire."""
        if service in self.silent:
            time.sleep(self.silence_s)
            return None
        self.turns.append((service, turn))
        end = self.participants[service].take(Turn.model_validate_json(turn.model_dump_json()))
        return TurnEnd.model_validate_json(end.model_dump_json())

    def meet_all(self, *but: str) -> None:
        for name, source in self.sources.items():
            if name != "physics" and name not in but:
                self.lockstep.note(name, source, True)

    def run(self, until_ns: int) -> None:
        deadline_s = time.monotonic() + DEADLINE_S
        while self.lockstep.now_ns < until_ns:
            while self.calls:
                self.lockstep.note(*self.calls.pop(0), None)
            self.lockstep.turn()
            assert time.monotonic() < deadline_s, self.lockstep.missing()


@contextmanager
def stack_of(
    log: Log, seed: int = 0, nodes: list[Node] | None = None, timeout_s: float = 5.0
) -> Iterator[Stack]:
    stack = Stack(nodes or build(log), seed, timeout_s)
    try:
        yield stack
    finally:
        stack.bus.close()


def in_one_process(until_ns: int) -> Log:
    log: Log = []
    executive = Executive(build(log), MemoryTransport())
    while executive.now_ns < until_ns:
        executive.turn()
    return log


@pytest.mark.parametrize("seed", range(3))
def test_a_slow_bus_cannot_be_seen_in_a_run(seed: int) -> None:
    log: Log = []
    with stack_of(log, seed) as stack:
        stack.meet_all()
        stack.run(50 * STEP_NS)
    assert log == in_one_process(50 * STEP_NS)
    recorded = [seen for name, _, seen in log if name == "recorder"]
    assert recorded[0][1:9] == [name for name in SERVICES if name not in MAPPERS]
    assert "goal" in [goal for name, _, seen in log if name == "navigation" for goal in seen]


def test_only_those_who_are_due_are_asked() -> None:
    with stack_of([]) as stack:
        stack.meet_all()
        stack.run(50 * STEP_NS)
    asked = [service for service, turn in stack.turns if turn.step]
    # At the first step and at every third.
    assert asked.count("navigation") == 17
    assert asked.count("worldgen") == asked.count("perception") == 0


@pytest.mark.parametrize(
    ("there", "awaited"),
    [
        ((), ["localization"]),
        (("localization",), []),
        (("mapping",), ["explorer"]),
        (("explorer",), ["mapping"]),
        (("mapping", "explorer"), []),
        (("localization", "mapping"), []),
    ],
)
def test_a_run_needs_localisation_or_mapping_and_exploring(
    there: tuple[str, ...], awaited: list[str]
) -> None:
    with stack_of([]) as stack:
        stack.meet_all("localization")
        for name in there:
            stack.lockstep.note(name, f"of {name}", True)
        assert stack.lockstep.awaited() == awaited


def test_nobody_steps_before_all_are_there_and_know_of_each_other() -> None:
    log: Log = []
    with stack_of(log) as stack:
        stack.meet_all("bringup")
        for _ in range(3):
            assert not stack.lockstep.turn()
        assert stack.lockstep.awaited() == ["bringup"]
        stack.unmatched = {"navigation"}
        stack.meet_all()
        assert not stack.lockstep.turn()
        assert not log
        stack.unmatched = set()
        stack.run(50 * STEP_NS)
    assert log == in_one_process(50 * STEP_NS)


def test_one_who_does_not_answer_is_named_with_the_time() -> None:
    with stack_of([], timeout_s=2.0) as stack:
        stack.meet_all()
        stack.run(50 * STEP_NS)
        stack.silent = {"navigation"}
        stack.silence_s = 2.0
        words = r"lockstep: navigation timed out after 2 s, at 0\.051 s of simulation time"
        with pytest.raises(LockstepError, match=words):
            stack.run(60 * STEP_NS)


def test_one_who_is_gone_is_not_said_to_be_slow() -> None:
    with stack_of([]) as stack:
        stack.meet_all()
        stack.run(50 * STEP_NS)
        stack.silent = {"navigation"}
        with pytest.raises(LockstepError, match=r"lockstep: navigation disconnected at 0\.051 s"):
            stack.run(60 * STEP_NS)


def test_a_tour_that_is_stopped_is_let_go() -> None:
    with stack_of([]) as stack:
        stack.meet_all()
        stack.run(25 * STEP_NS)
        stack.silent = {"bringup"}
        stack.run(40 * STEP_NS)
        assert "bringup" in stack.lockstep.missing()


def test_a_message_that_never_comes_is_named() -> None:
    with stack_of([], timeout_s=2.0) as stack:
        stack.meet_all()
        stack.run(10 * STEP_NS)
        stack.bus.lost = {TF.name}
        with pytest.raises(LockstepError, match=r": /tf #\d+ was not received at 0.0"):
            stack.run(60 * STEP_NS)


def test_who_is_no_longer_wanted_waits_for_no_message() -> None:
    wanted = iter([True, True, False])
    inbox = HeldInbox(Physics([]), lambda: None, lambda: next(wanted))
    start_s = time.monotonic()
    error = inbox.take_in(["ab"], [(CMD_VEL.name, "ab", 3)], DEADLINE_S, and_outside=False)
    assert error == "/cmd_vel #3 was not received"
    assert time.monotonic() - start_s < DEADLINE_S / 2.0


def test_one_who_leaves_ends_the_run_but_for_bringup() -> None:
    with stack_of([]) as stack:
        stack.meet_all()
        stack.run(10 * STEP_NS)
        stack.lockstep.note("navigation", "another", False)
        stack.lockstep.note("bringup", stack.sources["bringup"], False)
        stack.run(20 * STEP_NS)
        assert "bringup" in stack.lockstep.missing()
        with pytest.raises(LockstepError, match=r"navigation disconnected at 0\.020 s"):
            stack.lockstep.note("navigation", stack.sources["navigation"], False)


def test_a_tour_that_has_ended_leaves_and_a_new_one_joins() -> None:
    log: Log = []
    with stack_of(log) as stack:
        stack.meet_all()
        stack.run(80 * STEP_NS)
        assert "bringup" in stack.lockstep.missing()
        stack.lockstep.note("bringup", stack.sources["bringup"], False)
        late = Bringup()
        late.ends_ns = 120 * STEP_NS
        stack.lockstep.note("bringup", stack.add(late), True)
        stack.run(100 * STEP_NS)
        assert "bringup" not in stack.lockstep.missing()
        stack.run(150 * STEP_NS)
        assert "bringup" in stack.lockstep.missing()
    assert any("bringup" in seen for name, now_ns, seen in log if now_ns > 80 * STEP_NS)


def test_a_service_that_waits_for_long_takes_in_without_a_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(steps, "MAX_UNANNOUNCED", 20)
    with stack_of([]) as stack:
        stack.meet_all()
        stack.run(50 * STEP_NS)
        taken = [turn for name, turn in stack.turns if name == "perception" and turn.sent]
        assert len(taken) >= 2
        assert not any(turn.step for turn in taken)
        assert stack.bus.inboxes["perception"].pending(TF)


def test_what_comes_from_outside_is_taken_in_at_once() -> None:
    log: Log = []
    with stack_of(log) as stack:
        stack.meet_all()
        stack.run(25 * STEP_NS)
        stack.bus.inboxes["navigation"].deliver(
            GOAL_POSE, SAMPLES[GOAL_POSE], Envelope("a person", 0, 0, "")
        )
        stack.run(26 * STEP_NS)
        answers: list[Any] = []
        stack.bus.inboxes["spawner"].ask(GET_ENTITIES, GetEntities(), answers.append)
        stack.run(27 * STEP_NS)
        assert answers == [SAMPLES[ENTITIES]]
        stack.run(40 * STEP_NS)
    assert [service for service, turn in stack.turns if turn.step].count("spawner") == 1
    assert ("navigation", 26 * STEP_NS, ["goal"]) in log


def test_a_paused_simulation_still_answers() -> None:
    log: Log = []
    with stack_of(log) as stack:
        stack.meet_all()
        stack.run(10 * STEP_NS)
        answers: list[Any] = []
        physics = stack.bus.inboxes["physics"]
        physics.ask(SIMULATION_CONTROL, SimulationControl(pause=True), answers.append)
        stack.lockstep.turn()
        assert len(answers) == 1
        for _ in range(5):
            stack.lockstep.turn()
        assert stack.lockstep.now_ns <= 11 * STEP_NS
        physics.ask(SIMULATION_CONTROL, SimulationControl(pause=False), answers.append)
        stack.run(20 * STEP_NS)
        assert len(answers) == 2


def test_another_executive_begins_anew() -> None:
    log: Log = []
    with stack_of(log) as stack:
        stack.meet_all()
        stack.run(23 * STEP_NS)
        stack.bus.drain()
        again: Log = []
        source = stack.add(physics := Physics(again))
        second = Lockstep(
            physics, stack.bus.inboxes["physics"], stack.outboxes["physics"], source, stack.ask,
            stack.matched("physics"), 5.0,
        )  # fmt: skip
        stack.lockstep = second
        del log[:]
        stack.meet_all()
        stack.run(15 * STEP_NS)
    recorded = [seen for name, _, seen in log if name == "recorder"]
    # Nothing of before is left but what is latched.
    frames_seen = [name for name in recorded[0] if "_" in name]
    assert frames_seen == ["physics_1", "localization_9"]
    assert len(again) >= 15


def test_the_ledger_tells_each_reader_once_and_in_order() -> None:
    ledger = Ledger()
    for service in ("physics", "navigation", "recorder"):
        ledger.join(service, service[0], {PARAMETERS.name: 1})
    ledger.take("recorder")
    ledger.add("physics", {TF.name: 2})
    ledger.add("navigation", {TF.name: 1})
    ledger.add("navigation", {TF.name: 3})
    ledger.add("physics", {TF.name: 3})
    assert ledger.wakes("recorder", [TF.name])
    assert ledger.waiting("recorder") == 6
    assert ledger.take("recorder") == (
        (TF.name, "p", 1), (TF.name, "n", 2), (TF.name, "p", 2),
    )  # fmt: skip
    assert ledger.take("recorder") == ()
    assert not ledger.wakes("recorder", [TF.name])


def test_a_newcomer_is_told_of_what_is_latched_alone() -> None:
    ledger = Ledger()
    ledger.join("physics", "p", {})
    ledger.join("navigation", "n", {})
    ledger.add("physics", {TF.name: 9, TF_STATIC.name: 2})
    ledger.join("recorder", "r", {})
    assert ledger.take("recorder") == ((TF_STATIC.name, "p", 1),)
    ledger.leave("physics")
    ledger.leave("recorder")
    ledger.join("recorder", "q", {})
    assert ledger.take("recorder") == ()
