"""What a person does to a running simulation: control it, send goals, turn the robot by hand."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from typing import Any

from mazebot.common.bus.query import ask
from mazebot.common.maths.frames import wrap_angle, yaw_from_quaternion
from mazebot.common.messages.documents import SimulationControl, SimulationStats
from mazebot.common.messages.topics import SIMULATION_CONTROL
from tests.cli.test_app import mazebot
from tests.compose.stack import Stack, wait_until


def control(stack: Stack, **fields: object) -> SimulationStats:
    """Control the simulation of a stack; what it says of itself then."""
    session = stack.session()
    reply = ask(session, SIMULATION_CONTROL, SimulationControl.model_validate(fields), 10.0)
    session.close()  # type: ignore[no-untyped-call]
    assert reply.error == ""
    assert reply.stats is not None
    return reply.stats


def check_commands(stack: Stack) -> None:
    """Check a goal that Ctrl-C cancels, one that its time-out does, and a robot turned by hand."""
    connect = ("--connect", stack.endpoint)
    command = subprocess.Popen(
        [sys.executable, "-m", "mazebot.cli", "goal", "-1.678", "-1.178", "-2.25", *connect],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | stack.signs_in,
    )  # fmt: skip
    assert command.stdout is not None
    assert command.stdout.readline().startswith("driving to")
    wait_until(lambda: _state(stack) == "controlling", 10.0, "driving")
    command.send_signal(signal.SIGINT)
    told = command.communicate(timeout=20.0)[1]
    assert (command.returncode, told) == (130, "canceled: the robot stops\n"), command.returncode
    wait_until(lambda: _state(stack) == "idle", 5.0, "standing")
    late = mazebot(
        "goal", "-1.678", "-1.178", "-2.25", "--timeout", "1", *connect, **stack.signs_in
    )
    assert "canceled" in late.stderr
    assert "no active goal" in mazebot("cancel", *connect, **stack.signs_in).stderr
    # A robot that is told to stop still turns by half a radian.
    wait_until(lambda: abs(_turning_rad_s(stack)) < 1e-3, 10.0, "standing")
    before = _heading_rad(stack)
    turn = ("topic", "pub", "/cmd_vel", "{twist: {angular: {z: 1}}}", "--rate", "20")
    assert mazebot(*turn, "--times", "30", *connect, **stack.signs_in).returncode == 0
    assert abs(wrap_angle(_heading_rad(stack) - before)) > 0.3


def _state(stack: Stack) -> str:
    done = mazebot("topic", "echo", "/navigation/status", "--once", "--json",
                   "--connect", stack.endpoint, **stack.signs_in)  # fmt: skip
    return str(json.loads(done.stdout)["state"])


def _odom(stack: Stack) -> Any:
    done = mazebot("topic", "echo", "/ground_truth/odom", "--once", "--json",
                   "--connect", stack.endpoint, **stack.signs_in)  # fmt: skip
    return json.loads(done.stdout)


def _heading_rad(stack: Stack) -> float:
    return yaw_from_quaternion(**_odom(stack)["pose"]["pose"]["orientation"])


def _turning_rad_s(stack: Stack) -> float:
    return float(_odom(stack)["twist"]["twist"]["angular"]["z"])
