"""A stack of real services that is paused, and reset, while the robot drives."""

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
import zenoh

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.query import ask
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages.documents import SimulationControl, SimulationStats
from mazebot.common.messages.messages import DiagnosticArray, TwistStamped, ns_from_time
from mazebot.common.messages.topics import CMD_VEL, DIAGNOSTICS, SIMULATION_CONTROL, Topic
from mazebot.common.messages.wire import decode

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("real_time")]

DEADLINE_S = 60.0
LONG_S = 6.0
"""Longer than every time-out that goes by a wall clock, but that of a loop that hangs."""
ACCELERATION_M_S2, ACCELERATION_RAD_S2 = 1.0, 2.0
SERVICES = {
    "physics": ("--camera-enabled", "false"),
    "worldgen": (),
    "spawner": (),
    "localization": (),
    "navigation": (),
    "bringup": ("--world-name", "sim_house", "--goal", "[-1.678, -1.178, -2.25]"),
}


@dataclass
class Stack:
    """Services in processes of their own, and what they say."""

    session: zenoh.Session
    processes: dict[str, subprocess.Popen[str]] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    commands: list[TwistStamped] = field(default_factory=list)
    reports: list[DiagnosticArray] = field(default_factory=list)
    subscriptions: list[Any] = field(default_factory=list)
    listeners: list[threading.Thread] = field(default_factory=list)

    def start(self, name: str, endpoint: str, *options: str) -> None:
        process = subprocess.Popen(
            [sys.executable, "-m", f"mazebot.{name}", *SERVICES[name], *options],
            env={**os.environ, "MAZEBOT_BUS_CONNECT": endpoint},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.processes[name] = process
        self.listeners.append(threading.Thread(target=self._listen, args=(process,)))
        self.listeners[-1].start()

    def _listen(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        with process.stdout as said:
            for line in said:
                self.lines.append(line)

    def keep(self, topic: Topic[Any], messages: list[Any]) -> None:
        self.subscriptions.append(
            subscribe(self.session, topic, lambda data, _: messages.append(decode(topic, data)))
        )

    def control(self, **fields: Any) -> SimulationStats:
        reply = ask(self.session, SIMULATION_CONTROL, SimulationControl(**fields), DEADLINE_S)
        assert reply.error == ""
        assert reply.stats is not None
        return reply.stats

    def faults(self) -> list[str]:
        """What was ever said at a level above INFO."""
        return [line for line in self.lines if re.search(r"WARN|ERROR|error:|Traceback", line)]


def wait_until(
    condition: Callable[[], object], lines: list[str], deadline_s: float = DEADLINE_S
) -> None:
    end_s = time.monotonic() + deadline_s
    while not condition():
        assert time.monotonic() < end_s, "".join(lines)
        time.sleep(0.02)


@pytest.fixture
def stack(request: pytest.FixtureRequest) -> Iterator[Stack]:
    """All services, physics with the options that are the fixture's parameter."""
    physics: tuple[str, ...] = getattr(request, "param", ())
    with running_router() as endpoint:
        session = open_session(BusConfig(connect=endpoint), timeout_s=5.0)
        stack = Stack(session)
        stack.keep(CMD_VEL, stack.commands)
        stack.keep(DIAGNOSTICS, stack.reports)
        try:
            for name in SERVICES:
                stack.start(name, endpoint, *(physics if name == "physics" else ()))
            yield stack
        finally:
            for process in stack.processes.values():
                process.kill()
                process.wait()
            for listener in stack.listeners:
                listener.join()
            session.close()  # type: ignore[no-untyped-call]


def speed(stack: Stack) -> float:
    return stack.commands[-1].twist.linear.x if stack.commands else 0.0


@pytest.mark.timeout(200)
def test_a_pause_in_mid_drive_alarms_nobody_and_jumps_in_no_command(stack: Stack) -> None:
    wait_until(lambda: speed(stack) > 0.15, stack.lines)
    at = stack.control(pause=True)
    assert at.paused
    # What was sent before has arrived when this is answered.
    stack.control()
    sent, reported = len(stack.commands), len(stack.reports)
    wait_until(lambda: len(stack.reports) > reported + LONG_S * 4, stack.lines)
    assert len(stack.commands) <= sent + 1
    during = [status for array in stack.reports[reported:] for status in array.status]
    assert {status.name for status in during} == set(SERVICES)
    for name in SERVICES:
        # The first report may tell of how slow this machine was before.
        told = [status.message for status in during if status.name == name][1:]
        assert len(set(told)) == 1, told
        assert told[0] == "active" or told[0].startswith("slow: /"), told
    assert stack.control(pause=False).sim_time_s == at.sim_time_s
    assert stack.processes["bringup"].wait(DEADLINE_S) == 0
    gap_s = ns_from_time(stack.commands[sent].header.stamp) * 1e-9 - at.sim_time_s
    assert abs(gap_s) < 0.2
    # A machine that is too busy for real time lets the robot stop at times; it goes on. Periods are
    # missed by simulation time, in which there was no pause.
    busy = ("no velocity command for", "Control loop missed its desired rate")
    assert [line for line in stack.faults() if not any(words in line for words in busy)] == [
        "[WARN] [bringup]: tour finished; no evaluation received from the recorder\n"
    ]
    for before, after in zip(stack.commands, stack.commands[1:], strict=False):
        elapsed_s = (ns_from_time(after.header.stamp) - ns_from_time(before.header.stamp)) * 1e-9
        if elapsed_s > 0.5:
            continue
        for limit, change in (
            (ACCELERATION_M_S2, after.twist.linear.x - before.twist.linear.x),
            (ACCELERATION_RAD_S2, after.twist.angular.z - before.twist.angular.z),
        ):
            assert abs(change) <= limit * elapsed_s + 0.02, (before, after)


# So long that nothing else can stop the robot, however busy the machine is.
@pytest.mark.parametrize("stack", [("--cmd-vel-timeout-s", "5.0")], indirect=True)
@pytest.mark.timeout(200)
def test_a_killed_navigation_is_missed_before_its_commands_are(stack: Stack) -> None:
    wait_until(lambda: speed(stack) > 0.15, stack.lines)
    stack.processes["navigation"].kill()
    wait_until(lambda: any("stopping the robot" in line for line in stack.lines), stack.lines)
    said = "".join(stack.lines)
    assert "publisher of velocity commands is gone" in said, said


@pytest.mark.timeout(200)
def test_a_reset_in_mid_drive_begins_the_tour_anew(stack: Stack) -> None:
    wait_until(lambda: speed(stack) > 0.15, stack.lines)
    stats = stack.control(reset="all", seed=11)
    assert (stats.epoch, stats.seed) == (2, 11)
    assert stack.processes["bringup"].wait(DEADLINE_S) == 0
    assert sum("simulation restarted; restarting the tour" in line for line in stack.lines) == 1
    assert sum("goal: driving to" in line for line in stack.lines) == 2
    assert sum("goal: reached" in line for line in stack.lines) == 1
