"""A tour that is reset, readers that stall and networks that are cut, in containers: nobody else
notices.
"""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages.topics import (
    AMCL_POSE,
    CAMERA_INFO,
    CLOCK,
    CMD_VEL,
    DETECTIONS,
    GROUND_TRUTH_ODOM,
    IMU,
    NAVIGATION_STATUS,
    ODOM,
    SCAN,
    SIMULATION_STATS,
    TF,
    Topic,
)
from mazebot.common.node.node import Envelope
from tests.compose.checks import check_recordings, check_table, is_active
from tests.compose.control import check_commands, control
from tests.compose.motion import Witness
from tests.compose.stack import DEMOS, OPEN, Stack, docker, stack_of, wait_until

pytestmark = [pytest.mark.compose, pytest.mark.usefixtures("image")]

DEMO = DEMOS["enhanced"]
TOUR_S = 300.0
STALL_S = 10.0
AFTER_S = 3.0
"""Time after a stall in which a gap would still be its fault."""
PARTITION_S = 5.0
MAX_LATE_S = 1.0
BACK_S = 2.0
STEADY: tuple[Topic[Any], ...] = (
    CLOCK, TF, ODOM, IMU, SCAN, CAMERA_INFO, GROUND_TRUTH_ODOM, SIMULATION_STATS, DETECTIONS,
    AMCL_POSE, CMD_VEL, NAVIGATION_STATUS,
)  # fmt: skip
"""Sent at least twice a second as long as the robot drives, by physics, perception, navigation."""

Measured = Callable[[str, float], None]

STRANGER = """
import signal, sys, zenoh
config = zenoh.Config.from_json5(
    '{mode: "client", scouting: {multicast: {enabled: false}}, connect: {timeout_ms: 5000}}'
)
config.insert_json5("connect/endpoints", f'["{sys.argv[1]}"]')
session = zenoh.open(config)
subscriber = session.declare_subscriber("**", lambda sample: None)
print("listening", flush=True)
signal.pause()
"""


class Ear:
    """Hears every steady topic from outside the containers."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self.heard_s: dict[str, list[float]] = {topic.name: [] for topic in STEADY}
        self._kept = [subscribe(self._session, topic, self._note(topic)) for topic in STEADY]

    def _note(self, topic: Topic[Any]) -> Callable[[bytes, Envelope], None]:
        times_s = self.heard_s[topic.name]
        return lambda *_: times_s.append(time.monotonic())

    def latest_s(self, begin_s: float, end_s: float) -> dict[str, tuple[float, float]]:
        """By how much the latest message of each topic between two moments was late, and how long
        after the first moment the silence before it began.
        """
        late = {}
        for topic in STEADY:
            heard_s = self.heard_s[topic.name]
            times_s = [begin_s, *(at for at in heard_s if begin_s < at < end_s), end_s]
            gap_s, at_s = max((b - a, a - begin_s) for a, b in itertools.pairwise(times_s))
            late[topic.name] = gap_s - 1.0 / (topic.rate_hz or 1.0), at_s
        return late

    def next_after(self, topic: Topic[Any], wall_s: float) -> float | None:
        """When a topic was first heard after a moment."""
        return next((at for at in self.heard_s[topic.name] if at > wall_s), None)

    def close(self) -> None:
        """Listen no more."""
        self._session.close()  # type: ignore[no-untyped-call]


@contextmanager
def strangers(endpoint: str, count: int) -> Iterator[list[subprocess.Popen[str]]]:
    """So many processes that have subscribed to everything, as a hand-written script does."""
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", STRANGER, endpoint], stdout=subprocess.PIPE, text=True
        )
        for _ in range(count)
    ]
    try:
        for process in processes:
            assert process.stdout is not None
            assert process.stdout.readline() == "listening\n"
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.communicate()


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    output_file: Path = tmp_path_factory.mktemp("stalls") / "output"
    with stack_of(os.getuid(), OPEN) as stack, output_file.open("wb") as output:
        stack.in_foreground(output, "up", DEMO)
        wait_until(lambda: is_active(stack, DEMO), 90.0, "both lines")
        yield stack


@pytest.fixture
def ear(tour: Stack) -> Iterator[Ear]:
    ear = Ear(tour.session())
    yield ear
    ear.close()


@pytest.fixture
def witness(tour: Stack) -> Iterator[Witness]:
    witness = Witness(tour.session())
    wait_until(witness.driving, 60.0, "driving")
    yield witness
    witness.close()


def pass_time(seconds: float) -> None:
    """Let wall time go by: what is looked for is something that does not happen in it."""
    begin_s = time.monotonic()
    wait_until(lambda: time.monotonic() - begin_s > seconds, seconds + 5.0, "the time")


def check_nobody_noticed(ear: Ear, begin_s: float, what: str, measured: Measured) -> None:
    late = ear.latest_s(begin_s, time.monotonic())
    latest_s, _ = max(late.values())
    measured(f"latest message, {what}", latest_s)
    told = {name: f"{by_s:.2f} s late at {at_s:.1f} s" for name, (by_s, at_s) in late.items()}
    assert latest_s <= MAX_LATE_S, told


def test_a_reset_in_mid_drive_begins_the_tour_anew(tour: Stack, witness: Witness) -> None:
    """Seen by the last test: the tour and the recording have begun anew."""
    stats = control(tour, reset="all", seed=11)
    assert (stats.epoch, stats.seed, stats.iterations) == (2, 11, 0)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("count", [1, 5])
def test_readers_that_freeze_cost_nobody_anything(
    tour: Stack, ear: Ear, witness: Witness, measured: Measured, count: int
) -> None:
    with strangers(tour.endpoint, count) as frozen:
        begin_s = time.monotonic()
        for process in frozen:
            process.send_signal(signal.SIGSTOP)
        # Zenoh's own lease, which is theirs, is 10 s: their connections end in the meantime.
        pass_time(STALL_S + AFTER_S)
        check_nobody_noticed(ear, begin_s, f"{count} frozen", measured)
    wait_until(witness.driving, 10.0, "driving on")


@pytest.mark.timeout(300)
def test_a_recorder_that_is_paused_costs_nobody_anything(
    tour: Stack, ear: Ear, witness: Witness, measured: Measured
) -> None:
    begin_s = time.monotonic()
    tour.compose("pause", "recorder")
    try:
        pass_time(STALL_S)
    finally:
        tour.compose("unpause", "recorder")
    pass_time(AFTER_S)
    check_nobody_noticed(ear, begin_s, "recorder paused", measured)
    wait_until(witness.driving, 10.0, "driving on")


@pytest.mark.timeout(300)
def test_navigation_that_was_cut_off_drives_again_soon(
    tour: Stack, ear: Ear, witness: Witness, measured: Measured
) -> None:
    (network,) = tour.networks_of("navigation")
    container = tour.inspect("navigation")["Name"].removeprefix("/")
    docker("network", "disconnect", network, container)
    pass_time(PARTITION_S)
    docker("network", "connect", "--alias", "navigation", network, container)
    begin_s = time.monotonic()
    wait_until(lambda: ear.next_after(CMD_VEL, begin_s) is not None, 15.0, "commands")
    back_s = ear.next_after(CMD_VEL, begin_s)
    assert back_s is not None
    measured("navigation's first command after its network's return", back_s - begin_s)
    assert back_s - begin_s <= BACK_S
    wait_until(witness.driving, 10.0, "driving on")


@pytest.mark.timeout(400)
def test_the_tour_ends_well_after_all_of_that(tour: Stack) -> None:
    wait_until(
        lambda: bool(tour.inspect(DEMO)["State"]["Status"] == "exited"), TOUR_S, "the tour's end"
    )
    check_table(tour.logs(DEMO))
    assert tour.inspect(DEMO)["State"]["ExitCode"] == 0
    check_commands(tour)
    tour.down()
    assert len(check_recordings(tour)) == 2
