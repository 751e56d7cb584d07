"""`mazebot recordings view`."""

from __future__ import annotations

import os
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Sequence
from pathlib import Path

from mazebot.cli.parsing.patience import wait_quietly
from mazebot.common.config import ConfigError
from mazebot.common.recordings.catalog import LATEST, find_run
from mazebot.common.recordings.comparing.wholeness import IS_CUT, recording_fault
from mazebot.common.recordings.run_folder import LOCK, RECORDING, parts_of
from mazebot.recorder.config import LayoutName

_LOOK_S = 1.0


def view_run(
    directory: Path, name: str, web_port: int, open_browser: bool, layout: LayoutName | None = None
) -> None:
    """Serve a run to browsers on this machine until Ctrl-C, and optionally open it in one.

    Raises ConfigError where there is no such run or the port is taken.
    """
    run = find_run("recordings view", directory, name or LATEST, RECORDING)
    if run.recording is None:
        raise ConfigError(
            f"recordings view: {run.path}: has no {RECORDING}: it was run without recording"
        )
    recording = run.recording
    parts = shown(parts_of(recording.parent))
    # These load Rerun.
    from mazebot.recorder.drawing.layouts.layout_file import shown_in_layout  # noqa: PLC0415
    from mazebot.recorder.keeping.live import WebPage  # noqa: PLC0415

    with tempfile.TemporaryDirectory(prefix="mazebot-view-") as scratch:
        if layout is not None:
            parts = shown_in_layout(parts, layout, Path(scratch))
        page = WebPage("127.0.0.1", web_port, recording=parts)
        url = f"http://localhost:{web_port}"
        opened = open_browser and _opened(url)
        status = f"opened {url} in your browser" if opened else f"open {url} in a browser"
        sys.stdout.write(f"{recording}: {status} (Ctrl-C to stop)\n")
        sys.stdout.flush()
        wait_quietly()
        never = threading.Event()
        try:
            # A Ctrl-C in the moment before a wait without an end begins would not end it.
            while not never.wait(_LOOK_S):
                pass
        finally:
            page.close()


def shown(parts: Sequence[Path]) -> list[Path]:
    """The files of a recording that the viewer can show, if not to their ends; says what is wrong
    with the others.

    Raises ConfigError where it can show none.
    """
    faults = {part: recording_fault(part) for part in parts}
    shown = [part for part, fault in faults.items() if fault in ("", IS_CUT)]
    if not shown:
        part, fault = next(iter(faults.items()))
        raise ConfigError(f"recordings view: {part}: {fault}")
    for part, fault in faults.items():
        if fault and not (part.parent / LOCK).exists():
            sys.stderr.write(f"warning: {part}: {fault}\n")
    return shown


def _opened(url: str) -> bool:
    """Whether a browser was started. This machine must have a screen: a text browser cannot show a
    recording.
    """
    shows = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
    return (shows or sys.platform == "darwin") and webbrowser.open(url)
