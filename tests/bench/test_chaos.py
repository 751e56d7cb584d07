"""Faults in mid-drive."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mazebot.bench.chaos import machines
from mazebot.bench.chaos.faults import FAULTS, SHORT
from mazebot.bench.chaos.machines import Machine
from mazebot.bench.chaos.plots import write_plot
from mazebot.bench.chaos.recordings import faults_of_recordings
from mazebot.bench.chaos.summary import met, rows_of
from mazebot.bench.chaos.trial import Trial
from mazebot.common.config import ConfigError
from tests.cli.stack.running import wait_until


def trials_of(tmp_path: Path, *options: str) -> list[dict[str, object]]:
    """What `make chaos` reports."""
    report = tmp_path / "chaos.json"
    command = [sys.executable, "-m", "mazebot.bench.chaos", *options, "--json", str(report)]
    with subprocess.Popen(command, cwd=tmp_path) as run:
        try:
            # Its exit code tells whether promised times were kept: those are for a quiet machine.
            run.wait(800)
        except BaseException:
            # So that it ends its stack.
            run.send_signal(signal.SIGINT)
            raise
    found = json.loads(report.read_text())
    for trial in found["trials"]:
        assert trial["recovered"], trial
        assert (trial["goal"], trial["contacts"], trial["same_world"]) == ("reached", 0, True)
    assert not found["broken_recordings"]
    return list(found["trials"])


def services_in(folder: Path) -> list[Path]:
    """The processes that have a setting with this folder in it: those of a stack there."""
    found = []
    for environment in Path("/proc").glob("[0-9]*/environ"):
        # Some are of other users, some are over.
        with contextlib.suppress(OSError):
            if f"MAZEBOT_RECORDER_RECORDINGS_DIR={folder}".encode() in environment.read_bytes():
                found.append(environment)
    return found


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(900)
def test_the_robot_drives_on_after_the_main_faults(tmp_path: Path) -> None:
    trials = trials_of(tmp_path, "--short")
    assert sorted(str(trial["fault"]) for trial in trials) == sorted(SHORT)


@pytest.mark.slow
@pytest.mark.longest
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(900)
def test_an_exploration_goes_on_with_its_map_after_faults(tmp_path: Path) -> None:
    faults = ("kill-explorer", "kill-physics+mapping")
    trials = trials_of(tmp_path, "--explore", *(f"--fault={one}" for one in faults))
    assert sorted(str(trial["fault"]) for trial in trials) == sorted(faults)
    assert all(trial["seen_m2"] for trial in trials)


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(300)
def test_one_that_is_told_to_end_ends_its_stack_and_says_no_more(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mazebot.bench.chaos", "--fault", "kill-recorder"]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, env=os.environ | {"TMPDIR": str(tmp_path)}
    ) as run:
        wait_until(lambda: services_in(tmp_path), 200.0)
        run.send_signal(signal.SIGTERM)
        assert run.stderr is not None
        assert run.stderr.read() == "starting the stack\n"
    assert run.returncode == 128 + signal.SIGTERM
    wait_until(lambda: not services_in(tmp_path), 30.0)


def test_an_unknown_fault_is_one_line(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mazebot.bench.chaos", "--fault", "kill-cat"],
        capture_output=True, text=True, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith("error: FAULT: 'kill-cat': must be one of kill-worldgen, ")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "options", [("--links", "--short"), ("--links", "--explore"), ("--fault", "cut-router-5s")]
)
def test_nothing_to_be_done_is_one_line(tmp_path: Path, options: tuple[str, ...]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mazebot.bench.chaos", *options],
        capture_output=True, text=True, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("error: ")


def test_a_machine_is_changed_while_a_program_runs(tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        with pytest.raises(ConfigError, match="C compiler"):
            machines.compiler()
        return
    file = tmp_path / "machine"
    machines.set_machine(file, Machine())
    variables = machines.variables(str(machines.compile_library(tmp_path)), str(file))
    shows = (
        "import datetime, os, sys, time\n"
        "for line in sys.stdin:\n"
        "    begin_s = time.monotonic()\n"
        "    os.write(int(line), bytes(20_000))\n"
        "    time.sleep(0.001)\n"
        "    now = datetime.datetime.now(datetime.UTC).timestamp()\n"
        "    print(now, time.monotonic() - begin_s)\n"
        "    print(time.time(), 9.0, time.monotonic(), flush=True)"
    )
    with (
        (tmp_path / "written").open("wb", buffering=0) as opened,
        subprocess.Popen(
            [sys.executable, "-c", shows], env={**os.environ, **variables},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            pass_fds=(opened.fileno(),),
        ) as program,
    ):  # fmt: skip
        assert program.stdin is not None
        assert program.stdout is not None
        for machine in (
            Machine(), Machine(added_s=3600), Machine(added_s=-3600), Machine(),
            Machine(disk_bytes_s=100_000),
        ):  # fmt: skip
            machines.set_machine(file, machine)
            program.stdin.write(f"{opened.fileno()}\n")
            program.stdin.flush()
            shown = program.stdout.readline()
            machines.check(shown, machine, "the program")
            *also, monotonic_s = program.stdout.readline().split()
            machines.check(" ".join(also), machine, "the program")
            assert abs(float(monotonic_s) - time.monotonic()) < 60.0
            wrong = machine._replace(added_s=machine.added_s + 1800)
            with pytest.raises(ConfigError, match="the program: the clock cannot be set here"):
                machines.check(shown, wrong, "the program")
        with pytest.raises(ConfigError, match="the program: the disk cannot be made slow here"):
            machines.check(shown, Machine(disk_bytes_s=100), "the program")
        assert os.fstat(opened.fileno()).st_size == 5 * 20_000
        program.stdin.close()


def test_what_was_promised_and_not_kept_is_told(tmp_path: Path) -> None:
    well = Trial("kill-physics", 0, back_s=1.0, drives_s=1.5, goal="reached", next_goal="reached")
    late = Trial("kill-physics", 1, back_s=30.0, drives_s=31.0, goal="reached", next_goal="reached")
    lost = Trial("kill-router", 2, problem="not within 60 s: an active navigation", contacts=1)
    rolls = Trial("kill-navigation", 3, stop_s=0.9, goal="reached", next_goal="reached")
    rows = rows_of(FAULTS, [well, late, lost, rolls])
    assert [row.fault for row in rows] == ["kill-physics", "kill-navigation", "kill-router"]
    assert [line for row in rows for line in met(row)] == [
        "kill-physics: back after 15.50 s, not 5 s",
        "kill-navigation: at rest after 0.90 s, not 0.25 s",
        "kill-router: recovered 0 of 1",
        "kill-router: 1 contacts",
    ]
    write_plot(tmp_path / "chaos.png", rows, [well, late, lost, rolls])
    assert (tmp_path / "chaos.png").read_bytes().startswith(b"\x89PNG")


def test_a_recording_that_is_not_whole_is_told(tmp_path: Path) -> None:
    assert faults_of_recordings(tmp_path) == [f"{tmp_path}: no run was recorded"]
    run = tmp_path / "run"
    run.mkdir()
    (run / "run.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert faults_of_recordings(tmp_path) == ["run: no summary.json", "run: run.mcap is not whole"]
