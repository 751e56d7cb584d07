"""`mazebot topic list|info|hz|echo`."""

from __future__ import annotations

import dataclasses
import difflib
import itertools
import json
import math
import statistics
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml

from mazebot.cli.parsing.options import print_json
from mazebot.cli.parsing.patience import wait_quietly
from mazebot.cli.sim import paused
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.client.robot import NO_STACK, Robot
from mazebot.common.client.service_watch import Silence
from mazebot.common.client.subscription import Subscription
from mazebot.common.config import ConfigError
from mazebot.common.messages import wire
from mazebot.common.messages.documents import Document
from mazebot.common.messages.topics import BY_NAME, EDGE, SERVICES, TOPICS, Topic

ARRAY_SHOWN = 12
"""Numbers of an array to print; of the rest only the count."""


def list_topics(endpoint: str, verbose: bool, as_json: bool) -> None:
    """Print the topics whose owners are running; where none is, standard error tells so."""
    with ZenohRobot(endpoint) as robot:
        services = _running(robot).keys()
    there = sorted(
        (topic for topic in TOPICS if services & set(topic.owners)), key=lambda topic: topic.name
    )
    if as_json:
        print_json([{"name": topic.name, "type": wire.type_name(topic)} for topic in there])
        return
    for topic in there:
        kind = f" [{wire.type_name(topic)}]" if verbose else ""
        sys.stdout.write(f"{topic.name}{kind}\n")


def _running(robot: ZenohRobot) -> Mapping[str, frozenset[str]]:
    """As `Robot.alive`; where no service runs, standard error tells so."""
    services = robot.alive()
    if not services:
        sys.stderr.write(f"{NO_STACK}{robot.elsewhere(*SERVICES)}\n")
    return services


def print_topic(endpoint: str, name: str, as_json: bool) -> None:
    """Print a topic's row of the table, and which of its services are running."""
    topic = named_topic(name)
    with ZenohRobot(endpoint) as robot:
        services, key = _running(robot), robot.keys.of_topic(topic)
    info = {
        "name": topic.name,
        "type": wire.type_name(topic),
        "document": topic.type.__name__ if issubclass(topic.type, Document) else None,
        "about": topic.about,
        "key": key,
        "delivery": topic.delivery.value,
        "depth": topic.depth,
        "rate_hz": topic.rate_hz,
        "publishers": {one: one in services for one in topic.owners},
        "subscribers": {one: one in services for one in topic.readers},
    }
    if as_json:
        print_json(info)
        return
    for label, value in info.items():
        text = value
        if isinstance(value, dict):
            # The command line tool is not a running service.
            text = ", ".join(
                one if there or one == EDGE else f"{one} (not running)"
                for one, there in value.items()
            )
        if value is not None:
            sys.stdout.write(f"{label.replace('_hz', ' (Hz)')}: {text}\n")


def measure_rate(endpoint: str, name: str, window_s: float, as_json: bool) -> None:
    """Print the rate of a topic's messages over a window of wall time, and its jitter.

    Raises ConfigError where too few were received.
    """
    topic = named_topic(name)
    times_s: list[float] = []
    with ZenohRobot(endpoint) as robot:
        end = robot.watch((topic,), lambda *_: times_s.append(time.monotonic()))
        end_s = time.monotonic() + window_s
        silence = Silence()
        while time.monotonic() < end_s:
            before = len(times_s)
            time.sleep(min(0.1, window_s))
            _check_router(robot, silence, len(times_s) > before)
        end()
        if len(times_s) < 2:
            count = f"{len(times_s)} message{'s' * (len(times_s) != 1)}"
            raise _too_few(robot, topic, f"{count} in {window_s:g} s")
    gaps_s = [b - a for a, b in itertools.pairwise(times_s)]
    rate_hz, deviation_s = 1.0 / statistics.fmean(gaps_s), statistics.pstdev(gaps_s)
    if as_json:
        print_json(
            {
                "topic": topic.name,
                "rate_hz": rate_hz,
                "min_s": min(gaps_s),
                "max_s": max(gaps_s),
                "std_dev_s": deviation_s,
                "messages": len(times_s),
            }
        )
        return
    sys.stdout.write(
        f"average rate: {rate_hz:.2f} Hz\n"
        f"  min: {min(gaps_s):.4f} s  max: {max(gaps_s):.4f} s  "
        f"std dev: {deviation_s:.5f} s  window: {len(times_s)}\n"
    )


def echo(endpoint: str, name: str, once: bool, timeout_s: float, as_json: bool) -> None:
    """Print messages as YAML documents, or as one JSON line each, until the timeout; with `once`,
    only the first one.

    Raises ConfigError where none was received.
    """
    topic = named_topic(name)
    count = 0
    with ZenohRobot(endpoint) as robot:
        with Subscription(robot, topic) as messages:
            end_s = time.monotonic() + timeout_s
            silence = Silence()
            while time.monotonic() < end_s and not (once and count):
                has_received = _print_next(messages, as_json)
                count += has_received
                _check_router(robot, silence, has_received)
        if not count:
            raise _too_few(robot, topic, f"no message in {timeout_s:g} s")


def _check_router(robot: Robot, silence: Silence, has_received: bool) -> None:
    """Raises UnreachableError where nothing comes because the router is lost."""
    if silence.is_long(has_received):
        robot.alive()


def _print_next(messages: Subscription, as_json: bool) -> bool:
    """Print a message that is received within 0.1 s; whether there was one."""
    try:
        received = messages.next(0.1)
    except wire.WireError as error:
        # With --json, standard output is JSON only.
        stream = sys.stderr if as_json else sys.stdout
        stream.write(f"# rejected: {error}\n")
        return True
    if received is None:
        return False
    if as_json:
        sys.stdout.write(json.dumps(in_json(received[1]), allow_nan=False) + "\n")
    else:
        sys.stdout.write(f"{yaml.safe_dump(plain(received[1]), sort_keys=False)}---\n")
    sys.stdout.flush()
    wait_quietly()
    return True


def _too_few(robot: Robot, topic: Topic[object], problem: str) -> ConfigError:
    why = paused(robot)
    hint = f"; {why}" if why else robot.elsewhere(*topic.owners)
    return ConfigError(f"{topic.name}: {problem}{hint}")


def in_json(message: object) -> Any:
    """A message as JSON values, arrays in full; non-finite numbers as texts: "Infinity",
    "-Infinity", "NaN".
    """
    return _with_words(plain(message, None))


def _with_words(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _with_words(one) for name, one in value.items()}
    if isinstance(value, list):
        return [_with_words(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0.0 else "-Infinity"
    return value


def plain(value: Any, shown: int | None = ARRAY_SHOWN) -> Any:
    """A message as dicts, lists and numbers; arrays of more than `shown` numbers are truncated."""
    if isinstance(value, Document):
        return value.model_dump(mode="json")
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        return {
            name: plain(getattr(value, name), shown) for name in names if not name.startswith("__")
        }
    if isinstance(value, np.ndarray):
        items = value[:shown].tolist()
        cut = shown is not None and len(value) > shown
        return [*items, f"... {len(value)} in all"] if cut else items
    if isinstance(value, list | tuple):
        return [plain(item, shown) for item in value]
    return value


def named_topic(name: str) -> Topic[object]:
    """The topic of a name with or without its slash. Raises ConfigError where there is none."""
    topic = BY_NAME.get("/" + name.removeprefix("/"))
    if topic is None:
        near = difflib.get_close_matches(f"/{name.removeprefix('/')}", BY_NAME, 1)
        problem = (
            f"did you mean {near[0]}?" if near else f"must be one of {', '.join(sorted(BY_NAME))}"
        )
        raise ConfigError(f"topic: {name!r:.60}: no such topic; {problem}")
    return topic
