"""Whether a service of a running stack is there, and still the same process."""

from __future__ import annotations

import time

from mazebot.common.client.robot import Robot, RobotError

PATIENCE_S = 5.0
"""Wall time without a message of a service after which it is checked whether it is running."""
_POLL_S = 0.05


class ServiceGoneError(RobotError):
    """A service has ended or was restarted: what it was asked for is lost."""


class Silence:
    """Counts the wall time since the last message."""

    def __init__(self) -> None:
        self._since_s = time.monotonic()

    def is_long(self, has_received: bool) -> bool:
        """Whether nothing was received for `PATIENCE_S`, which then begins again. Call it
        regularly; `has_received`: whether something was since the last call.
        """
        now_s = time.monotonic()
        if not has_received and now_s - self._since_s <= PATIENCE_S:
            return False
        self._since_s = now_s
        return not has_received


class ServiceWatch:
    """Notices that a service has ended or was restarted."""

    def __init__(self, robot: Robot, service: str) -> None:
        self._robot = robot
        self._service = service
        self._processes = robot.alive().get(service, frozenset())
        self._silence = Silence()

    def check(self, has_received: bool) -> None:
        """Call it regularly. `has_received`: whether the service has sent a message since the last
        call.

        Raises ServiceGoneError where the service has ended, or was restarted; UnreachableError
        where the router is lost.
        """
        if not self._silence.is_long(has_received):
            return
        now = self._robot.alive().get(self._service, frozenset())
        self._processes = self._processes or now
        if not now & self._processes:
            what = "was restarted" if now else "has ended"
            raise ServiceGoneError(f"the {self._service} service {what}")


def wait_until_alive(robot: Robot, service: str, timeout_s: float) -> bool:
    """Wait until a service is running; False after `timeout_s` of wall time."""
    end_s = time.monotonic() + timeout_s
    while time.monotonic() < end_s:
        if service in robot.alive():
            return True
        time.sleep(_POLL_S)
    return False
