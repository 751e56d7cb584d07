"""Every service in a process of its own, in lockstep, and a record of what they send."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages.topics import SERVICES, TOPICS, Topic
from mazebot.common.node.node import Envelope
from tests.parity.transport import Record

DEADLINE_S = 100.0


class RunningServices:
    """Their processes, and what a bystander hears of them."""

    def __init__(self, processes: dict[str, subprocess.Popen[bytes]], folder: Path) -> None:
        self.processes = processes
        self._folder = folder
        self._record: Record = []
        self._counts: Counter[str] = Counter()
        self._heard = threading.Condition()

    def hear(self, topic: Topic[Any]) -> Callable[[bytes, Envelope], None]:
        """What takes in the messages of a topic."""

        def receive(payload: bytes, envelope: Envelope) -> None:
            with self._heard:
                self._record.append((topic.name, envelope.sent_ns, envelope.world_hash, payload))
                self._counts[topic.name] += 1
                self._heard.notify()

        return receive

    def record(self) -> Record:
        """What was heard so far."""
        with self._heard:
            return list(self._record)

    def wait_for(self, counts: Mapping[str, int]) -> None:
        """Return when at least so many messages were heard on each topic.

        Raises AssertionError where a service has ended, or it takes too long.
        """
        deadline_s = time.monotonic() + DEADLINE_S
        with self._heard:
            while missing := {
                name: count - self._counts[name]
                for name, count in counts.items()
                if count > self._counts[name]
            }:
                ended = [name for name, process in self.processes.items() if process.poll()]
                assert not ended, [(self._folder / f"{name}.log").read_text() for name in ended]
                assert time.monotonic() < deadline_s, f"never heard: {missing}"
                self._heard.wait(0.1)


@contextmanager
def running_services(
    endpoint: str,
    folder: Path,
    environment: Mapping[str, str] | None = None,
    without: Collection[str] = ("mapping", "explorer"),
) -> Iterator[RunningServices]:
    """All services of a run on a router; each one's output is in a file of the folder."""
    settings = {
        **os.environ,
        "MAZEBOT_BUS_CONNECT": endpoint,
        "MAZEBOT_BUS_PACE": "lockstep",
        "MAZEBOT_RECORDER_RECORD": "false",
        "MAZEBOT_RECORDER_OUT_DIR": str(folder / "run"),
        **(environment or {}),
    }
    session = open_session(BusConfig(connect=endpoint), timeout_s=DEADLINE_S)
    stack = RunningServices({}, folder)
    heard = [subscribe(session, topic, stack.hear(topic)) for topic in TOPICS]
    try:
        for name in SERVICES:
            if name in without:
                continue
            with (folder / f"{name}.log").open("wb") as output:
                stack.processes[name] = subprocess.Popen(
                    [sys.executable, "-m", f"mazebot.{name}"],
                    env=settings, stdout=output, stderr=subprocess.STDOUT,
                )  # fmt: skip
        yield stack
    finally:
        for process in stack.processes.values():
            process.kill()
        for process in stack.processes.values():
            process.wait()
        del heard
        session.close()  # type: ignore[no-untyped-call]


def _burn() -> None:
    while True:
        pass


@contextmanager
def busy(burners: int) -> Iterator[None]:
    """Other processes want the processor, so many of them."""
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=_burn, daemon=True) for _ in range(burners)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.join()
