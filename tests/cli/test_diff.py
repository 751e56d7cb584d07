"""`mazebot diff` as people run it, on runs made by hand."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from mazebot.cli import app
from mazebot.common.messages import topics as table
from mazebot.common.messages import wire
from mazebot.common.node.node import Envelope
from mazebot.common.recordings.comparing.digests import DigestWriter
from tests.recorder.synthetic import driving, opening, room


def make_run(
    folder: Path, *, seed: int = 7, speed_m_s: float = 0.26, differs: bool = False
) -> Path:
    """A run of 2 s; one that differs says another velocity from 1 s on."""
    folder.mkdir()
    summary = {"world": "room", "world_hash": "ab", "seed": seed, "versions": {"numpy": "2"}}
    (folder / "summary.json").write_text(json.dumps(summary))
    services: dict[str, Any] = {
        "navigation": {"max_speed_m_s": speed_m_s},
        "recorder": {"out_dir": str(folder)},
    }
    (folder / "config.yaml").write_text(yaml.safe_dump({"seed": seed, "services": services}))
    writer = DigestWriter(folder / "digests.bin")
    for number, (now_ns, topic, message) in enumerate([*opening(room()), *driving(room(), 2.0)]):
        if differs and topic is table.CMD_VEL and now_ns > 1_000_000_000:
            message.twist.linear.x = 0.3
        pieces = wire.encode_in_pieces(topic, message)
        writer.add(topic, pieces, Envelope("navigation", number, now_ns, ""))
    writer.close()
    return folder


def diff(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> object:
    monkeypatch.setattr(sys, "argv", ["mazebot", "diff", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        app.main()
    return ended.value.code


def test_equal_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = make_run(tmp_path / "a"), make_run(tmp_path / "b")
    assert diff(monkeypatch, first, second) == 0
    told = capsys.readouterr().out.splitlines()
    assert told[0] == "same world (room), seed (7), configuration and versions"
    assert told[1].startswith("the same: ")
    assert len(told) == 2


def test_runs_that_part_are_told_of_with_what_made_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    make_run(tmp_path / "a")
    make_run(tmp_path / "b", seed=8, speed_m_s=0.3, differs=True)
    assert diff(monkeypatch, "a", "b", "--dir", tmp_path) == 1
    told = capsys.readouterr().out.splitlines()
    assert told[:2] == ["seed: 7 | 8", "navigation.max_speed_m_s: 0.26 | 0.3"]
    assert told[2].startswith(
        "first difference: 1.033 s (control tick 20), /cmd_vel of navigation: message "
    )
    assert told[2].endswith(" differs")


def test_the_newest_run_is_called_latest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    make_run(tmp_path / "2026-01-01_00-00-00_room", seed=7)
    make_run(tmp_path / "2026-01-02_00-00-00_room", seed=8)
    assert diff(monkeypatch, "2026-01-01_00-00-00_room", "latest", "--dir", tmp_path) == 0
    assert capsys.readouterr().out.splitlines()[0] == "seed: 7 | 8"


def test_a_run_that_has_not_ended_is_compared_as_far_as_it_went(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = make_run(tmp_path / "a"), make_run(tmp_path / "b")
    (second / ".recording").touch()
    (second / "summary.json").unlink()
    assert diff(monkeypatch, first, second) == 0
    assert "the second run has not ended" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda run: [file.unlink() for file in run.iterdir()], "not a folder of a run"),
        (lambda run: (run / "digests.bin").unlink(), "run without recording"),
        (lambda run: (run / "digests.bin").write_bytes(b"\0"), "not a digests file"),
        (lambda run: (run / "config.yaml").write_text("a: ["), "config.yaml"),
        (lambda run: (run / "summary.json").write_text("[]"), "contains no settings"),
    ],
)
def test_what_cannot_be_compared_is_told_in_a_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    spoil: Any,
    words: str,
) -> None:
    first, second = make_run(tmp_path / "a"), make_run(tmp_path / "b")
    spoil(second)
    assert diff(monkeypatch, first, second) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert words in told.err
    assert told.err.count("\n") == 1
