"""Malformed messages, floods and silent connections to a running stack, from a stranger, while the
robot drives.
"""

from __future__ import annotations

import random
import socket
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from mazebot.bench.chaos.run import STEADY_S
from mazebot.bench.chaos.stacks import ProcessStack
from mazebot.bench.chaos.tasks import GOAL_S, Drive
from mazebot.bench.chaos.witness import Witness
from mazebot.bench.fuzz.crowd import READERS, STOPPED, crowd
from mazebot.bench.fuzz.decoders import MEMORY_MB, Tell
from mazebot.bench.fuzz.mutations import mutated, oversize
from mazebot.common.bus.attachment import pack_attachment
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.config import ConfigError
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import wire
from mazebot.common.messages.documents import Planar
from mazebot.common.messages.keys import DEFAULT_KEYS
from mazebot.common.messages.topics import CMD_VEL, QUERIES, SEND_GOAL, TOPICS, Topic
from mazebot.common.node.node import Envelope

_ACTIVE_S = 240.0
_PAUSE_S = 0.0005
"""After each message: some thousand a second are more than any robot sends."""
_CLIENT_S = 5.0
_FLOOD_SHARE = 0.25
"""Of the seconds, after the malformed messages: requests, as fast as a program can."""
_ANSWER_S = 30.0
HALF_OPEN = 150
QUIET = "nothing"
JOIN_S = 1.0
"""For a new client, beside connections that say nothing."""


@dataclass
class LiveReport:
    """What came of it."""

    sent: int = 0
    queries: int = 0
    requests: int = 0
    """Of the flood."""
    answered: int = 0
    join_s: float = 0.0
    """Of a client beside connections that say nothing."""
    period_p99_ms: dict[str, float] = field(default_factory=dict)
    """Between velocity commands of a drive, with nothing else and with each kind of trouble."""
    goals_reached: int = 0
    grown_mb: dict[str, float] = field(default_factory=dict)
    findings: list[str] = field(default_factory=list)


def fuzz_stack(
    seed: int, seconds: float, real: Mapping[str, list[bytes]], folder: Path, tell: Tell
) -> LiveReport:
    """Do it for some seconds. Raises ConfigError where the stack cannot be started."""
    stack, report = ProcessStack(folder, seed), LiveReport()
    try:
        tell("starting a stack")
        stack.start()
        witness = Witness(stack.bus, "sim_house_enhanced")
        try:
            witness.request_world(_ACTIVE_S)
            _fuzz(stack, witness, seed, seconds, real, report, tell)
        finally:
            witness.close()
    finally:
        stack.stop()
    return report


class _Stranger:
    """Drives the robot as its owner does, and meanwhile does what nobody should."""

    def __init__(
        self, stack: ProcessStack, witness: Witness, seed: int, report: LiveReport, tell: Tell
    ) -> None:
        self._stack, self._witness, self._report, self._tell = stack, witness, report, tell
        self._rng = random.Random(f"{seed} live")
        self._session = open_session(BusConfig(connect=stack.endpoint), _CLIENT_S)
        self.drive = Drive(witness, seed)
        self._trouble = ""
        self._drives = 0
        self._commands: list[tuple[str, int, float]] = []
        """The trouble, the drive and the wall time of each velocity command."""
        self._subscriber = subscribe(self._session, CMD_VEL, lambda *_: self._on_command())

    def close(self) -> None:
        """Leave the bus."""
        self._subscriber.undeclare()
        self._session.close()  # type: ignore[no-untyped-call]

    def drive_with(self, trouble: str, least_s: float = 0.0) -> None:
        """Drive for at least some seconds, to the end of a goal."""
        self._trouble, end_s = trouble, time.monotonic() + least_s
        while True:
            self.go_on()
            self._witness.wait(self.drive.outcome, GOAL_S, "the result of a goal")
            if time.monotonic() >= end_s:
                return

    def go_on(self) -> None:
        """Send the robot to its next goal, if it has none."""
        if not self.drive.is_over():
            return
        self._report.goals_reached += self.drive.outcome() == "reached"
        self._drives += 1
        self.drive.begin()

    def send_malformed(self, real: Mapping[str, list[bytes]], seconds: float) -> None:
        """Messages on all topics, and now and then a query."""
        self._trouble = "malformed messages"
        rng, report = self._rng, self._report
        others = [data for found in real.values() for data in found if len(data) < 100_000]
        read = [topic for topic in TOPICS if topic.readers]
        for topic in read:
            _put(self._session, topic, oversize(rng.choice(others), rng), rng)
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            topic = rng.choice(read)
            data = mutated(rng.choice(real.get(topic.name, others)), others, rng)
            if _is_valid(topic, data):
                # Whoever may publish may also say what is true: that is no fault.
                continue
            _put(self._session, topic, data, rng)
            report.sent += 1
            if report.sent % 50 == 0:
                _ask(self._session, rng.choice(QUERIES).name, data)
                report.queries += 1
            if report.sent % 1000 == 0:
                self._tell(f"a running stack: {report.sent} messages")
                self.go_on()
            time.sleep(_PAUSE_S)

    def flood(self, seconds: float) -> None:
        """Goals far outside the map: each is answered once, also where too many of them wait."""
        self._trouble = "a flood of goals"
        goal = act.NavigateToPose(pose=Planar(x_m=1e4, y_m=1e4, yaw_rad=0.0))
        lock = threading.Lock()
        answers: dict[str, int] = {}

        def heard(goal_id: str, reply: zenoh.Reply) -> None:
            is_late = reply.err is not None and reply.err.payload.to_string() == "Timeout"
            with lock:
                answers[goal_id] += not is_late

        key = DEFAULT_KEYS.of_query(SEND_GOAL)
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            goal_id = f"flood-{len(answers)}"
            with lock:
                answers[goal_id] = 0
            payload = wire.encode_json(act.SendGoal(goal_id=goal_id, goal=goal))
            self._session.get(key, partial(heard, goal_id), payload=payload, timeout=_ANSWER_S)
            if len(answers) % 1000 == 0:
                self._tell(f"a running stack: a flood of {len(answers)} goals")
            self.go_on()
            time.sleep(_PAUSE_S)
        self._report.requests = len(answers)
        try:
            self._witness.wait(lambda: all(answers.values()), _ANSWER_S, "answers to all goals")
        except ConfigError as error:
            self._report.findings.append(str(error))
        self._report.answered = sum(answers.values())
        twice = sum(count > 1 for count in answers.values())
        if twice:
            self._report.findings.append(f"{twice} requests were answered more than once")

    def connect_silently(self) -> None:
        """Connections that say nothing keep no client from joining, nor the robot from driving."""
        with ExitStack() as held:
            for _ in range(HALF_OPEN):
                address = ("127.0.0.1", self._stack.port)
                held.enter_context(socket.create_connection(address, _CLIENT_S))
            begin_s = time.monotonic()
            session = open_session(BusConfig(connect=self._stack.endpoint), _CLIENT_S)
            self._report.join_s = time.monotonic() - begin_s
            session.close()  # type: ignore[no-untyped-call]
            self.drive_with("silent connections")
        if self._report.join_s > JOIN_S:
            self._report.findings.append(f"a client joined after {self._report.join_s:.1f} s")

    def be_read(self, seconds: float) -> None:
        """Many who read all that is said, some of whom stand still, delay no command."""
        with crowd(self._stack.endpoint):
            self.drive_with(f"{READERS} readers of everything, {STOPPED} stopped", seconds)

    def measure(self) -> None:
        """Take the periods of control into the report."""
        periods: dict[str, list[float]] = {}
        for (trouble, drive, before_s), (*same, after_s) in pairwise(self._commands):
            if trouble and [trouble, drive] == same:
                periods.setdefault(trouble, []).append(1e3 * (after_s - before_s))
        self._report.period_p99_ms = {
            trouble: float(np.percentile(found, 99.0)) for trouble, found in periods.items()
        }

    def _on_command(self) -> None:
        if self._drives and not self.drive.is_over():
            self._commands.append((self._trouble, self._drives, time.monotonic()))


def _fuzz(
    stack: ProcessStack,
    witness: Witness,
    seed: int,
    seconds: float,
    real: Mapping[str, list[bytes]],
    report: LiveReport,
    tell: Tell,
) -> None:
    witness.wait(lambda: witness.is_active, STEADY_S, "an active navigation")
    stranger = _Stranger(stack, witness, seed, report, tell)
    # Whatever a drive needs is in memory after the first one.
    stranger.drive_with("")
    tell("a running stack: driving, for comparison")
    stranger.drive_with(QUIET, seconds * _FLOOD_SHARE)
    stack.look()
    before, memory = witness.alive(), _memory_mb(stack)
    stranger.go_on()
    stranger.send_malformed(real, seconds)
    stranger.flood(seconds * _FLOOD_SHARE)
    tell("a running stack: the last goals")
    try:
        witness.wait(stranger.drive.outcome, GOAL_S, "the result of a goal")
        stranger.connect_silently()
        tell(f"a running stack: {READERS} readers of everything")
        stranger.be_read(seconds * _FLOOD_SHARE)
    except ConfigError as error:
        report.findings.append(str(error))
    stranger.measure()
    stranger.close()
    _judge(stack, witness, stranger.drive, report, before, memory)


def _judge(
    stack: ProcessStack,
    witness: Witness,
    drive: Drive,
    report: LiveReport,
    before: Mapping[str, frozenset[str]],
    memory: Mapping[str, float],
) -> None:
    outcome = drive.outcome()
    report.goals_reached += outcome == "reached"
    if outcome != "reached":
        report.findings.append(f"a goal ended with {outcome or 'nothing'}")
    after = witness.alive()
    for service, sources in before.items():
        if after.get(service) != sources:
            report.findings.append(f"{service} has ended, and was started again")
    if witness.contacts:
        report.findings.append(f"{len(witness.contacts)} contacts")
    grown = _memory_mb(stack)
    report.grown_mb = {name: grown.get(name, 0.0) - memory[name] for name in memory}
    for name, grown_mb in report.grown_mb.items():
        # A recording grows by itself.
        if name != "recorder" and grown_mb > MEMORY_MB:
            report.findings.append(f"{name} has grown by {grown_mb:.0f} MB")


def _memory_mb(stack: ProcessStack) -> dict[str, float]:
    return {service: memory_mb for service, (_, memory_mb) in stack.held().items()}


def _is_valid(topic: Topic[Any], data: bytes) -> bool:
    try:
        wire.validate(topic, wire.decode(topic, wire.of_own_type(topic, data)))
    except wire.WireError:
        return False
    return True


def _put(session: zenoh.Session, topic: Topic[Any], data: bytes, rng: random.Random) -> None:
    source = f"{rng.getrandbits(128):032x}"
    attachment: bytes | None = rng.choice(
        (
            pack_attachment(topic, Envelope(source, rng.randrange(2**32), 0, "")),
            rng.randbytes(33), rng.randbytes(rng.randrange(80)), None,
        )
    )  # fmt: skip
    session.put(DEFAULT_KEYS.of_topic(topic), data, attachment=attachment)


def _ask(session: zenoh.Session, name: str, data: bytes) -> None:
    query = next(one for one in QUERIES if one.name == name)
    session.get(DEFAULT_KEYS.of_query(query), lambda _: None, payload=data, timeout=_CLIENT_S)
