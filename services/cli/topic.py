"""`mazebot topic list|hz|echo`."""

from __future__ import annotations

import dataclasses
import itertools
import queue
import statistics
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from services.cli.session import connected
from services.cli.sim import paused
from services.common import wire
from services.common.bus import alive, subscribe, topic_named
from services.common.config import ConfigError
from services.common.documents import Document
from services.common.topics import TOPICS, Topic

if TYPE_CHECKING:
    import zenoh

ARRAY_SHOWN = 12
"""Numbers of an array to print; the rest is counted."""


def list_topics(endpoint: str, verbose: bool) -> None:
    """Print the topics whose owners are there."""
    with connected(endpoint) as session:
        services = alive(session)
    for topic in sorted(TOPICS, key=lambda topic: topic.name):
        if services & set(topic.owners):
            kind = f" [{wire.type_name(topic)}]" if verbose else ""
            sys.stdout.write(f"{topic.name}{kind}\n")


def measure_rate(endpoint: str, name: str, window_s: float) -> None:
    """Print the rate of a topic's messages over a window of wall time, and how even it is.

    Raises ConfigError where too few came.
    """
    topic = _topic(name)
    times_s: list[float] = []
    with connected(endpoint) as session:
        subscription = subscribe(session, topic, lambda *_: times_s.append(time.monotonic()))
        end_s = time.monotonic() + window_s
        while time.monotonic() < end_s:
            time.sleep(min(0.1, window_s))
        del subscription
        if len(times_s) < 2:
            count = f"{len(times_s)} message{'s' * (len(times_s) != 1)}"
            raise _too_few(session, topic, f"{count} in {window_s:g} s")
    gaps_s = [b - a for a, b in itertools.pairwise(times_s)]
    sys.stdout.write(
        f"average rate: {1.0 / statistics.fmean(gaps_s):.2f} Hz\n"
        f"  min: {min(gaps_s):.4f} s  max: {max(gaps_s):.4f} s  "
        f"std dev: {statistics.pstdev(gaps_s):.5f} s  window: {len(times_s)}\n"
    )


def echo(endpoint: str, name: str, once: bool, timeout_s: float) -> None:
    """Print messages as YAML documents until the time is out; with `once`, the first one.

    Raises ConfigError where none came.
    """
    topic = _topic(name)
    payloads: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    count = 0
    with connected(endpoint) as session:
        subscription = subscribe(session, topic, lambda payload, _: payloads.put(payload))
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s and not (once and count):
            try:
                payload = payloads.get(timeout=0.1)
            except queue.Empty:
                continue
            try:
                text = yaml.safe_dump(plain(wire.decode(topic, payload)), sort_keys=False)
            except wire.WireError as error:
                text = f"# rejected: {error}\n"
            sys.stdout.write(f"{text}---\n")
            sys.stdout.flush()
            count += 1
        del subscription
        if not count:
            raise _too_few(session, topic, f"no message in {timeout_s:g} s")


def _too_few(session: zenoh.Session, topic: Topic[object], said: str) -> ConfigError:
    why = paused(session)
    return ConfigError(f"{topic.name}: {said}{f'; {why}' if why else ''}")


def plain(value: Any) -> Any:
    """A message as dicts, lists and numbers, long arrays cut short."""
    if isinstance(value, Document):
        return value.model_dump(mode="json")
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        return {name: plain(getattr(value, name)) for name in names if not name.startswith("__")}
    if isinstance(value, np.ndarray):
        shown = [item.item() for item in value[:ARRAY_SHOWN]]
        return [*shown, f"... {len(value)} in all"] if len(value) > ARRAY_SHOWN else shown
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def _topic(name: str) -> Topic[object]:
    topic = topic_named(name)
    if topic is None:
        raise ConfigError(f"topic: {name!r} is none of ours (see `mazebot topic list`)")
    return topic
