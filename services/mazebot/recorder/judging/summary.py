"""Makes the summary of a run, and its text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pydantic_core import to_json

from mazebot.common.config import value_of
from mazebot.common.messages.documents import Evaluation, Parameters, SimulationStats, World
from mazebot.common.node.node import TopicCounts
from mazebot.common.recordings.summary import (
    ChangedSetting,
    Contacts,
    Hardware,
    Pauses,
    RunSummary,
    TopicMessages,
)
from mazebot.recorder.judging.wall_time import WallTime

RejectedElsewhere = Mapping[tuple[str, str, str], int]
"""Messages that other services rejected: by service, topic and reason."""


def build_summary(
    *,
    ended: bool,
    world: World,
    seed: int,
    stats: SimulationStats | None,
    rebuilds: int,
    sim_time_s: float | None,
    wall_time: WallTime,
    now_s: float,
    evaluation: Evaluation,
    totals: Mapping[str, Any],
    counts: Mapping[str, TopicCounts],
    recorded: Mapping[str, int] | None,
    wanted: Mapping[str, int],
    rejected_elsewhere: RejectedElsewhere,
    versions: Mapping[str, str],
    hardware: Hardware | None = None,
    parameters: Iterable[Parameters] = (),
) -> RunSummary:
    """The summary of a run so far; `recorded`: messages in its files, None: it has none; `wanted`:
    those that were to be there; `now_s` is the wall time up to which its pauses are counted.
    """
    judged = dict(evaluation)
    contacts = judged.pop("contacts")
    totals = dict(totals)
    count = totals.pop("contacts")
    return RunSummary(
        world=world.name,
        world_hash=world.hash,
        ended=ended,
        seed=seed,
        epoch=stats.epoch if stats else None,
        rebuilds=rebuilds,
        state_hash=(stats.state_hash or None) if stats else None,
        image_hash=(stats.image_hash or None) if stats else None,
        sim_time_s=sim_time_s,
        wall_time_s=wall_time.wall_time_s,
        real_time_factor=wall_time.real_time_factor,
        pauses=Pauses(count=wall_time.pauses, wall_time_s=wall_time.paused_s(now_s)),
        renderer=(stats.renderer or None) if stats else None,
        contacts=Contacts(count=count, list=contacts),
        **judged,
        **totals,
        messages=_messages(counts, recorded, wanted, rejected_elsewhere),
        versions=dict(versions),
        hardware=hardware,
        changed_settings=_changed(parameters),
    )


def summary_text(summary: RunSummary) -> Iterator[bytes]:
    """The text of summary.json, as UTF-8, in pieces: as one string it would grow with each goal,
    every few seconds.
    """
    yield from _pieces(dict(summary), b"\n")
    yield b"\n"


def _changed(parameters: Iterable[Parameters]) -> dict[str, ChangedSetting]:
    return {
        f"{entry.service}.{name}": ChangedSetting(
            value=value_of(entry.values, name), default=default
        )
        for entry in sorted(parameters, key=lambda entry: entry.service)
        if entry.service != "recorder"
        for name, default in sorted(entry.defaults.items())
        if name != "seed"
    }


def _pieces(value: Any, line: bytes) -> Iterator[bytes]:
    """JSON of a value, in lines that start like this one."""
    if isinstance(value, Contacts):
        value = dict(value)
    if not isinstance(value, dict | list | tuple) or not value:
        yield to_json(value, indent=2, inf_nan_mode="null").replace(b"\n", line)
        return
    named = isinstance(value, dict)
    opening, closing = (b"{", b"}") if named else (b"[", b"]")
    for index, entry in enumerate(value):
        yield (b"," if index else opening) + line + b"  "
        if named:
            yield to_json(entry) + b": "
        yield from _pieces(value[entry] if named else entry, line + b"  ")
    yield line + closing


def _messages(
    counts: Mapping[str, TopicCounts],
    recorded: Mapping[str, int] | None,
    wanted: Mapping[str, int],
    elsewhere: RejectedElsewhere,
) -> dict[str, TopicMessages]:
    rejected: dict[str, dict[str, int]] = {}
    for topic, seen in counts.items():
        for reason, count in seen.rejected.items():
            rejected.setdefault(topic, {})[f"recorder: {reason}"] = count
    for (service, topic, reason), count in elsewhere.items():
        rejected.setdefault(topic, {})[f"{service}: {reason}"] = count
    rows = {}
    for topic in dict.fromkeys((*counts, *rejected)):
        by = rejected.get(topic, {})
        row = TopicMessages(
            sent=None, received=None, lost=None, recorded=None,
            rejected=sum(by.values()), rejected_by=dict(sorted(by.items())),
        )  # fmt: skip
        known = counts.get(topic)
        if known is not None:
            # Of a topic of a run before, the latched message belongs to this one as well.
            received = known.received if recorded is None else wanted.get(topic, 0)
            row = row.model_copy(update={
                "sent": max(known.sent, received + known.lost),
                "received": received,
                "lost": known.lost,
                "recorded": None if recorded is None else recorded.get(topic, 0),
            })  # fmt: skip
        rows[topic] = row
    return rows
