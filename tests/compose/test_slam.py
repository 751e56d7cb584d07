"""`docker compose up slam-world`, whose mapping is killed on the way."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.compose.checks import ACTIVE, check_nothing_compiled, is_active
from tests.compose.stack import stack_of, wait_until

pytestmark = [pytest.mark.compose, pytest.mark.usefixtures("image")]

DEMO = "slam-world"
KEYFRAMES = 6
"""Of 27 or so in the end."""


def graph_in(recordings: Path) -> dict[str, Any] | None:
    """The pose graph of the only run, once there is one."""
    found = list(recordings.glob("*/map/pose_graph.json"))
    return json.loads(found[0].read_text()) if found else None


@pytest.mark.timeout(600)
def test_a_house_is_mapped_to_the_end_though_mapping_is_killed(person: int, tmp_path: Path) -> None:
    with stack_of(person) as stack, (tmp_path / "output").open("wb") as output:
        process = stack.in_foreground(output, "up", DEMO)
        wait_until(lambda: is_active(stack, DEMO), 60.0, "both lines")
        assert "localization" not in stack.containers()

        def has_grown() -> bool:
            graph = graph_in(stack.recordings)
            return graph is not None and len(graph["nodes"]) >= KEYFRAMES

        wait_until(has_grown, 120.0, f"{KEYFRAMES} keyframes")
        stack.kill("mapping")
        wait_until(lambda: process.poll() is not None, 300.0, "the exploration ends")
        log = stack.logs(DEMO)
        assert process.returncode == 0, log
        assert stack.compose("logs", DEMO).stdout.count(ACTIVE) == 2
        assert "exploration complete" in log
        for service in ("mapping", "explorer"):
            check_nothing_compiled(stack, service)
        stack.down()
        (run,) = [path for path in stack.recordings.iterdir() if path.is_dir()]
        summary = json.loads((run / "summary.json").read_text())
        assert summary["mapping"]["coverage_share"] >= 0.99
        assert summary["mapping"]["walls_found_share"] >= 0.97
        assert summary["mapping"]["trajectory_error_m"]["p95"] <= 0.05
        assert summary["contacts"]["count"] == 0
        names = {path.name for path in (run / "map").iterdir()}
        assert names == {"map.yaml", "map.pgm", "markers.yaml", "pose_graph.json"}
        graph = graph_in(stack.recordings)
        assert graph is not None
        # One that had begun anew would know nothing of the beginning.
        assert graph["nodes"][0]["stamp_ns"] < 5_000_000_000
