"""A tour that is paused for a minute, and one that is reset, in containers."""

from __future__ import annotations

import itertools
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.common.bus import BusConfig, ask, open_session, subscribe
from services.common.documents import SimulationControl, SimulationStats
from services.common.messages import TwistStamped, ns_from_time
from services.common.topics import CMD_VEL, SIMULATION_CONTROL
from services.common.wire import decode
from tests.compose.checks import check_recordings, check_table, is_active
from tests.compose.motion import Witness
from tests.compose.stack import DEMOS, SERVICES, Stack, stack_of, wait_until

pytestmark = [pytest.mark.compose, pytest.mark.usefixtures("image")]

DEMO = DEMOS["enhanced"]
TOUR_S = 300.0
PAUSE_S = 60.0
AFTER = 20
"""Commands after the pause that are looked at: a second of them."""
LATE_S = 0.15
ACCELERATION_M_S2 = 1.0
ALARM = re.compile(r"WARN|ERROR|error:|Traceback|waiting for")


@pytest.fixture
def tour(tmp_path: Path) -> Iterator[Stack]:
    with stack_of(os.getuid()) as stack, (tmp_path / "output").open("wb") as output:
        stack.in_foreground(output, "up", DEMO)
        wait_until(lambda: is_active(stack, DEMO), 90.0, "both lines")
        yield stack


def control(stack: Stack, **fields: object) -> SimulationStats:
    session = open_session(BusConfig(connect=stack.endpoint), timeout_s=5.0)
    reply = ask(session, SIMULATION_CONTROL, SimulationControl.model_validate(fields), 10.0)
    session.close()  # type: ignore[no-untyped-call]
    assert reply.error == ""
    assert reply.stats is not None
    return reply.stats


def said(stack: Stack) -> dict[str, list[str]]:
    """The lines of every container."""
    return {service: stack.logs(service).splitlines() for service in (*SERVICES, DEMO)}


def is_over(stack: Stack) -> bool:
    return bool(stack.inspect(DEMO)["State"]["Status"] == "exited")


@pytest.mark.timeout(600)
def test_a_minute_s_pause_in_mid_drive_alarms_nobody(tour: Stack) -> None:
    session = open_session(BusConfig(connect=tour.endpoint), timeout_s=5.0)
    commands: list[TwistStamped] = []
    subscription = subscribe(
        session, CMD_VEL, lambda data, _: commands.append(decode(CMD_VEL, data))
    )
    witness = Witness(tour.endpoint)
    wait_until(witness.driving, 60.0, "driving")
    at = control(tour, pause=True)
    before, sent, begin_s = said(tour), len(commands), time.monotonic()
    wait_until(lambda: time.monotonic() - begin_s > PAUSE_S, PAUSE_S + 5.0, "a minute")
    assert control(tour).iterations == at.iterations
    assert len(commands) <= sent + 1
    for service, lines in said(tour).items():
        new = lines[len(before[service]) :]
        assert not [line for line in new if ALARM.search(line)], f"{service}: {new}"
        state = tour.inspect(service)["State"]
        assert state["Status"] == "running"
        assert state.get("Health", {}).get("Status", "healthy") == "healthy"
        assert tour.inspect(service)["RestartCount"] == 0
    control(tour, pause=False)
    wait_until(lambda: is_over(tour), TOUR_S, "the end of the tour")
    witness.close()
    check_table(tour.logs(DEMO))
    for first, after in itertools.pairwise(commands[sent - 1 : sent + AFTER]):
        elapsed_s = _elapsed_s(first, after)
        assert elapsed_s < LATE_S
        change_m_s = abs(after.twist.linear.x - first.twist.linear.x)
        assert change_m_s <= ACCELERATION_M_S2 * elapsed_s + 0.02, (first, after)
    del subscription
    session.close()  # type: ignore[no-untyped-call]


@pytest.mark.timeout(600)
def test_a_reset_in_mid_drive_begins_the_tour_and_the_recording_anew(tour: Stack) -> None:
    witness = Witness(tour.endpoint)
    wait_until(witness.driving, 60.0, "driving")
    stats = control(tour, reset="all", seed=11)
    assert (stats.epoch, stats.seed, stats.iterations) == (2, 11, 0)
    wait_until(lambda: is_over(tour), TOUR_S, "the end of the tour")
    witness.close()
    check_table(tour.logs(DEMO))
    assert tour.inspect(DEMO)["State"]["ExitCode"] == 0
    tour.down()
    assert len(check_recordings(tour)) == 2


def _elapsed_s(first: TwistStamped, after: TwistStamped) -> float:
    return (ns_from_time(after.header.stamp) - ns_from_time(first.header.stamp)) * 1e-9
