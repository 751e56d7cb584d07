"""`mazebot recordings list|view`."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from services.common.config import ConfigError
from services.recorder.catalog import RecordingInfo, list_recordings
from services.recorder.run_folder import RECORDING


def list_runs(directory: Path) -> None:
    """Print the runs of a folder, newest first."""
    runs = list_recordings(directory)
    if not runs:
        sys.stdout.write(f"no recordings in {directory}; `make demo` makes one\n")
        return
    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("name", "world", "started", "goals", "simulated s", "size MB", ""):
        table.add_column(heading, justify="left" if heading in ("name", "world") else "right")
    for run in runs:
        started = run.started.strftime("%Y-%m-%d %H:%M:%S") if run.started else "-"
        goals = f"{run.goals_reached}/{run.goals_total}"
        state = "" if run.closed else "open"
        size = f"{run.size_bytes / 1e6:.1f}"
        table.add_row(run.name, run.world, started, goals, f"{run.sim_time_s:.0f}", size, state)
    console = Console()
    if not console.is_terminal:
        console.width = 200
    console.print(table)


def view_run(directory: Path, name: str, web_port: int) -> None:
    """Serve a run to browsers on this machine until Ctrl-C.

    Raises ConfigError where there is no such run or the port is taken.
    """
    recording = _find(directory, name)
    from services.recorder.live import WebPage  # noqa: PLC0415 - loads Rerun

    page = WebPage("127.0.0.1", web_port, recording=recording)
    sys.stdout.write(f"{recording}: open http://localhost:{web_port} (Ctrl-C ends)\n")
    sys.stdout.flush()
    try:
        threading.Event().wait()
    finally:
        page.close()


def _find(directory: Path, name: str) -> Path:
    folder = Path(name)
    if name and (folder / RECORDING).is_file():
        return folder / RECORDING
    runs: list[RecordingInfo] = [run for run in list_recordings(directory) if run.recording]
    for run in runs:
        if run.recording and (not name or run.name == name):
            return run.recording
    if name:
        known = ", ".join(run.name for run in runs[:3]) or "none"
        raise ConfigError(f"recordings: {name!r} is no run in {directory}; it has {known}")
    raise ConfigError(f"recordings: no run.rrd in {directory}; `make demo` makes one")
