"""`mazebot teleop`: drives the robot of a running stack from the keyboard."""

from __future__ import annotations

import codecs
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer

from mazebot.cli.drive.teleop_keys import TABLE, Teleop, split_keys
from mazebot.cli.parsing.options import ROUTER, Connect
from mazebot.cli.parsing.patience import wait_quietly
from mazebot.common.config import ConfigError
from mazebot.common.robot.waffle import MAX_ANGULAR_RAD_S, MAX_LINEAR_M_S

if TYPE_CHECKING:
    from mazebot.common.client.robot import Robot

PERIOD_S = 0.05
_STOPS_SENT = 3
"""A stop may be lost; without commands the watchdog stops the robot, but later."""


def teleop(
    speed: Annotated[
        float, typer.Option(min=0.01, max=MAX_LINEAR_M_S, help="m/s, of the held keys")
    ] = 0.2,
    turn: Annotated[
        float, typer.Option(min=0.01, max=MAX_ANGULAR_RAD_S, help="rad/s, of the held keys")
    ] = 1.0,
    connect: Connect = ROUTER,
) -> None:
    """Drive the robot of a running stack from the keyboard.

    Arrows, or the keys of teleop_twist_keyboard, drive while they are held; w, x, a and d change
    a constant velocity, as in turtlebot3_teleop. The collision monitor slows down and stops before
    obstacles. While a task is running, only its assisted teleop uses the keys.
    """
    if not sys.stdin.isatty():
        raise ConfigError("teleop: standard input: must be a terminal, for the keys")
    from mazebot.cli.drive.progress import ProgressLine  # noqa: PLC0415
    from mazebot.cli.drive.task import await_navigation  # noqa: PLC0415 - loads Zenoh
    from mazebot.common.client.over_zenoh import ZenohRobot  # noqa: PLC0415
    from mazebot.common.client.user_messages import velocity  # noqa: PLC0415
    from mazebot.common.messages.topics import (  # noqa: PLC0415
        CMD_VEL_TELEOP,
        COLLISION_MONITOR_STATE,
        NAVIGATION_STATUS,
    )

    with ZenohRobot(connect) as robot:
        robot.watch((COLLISION_MONITOR_STATE, NAVIGATION_STATUS))
        await_navigation(robot, "teleop")
        sys.stdout.write(TABLE)
        wait_quietly()
        with keyboard() as fd, ProgressLine() as line:
            try:
                _drive(robot, Teleop(speed, turn), fd, line.show)
            finally:
                for _ in range(_STOPS_SENT):
                    robot.publish(CMD_VEL_TELEOP, velocity(robot, 0.0, 0.0))


def _drive(robot: Robot, state: Teleop, fd: int, show: Callable[[str], None]) -> None:
    """Publish the velocities of the keys until the user quits."""
    from mazebot.common.client.user_messages import velocity  # noqa: PLC0415
    from mazebot.common.messages.topics import (  # noqa: PLC0415
        CMD_VEL_TELEOP,
        COLLISION_MONITOR_STATE,
        NAVIGATION_STATUS,
    )

    decoder = codecs.getincrementaldecoder("utf-8")("replace")
    rest, stops, next_s = "", _STOPS_SENT, time.monotonic()
    while not state.leaves:
        next_s = max(next_s, time.monotonic() - PERIOD_S)
        if select.select([fd], [], [], max(next_s - time.monotonic(), 0.0))[0]:
            data = os.read(fd, 1024)
            if not data:
                return
            keys, rest = split_keys(rest + decoder.decode(data))
            for key in keys:
                state.press(key, time.monotonic())
        if time.monotonic() < next_s:
            continue
        next_s += PERIOD_S
        linear_m_s, angular_rad_s = state.command(time.monotonic())
        stops = stops + 1 if linear_m_s == angular_rad_s == 0.0 else 0
        # A user who only watches must not hold up a task.
        if stops <= _STOPS_SENT:
            robot.publish(CMD_VEL_TELEOP, velocity(robot, linear_m_s, angular_rad_s))
        text = f"linear {linear_m_s:+.2f} m/s, angular {angular_rad_s:+.2f} rad/s"
        monitor = robot.latest(COLLISION_MONITOR_STATE)
        if monitor is not None and monitor.action != "do_nothing":
            text += f"; collision monitor: {monitor.action}"
        status = robot.latest(NAVIGATION_STATUS)
        if status is not None and status.is_busy:
            text += "; a task is running: `mazebot cancel` cancels it"
        show(text)


@contextmanager
def keyboard() -> Iterator[int]:
    """The terminal's file descriptor, which returns each key at once and echoes none.

    The terminal is restored when the context ends, also by SIGTERM or SIGHUP.
    """
    # There is no termios on Windows: the command's help works there all the same.
    import termios  # noqa: PLC0415
    import tty  # noqa: PLC0415

    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)

    def leave(number: int, _: FrameType | None) -> None:
        raise SystemExit(128 + number)

    def come_back(_: int, __: FrameType | None) -> None:
        tty.setcbreak(fd)

    handlers = {signal.SIGTERM: leave, signal.SIGHUP: leave, signal.SIGCONT: come_back}
    old = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        tty.setcbreak(fd)
        yield fd
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)
        termios.tcsetattr(fd, termios.TCSAFLUSH, before)
