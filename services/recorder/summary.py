"""The summary of a run, as its summary.json holds it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic_core import to_json

from services.common.documents import Evaluation, SimulationStats, World
from services.common.node import TopicCounts

Summary = dict[str, Any]
RejectedElsewhere = Mapping[tuple[str, str, str], int]
"""Messages that other services rejected: by service, topic and reason."""


def build_summary(
    *,
    world: World,
    seed: int,
    stats: SimulationStats | None,
    rebuilds: int,
    pauses: int,
    paused_s: float,
    sim_time_s: float,
    recorded_s: float,
    wall_time_s: float,
    evaluation: Evaluation,
    totals: Mapping[str, Any],
    counts: Mapping[str, TopicCounts],
    rejected_elsewhere: RejectedElsewhere,
    versions: Mapping[str, str],
) -> Summary:
    """Everything about a run that a script may want, as JSON values and documents.

    `wall_time_s` runs from the first tick of the clock that came here to the newest message, but
    for the time in which the simulation was paused, and `recorded_s` is the simulation time between
    them; the real time factor is None before any has passed. `rebuilds` counts how often the world
    was built anew while time went on. `messages` counts by topic what its publishers sent, what
    came here, what was lost on the way here, and what any service rejected, with the service and
    the reason.
    """
    judged = dict(evaluation)
    contacts = judged.pop("contacts")
    totals = dict(totals)
    return {
        "world": world.name,
        "world_hash": world.hash,
        "seed": seed,
        "epoch": stats.epoch if stats else 0,
        "rebuilds": rebuilds,
        "state_hash": stats.state_hash if stats else "",
        "image_hash": stats.image_hash if stats else "",
        "sim_time_s": sim_time_s,
        "wall_time_s": wall_time_s,
        "real_time_factor": recorded_s / wall_time_s if wall_time_s > 0.0 else None,
        "pauses": {"count": pauses, "wall_time_s": paused_s},
        "renderer": stats.renderer if stats else "",
        "goals": judged.pop("goals"),
        "contacts": {"count": totals.pop("contacts"), "list": contacts},
        **judged,
        **totals,
        "messages": _messages(counts, rejected_elsewhere),
        "versions": dict(versions),
    }


def summary_text(summary: Summary) -> Iterator[bytes]:
    """The text of summary.json, as UTF-8, piece by piece: in one it would be longer with each goal,
    every few seconds.
    """
    yield from _pieces(summary, b"\n")
    yield b"\n"


def _pieces(value: Any, line: bytes) -> Iterator[bytes]:
    """JSON of a value, in lines that begin like this one."""
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


def _messages(counts: Mapping[str, TopicCounts], elsewhere: RejectedElsewhere) -> Summary:
    rejected: dict[str, dict[str, int]] = {}
    for topic, seen in counts.items():
        for reason, count in seen.rejected.items():
            rejected.setdefault(topic, {})[f"recorder: {reason}"] = count
    for (service, topic, reason), count in elsewhere.items():
        rejected.setdefault(topic, {})[f"{service}: {reason}"] = count
    topics = dict.fromkeys((*counts, *rejected))
    return {
        topic: {
            "sent": counts[topic].sent if topic in counts else 0,
            "received": counts[topic].received if topic in counts else 0,
            "lost": counts[topic].lost if topic in counts else 0,
            "rejected": sum(rejected.get(topic, {}).values()),
            "rejected_by": dict(sorted(rejected.get(topic, {}).items())),
        }
        for topic in topics
    }
