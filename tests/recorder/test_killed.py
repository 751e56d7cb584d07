"""A recorder that is killed at random moments while the robot drives on."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mazebot.common.files.root import ROOT
from mazebot.common.recordings.mcap.mcap_messages import RecordedMessage, read_messages
from mazebot.common.recordings.mcap.mcap_scan import scan
from mazebot.common.recordings.run_folder import LOCK, MESSAGES, parts_of
from mazebot.recorder.keeping.repair import Repair
from tests.recorder.driven_recorder import SAID
from tests.recorder.test_node import verify

MOST_LOST_S = 0.5


def drive(folder: Path, start_ns: int, killed_after_s: float) -> tuple[int, list[tuple[int, int]]]:
    """Run a recorder until it is killed; its exit code, and when what was said."""
    said = folder.parent / "said"
    command = [sys.executable, "-m", "tests.recorder.driven_recorder"]
    arguments = [str(folder), str(start_ns), str(killed_after_s), str(said)]
    code = subprocess.run([*command, *arguments], cwd=ROOT, timeout=120.0, check=False).returncode
    data = said.read_bytes()
    return code, list(SAID.iter_unpack(data[: len(data) // SAID.size * SAID.size]))


def messages_of(folder: Path) -> list[RecordedMessage]:
    """Of all runs: one that is killed before it has kept its progress is not gone on with."""
    runs = sorted(folder.iterdir())
    return [message for run in runs for message in read_messages(parts_of(run, MESSAGES))]


def kill_many_times(folder: Path, kills: int, seed: int) -> list[float]:
    """Wall time that was lost at each kill. Each recorder goes on with the run of the last one."""
    random_ = random.Random(seed)
    start_ns, lost_s, before = 0, list[float](), list[RecordedMessage]()
    for _ in range(kills):
        code, said = drive(folder, start_ns, random_.uniform(0.5, 3.0))
        assert code == -signal.SIGKILL
        messages = messages_of(folder)
        assert messages[: len(before)] == before, "something earlier is lost"
        new, before = messages[len(before) :], messages
        newest_ns = max((m.envelope.sent_ns for m in new if m.topic == "/clock"), default=start_ns)
        lost = [wall_ns for wall_ns, sim_ns in said if sim_ns > newest_ns]
        lost_s.append((said[-1][0] - lost[0]) * 1e-9 if lost else 0.0)
        clocks_ns = [m.envelope.sent_ns for m in new if m.topic == "/clock"]
        assert np.all(np.diff(clocks_ns) < 50_000_000), "there is a gap"
        start_ns = said[-1][1] // 1_000_000_000 * 1_000_000_000 + 1_000_000_000
    return lost_s


@pytest.mark.slow
def test_killed_at_random_moments_it_loses_half_a_second_each_time(tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    lost_s = kill_many_times(folder, 5, seed=7)
    assert max(lost_s) <= MOST_LOST_S, lost_s
    before = messages_of(folder)
    runs = sorted(folder.iterdir())
    assert not scan(runs[-1] / "run.mcap").is_whole
    Repair(folder).repair_all()
    for run in runs:
        assert not (run / LOCK).exists()
        verify(run / "run.rrd")
        assert scan(run / "run.mcap").is_whole
    assert messages_of(folder) == before
