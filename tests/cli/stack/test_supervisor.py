"""The processes of a stack: how they start, end, are started again, and are told apart."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mazebot.cli.stack.control import end, start, wait_until_active
from mazebot.cli.stack.log_file import LogWriter, follow, read_lines
from mazebot.cli.stack.plan import StackPlan
from mazebot.cli.stack.state import ProcessId, StackFolder, StackState, running_stacks
from mazebot.common.config import ConfigError
from tests.cli.stack.running import DEAF, LASTS, plan_of, runtime, says, service, wait_until

__all__ = ["runtime"]

pytestmark = pytest.mark.usefixtures("runtime")


PHYSICS_WAITS = "[INFO] [physics]: waiting for a world"


@contextmanager
def started(plan: StackPlan) -> Iterator[StackFolder]:
    folder = StackFolder(plan.port)
    start(plan, folder)
    try:
        yield folder
    finally:
        end(folder)


def test_the_state_of_a_service_is_what_it_says_last() -> None:
    plan = plan_of(
        router=says("[INFO] [router]: listening on tcp/127.0.0.1:1"),
        physics=says(
            "[INFO] [physics]: connected to tcp/1", "[INFO] [physics]: waiting for a world"
        ),
        worldgen=says(
            "[INFO] [worldgen]: waiting for a world request", "[INFO] [worldgen]: active"
        ),
        localization=says(
            "[INFO] [localization]: waiting for a key", "[INFO] [localization]: connected to tcp/1"
        ),
        bringup=says("nothing of interest"),
    )
    with started(plan) as folder:
        states = {
            # What it waits for beside the bus is not known yet.
            "localization": "starting",
            "router": "active",
            "physics": "waiting for a world",
            "worldgen": "active",
            "bringup": "starting",
        }
        wait_until(lambda: {name: service(folder, name).text for name in states} == states)
        for name in states:
            process = service(folder, name).process
            assert process is not None
            assert process.runs()


def test_a_service_that_dies_is_started_again_and_its_death_is_said() -> None:
    with started(plan_of(physics=says("here"))) as folder:
        first = service(folder, "physics").process
        assert first is not None
        # Killed earlier, it would say nothing.
        wait_until(lambda: said(folder, "physics"))
        os.kill(first.pid, signal.SIGKILL)
        wait_until(lambda: service(folder, "physics").restarts == 1)
        wait_until(lambda: service(folder, "physics").process not in (None, first))
        wait_until(lambda: len(said(folder, "physics")) == 2)
        assert said(folder, "up") == ["physics has ended (signal 9): starting it again in 0.1 s"]
        assert not first.runs()


def test_one_that_ends_again_and_again_waits_longer_each_time() -> None:
    with started(plan_of(physics="import sys; sys.exit(3)")) as folder:
        wait_until(lambda: len(said(folder, "up")) >= 3)
        waits = [line.rpartition("in ")[2] for line in said(folder, "up")[:3]]
        assert waits == ["0.1 s", "0.2 s", "0.4 s"]
        assert "exit code 3" in said(folder, "up")[0]


def test_a_demo_is_not_started_again() -> None:
    with started(plan_of(restarts=False, bringup="import sys; sys.exit(1)")) as folder:
        wait_until(lambda: service(folder, "bringup").phase == "ended")
        # Longer than another one would wait.
        ended_s = time.monotonic()
        wait_until(lambda: time.monotonic() > ended_s + 0.5)
        state = service(folder, "bringup")
        assert (state.text, state.process, state.restarts) == ("ended (exit code 1)", None, 0)
        assert wait_until_active(folder, lambda _: None, 5.0, 1.0).code == 1


def test_all_end_and_one_that_does_not_is_killed() -> None:
    plan = plan_of(router=LASTS, physics=DEAF, worldgen=LASTS)
    folder = StackFolder(plan.port)
    state = start(plan, folder)
    wait_until(lambda: said(folder, "physics") == ["deaf"])
    begin_s = time.monotonic()
    assert end(folder) == 3
    assert 4.5 < time.monotonic() - begin_s < 9.0
    assert not any(one.process and one.process.runs() for one in state.services)
    assert not state.supervisor.runs()
    assert said(folder, "up") == ["physics has not ended within 5 s: killed"]
    assert folder.running() is None
    assert end(folder) == 0


def test_services_end_with_a_supervisor_that_is_killed() -> None:
    with started(plan_of(router=LASTS, physics=LASTS)) as folder:
        state = folder.running()
        assert state is not None
        os.kill(state.supervisor.pid, signal.SIGKILL)
        wait_until(lambda: folder.running() is None)
        lock = folder.locked()
        assert lock is not None
        lock.close()


def test_what_a_killed_supervisor_leaves_is_ended() -> None:
    plan = plan_of(physics=DEAF)
    folder = StackFolder(plan.port)
    state = start(plan, folder)
    wait_until(lambda: said(folder, "physics") == ["deaf"])
    os.kill(state.supervisor.pid, signal.SIGKILL)
    wait_until(lambda: not state.supervisor.runs())
    assert folder.running() is not None
    assert end(folder) == 1
    assert folder.running() is None


def test_a_process_of_somebody_else_is_left_alone() -> None:
    with subprocess.Popen([sys.executable, "-c", LASTS]) as other:
        mine = ProcessId.of(other.pid)
        # The number was one of ours once, and is theirs now.
        reused = ProcessId(pid=mine.pid, started_ticks=mine.started_ticks - 1)
        folder = StackFolder(1)
        folder.path.mkdir()
        state = StackState(
            endpoint="tcp/127.0.0.1:1", about="", supervisor=reused, since_s=0.0, services=[]
        )
        folder.write(state)
        assert folder.running() is None
        assert end(folder) == 0
        reused.send(signal.SIGKILL)
        assert other.poll() is None
        assert mine.runs()
        mine.send(signal.SIGKILL)
        other.wait(10.0)
        assert not mine.runs()


def test_only_one_stack_runs_on_a_port() -> None:
    plan = plan_of(physics=LASTS)
    with started(plan) as folder:
        with pytest.raises(ConfigError, match="a stack runs already on tcp/127"):
            start(plan, folder)
        with started(plan_of(physics=LASTS)) as other:
            assert other.running() is not None
        assert folder.running() is not None


def test_what_is_waited_for_is_told_and_a_stack_that_is_not_active_in_time_is_an_error() -> None:
    told: list[str] = []
    plan = plan_of(
        router=says("[INFO] [router]: listening on tcp/1"),
        bringup=says("[INFO] [bringup]: waiting for physics (not running)"),
    )
    with started(plan) as folder:
        wait_until(lambda: service(folder, "bringup").phase == "waiting")
        with pytest.raises(ConfigError, match="5 s: bringup: waiting for physics"):
            wait_until_active(folder, told.append, 0.5, 1.0)
    assert told == ["bringup: waiting for physics (not running)"]


def test_why_a_service_is_started_again_and_again_is_told() -> None:
    told: list[str] = []
    reason = "recorder: web_port: 9090: address in use"
    plan = plan_of(
        router=says("[INFO] [router]: listening on tcp/1"),
        recorder=f"import sys\nprint('[INFO] [recorder]: starting')\nsys.exit('error: {reason}')",
    )

    def tell(missing: str) -> None:
        told.append(missing)
        if reason in missing:
            raise KeyboardInterrupt

    with started(plan) as folder, pytest.raises(KeyboardInterrupt):
        wait_until_active(folder, tell, 20.0, 20.0)
    assert told[-1] == f"recorder: restarting (exit code 1): {reason}"


def test_without_a_demo_what_others_send_is_waited_for_a_while(tmp_path: Path) -> None:
    told: list[str] = []
    loaded = tmp_path / "loaded"
    waits = f"import os, time\nwhile not os.path.exists({str(loaded)!r}): time.sleep(0.01)\n"
    said = ("[INFO] [physics]: connected to tcp/1", "[INFO] [physics]: waiting for a world")
    plan = plan_of(
        router=says("[INFO] [router]: listening on tcp/1"),
        physics="".join(f"print({line!r}, flush=True)\n" for line in said)
        + waits
        + says("[INFO] [physics]: active"),
    )

    def tell(missing: str) -> None:
        told.append(missing)
        if "a world" in missing:
            loaded.touch()

    with started(plan) as folder:
        wait_until(lambda: service(folder, "physics").phase == "waiting")
        # The other half may be started later.
        awaited = wait_until_active(folder, lambda _: None, 10.0, 0.0)
        assert awaited == (0, "physics: waiting for a world")
        assert wait_until_active(folder, tell, 20.0, 20.0) == (0, "")
    assert told == ["physics: waiting for a world"]


def test_once_a_demo_has_ended_all_others_have_to_be_connected(tmp_path: Path) -> None:
    told: list[str] = []
    asked = tmp_path / "asked"

    def tell(missing: str) -> None:
        told.append(missing)
        asked.touch()

    waits = f"import os, time\nwhile not os.path.exists({str(asked)!r}): time.sleep(0.01)\n"
    plan = plan_of(
        restarts=False,
        router=says("[INFO] [router]: listening on tcp/1"),
        bringup="print('[INFO] [bringup]: active')",
        recorder=waits + says("[INFO] [recorder]: active"),
    )
    with started(plan) as folder:
        wait_until(lambda: service(folder, "bringup").phase == "ended")
        assert wait_until_active(folder, tell, 20.0, 20.0) == (0, "")
        assert service(folder, "recorder").phase == "active"
    assert told == ["recorder: starting"]


def test_a_folder_that_others_may_write_is_refused(runtime: Path) -> None:
    (runtime / "mazebot").mkdir(exist_ok=True)
    (runtime / "mazebot").chmod(0o777)
    with pytest.raises(ConfigError, match="only you may write"):
        StackFolder(1)


@pytest.mark.parametrize("has_run_there", [False, True])
def test_a_stack_is_found_from_a_shell_with_another_environment(
    has_run_there: bool, runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = runtime / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    with started(plan_of(router=LASTS)) as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
        if has_run_there:
            (runtime / "mazebot" / str(folder.port)).mkdir(parents=True)
        assert StackFolder(folder.port).running() == folder.running()
        assert folder.running() in list(running_stacks())
        # Others could have written there what they like.
        folder.path.parent.chmod(0o777)
        assert StackFolder(folder.port).running() is None


def test_the_log_is_followed_over_a_change_of_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    monkeypatch.setattr("mazebot.cli.stack.log_file._MAX_BYTES", 300)
    monkeypatch.setattr("mazebot.cli.stack.log_file._POLL_S", 0.001)
    log = LogWriter(tmp_path)
    # It closes the file also when the test has failed.
    request.addfinalizer(log.close)
    log.put("physics", "first")
    lines = follow(tmp_path, ("physics",), lambda: True)
    seen = [next(lines)]
    for number in range(40):
        log.put("physics", f"line {number}")
        log.put("other", "not this one")
        while (line := next(lines)) is not None:
            seen.append(line)
    assert seen == [("physics", text) for text in ("first", *(f"line {n}" for n in range(40)))]
    assert len(list(tmp_path.iterdir())) == 2
    assert [text for _, text in read_lines(tmp_path, ("physics",))][-1] == "line 39"


def said(folder: StackFolder, name: str) -> list[str]:
    """What a service has said."""
    return [text for _, text in read_lines(folder.path, (name,))]
