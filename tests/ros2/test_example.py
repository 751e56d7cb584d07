"""The controller of examples/ros2 that needs no ROS 2 drives a simulator that runs alone."""

from __future__ import annotations

import math
import subprocess
import threading

import pytest

from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribed
from mazebot.common.files.root import ROOT
from mazebot.common.messages import wire
from mazebot.common.messages.messages import Odometry
from mazebot.common.messages.topics import ODOM
from mazebot.common.node.node import Envelope
from tests.docs.stack import running_stack
from tests.ros2.environment import FOLDER

pytestmark = [pytest.mark.ros2, pytest.mark.timeout(180)]
GOAL_M = (0.4, -0.8)


def test_it_drives_to_a_place() -> None:
    example = ROOT / "examples" / "ros2" / "drive_pyzeros.py"
    odom: list[Odometry] = []
    came = threading.Event()

    def receive(payload: bytes, _: Envelope) -> None:
        odom.append(wire.decode(ODOM, payload))
        came.set()

    with running_stack(pace="1", goal=None) as endpoint:
        command = [str(FOLDER / "bin" / "python"), str(example), *map(str, GOAL_M), endpoint]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert (done.returncode, done.stdout) == (0, "there\n"), done.stderr
        session = open_session(BusConfig(connect=endpoint), timeout_s=20.0)
        with subscribed(session, ODOM, receive):
            assert came.wait(20.0)
        session.close()  # type: ignore[no-untyped-call]
    place = odom[-1].pose.pose.position
    assert math.dist(GOAL_M, (place.x, place.y)) < 0.06
