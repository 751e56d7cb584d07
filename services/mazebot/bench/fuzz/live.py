"""Malformed messages to a running stack, from a stranger, while the robot drives."""

from __future__ import annotations

import random
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

from mazebot.bench.chaos.run import STEADY_S
from mazebot.bench.chaos.stacks import ProcessStack
from mazebot.bench.chaos.tasks import GOAL_S, Drive
from mazebot.bench.chaos.witness import Witness
from mazebot.bench.fuzz.decoders import MEMORY_MB, Tell
from mazebot.bench.fuzz.mutations import mutated, oversize
from mazebot.common.bus.attachment import pack_attachment
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import open_session
from mazebot.common.config import ConfigError
from mazebot.common.messages import wire
from mazebot.common.messages.keys import DEFAULT_KEYS
from mazebot.common.messages.topics import QUERIES, TOPICS, Topic
from mazebot.common.node.node import Envelope

_ACTIVE_S = 240.0
_PAUSE_S = 0.0005
"""After each message: some thousand a second are more than any robot sends."""
_CLIENT_S = 5.0


@dataclass
class LiveReport:
    """What came of it."""

    sent: int = 0
    queries: int = 0
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
        witness = Witness(stack.endpoint, "sim_house_enhanced")
        try:
            witness.request_world(_ACTIVE_S)
            _fuzz(stack, witness, seed, seconds, real, report, tell)
        finally:
            witness.close()
    finally:
        stack.stop()
    return report


def _fuzz(
    stack: ProcessStack,
    witness: Witness,
    seed: int,
    seconds: float,
    real: Mapping[str, list[bytes]],
    report: LiveReport,
    tell: Tell,
) -> None:
    drive = Drive(witness, seed)
    witness.wait(lambda: witness.is_active, STEADY_S, "an active navigation")
    # Whatever a drive needs is in memory after the first one.
    drive.begin()
    witness.wait(drive.outcome, GOAL_S, "the result of a goal")
    drive.begin()
    stack.look()
    before, memory = witness.alive(), stack.memory_mb()
    session = open_session(BusConfig(connect=stack.endpoint), _CLIENT_S)
    others = [data for found in real.values() for data in found if len(data) < 100_000]
    rng = random.Random(f"{seed} live")
    read = [topic for topic in TOPICS if topic.readers]
    for topic in read:
        _put(session, topic, oversize(rng.choice(others), rng), rng)
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        topic = rng.choice(read)
        data = mutated(rng.choice(real.get(topic.name, others)), others, rng)
        if _is_valid(topic, data):
            # Whoever may publish may also say what is true: that is no fault.
            continue
        _put(session, topic, data, rng)
        report.sent += 1
        if report.sent % 50 == 0:
            _ask(session, rng.choice(QUERIES).name, data)
            report.queries += 1
        if report.sent % 1000 == 0:
            tell(f"a running stack: {report.sent} messages")
            if drive.outcome():
                report.goals_reached += drive.outcome() == "reached"
                drive.begin()
        time.sleep(_PAUSE_S)
    session.close()  # type: ignore[no-untyped-call]
    tell("a running stack: the last goal")
    _judge(stack, witness, drive, report, before, memory)


def _judge(
    stack: ProcessStack,
    witness: Witness,
    drive: Drive,
    report: LiveReport,
    before: Mapping[str, frozenset[str]],
    memory: Mapping[str, float],
) -> None:
    try:
        witness.wait(drive.outcome, GOAL_S, "the result of a goal")
    except ConfigError as error:
        report.findings.append(str(error))
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
    grown = stack.memory_mb()
    report.grown_mb = {name: grown.get(name, 0.0) - memory[name] for name in memory}
    for name, grown_mb in report.grown_mb.items():
        # A recording grows by itself.
        if name != "recorder" and grown_mb > MEMORY_MB:
            report.findings.append(f"{name} has grown by {grown_mb:.0f} MB")


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
