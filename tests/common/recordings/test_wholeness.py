"""Whether the files of a run are whole, and of one run."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from mazebot.cli.recordings.view import shown
from mazebot.common.recordings.comparing.wholeness import faults, faults_of_file, recording_faults
from tests.cli.test_app import mazebot
from tests.common.recordings.made_run import made_run

RECORDED: dict[str, Any] = {"record": True, "segment_mib": 1}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    made_run(folder / "one", **RECORDED)
    made_run(folder / "other", seconds=1.0, **RECORDED)
    return folder


@pytest.fixture
def runs(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "runs")


def diff(runs: Path, *options: str) -> tuple[int, str]:
    done = mazebot("diff", str(runs / "copy"), str(runs / "one"), *options)
    return done.returncode, done.stdout


def cut(file: Path) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 3])


def test_a_run_under_another_name_is_whole(runs: Path) -> None:
    copy = (runs / "one").rename(runs / "copy")
    shutil.copytree(copy, runs / "one")
    assert faults(copy) == faults(runs / "other") == ()
    shutil.copy(copy / "run.mcap", runs / "x.mcap")
    assert faults_of_file(runs / "x.mcap") == ()
    code, said = diff(runs)
    assert code == 0, said
    # What goes on is not judged.
    data = (copy / "run.mcap").read_bytes()
    (copy / "run.mcap").write_bytes(data[: len(data) // 2])
    assert faults(copy)
    (copy / ".recording").touch()
    assert faults(copy) == ()


@pytest.mark.parametrize(("spoil", "words"), [
    (lambda one, _: cut(one / "run.mcap"), ["run.mcap is cut", "recorded messages are there"]),
    (lambda one, _: cut(one / "digests.bin"), ["digests.bin ends at "]),
    (lambda one, other: shutil.copy(other / "run.mcap", one),
     ["run.mcap is of another run: run 'other', by summary.json 'one'", "messages are there"]),
    (lambda one, other: shutil.copy(other / "run.mcap", one / "run_3.mcap"),
     ["run_2.mcap is missing", "run_3.mcap is of another run"]),
    (lambda one, _: (one / "run.mcap").write_bytes(b"x"),
     ["run.mcap is no MCAP file", "0 of "]),
])  # fmt: skip
def test_what_is_not_whole_is_no_success(runs: Path, spoil: Any, words: list[str]) -> None:
    shutil.copytree(runs / "one", runs / "copy")
    spoil(runs / "copy", runs / "other")
    found = faults(runs / "copy")
    assert len(found) == len(words)
    for fault, part in zip(found, words, strict=True):
        assert part in fault
    code, said = diff(runs)
    assert code == 1
    assert f"the first run is not whole: {found[0]}" in said
    assert json.loads(diff(runs, "--json")[1])["faults"] == [list(found), []]
    assert mazebot("recordings", "info", str(runs / "copy")).stdout.count("\nfault ") == len(found)
    done = mazebot("recordings", "compare", str(runs / "one"), str(runs / "copy"))
    assert (done.returncode, found[0] in done.stdout) == (1, True)


@pytest.mark.parametrize(("spoil", "fault", "shows"), [
    (cut, "run.rrd is cut", True),
    (lambda file: file.write_bytes(b""), "run.rrd is empty", False),
    (lambda file: file.write_bytes(b"x" * 5000), "run.rrd is no recording of Rerun", False),
])  # fmt: skip
def test_what_the_viewer_cannot_show_is_told(
    runs: Path, capsys: pytest.CaptureFixture[str], spoil: Any, fault: str, shows: bool
) -> None:
    file = runs / "one" / "run.rrd"
    assert recording_faults(runs / "one") == ()
    spoil(file)
    assert recording_faults(runs / "one") == (fault,)
    said = mazebot("recordings", "info", str(runs / "one")).stdout
    assert f"fault {fault}" in " ".join(said.split())
    if shows:
        assert shown([file]) == [file]
        assert capsys.readouterr().err == f"warning: {file}: is cut\n"
    else:
        done = mazebot("recordings", "view", str(runs / "one"))
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr.endswith(f"error: recordings view: {file}: {fault[8:]}\n")
    (runs / "one" / ".recording").touch()
    assert recording_faults(runs / "one") == ()
