"""Malformed messages to everything that reads any."""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mazebot.bench.fuzz.decoders import fuzz_requests, fuzz_topics
from mazebot.bench.fuzz.mutations import MUTATIONS, mutated
from mazebot.common.messages import wire
from mazebot.common.messages.topics import QUERIES, SCAN, TOPICS
from tests.common.samples import SAMPLES

REAL = {topic.name: [wire.encode(topic, SAMPLES[topic])] for topic in TOPICS}


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(700)
def test_nothing_malformed_ends_a_stack_or_keeps_the_robot_from_its_goal(tmp_path: Path) -> None:
    command = [
        sys.executable, "-m", "mazebot.bench.fuzz", "--cases", "400", "--seconds", "20",
        "--json", "fuzz.json",
    ]  # fmt: skip
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as run:
        try:
            said, _ = run.communicate(timeout=600)
        except BaseException:
            # So that it ends its stack.
            run.send_signal(signal.SIGINT)
            raise
    found = json.loads((tmp_path / "fuzz.json").read_text())
    # How much memory the allocator keeps is another matter than what a message may do.
    assert [one for one in found["problems"] if "has grown" not in one] == [], said
    assert {one["sent"] for one in found["decoded"]} == {400}
    for one in found["decoded"]:
        assert one["rejected"] + one["valid"] == one["sent"], one
    assert found["stack"]["sent"] > 1000
    assert found["stack"]["goals_reached"] >= 4
    assert found["stack"]["answered"] == found["stack"]["requests"] > 500
    assert len(found["stack"]["period_p99_ms"]) == 5


def test_each_is_taken_or_rejected_and_counted_once() -> None:
    told: list[str] = []
    reports = fuzz_topics(1, 12, REAL, told.append, 0) + fuzz_requests(1, 12, REAL, told.append)
    assert told
    assert {one.name for one in reports} >= {SCAN.name, QUERIES[0].name, "/spawn_entity"}
    for one in reports:
        assert not one.findings, one.findings
        assert one.rejected + one.valid == one.sent == 12


def test_what_a_decoder_does_not_catch_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError("of a decoder")

    monkeypatch.setattr(wire, "validate", fails)
    (report,) = (
        one for one in fuzz_topics(1, 30, REAL, lambda _: None, 0) if one.name == SCAN.name
    )
    assert report.findings[0].problem == "ZeroDivisionError: of a decoder"


def test_one_seed_gives_the_same_messages() -> None:
    data, others = REAL[SCAN.name][0], [one[0] for one in REAL.values()]
    first, second = (
        [mutated(data, others, random.Random(seed)) for seed in range(50)] for _ in range(2)
    )
    assert first == second
    assert len(set(first)) > 40
    for mutation in MUTATIONS:
        assert isinstance(mutation(b"", others, random.Random(1)), bytes)
