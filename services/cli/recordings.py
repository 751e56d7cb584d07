"""`mazebot recordings list|view`."""

from __future__ import annotations

import dataclasses
import os
import sys
import tempfile
import threading
import webbrowser
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from services.cli.options import print_json
from services.common.config import ConfigError
from services.common.recordings.catalog import RecordingInfo, list_recordings
from services.common.recordings.run_folder import RECORDING, parts_of
from services.recorder.config import LayoutName

DEFAULT = Path("recordings")


def list_runs(directory: Path | None, as_json: bool) -> None:
    """Print the runs of a folder, newest first.

    Raises ConfigError where the given path is not a folder.
    """
    if directory is not None and not directory.is_dir():
        raise ConfigError(f"--dir: {directory}: must be a folder of recordings")
    directory = directory or DEFAULT
    runs = list_recordings(directory)
    if as_json:
        print_json([_row(run) for run in runs])
        return
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
        simulated = "-" if run.sim_time_s is None else f"{run.sim_time_s:.0f}"
        table.add_row(run.name, run.world, started, goals, simulated, size, state)
    console = Console()
    if not console.is_terminal:
        console.width = 200
    console.print(table)


def _row(run: RecordingInfo) -> dict[str, object]:
    return dataclasses.asdict(run) | {
        "path": str(run.path),
        "started": run.started.isoformat() if run.started else None,
        "recording": str(run.recording) if run.recording else None,
    }


def view_run(
    directory: Path, name: str, web_port: int, open_browser: bool, layout: LayoutName | None = None
) -> None:
    """Serve a run to browsers on this machine until Ctrl-C, and optionally open it in one.

    Raises ConfigError where there is no such run or the port is taken.
    """
    recording = _find(directory, name)
    # These load Rerun.
    from services.recorder.drawing.layouts.layout_file import shown_in_layout  # noqa: PLC0415
    from services.recorder.keeping.live import WebPage  # noqa: PLC0415

    parts = parts_of(recording.parent)
    scratch = tempfile.TemporaryDirectory(prefix="mazebot-view-")
    if layout is not None:
        parts = shown_in_layout(parts, layout, Path(scratch.name))
    page = WebPage("127.0.0.1", web_port, recording=parts)
    url = f"http://localhost:{web_port}"
    opened = open_browser and _opened(url)
    told = f"opened {url} in your browser" if opened else f"open {url} in a browser"
    sys.stdout.write(f"{recording}: {told} (Ctrl-C ends)\n")
    sys.stdout.flush()
    try:
        threading.Event().wait()
    finally:
        page.close()
        scratch.cleanup()


def _opened(url: str) -> bool:
    """Whether a browser was started. This machine must have a screen: a text browser cannot show a
    recording.
    """
    shows = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
    return (shows or sys.platform == "darwin") and webbrowser.open(url)


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
