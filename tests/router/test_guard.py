"""The router in its processes: one that is it, and one that watches over it."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mazebot.bench.parts.loopback_router import free_port, wait_for_router
from mazebot.router.guard import EXIT_NO_RESPONSE, PERIOD_S, START_TICKS, ResponseTimer, reachable

DEADLINE_S = 45.0


def wait_until(condition: Callable[[], object]) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


@pytest.fixture
def router() -> Iterator[tuple[subprocess.Popen[str], int, str]]:
    """The guard, the process id of its router, and where that listens."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "mazebot.router", "--listen", endpoint, "--silence-s", "1"]
    guard = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        wait_for_router(endpoint)
        children = Path(f"/proc/{guard.pid}/task/{guard.pid}/children").read_text().split()
        (pid,) = children
        yield guard, int(pid), endpoint
    finally:
        guard.kill()
        guard.communicate()


def is_running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def has_a_connection(pid: int) -> bool:
    """Whether the guard has come to ask its router, which then need not begin any more."""
    for path in Path(f"/proc/{pid}/fd").iterdir():
        # One may be closed in the meantime.
        with contextlib.suppress(FileNotFoundError):
            if str(path.readlink()).startswith("socket:"):
                return True
    return False


def test_a_router_that_hangs_is_ended(router: tuple[subprocess.Popen[str], int, str]) -> None:
    guard, pid, _ = router
    wait_until(lambda: has_a_connection(guard.pid))
    # Before its first answer a router has longer: it may be starting.
    answered_s = time.monotonic() + 2.0 * PERIOD_S
    wait_until(lambda: time.monotonic() > answered_s)
    os.kill(pid, signal.SIGSTOP)
    assert guard.wait(DEADLINE_S) == EXIT_NO_RESPONSE
    assert not is_running(pid)
    assert guard.stderr is not None
    assert guard.stderr.read() == "error: router: no response for 1 s; exiting\n"


def test_a_router_without_its_guard_ends(router: tuple[subprocess.Popen[str], int, str]) -> None:
    guard, pid, _ = router
    guard.kill()
    wait_until(lambda: not is_running(pid))


def test_a_router_that_ends_takes_its_guard_along(
    router: tuple[subprocess.Popen[str], int, str],
) -> None:
    guard, pid, _ = router
    os.kill(pid, signal.SIGKILL)
    assert guard.wait(DEADLINE_S) == 128 + signal.SIGKILL


def test_it_stops_as_it_is_told(router: tuple[subprocess.Popen[str], int, str]) -> None:
    guard, pid, _ = router
    guard.terminate()
    assert guard.wait(DEADLINE_S) == 0
    assert not is_running(pid)


def test_silence_is_counted_in_ticks_and_a_start_may_take_longer() -> None:
    timer = ResponseTimer(3)
    assert not any(timer.tick() for _ in range(START_TICKS))
    assert timer.tick()
    timer.responded()
    assert [timer.tick() for _ in range(4)] == [False, False, False, True]


@pytest.mark.parametrize(
    ("listen", "connect"),
    [
        ("tcp/0.0.0.0:7447", "tcp/127.0.0.1:7447"),
        ("tcp/[::]:7447", "tcp/127.0.0.1:7447"),
        ("tcp/10.0.0.1:80", "tcp/10.0.0.1:80"),
    ],
)
def test_all_addresses_are_reached_by_the_loopback(listen: str, connect: str) -> None:
    assert reachable(listen) == connect


def test_a_mistake_is_one_line() -> None:
    command = [sys.executable, "-m", "mazebot.router", "--listen", "nowhere"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: router: listen:")
    assert done.stderr.count("\n") == 1
