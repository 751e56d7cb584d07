"""A tour that is paused for a minute, and one that is reset, in containers."""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.query import ask
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.maths.frames import wrap_angle, yaw_from_quaternion
from mazebot.common.messages.documents import SimulationControl, SimulationStats
from mazebot.common.messages.messages import TwistStamped, ns_from_time
from mazebot.common.messages.topics import CMD_VEL, SIMULATION_CONTROL
from mazebot.common.messages.wire import decode
from tests.cli.test_app import mazebot
from tests.compose.checks import check_recordings, check_table, is_active
from tests.compose.motion import Witness
from tests.compose.stack import DEMOS, SERVICES, Stack, stack_of, wait_until

pytestmark = [pytest.mark.compose, pytest.mark.usefixtures("image")]

DEMO = DEMOS["enhanced"]
TOUR_S = 300.0
PAUSE_S = 60.0
AFTER = 20
"""Commands after the pause that are looked at: a second of them."""
LATE_S = 0.2
"""When the watchdog stops the robot: a busy machine delays a command, but not until then."""
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
    _commands(tour)
    tour.down()
    assert len(check_recordings(tour)) == 2


def _commands(stack: Stack) -> None:
    """A goal that Ctrl-C cancels, one that its time-out does, and a robot turned by hand."""
    connect = ("--connect", stack.endpoint)
    command = subprocess.Popen(
        [sys.executable, "-m", "mazebot.cli", "goal", "-1.678", "-1.178", "-2.25", *connect],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert command.stdout is not None
    assert command.stdout.readline().startswith("driving to")
    wait_until(lambda: _state(stack) == "controlling", 10.0, "driving")
    command.send_signal(signal.SIGINT)
    assert command.communicate(timeout=20.0)[1] == "canceled: the robot stops\n"
    assert command.returncode == 130
    wait_until(lambda: _state(stack) == "idle", 5.0, "standing")
    late = mazebot("goal", "-1.678", "-1.178", "-2.25", "--timeout", "1", *connect)
    assert "canceled" in late.stderr
    assert "no active goal" in mazebot("cancel", *connect).stderr
    # A robot that is told to stop still turns by half a radian.
    wait_until(lambda: abs(_turning_rad_s(stack)) < 1e-3, 10.0, "standing")
    before = _heading_rad(stack)
    turn = ("topic", "pub", "/cmd_vel", "{twist: {angular: {z: 1}}}", "--rate", "20")
    assert mazebot(*turn, "--times", "30", *connect).returncode == 0
    assert abs(wrap_angle(_heading_rad(stack) - before)) > 0.3


def _state(stack: Stack) -> str:
    done = mazebot("topic", "echo", "/navigation/status", "--once", "--json",
                   "--connect", stack.endpoint)  # fmt: skip
    return str(json.loads(done.stdout)["state"])


def _odom(stack: Stack) -> Any:
    done = mazebot("topic", "echo", "/ground_truth/odom", "--once", "--json",
                   "--connect", stack.endpoint)  # fmt: skip
    return json.loads(done.stdout)


def _heading_rad(stack: Stack) -> float:
    return yaw_from_quaternion(**_odom(stack)["pose"]["pose"]["orientation"])


def _turning_rad_s(stack: Stack) -> float:
    return float(_odom(stack)["twist"]["twist"]["angular"]["z"])


def _elapsed_s(first: TwistStamped, after: TwistStamped) -> float:
    return (ns_from_time(after.header.stamp) - ns_from_time(first.header.stamp)) * 1e-9
