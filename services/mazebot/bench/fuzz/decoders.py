"""Malformed messages to what every service decodes and counts with, in this process."""

from __future__ import annotations

import gc
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mazebot.bench.fuzz.mutations import mutated, oversize
from mazebot.bench.memory import resident_mb
from mazebot.common.maths.frames import MAP_FRAME, SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import GOAL_POSE, QUERIES, TOPICS, Topic
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox
from mazebot.common.ros.interfaces import Interfaces, interfaces
from mazebot.common.ros.table import ROS_SERVICES
from mazebot.embedded.session import Session

MEMORY_MB = 64.0
_SECONDS = 6.0
_OVERSIZE = 2
"""Of 50 MB, for each topic."""
_MOST_KEPT = 20

Tell = Callable[[str], None]


@dataclass
class Finding:
    """What must not be: the input shows it."""

    name: str
    problem: str
    data: bytes


@dataclass
class Report:
    """What was sent to one topic, query or service."""

    name: str
    sent: int = 0
    rejected: int = 0
    valid: int = 0
    """Still a message that it may have."""
    findings: list[Finding] = field(default_factory=list)


def real_messages(seed: int) -> dict[str, list[bytes]]:
    """Messages of a short drive, by topic."""
    kept: dict[str, list[bytes]] = {}

    def keep(topic: Topic[Any], message: Any, _: Envelope) -> None:
        found = kept.setdefault(topic.name, [])
        if len(found) < _MOST_KEPT:
            found.append(wire.encode(topic, message))

    with Session("enhanced", seed) as session:
        end = session.watch(TOPICS, keep)
        pose = msg.pose_from_se2(SE2(0.5, -0.9, 0.0))
        session.run_for(1.0)
        session.publish(GOAL_POSE, msg.PoseStamped(msg.header(0, MAP_FRAME), pose))
        session.run_for(_SECONDS)
        end()
    return kept


def fuzz_topics(
    seed: int, cases: int, real: Mapping[str, list[bytes]], tell: Tell, oversized: int = _OVERSIZE
) -> list[Report]:
    """Messages to the inboxes of those who read each topic; `oversized` of them have 50 MB."""
    others = [data for found in real.values() for data in found if len(data) < 100_000]
    reports = []
    for topic in TOPICS:
        if not topic.readers:
            continue
        rng = random.Random(f"{seed} {topic.name}")
        report = Report(topic.name)
        inbox = Inbox(_named(topic.readers[0]))
        valid = real.get(topic.name, others)
        for number, data in enumerate(_cases(valid, others, cases, oversized, rng)):
            if number % 1000 == 0:
                tell(f"{topic.name}: {number} of {cases}")
            _deliver(topic, inbox, data, number, report)
        reports.append(report)
    return reports


def _cases(
    valid: Sequence[bytes], others: Sequence[bytes], cases: int, oversized: int, rng: random.Random
) -> Iterator[bytes]:
    for _ in range(oversized):
        yield oversize(rng.choice(valid), rng)
    for _ in range(cases - oversized):
        yield mutated(rng.choice(valid), others, rng)


def _deliver(topic: Topic[Any], inbox: Inbox, data: bytes, number: int, report: Report) -> None:
    """Exactly one of two must come of it: a message, or one more rejected."""
    counts = inbox.counts[topic.name]
    before = sum(counts.rejected.values())
    report.sent += 1
    try:
        inbox.deliver(topic, data, Envelope(f"{number % 50:032x}", number, 0, ""))
        taken = len(inbox.received(topic))
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        report.findings.append(Finding(topic.name, text[:200], data))
        return
    rejected = sum(counts.rejected.values()) - before
    report.rejected += rejected
    report.valid += taken
    if taken + rejected != 1:
        problem = f"{taken} messages and {rejected} rejections of one"
        report.findings.append(Finding(topic.name, problem, data))


def fuzz_requests(
    seed: int, cases: int, real: Mapping[str, list[bytes]], tell: Tell
) -> list[Report]:
    """Requests to the decoders of queries, and of the services of each distribution."""
    others = [data for found in real.values() for data in found if len(data) < 100_000]
    types: list[tuple[str, Callable[[bytes], Any]]] = [
        (query.name, lambda data, kind=query.request: wire.decode_json(kind, data))  # type: ignore[misc]
        for query in QUERIES
    ]
    of: Interfaces = interfaces("jazzy")
    types += [
        (name, lambda data, kind=kind: of.decode(f"{kind}_Request", data))  # type: ignore[misc]
        for name, kind in sorted({(one.name, one.type) for one in ROS_SERVICES})
    ]
    reports = []
    for name, decode in types:
        rng = random.Random(f"{seed} {name}")
        report = Report(name)
        for number in range(cases):
            if number % 1000 == 0:
                tell(f"{name}: {number} of {cases}")
            data = mutated(rng.choice(others), others, rng)
            report.sent += 1
            try:
                decode(data)
                report.valid += 1
            except wire.WireError:
                report.rejected += 1
            except Exception as error:
                text = f"{type(error).__name__}: {error}"
                report.findings.append(Finding(name, text[:200], data))
        reports.append(report)
    return reports


def memory_after(act: Callable[[], None]) -> float:
    """MB by which the process has grown."""
    gc.collect()
    before = resident_mb()
    act()
    gc.collect()
    return resident_mb() - before


def _named(service: str) -> Node:
    class Named(Node):
        name = service

        def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
            """It only has an inbox."""

    return Named()
