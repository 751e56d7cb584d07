"""What must hold of any tour in containers, and of what it leaves."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.compose.stack import Stack

ACTIVE = "Managed nodes are active"
MANAGERS = ("lifecycle_manager_localization", "lifecycle_manager_navigation")
GOALS = ("location1", "location2", "location3", "location4", "home")


def is_active(stack: Stack, demo: str) -> bool:
    """Whether both lines stand in the demo's own log."""
    log = stack.logs(demo) if demo in stack.containers() else ""
    return all(f"[INFO] [{manager}]: {ACTIVE}" in log for manager in MANAGERS)


def check_nothing_compiled(stack: Stack, service: str) -> None:
    """Check that a service has found every kernel that it used in the image."""
    code = """
import os
from pathlib import Path
kept, image = (
    {str(file.relative_to(folder)) for file in Path(folder).rglob("*.nb?")}
    for folder in (os.environ["NUMBA_CACHE_DIR"], "/opt/mazebot/kernels")
)
print(len(image) > 100, *sorted(kept - image))
"""
    compiled = stack.inside(service, code)
    assert compiled == "True", f"{service}: {compiled}"


def check_table(log: str) -> None:
    """Check that the tour ended with its table, all goals reached, without a contact."""
    table = log[log.index("tour finished") :].splitlines()
    rows = {line.split()[0]: line.split() for line in table if line.strip()}
    for goal in GOALS:
        assert rows[goal][1] == "yes", f"{goal} was not reached:\n{log}"
    assert "contacts: 0" in [line.strip() for line in table], log


def check_recordings(stack: Stack) -> list[dict[str, Any]]:
    """Check that every recording is closed and belongs to the person; the runs' summaries."""
    folders = [path for path in stack.recordings.iterdir() if path.is_dir()]
    assert folders, f"no run in {stack.recordings}"
    for path in (stack.recordings, *stack.recordings.rglob("*")):
        assert path.stat().st_uid == stack.uid, f"{path} belongs to {path.stat().st_uid}"
    summaries = []
    for folder in folders:
        assert {path.name for path in folder.iterdir()} - {".to_compress"} == {
            "config.yaml",
            "digests.bin",
            "report.html",
            "run.mcap",
            "run.rrd",
            "series.json",
            "summary.json",
            "thumbnail.png",
        }
        verified = subprocess.run(
            [Path(sys.executable).with_name("rerun"), "rrd", "verify", folder / "run.rrd"],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert verified.returncode == 0, verified.stderr
        summaries.append(json.loads((folder / "summary.json").read_text()))
    return summaries
