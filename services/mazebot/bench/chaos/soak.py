"""`make soak MINUTES=30`: a stack that is driven in for long, with a service killed each minute and
another world every five.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from mazebot.bench.chaos.faults import Fault
from mazebot.bench.chaos.recordings import faults_of_recordings
from mazebot.bench.chaos.run import try_one
from mazebot.bench.chaos.scratch import scratch_folder
from mazebot.bench.chaos.stacks import SERVICES, ContainerStack, ProcessStack, Stack
from mazebot.bench.chaos.tasks import Drive
from mazebot.bench.chaos.trial import Trial
from mazebot.bench.chaos.witness import Witness
from mazebot.bench.ending import run
from mazebot.common.bus.session import BusUnavailableError
from mazebot.common.config import ConfigError, fail
from mazebot.common.messages.topics import BY_NAME, Delivery, Topic
from mazebot.common.node.node import random_generator
from mazebot.common.recordings.run_folder import SUMMARY

WORLDS = ("sim_house_enhanced", "sim_house_rooms", "sim_house", "sim_house_markers")
"""One after the other: all have places to drive to."""
MINUTE_S = 60.0
_ACTIVE_S = 240.0
_WARM_UP_S = 60.0
"""Of a process: until its caches are filled."""
_LEAST_JUDGED_S = 240.0
"""Of a process after that, for its growth to be told."""
MOST_GROWTH_MB = 64.0
"""Of a process after its warm-up, as in `make fuzz`."""
MOST_FILES = 16
"""By which the open files of a process may grow."""
_SAMPLE_S = 10.0
_SAVES = "recorder"
"""Its memory grows with what it has recorded, until the next world."""


class Sample(NamedTuple):
    """What a service's process held at a moment."""

    service: str
    process: int
    wall_s: float
    memory_mb: float
    files: int | None
    """None: they may not be seen."""


class Life(NamedTuple):
    """One process from its first sample to its last one."""

    service: str
    lasted_s: float
    peak_mb: float
    growth_mb: float | None
    """After the warm-up, by least squares; None: it did not live for long enough."""
    files: int | None
    """By which they grew then."""


def lives_of(samples: Iterable[Sample]) -> list[Life]:
    """Each process of the samples, in the order in which they were first seen."""
    by_process: dict[tuple[str, int], list[Sample]] = {}
    for sample in samples:
        by_process.setdefault((sample.service, sample.process), []).append(sample)
    return [_life(own) for own in by_process.values()]


def _life(own: Sequence[Sample]) -> Life:
    lasted_s = own[-1].wall_s - own[0].wall_s
    peak_mb = max(sample.memory_mb for sample in own)
    late = [sample for sample in own if sample.wall_s - own[0].wall_s >= _WARM_UP_S]
    if not late or late[-1].wall_s - late[0].wall_s < _LEAST_JUDGED_S:
        return Life(own[0].service, lasted_s, peak_mb, None, None)
    times_s = np.array([sample.wall_s for sample in late])
    slope = np.polyfit(times_s - times_s[0], [sample.memory_mb for sample in late], 1)[0]
    growth_mb = float(slope * (times_s[-1] - times_s[0]))
    first, last = late[0].files, late[-1].files
    files = None if first is None or last is None else last - first
    return Life(own[0].service, lasted_s, peak_mb, growth_mb, files)


def samples_of(stack: Stack, wall_s: float) -> Iterator[Sample]:
    """What the processes of a stack hold now."""
    for service, (process, memory_mb) in stack.held().items():
        try:
            files: int | None = sum(1 for _ in Path(f"/proc/{process}/fd").iterdir())
        except OSError:
            files = None
        yield Sample(service, process, wall_s, memory_mb, files)


def _counts_each(topic: Topic[Any]) -> bool:
    if topic.delivery is Delivery.LATEST or topic.rate_hz is not None:
        return False
    return topic.delivery is Delivery.EVERY or topic.depth > 1


def lost_of(recordings: Path, cut: Collection[str] = ()) -> dict[str, int]:
    """Messages that may never be lost and were, by topic, over all runs in a folder. What comes
    regularly is followed by the next one; of a topic that keeps its last message for late readers,
    a later one has taken the place of each that is missing.

    Args:
        recordings: the folder of the runs.
        cut: the names of runs in which there was no router for a while, which explains it.
    """
    lost: dict[str, int] = {}
    for summary in sorted(recordings.glob(f"*/{SUMMARY}")):
        if summary.parent.name in cut:
            continue
        messages = json.loads(summary.read_text(encoding="utf-8"))["messages"]
        for name, counts in messages.items():
            topic = BY_NAME.get(name)
            if topic is not None and _counts_each(topic) and counts["lost"]:
                lost[name] = lost.get(name, 0) + counts["lost"]
    return lost


class _Soak:
    """The drive, and what came of it."""

    def __init__(
        self, stack: Stack, witness: Witness, seed: int, minutes: float, minutes_a_world: int
    ) -> None:
        self.trials: list[Trial] = []
        self.samples: list[Sample] = []
        self.worlds: list[str] = [WORLDS[0]]
        self.cut: set[str] = set()
        """The runs in which the router was killed."""
        self._stack, self._witness = stack, witness
        self._task = Drive(witness, seed)
        self._random = random_generator(seed, "soak/faults")
        self._minutes, self._minutes_a_world = minutes, minutes_a_world
        self._sampled_s = 0.0

    def run(self) -> None:
        """Drive for the whole time. Raises ConfigError where a world does not come."""
        start_s = time.monotonic()
        end_s = start_s + self._minutes * MINUTE_S
        minute = 0
        while time.monotonic() < end_s:
            if minute and minute % self._minutes_a_world == 0:
                self._next_world()
            self._kill_one()
            minute += 1
            self._drive_until(min(end_s, start_s + minute * MINUTE_S))

    def _next_world(self) -> None:
        name = WORLDS[len(self.worlds) % len(WORLDS)]
        self._witness.load_world(name, _ACTIVE_S)
        self.worlds.append(name)
        _say(f"world {len(self.worlds)}: {name}")

    def _kill_one(self) -> None:
        services = (*SERVICES, "router")
        fault = Fault("kill", (services[int(self._random.integers(len(services)))],))
        trial = Trial(fault.name, len(self.trials))
        self._sample()
        if "router" in fault.services:
            runs = [path.parent.name for path in self._stack.recordings.glob(f"*/{SUMMARY}")]
            self.cut.update(sorted(runs)[-1:])
        try:
            try_one(self._stack, self._witness, self._task, fault, trial)
        except ConfigError as error:
            trial.problem = str(error)
        self.trials.append(trial)
        self._witness.forget()
        how = "recovered" if trial.recovered else f"NOT recovered: {trial.problem or trial.goal}"
        _say(f"{len(self.trials)}: {trial.fault}: {how}")
        self._stack.look()

    def _drive_until(self, end_s: float) -> None:
        while time.monotonic() < end_s:
            if self._task.is_over() and self._witness.is_active:
                self._task.begin()
            if time.monotonic() - self._sampled_s >= _SAMPLE_S:
                self._sample()
            time.sleep(min(0.2, max(0.0, end_s - time.monotonic())))

    def _sample(self) -> None:
        self._sampled_s = time.monotonic()
        self.samples.extend(samples_of(self._stack, self._sampled_s))


def failures_of(trials: Sequence[Trial], lives: Sequence[Life], lost: dict[str, int]) -> list[str]:
    """What did not hold, in words."""
    failures = [
        f"{trial.fault}: not recovered: {trial.problem or trial.goal}"
        for trial in trials
        if not trial.recovered
    ]
    failures += [f"{t.fault}: {t.contacts} contacts" for t in trials if t.contacts]
    for life in lives:
        if life.growth_mb is not None and life.growth_mb > MOST_GROWTH_MB:
            if life.service != _SAVES:
                failures.append(
                    f"{life.service}: grew by {life.growth_mb:.0f} MB in {life.lasted_s:.0f} s"
                )
        if life.files is not None and life.files > MOST_FILES:
            failures.append(f"{life.service}: {life.files} more open files")
    failures += [f"{name}: {count} messages lost" for name, count in lost.items()]
    return failures


def main(arguments: Sequence[str]) -> int:
    """Drive, and print; the exit code is 1 where something did not hold."""
    options = _options(arguments)
    with scratch_folder("mazebot-soak-") as scratch:
        kind = ContainerStack if options.containers else ProcessStack
        stack = kind(scratch.path, options.seed)
        try:
            soak, broken, lost = _run(stack, options)
        except (BusUnavailableError, ConfigError) as error:
            fail(str(error))
        lives = lives_of(soak.samples)
        failures = failures_of(soak.trials, lives, lost) + [f"recording: {line}" for line in broken]
        scratch.is_needed = bool(failures)
    reached = sum(trial.recovered for trial in soak.trials)
    console = Console(width=110)
    console.print(_table(lives))
    console.print(
        f"{options.minutes:g} minutes, {len(soak.worlds)} worlds, {len(soak.trials)} services "
        f"killed: {reached} times recovered"
    )
    if options.json:
        report = {
            "seed": options.seed, "minutes": options.minutes, "containers": options.containers,
            "worlds": soak.worlds, "trials": [trial.values() for trial in soak.trials],
            "lives": [life._asdict() for life in lives], "lost": lost,
            "broken_recordings": broken,
        }  # fmt: skip
        Path(options.json).write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    for line in failures:
        _say(f"not kept: {line}")
    return 1 if failures else 0


def _run(stack: Stack, options: argparse.Namespace) -> tuple[_Soak, list[str], dict[str, int]]:
    """Raises ConfigError and BusUnavailableError."""
    _say("starting the stack")
    try:
        stack.start()
        witness = Witness(stack.bus, WORLDS[0])
        try:
            witness.request_world(_ACTIVE_S)
            soak = _Soak(stack, witness, options.seed, options.minutes, options.minutes_a_world)
            soak.run()
        finally:
            witness.close()
    finally:
        stack.stop()
    return soak, faults_of_recordings(stack.recordings), lost_of(stack.recordings, soak.cut)


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--minutes-a-world", type=int, default=5, metavar="N")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--containers", action="store_true", help="in containers of Docker")
    parser.add_argument("--json", default="", help="write a report")
    options = parser.parse_args(arguments)
    if not 0.0 < options.minutes <= 10_000.0:
        fail(f"--minutes: must be more than 0, at most 10000 (got {options.minutes:g})")
    if options.minutes_a_world < 1:
        fail(f"--minutes-a-world: must be at least 1 (got {options.minutes_a_world})")
    return options


def _table(lives: Sequence[Life]) -> Table:
    """The longest life of each service."""
    table = Table(box=box.SIMPLE_HEAD)
    for name in ("service", "processes", "longest s", "peak MB", "grew MB", "open files"):
        table.add_column(name, justify="left" if name == "service" else "right")
    for service in dict.fromkeys(life.service for life in lives):
        own = [life for life in lives if life.service == service]
        longest = max(own, key=lambda life: life.lasted_s)
        growth = "" if longest.growth_mb is None else f"{longest.growth_mb:+.0f}"
        files = "" if longest.files is None else f"{longest.files:+d}"
        table.add_row(
            service, str(len(own)), f"{longest.lasted_s:.0f}",
            f"{max(life.peak_mb for life in own):.0f}", growth, files,
        )  # fmt: skip
    return table


def _say(line: str) -> None:
    sys.stderr.write(f"{line}\n")
    sys.stderr.flush()


if __name__ == "__main__":
    run(main)
