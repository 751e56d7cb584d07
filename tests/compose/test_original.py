"""`docker compose up demo-world`, by a person who is not root, in a clone without recordings/."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.compose.checks import ACTIVE, check_recordings, check_table, is_active
from tests.compose.stack import DEMOS, Stack, stack_of, wait_until
from tests.recorder.stream.stalled_viewer import stalled_viewer

pytestmark = [pytest.mark.compose, pytest.mark.usefixtures("image")]

DEMO = DEMOS["original"]


@pytest.fixture(scope="module")
def stack(person: int) -> Iterator[Stack]:
    with stack_of(person) as stack:
        (stack.recordings / ".gitkeep").unlink()
        stack.recordings.rmdir()
        yield stack


@pytest.fixture(scope="module")
def process(
    stack: Stack, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[subprocess.Popen[bytes]]:
    output: Path = tmp_path_factory.mktemp("up") / "output"
    with output.open("wb") as stream:
        yield stack.in_foreground(stream, "up", DEMO)


def test_it_is_active_within_20_s(stack: Stack, process: subprocess.Popen[bytes]) -> None:
    assert process.poll() is None
    wait_until(lambda: is_active(stack, DEMO), 20.0, "both lines")


def test_the_recorder_works_as_the_person(stack: Stack, process: subprocess.Popen[bytes]) -> None:
    wait_until(lambda: is_active(stack, DEMO), 60.0, "both lines")
    status = stack.status_of_process("recorder")
    assert status["Uid"].split() == [str(stack.uid)] * 4
    assert status["CapEff"] == "0000000000000000"


def test_a_viewer_that_stalls_and_a_recorder_that_is_killed_cost_the_tour_nothing(
    stack: Stack, process: subprocess.Popen[bytes]
) -> None:
    """Seen by the tests below: one recording, whole, in one folder, and the table."""
    wait_until(lambda: is_active(stack, DEMO), 60.0, "both lines")
    with stalled_viewer(stack.data_port):
        wait_until(lambda: "reached after" in stack.logs(DEMO), 120.0, "a goal is reached")
    stack.kill("recorder")
    wait_until(lambda: "resuming" in stack.logs("recorder"), 15.0, "the recorder is back")
    with stalled_viewer(stack.data_port):
        wait_until(lambda: process.poll() is not None, 300.0, "the tour ends")
    said = stack.logs("recorder")
    assert "recording stopped" not in said
    assert "the main loop is hung" not in said


def test_the_tour_ends_and_leaves_what_belongs_to_the_person(
    stack: Stack, process: subprocess.Popen[bytes]
) -> None:
    assert process.wait(300.0) == 0
    log = stack.logs(DEMO)
    check_table(log)
    assert stack.compose("logs", DEMO).stdout.count(ACTIVE) == 2
    assert stack.down() <= 5.0
    (summary,) = check_recordings(stack)
    assert summary["world"] == "sim_house"
    assert [goal["reached"] for goal in summary["goals"]] == [True] * 5
    assert not summary["markers_seen"]
