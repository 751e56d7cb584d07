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
from mazebot.common.access.key_store import KeyStore
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import BusUnavailableError, join, open_session
from mazebot.router.config import RouterConfig
from mazebot.router.guard import (
    EXIT_NO_RESPONSE,
    PERIOD_S,
    START_TICKS,
    ResponseTimer,
    Starvation,
    reachable,
)
from mazebot.router.router import Router

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


def test_a_period_in_which_it_lacks_a_processor_says_little() -> None:
    timer = ResponseTimer(3)
    timer.responded()
    assert not any(timer.tick(starved=True) for _ in range(10))
    # And yet not for ever.
    assert any(timer.tick(starved=True) for _ in range(10))


def test_a_process_that_waits_for_a_processor_is_told_from_one_that_sleeps() -> None:
    spin = (
        "import os\nos.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "print(flush=True)\nwhile True: pass"
    )
    spinning = [
        subprocess.Popen([sys.executable, "-c", spin], stdout=subprocess.PIPE) for _ in range(3)
    ]
    sleeping = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        for process in spinning:
            assert process.stdout is not None
            process.stdout.readline()
        busy, idle = Starvation(spinning[0].pid), Starvation(sleeping.pid)
        # The period of a guard.
        with pytest.raises(subprocess.TimeoutExpired):
            sleeping.wait(PERIOD_S)
        assert busy.look()
        assert not idle.look()
    finally:
        for process in (*spinning, sleeping):
            process.kill()
            process.communicate()


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


@pytest.mark.slow
def test_a_key_opens_from_when_it_is_made_until_it_is_revoked(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    store = KeyStore(tmp_path / "keys")
    command = [sys.executable, "-m", "mazebot.router", "--listen", endpoint]
    with subprocess.Popen([*command, "--keys-dir", str(store.folder)]) as guard:
        try:
            anna = store.path_of("anna")
            wait_until(lambda: lets_in(endpoint, store.path_of("viewer")))
            assert not lets_in(endpoint, None)
            store.add("anna", "viewer")
            wait_until(lambda: lets_in(endpoint, anna))
            kept = tmp_path / "anna.key"
            kept.write_bytes(anna.read_bytes())
            store.rotate(["anna"])
            wait_until(lambda: lets_in(endpoint, anna) and not lets_in(endpoint, kept))
            kept.write_bytes(anna.read_bytes())
            store.revoke("anna")
            wait_until(lambda: not lets_in(endpoint, kept))
            wait_until(lambda: lets_in(endpoint, store.path_of("viewer")))
            assert guard.poll() is None
        finally:
            guard.terminate()


def test_with_a_wrong_key_in_the_folder_all_stays_as_it_was(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store = KeyStore(tmp_path / "keys")
    router = Router(RouterConfig(listen="tcp/127.0.0.1:0", keys_dir=store.folder))
    try:
        store.path_of("bob").write_text("{")
        for _ in range(3):
            router.take_new_keys()
        (said,) = (record.getMessage() for record in caplog.records if record.levelname == "ERROR")
        assert said.startswith(f"the keys stay as they were: {store.path_of('bob')}: must be a key")
        assert lets_in(router.endpoint, store.path_of("viewer"))
        store.path_of("bob").unlink()
        store.add("bob", "viewer")
        router.take_new_keys()
        assert lets_in(router.endpoint, store.path_of("bob"))
    finally:
        router.close()


def lets_in(endpoint: str, key_file: Path | None) -> bool:
    try:
        session = open_session(BusConfig(connect=endpoint, key_file=key_file))
    except BusUnavailableError:
        return False
    session.close()  # type: ignore[no-untyped-call]
    return True


def test_a_tool_signs_in_with_the_key_in_its_folder_only_where_the_router_wants_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = KeyStore(tmp_path / "keys")
    store.complete()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    for keys_dir, name in ((store.folder, "operator"), (None, None)):
        router = Router(RouterConfig(listen="tcp/127.0.0.1:0", keys_dir=keys_dir))
        try:
            session, key = join(BusConfig(connect=router.endpoint))
            assert (key and key.name) == name
            session.close()  # type: ignore[no-untyped-call]
        finally:
            router.close()
