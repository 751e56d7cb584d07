"""`mazebot recordings list|view`."""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path
from urllib.parse import quote

from rich import box
from rich.console import Console
from rich.table import Table

from services.common.config import ConfigError
from services.recorder.catalog import RecordingInfo, list_recordings
from services.recorder.repair import rerun_binary
from services.recorder.run_folder import RECORDING

GRPC_PORT_AFTER_WEB = 1
"""The page reads the recording from the port after its own."""


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
    """Serve a run to a browser; the process becomes the viewer's server and ends with Ctrl-C.

    Raises ConfigError where there is no such run or a port is taken.
    """
    recording = _find(directory, name)
    binary = rerun_binary()
    if binary is None:
        raise ConfigError("recordings: the rerun program is not installed (make env)")
    grpc_port = web_port + GRPC_PORT_AFTER_WEB
    for port in (web_port, grpc_port):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                raise ConfigError(f"--port: {port} is taken; choose another") from None
    source = quote(f"rerun+http://localhost:{grpc_port}/proxy", safe="")
    sys.stdout.write(f"open http://localhost:{web_port}/?url={source}\n")
    sys.stdout.flush()
    arguments = ["--serve-web", "--web-viewer-port", str(web_port), "--port", str(grpc_port)]
    os.execv(binary, ["rerun", str(recording), *arguments, "--bind", "127.0.0.1"])


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
