"""Runs the services of a stack, each in a process of its own, until SIGTERM:

    python -m mazebot.cli.stack.supervisor < PLAN

It collects what the services say in the folder's log, and starts
a service that has ended again, as Docker does with `restart: unless-stopped`.
"""

from __future__ import annotations

import ctypes
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from typing import IO

from mazebot.cli.stack.log_file import LogWriter
from mazebot.cli.stack.plan import ROUTER, ServicePlan, StackPlan
from mazebot.cli.stack.state import (
    ProcessId,
    ServiceState,
    StackFolder,
    StackState,
    how_ended,
)
from mazebot.common.stop_signals import on_stop

SUPERVISOR = "up"
"""The name under which it writes to the log."""
STOP_S = 5.0
"""After SIGTERM a service has this time to end; then it is killed."""
_LONGER_S = {"recorder": 60.0}
"""It has a recording to finish."""
_TICK_S = 0.1
_FIRST_WAIT_S, _MAX_WAIT_S = 0.1, 60.0
"""Before a service is started again; doubled each time, until it has run for `_STABLE_S`."""
_STABLE_S = 10.0
_PR_SET_PDEATHSIG = 1
_READ_BYTES = 65536


def stop_s(service: str) -> float:
    """Time that a service has to end."""
    return _LONGER_S.get(service, STOP_S)


class _Service:
    """One service: its process, and what it says."""

    def __init__(self, plan: ServicePlan, log: LogWriter) -> None:
        self.plan = plan
        self.state = ServiceState(name=plan.name, since_s=time.time())
        self.process: subprocess.Popen[bytes] | None = None
        self._log = log
        self._rest = b""
        self._wait_s = _FIRST_WAIT_S
        self._started_s = 0.0
        self.due_s = 0.0
        """When it is to be started, by the monotonic clock."""

    def start(self) -> IO[bytes]:
        """Start it; return what it says."""
        self.process = subprocess.Popen(
            self.plan.command,
            env={**os.environ, **self.plan.environment},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            preexec_fn=_end_with_parent,  # noqa: PLW1509 - there is one thread
        )
        assert self.process.stdout is not None
        os.set_blocking(self.process.stdout.fileno(), False)
        self._started_s = time.monotonic()
        self.state.process = ProcessId.of(self.process.pid)
        self.state.phase, self.state.since_s = "starting", time.time()
        return self.process.stdout

    def read(self) -> bool:
        """Take in what it has said; whether its state has changed."""
        assert self.process is not None
        assert self.process.stdout is not None
        data = self.process.stdout.read(_READ_BYTES) or b""
        *lines, self._rest = (self._rest + data).split(b"\n")
        before = self.state.text
        for line in lines:
            self._take(line.decode(errors="replace").rstrip("\r"))
        return self.state.text != before

    def _take(self, line: str) -> None:
        self._log.put(self.plan.name, line)
        _, mark, text = line.partition(f"[{self.plan.name}]: ")
        if not mark:
            return
        if text.startswith("waiting for "):
            self.state.phase = "waiting"
            self.state.waits_for = text.removeprefix("waiting for ")
        elif text.startswith("connected to "):
            # Whether it waits for anything is said next.
            self.state.phase = "starting"
        elif text == "active" or text.startswith("listening on "):
            self.state.phase = "active"

    def take_leave(self, is_wanted: bool) -> None:
        """Its process has ended: say so, unless that `is_wanted`, and plan its next start."""
        assert self.process is not None
        assert self.process.stdout is not None
        self.read()
        self.process.stdout.close()
        code = self.process.returncode
        self.process, self.state.process = None, None
        self.state.exit_code, self.state.since_s = code, time.time()
        if is_wanted or not self.plan.restarts:
            self.state.phase = "ended"
            if not is_wanted:
                self._log.put(SUPERVISOR, f"{self.plan.name} has ended ({how_ended(code)})")
            return
        if time.monotonic() - self._started_s > _STABLE_S:
            self._wait_s = _FIRST_WAIT_S
        self.due_s = time.monotonic() + self._wait_s
        self.state.phase = "restarting"
        self.state.restarts += 1
        self._log.put(
            SUPERVISOR,
            f"{self.plan.name} has ended ({how_ended(code)}): starting it again in "
            f"{self._wait_s:g} s",
        )
        self._wait_s = min(2.0 * self._wait_s, _MAX_WAIT_S)


class Supervisor:
    """All services of a stack."""

    def __init__(self, plan: StackPlan) -> None:
        self._folder = StackFolder(plan.port)
        self._selector = selectors.DefaultSelector()
        self._log = LogWriter(self._folder.path)
        self._services = [_Service(service, self._log) for service in plan.services]
        self._stopped = False
        self._state = StackState(
            endpoint=plan.endpoint,
            about=plan.about,
            supervisor=ProcessId.of(os.getpid()),
            since_s=time.time(),
            services=[service.state for service in self._services],
        )

    def stop(self, *_: object) -> None:
        """End the services soon."""
        self._stopped = True

    def run(self) -> None:
        """Start the services, and keep them running until `stop()`."""
        try:
            while not self._stopped:
                if self._start_due() | self._read(_TICK_S) | self._look():
                    self._folder.write(self._state)
        finally:
            self._stopped = True
            self._end(service for service in self._services if service.plan.name != ROUTER)
            self._end(service for service in self._services if service.plan.name == ROUTER)
            self._log.close()
            self._folder.forget()

    def _start_due(self) -> bool:
        due = [
            service
            for service in self._services
            if service.process is None
            and service.state.phase in ("starting", "restarting")
            and time.monotonic() >= service.due_s
        ]
        for service in due:
            self._selector.register(service.start(), selectors.EVENT_READ, service)
        return bool(due)

    def _read(self, timeout_s: float) -> bool:
        """Take in what the services say; whether a state has changed."""
        changed = False
        for key, _ in self._selector.select(timeout_s):
            service: _Service = key.data
            changed |= service.read()
        return changed

    def _look(self) -> bool:
        """Look for services that have ended; whether one has."""
        ended = [
            service
            for service in self._services
            if service.process is not None and service.process.poll() is not None
        ]
        for service in ended:
            assert service.process is not None
            assert service.process.stdout is not None
            self._selector.unregister(service.process.stdout)
            service.take_leave(is_wanted=self._stopped)
        return bool(ended)

    def _end(self, services: Iterable[_Service]) -> None:
        """SIGTERM, then SIGKILL."""
        running = [service for service in services if service.process is not None]
        for service in running:
            assert service.process is not None
            service.process.terminate()
        begun_s = time.monotonic()
        while any(one.process is not None for one in running):
            self._read(_TICK_S)
            self._look()
            for service in running:
                limit_s = stop_s(service.plan.name)
                if service.process is None or time.monotonic() - begun_s < limit_s:
                    continue
                self._log.put(
                    SUPERVISOR, f"{service.plan.name} has not ended within {limit_s:g} s: killed"
                )
                service.process.kill()
                service.process.wait()
                self._look()


def _end_with_parent() -> None:
    """Have the kernel end this process when the supervisor is killed."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def main() -> None:
    """Run the stack whose plan is on standard input, until SIGTERM."""
    supervisor = Supervisor(StackPlan.model_validate_json(sys.stdin.read()))
    on_stop(supervisor.stop)
    supervisor.run()


if __name__ == "__main__":
    main()
