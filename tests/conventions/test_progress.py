"""What `make` shows of the commands that say nothing themselves."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

from mazebot.common.files.root import ROOT

WITH_PROGRESS = ROOT / "scripts" / "with-progress.sh"
COUNT_INSTALLED = ROOT / "scripts" / "count-installed.sh"


def test_a_silent_command_is_told_of_until_it_ends_with_its_own_code() -> None:
    with subprocess.Popen(
        [WITH_PROGRESS, "installing", "echo 3 of 4", "sh", "-c", "read line; exit $line"],
        stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stderr is not None
        assert process.stdin is not None
        assert process.stderr.readline() == "installing\n"
        told = {f"installing: 3 of 4, {second} s\n" for second in range(1, 60)}
        assert process.stderr.readline() in told
        process.stdin.write("7\n")
        process.stdin.close()
        assert process.wait(30.0) == 7
        assert set(process.stderr) <= told


def test_a_quick_command_is_told_of_once() -> None:
    done = subprocess.run(
        [WITH_PROGRESS, "installing", "", "echo", "all well"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert (done.stdout, done.stderr) == ("all well\n", "installing\n")


def test_libraries_are_counted_as_they_are_fetched_installed_and_compiled(tmp_path: Path) -> None:
    lock = tmp_path / "some.lock"
    lock.write_text("a==1 \\\n    --hash=x\nb==2 \\\nc==3 ; sys_platform == 'win32' \\\n")
    cache, libraries = tmp_path / "cache", tmp_path / "venv" / "lib" / "python3.11/site-packages"
    uv = tmp_path / "uv"
    uv.write_text(f"#!/bin/sh\necho {cache}\n")
    uv.chmod(0o755)
    (cache / "archive-v0" / "old").mkdir(parents=True)
    libraries.mkdir(parents=True)
    made = tmp_path / "venv" / "pyvenv.cfg"
    made.touch()
    for path, age_s in ((cache / "archive-v0" / "old", 200.0), (made, 100.0)):
        os.utime(path, (time.time() - age_s,) * 2)

    def counted() -> str:
        return subprocess.run(
            [COUNT_INSTALLED, uv, tmp_path / "venv", lock],
            capture_output=True, text=True, check=True,
        ).stdout.strip()  # fmt: skip

    (cache / "archive-v0" / "new").mkdir()
    assert counted() == "1 of 2 fetched"
    (libraries / "a-1.dist-info").mkdir()
    assert counted() == "1 of 2 installed"
    (libraries / "b-2.dist-info").mkdir()
    (libraries / "a.pyc").touch()
    assert counted() == "2 installed, 1 files of byte code"


def test_nothing_is_installed_in_silence() -> None:
    lines = (ROOT / "Makefile").read_text().replace("\\\n", " ").splitlines()
    words = ("pip sync", "pip install", " venv ")
    installing = [line for line in lines if any(word in line for word in words)]
    assert len(installing) >= 5
    assert [line for line in installing if "$(TELL)" not in line] == []
