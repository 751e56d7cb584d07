"""`mazebot recordings ...` as people run it."""

from __future__ import annotations

import json
import shutil
import sys
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from unittest import mock

import pyarrow.parquet
import pytest
import typer

from mazebot.cli.recordings.selection import time_of
from mazebot.common.recordings.labels import read_labels
from mazebot.common.recordings.mcap.mcap_file import McapFile
from mazebot.common.recordings.mcap.mcap_messages import read_messages
from mazebot.common.recordings.mcap.mcap_scan import scan
from mazebot.common.recordings.run_folder import LOCK, RunFolder
from tests.cli.test_app import assert_one_line, mazebot
from tests.common.recordings.made_run import listed_run, made_run

REAL, BAD, FAR = (
    "2026-11-20_10-00-00_house", "2026-11-21_10-00-00_maze", "2025-01-01_10-00-00_house",
)  # fmt: skip

OF_ORIGINAL, OF_ENHANCED = "2026-11-18_10-00-00_tour", "2026-11-19_10-00-00_tour"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_run(tmp_path_factory.mktemp("made") / "run", compact_timeout_s=0.0)


@pytest.fixture
def runs(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a real run, one that cannot be read, and an old one."""
    folder = tmp_path / "recordings"
    shutil.copytree(made, folder / REAL)
    listed_run(folder, BAD, summary_json="{bad")
    goals = [{"reached": True}]
    far = {"world": "house", "seed": 3, "goals": goals, "localisation_error_m": {"mean": 0.9}}
    listed_run(folder, FAR, far, labels_json='{"tags": ["best"]}')
    monkeypatch.chdir(tmp_path)
    return folder


def listed(*arguments: str) -> list[str]:
    done = mazebot("recordings", "list", *arguments, "--json")
    assert done.returncode == 0, done.stderr
    return [run["name"] for run in json.loads(done.stdout)]


def told(*arguments: str) -> str:
    done = mazebot("recordings", *arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def read(*arguments: str) -> Any:
    return json.loads(told(*arguments, "--json"))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ([], [BAD, REAL, FAR]),
        (["--reverse"], [FAR, REAL, BAD]),
        (["--world", "HOUSE"], [FAR]),
        (["--world", "room"], [REAL]),
        (["--world", "original"], [OF_ORIGINAL]),
        (["--world", "enhanced"], [OF_ENHANCED]),
        (["--world", "sim_house"], [OF_ENHANCED, OF_ORIGINAL]),
        (["--tag", "best"], [FAR]),
        (["--tag", "best", "--tag", "keep"], []),
        (["--failed"], [BAD, REAL]),
        (["--since", "2026-11-21"], [BAD]),
        (["--since", "2026-11-20T10:00"], [BAD, REAL]),
        (["--sort", "name"], [FAR, REAL, BAD]),
        (["--sort", "error"], [FAR, REAL, BAD]),
        (["--sort", "time", "--reverse", "--world", "o"], [FAR, REAL]),
    ],
)
def test_the_runs_asked_for_are_listed(runs: Path, options: list[str], expected: list[str]) -> None:
    if expected and expected[-1] in (OF_ORIGINAL, OF_ENHANCED):
        listed_run(runs, OF_ORIGINAL, {"world": "sim_house"})
        listed_run(runs, OF_ENHANCED, {"world": "sim_house_enhanced"})
    assert listed(*options) == expected


def test_a_list_shows_what_each_run_did(runs: Path) -> None:
    lines = told("list").splitlines()
    heading = "name world started goals simulated s error m size MB tags state"
    assert " ".join(lines[0].split()) == heading
    assert "summary.json: " in lines[2]
    assert lines[3].split()[:5] == [REAL, "room", "2026-11-20", "10:00:00", "0/1"]
    assert lines[4].split()[-1] == "best"
    assert told("list", "--world", "nowhere").startswith("no recordings in recordings")


@pytest.mark.parametrize(
    ("text", "age"),
    [("90min", timedelta(minutes=90)), ("1.5h", timedelta(hours=1.5)), ("2w", timedelta(days=14))],
)
def test_an_age_is_a_time(text: str, age: timedelta) -> None:
    now = datetime(2026, 11, 21, 12, 0, 0)  # noqa: DTZ001 - local
    assert time_of(text, now) == now - age


def test_a_run_is_told_of(runs: Path) -> None:
    text = told("info", REAL)
    for words in (
        "0 of 1 reached",
        "localisation error, mean",
        "set navigation.controller_server.controller  ",
    ):
        assert words in text
    found = read("info", "latest")
    assert (found["name"], found["problem"].partition(":")[0]) == (BAD, "summary.json")
    assert read("info", str(runs / REAL))["figures"]["goals_missed"] == 1.0


def test_what_was_not_recorded_of_a_run_is_told(runs: Path) -> None:
    counts = {"received": 835, "recorded": 509}
    nowhere = {"received": None, "recorded": None}
    listed_run(runs, "hole", {"messages": {"/scan": counts, "/cmd_vel_teleop": nowhere}})
    listed_run(runs, "cut", {"messages": {"/scan": counts}, "ended": False})
    gap = "509 of 835 messages recorded"
    rows = {line.split()[0]: line for line in told("list").splitlines()}
    assert rows["hole"].endswith(f" {gap}")
    assert rows["cut"].endswith(f"interrupted, {gap}")
    assert gap in told("info", "hole")
    assert gap in told("compare", FAR, "hole")
    assert gap in told("report", "hole") + (runs / "hole" / "report.html").read_text()
    # As long as its recorder has not been taken care of, it is not known what its files hold.
    (runs / "hole" / LOCK).touch()
    assert gap not in told("info", "hole")


def test_a_report_is_made_again(runs: Path) -> None:
    files = [runs / name / "report.html" for name in (REAL, FAR)]
    assert told("report", REAL, FAR).splitlines() == [
        f"recordings/{REAL}/report.html",
        f"recordings/{REAL}/thumbnail.png",
        f"recordings/{FAR}/report.html",
    ]
    assert all(file.is_file() for file in files)
    # Also of a run whose recorder was killed.
    (runs / REAL / LOCK).touch()
    told("report", REAL)
    assert "was interrupted" in files[0].read_text()


def test_runs_are_compared(runs: Path) -> None:
    text = " ".join(told("compare", REAL, FAR).split())
    for words in ("navigation running -", "goals reached", "has no digests.bin"):
        assert words in text
    comparison = read("compare", FAR, REAL, "--no-messages")
    rows = {row["name"]: row for row in comparison["figures"]}
    assert rows["localisation_error_m.mean"]["judgements"] == ["same", "better"]
    assert comparison["messages"] == []


def test_runs_are_exported(runs: Path, tmp_path: Path) -> None:
    assert told("export", "--out", "runs.parquet") == "runs.parquet: 3 runs\n"
    assert pyarrow.parquet.read_table(tmp_path / "runs.parquet")["name"].to_pylist() == [
        FAR, REAL, BAD,
    ]  # fmt: skip
    assert read("export", "--out", "goals.csv", "--goals", "--failed") == {
        "file": "goals.csv",
        "rows": 1,
    }


def test_tags_and_a_note_are_set_and_removed(runs: Path) -> None:
    assert told("tag", REAL, "slow", "keep", "--note", "why?") == "tags: keep slow\nnote: why?\n"
    assert told("tag", REAL) == "tags: keep slow\nnote: why?\n"
    assert read("tag", REAL, "--remove", "slow", "--note", "-") == {
        "name": REAL, "tags": ["keep"], "note": "",
    }  # fmt: skip
    assert read_labels(runs / REAL).tags == ("keep",)
    before = (runs / REAL / "labels.json").read_bytes()
    assert_one_line(mazebot("recordings", "tag", REAL, "good", "not/one"), "'not/one'", "letters")
    assert (runs / REAL / "labels.json").read_bytes() == before


def test_old_runs_are_pruned_as_far_as_was_said(runs: Path) -> None:
    assert "would delete: 1 of 3 runs" in told("prune", "--keep-last", "2", "--dry-run")
    assert len(list(runs.iterdir())) == 3
    # Nobody can be asked.
    assert_one_line(mazebot("recordings", "prune", "--keep-last", "2"), "--yes")
    assert len(list(runs.iterdir())) == 3
    told("tag", FAR, "keep")
    assert told("prune", "--keep-last", "2", "--yes") == "nothing to delete: all 3 runs stay\n"
    found = read("prune", "--keep-gb", "0", "--yes")
    assert (found["deleted"], len(found["runs"]), found["failed"]) == (True, 2, [])
    assert listed() == [FAR]


@pytest.mark.parametrize(("answer", "left"), [("n", 3), ("y", 1)])
def test_it_asks_before_it_deletes(
    runs: Path, monkeypatch: pytest.MonkeyPatch, answer: str, left: int
) -> None:
    stdin = mock.Mock()
    stdin.isatty.return_value = True
    monkeypatch.setattr(sys, "stdin", stdin)
    refusal = None if answer == "y" else typer.Abort
    with mock.patch("typer.confirm", side_effect=refusal):
        done = mazebot("recordings", "prune", "--keep-last", "1")
    assert done.returncode == (0 if answer == "y" else 130)
    assert len(list(runs.iterdir())) == left


def test_a_run_that_is_recorded_is_neither_deleted_nor_repaired(runs: Path) -> None:
    live = RunFolder.exactly(runs / "live")
    found = read("prune", "--keep-last", "0", "--dry-run")
    assert "live" not in [run["name"] for run in found["runs"]]
    assert_one_line(mazebot("recordings", "repair", "live"), "is being recorded")
    assert read("repair") == {"repaired": [], "failed": []}
    live.let_go()


def test_killed_runs_are_repaired(runs: Path) -> None:
    for name in (REAL, FAR):
        (runs / name / LOCK).touch()
    assert "interrupted" in told("list")
    assert told("repair", REAL) == f"recordings/{REAL}: repaired\n"
    assert (runs / REAL / "report.html").is_file()
    assert (runs / FAR / LOCK).exists()
    assert read("repair") == {"repaired": [f"recordings/{FAR}"], "failed": []}
    assert told("repair") == "nothing to repair in recordings\n"


def test_a_run_whose_messages_are_cut_off_is_repaired_when_named(runs: Path) -> None:
    file = runs / REAL / "run.mcap"
    made = McapFile(file)
    made.add_channel("/a", "std_msgs/msg/String", "string data", {})
    made.add_messages([(0, number, number, number, (b"hello",)) for number in range(10)])
    made.close()
    whole = list(read_messages([file]))
    file.write_bytes(file.read_bytes()[:-50])
    assert read("repair") == {"repaired": [], "failed": []}
    assert "repaired" in told("repair", REAL)
    assert scan(file).is_whole
    assert len(whole) == 10
    assert list(read_messages([file])) == whole
    assert_one_line(
        mazebot("recordings", "repair", REAL),
        "is complete: must be a run whose recorder was killed",
    )


def test_a_run_of_which_nothing_can_be_read_is_not_said_to_be_whole(runs: Path) -> None:
    (runs / REAL / LOCK).touch()
    (runs / REAL / "run.mcap").write_bytes(b"nothing of a recording" * 100)
    done = mazebot("recordings", "repair", REAL)
    assert done.returncode == 2
    assert "repaired" not in done.stdout
    assert done.stderr.count("\n") == 1
    assert f"recordings/{REAL}/run.mcap: cannot be read" in done.stderr


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["info", "2026-11-2"], {REAL}),
        (["compare", REAL, "2026"], {REAL}),
        (["report", "20"], {REAL}),
        (["repair", "2026"], {REAL}),
        (["tag", "2026"], {REAL}),
        (["tag", REAL, ""], {"best", "keep"}),
        (["tag", REAL, "--remove", "b"], {"best"}),
        (["list", "--tag", "k"], {"keep"}),
        (["list", "--sort", "s"], {"started", "size"}),
    ],
)
def test_the_shell_completes_runs_and_tags(runs: Path, words: list[str], offered: set[str]) -> None:
    words = ["recordings", *words]
    done = mazebot(
        _MAZEBOT_COMPLETE="complete_bash",
        COMP_WORDS=" ".join(["mazebot", *words]),
        COMP_CWORD=str(len(words)),
    )
    assert set(done.stdout.split()) == offered
