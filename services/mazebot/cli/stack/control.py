"""Starts a stack, and ends it."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from mazebot.cli.stack.log_file import read_lines
from mazebot.cli.stack.plan import DEMO, StackPlan
from mazebot.cli.stack.state import ProcessId, ServiceState, StackFolder, StackState
from mazebot.cli.stack.supervisor import STOP_S, stop_s
from mazebot.common.config import ConfigError

_ERRORS = "supervisor.err"
_ERROR = "error: "
"""Begins what a service says before it ends with exit code 2."""
_POLL_S = 0.1
_BEGIN_S = 10.0
"""Within this time the supervisor runs."""
_SETTLED_S = 0.5
"""A service that is active for so long waits for nothing."""


def refuse_second(folder: StackFolder) -> None:
    """Raises ConfigError where a stack runs."""
    state = folder.running()
    if state is not None:
        raise _runs_already(state)


def _runs_already(state: StackState) -> ConfigError:
    return ConfigError(
        f"up: a stack runs already on {state.endpoint} ({state.about}, {len(state.services)} "
        "services): mazebot down ends it, --router-port N starts another one beside it"
    )


def start(plan: StackPlan, folder: StackFolder) -> StackState:
    """Start a stack in the background, and return as soon as its processes are started.

    Raises ConfigError where one runs already.
    """
    lock = folder.locked()
    if lock is None:
        state = folder.running()
        raise _runs_already(state) if state else ConfigError("up: another one is starting")
    with lock:
        folder.forget()
        folder.use_keys(plan.keys_dir)
        with (folder.path / _ERRORS).open("wb") as errors:
            supervisor = subprocess.Popen(
                [sys.executable, "-m", "mazebot.cli.stack.supervisor"],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                # The lock stands as long as the supervisor runs. Ctrl-C is for the command alone.
                pass_fds=(lock.fileno(),),
                start_new_session=True,
            )
        assert supervisor.stdin is not None
        with supervisor.stdin:
            supervisor.stdin.write(plan.model_dump_json().encode())
    # It outlives this command; where it ends sooner, nothing of it must stay.
    threading.Thread(target=supervisor.wait, name="supervisor", daemon=True).start()
    deadline_s = time.monotonic() + _BEGIN_S
    while time.monotonic() < deadline_s:
        state = folder.read()
        if state is not None and all(map(_has_begun, state.services)):
            return state
        if supervisor.poll() is not None:
            break
        time.sleep(_POLL_S)
    said = (folder.path / _ERRORS).read_text(errors="replace").strip().splitlines()
    raise ConfigError(f"up: the services could not be started: {said[-1] if said else ''}")


def _has_begun(service: ServiceState) -> bool:
    return service.process is not None or service.phase != "starting"


class Awaited(NamedTuple):
    """What came of waiting for a stack."""

    code: int
    """The exit code of a demo that has ended before; else 0."""
    waiting: str
    """What its services still wait for, which others have to send; empty: nothing."""


def wait_until_active(
    folder: StackFolder, tell: Callable[[str], None], timeout_s: float, others_s: float
) -> Awaited:
    """Wait until the services of a stack are active; from when they are all connected on, for
    `others_s` at most. `tell` gets what is waited for.

    A demo knows what the others wait for, and which of them may; without one, or once it has ended,
    all have to be connected, and may wait for services of another stack.

    Raises ConfigError where that takes too long, or the stack ends.
    """
    deadline_s, settled_s = time.monotonic() + timeout_s, time.monotonic()
    connected_s: float | None = None
    told = ""
    while (now_s := time.monotonic()) < deadline_s:
        state = folder.running()
        if state is None:
            raise ConfigError("up: the stack has ended")
        demo = state.service(DEMO)
        if demo is not None and demo.phase == "ended" and demo.exit_code:
            return Awaited(demo.exit_code, "")
        missing, waiting = _missing(state, folder)
        connected_s = None if missing else connected_s or now_s
        if connected_s is not None and now_s - connected_s > others_s:
            return Awaited(0, waiting)
        if missing or waiting:
            settled_s = now_s
            if (missing or waiting) != told:
                told = missing or waiting
                tell(told)
        elif now_s - settled_s > _SETTLED_S:
            return Awaited(0, "")
        time.sleep(_POLL_S)
    raise ConfigError(f"up: not active within {timeout_s:g} s: {told} (mazebot logs, mazebot down)")


def _missing(state: StackState, folder: StackFolder) -> tuple[str, str]:
    """What a stack waits for, in words: of itself, and of others. Empty: nothing."""
    demo = state.service(DEMO)
    if demo is not None and demo.phase != "ended":
        return "" if demo.phase == "active" else f"{DEMO}: {demo.text}", ""
    inactive = [one for one in state.services if one is not demo and one.phase != "active"]
    connected = [one for one in inactive if one.phase == "waiting" and "the bus" not in one.text]
    own = [one for one in inactive if one not in connected]
    return (
        ", ".join(f"{one.name}: {one.text}{_reason(one, folder)}" for one in own),
        ", ".join(f"{one.name}: {one.text}" for one in connected),
    )


def _reason(service: ServiceState, folder: StackFolder) -> str:
    """Why a service ended last, after a colon, where it has said so."""
    if service.phase != "restarting":
        return ""
    said = [text for _, text in read_lines(folder.path, {service.name})]
    errors = [text.removeprefix(_ERROR) for text in said if text.startswith(_ERROR)]
    return f": {errors[-1]}" if errors else ""


def end(folder: StackFolder) -> int:
    """End all processes of a stack; return how many there were, the supervisor not among them.
    Only processes that the stack has started are ended, whatever has their numbers by now.
    """
    state = folder.running()
    if state is None:
        return 0
    state.supervisor.send(signal.SIGTERM)
    # It ends the services, and the router after them.
    longest_s = max([STOP_S, *(stop_s(one.name) for one in state.services)])
    _wait((state.supervisor,), longest_s + STOP_S + 2.0)
    services = [one.process for one in state.services if one.process is not None]
    count = len(services)
    # What a supervisor leaves that was killed itself.
    left = [state.supervisor, *services]
    for number, timeout_s in ((signal.SIGTERM, STOP_S), (signal.SIGKILL, STOP_S)):
        for process in left:
            process.send(number)
        _wait(left, timeout_s)
    folder.forget()
    return count


def _wait(processes: tuple[ProcessId, ...] | list[ProcessId], timeout_s: float) -> None:
    """Wait until some processes have ended."""
    deadline_s = time.monotonic() + timeout_s
    while any(process.runs() for process in processes) and time.monotonic() < deadline_s:
        time.sleep(_POLL_S)
