"""Takes a run's picture: `python -m tests.browser.picture recordings/<run> out.png --at 0.93`."""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import get_args

import cv2

from mazebot.recorder.config import LayoutName
from mazebot.recorder.keeping.repair import Rewriting
from tests.browser.viewer import many_colors, screenshot, served


def main() -> None:
    """Show a run's recording in a headless browser until it has settled, and keep the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="the run's folder")
    parser.add_argument("picture", type=Path, help="the PNG to write")
    parser.add_argument("--at", type=float, help="fraction of the run's time [default: its end]")
    parser.add_argument("--settle", type=float, default=30.0, help="seconds for loading")
    parser.add_argument("--layout", choices=get_args(LayoutName), help="[default: its own]")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        # A software renderer takes in one chunk a frame: few chunks, or a long wait.
        recording = Path(shutil.copy(options.run / "run.rrd", folder))
        Rewriting([recording]).run(timeout_s=60.0)
        with served(recording, options.layout) as url:
            picture = screenshot(url, many_colors, settle_s=options.settle, at=options.at)
    cv2.imwrite(str(options.picture), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
