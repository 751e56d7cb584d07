"""Opens a recording in a headless browser and takes its picture."""

from __future__ import annotations

import contextlib
import io
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import quote

import cv2
import numpy as np
from numpy.typing import NDArray

from services.recorder.repair import rerun_binary

Picture = NDArray[np.uint8]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
# No GPU is asked for: WebGL2 on SwiftShader.
_ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
_PERIOD_S = 0.2


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def served(recording: Path) -> Iterator[str]:
    """Serve a recording with the package's own viewer; the address to open."""
    binary = rerun_binary()
    assert binary is not None
    web_port, grpc_port = free_port(), free_port()
    ports = ["--web-viewer-port", str(web_port), "--port", str(grpc_port), "--bind", "127.0.0.1"]
    command = [str(binary), str(recording), "--serve-web", *ports]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL
    ) as process:
        try:
            wait_for_port(web_port)
            source = quote(f"rerun+http://127.0.0.1:{grpc_port}/proxy", safe="")
            yield f"http://127.0.0.1:{web_port}/?url={source}"
        finally:
            process.kill()


def wait_for_port(port: int, timeout_s: float = 20.0) -> None:
    """Return when something listens on a port."""
    end_s = time.monotonic() + timeout_s
    while time.monotonic() < end_s:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        time.sleep(_PERIOD_S)
    raise TimeoutError(f"nothing listens on port {port}")


def screenshot(
    url: str,
    done: Callable[[Picture], bool],
    *,
    size: tuple[int, int] = (1600, 900),
    timeout_s: float = 90.0,
    settle_s: float = 0.0,
) -> Picture:
    """The page as (h, w, 3) BGR, as soon as it is `done`, or as it is after `timeout_s`."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, headless=True, args=_ARGUMENTS
        )
        try:
            page = browser.new_page(
                viewport={"width": size[0], "height": size[1]}, color_scheme="dark"
            )
            page.route("**/fonts.g*", lambda route: route.abort())
            page.goto(url, wait_until="commit")
            end_s = time.monotonic() + timeout_s
            picture = _shoot(page.screenshot)
            while not done(picture) and time.monotonic() < end_s:
                page.wait_for_timeout(1000.0 * _PERIOD_S)
                picture = _shoot(page.screenshot)
            if settle_s:
                page.wait_for_timeout(1000.0 * settle_s)
                picture = _shoot(page.screenshot)
            return picture
        finally:
            browser.close()


def _shoot(screenshot_: Callable[..., bytes]) -> Picture:
    # A page that still compiles the viewer answers late.
    data = io.BytesIO(screenshot_(timeout=60_000.0)).getvalue()
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture, np.uint8)


def count_near(picture: Picture, bgr: tuple[int, int, int], tolerance: int = 30) -> int:
    """Pixels within `tolerance` of a colour in every channel."""
    difference = np.abs(picture.astype(np.int16) - np.array(bgr, np.int16))
    return int((difference.max(axis=2) <= tolerance).sum())
