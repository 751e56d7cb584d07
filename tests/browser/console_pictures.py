"""Takes the pictures of the live page for the docs: `python -m tests.browser.console_pictures`."""

from __future__ import annotations

import argparse
import contextlib
import io
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from PIL import Image

from mazebot.common.files.root import ROOT
from tests.browser.test_console_live import address_in, opened_in
from tests.browser.viewer import ARGUMENTS, CHROMIUM

if TYPE_CHECKING:
    from playwright.sync_api import Browser

Scheme = Literal["light", "dark"]
DESK, PHONE = (1440, 900), (390, 844)
PICTURES: dict[str, tuple[tuple[int, int], Scheme]] = {
    "console-live.png": (DESK, "light"),
    "console-live-dark.png": (DESK, "dark"),
    "console-phone.png": (PHONE, "light"),
    "console-phone-dark.png": (PHONE, "dark"),
}
"""Size in pixels and colour scheme."""
_WAIT_MS = 120_000.0
"""For a page on a busy machine."""
AT_S = 25.1
"""Simulation time: trails are drawn, a marker is in sight, a goal is under way."""


def main() -> None:
    """Drive the tour of the enhanced world, pause it, and take every picture of that moment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=ROOT / "docs" / "images")
    options = parser.parse_args()
    from playwright.sync_api import sync_playwright

    with (
        tempfile.TemporaryDirectory() as scratch,
        _demo(Path(scratch)) as url,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, headless=True, args=ARGUMENTS
        )
        paused = False
        for name, (size, scheme) in PICTURES.items():
            data = _picture(browser, url, size, scheme, paused)
            # A palette takes a third of the bytes.
            picture = Image.open(io.BytesIO(data)).convert("RGB").quantize(256)
            picture.save(options.folder / name, optimize=True)
            paused = True
        browser.close()


@contextlib.contextmanager
def _demo(folder: Path) -> Iterator[str]:
    """The address of the console beside a tour, which ends with the context."""
    output = folder / "output.txt"
    with output.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "mazebot.cli", "demo", "--console", "--console-port", "0",
             "--router-port", "0", "--world", "enhanced", "--seed", "7",
             "--out", str(folder / "run")],
            stdout=file, stderr=subprocess.STDOUT,
        )  # fmt: skip
    try:
        yield address_in(output, process)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(120.0)


def _picture(
    browser: Browser, url: str, size: tuple[int, int], scheme: Scheme, paused: bool
) -> bytes:
    """The live page as a PNG; the simulation is paused at its moment if it is not."""
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]}, color_scheme=scheme,
        has_touch=size == PHONE,
    )  # fmt: skip
    live = opened_in(context, url)
    if not paused:
        live.page.wait_for_selector("#time", timeout=_WAIT_MS)
        live.wait(lambda: live.page.locator("#time").inner_text(), 0.001 * _WAIT_MS)
        live.wait(lambda: live.time_s() > AT_S, 300.0)
        live.page.get_by_role("button", name="Pause", exact=True).click()
    live.page.get_by_role("button", name="Resume", exact=True).wait_for(timeout=_WAIT_MS)
    # The camera's picture and the plots come with the next frames.
    live.wait(lambda: live.figure("true pose"))
    live.page.wait_for_timeout(3000.0)
    data = live.page.screenshot(timeout=_WAIT_MS)
    context.close()
    assert not live.wrong, live.wrong
    return data


if __name__ == "__main__":
    main()
