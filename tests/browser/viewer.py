"""Opens a recording in a headless browser and takes its picture."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.bench.parts.loopback_router import free_port
from mazebot.recorder.config import LayoutName
from mazebot.recorder.drawing.layouts.layout_file import shown_in_layout
from mazebot.recorder.keeping.live import WebPage

if TYPE_CHECKING:
    from playwright.sync_api import Page

Picture = NDArray[np.uint8]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""No GPU is asked for: WebGL2 on SwiftShader."""
_PERIOD_S = 0.2
SETTLE_S = 10.0
"""Until a software renderer has drawn another time."""
_TIME_SLIDER_PX = 293, 209, 14
"""Its left end from the left, its right end from the right, and its middle from the bottom."""


@contextlib.contextmanager
def served(recording: Path, layout: LayoutName | None = None) -> Iterator[str]:
    """Serve a recording with the package's own viewer; the address to open."""
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        parts = shown_in_layout([recording], layout, Path(folder)) if layout else [recording]
        page = WebPage("127.0.0.1", port, recording=parts)
        try:
            yield f"http://127.0.0.1:{port}/"
        finally:
            page.close()


def screenshot(
    url: str,
    done: Callable[[Picture], bool],
    *,
    size: tuple[int, int] = (1600, 900),
    timeout_s: float = 90.0,
    settle_s: float = 0.0,
    at: float | None = None,
    click: tuple[int, int] | None = None,
) -> Picture:
    """The page as (h, w, 3) BGR, as soon as it is `done`, or as it is after `timeout_s`.

    Until it is done, a place, such as a tab's name, is clicked each time that it was looked at: the
    page is not ready for it at once. Then it is given `settle_s` to load the rest, and shown at the
    fraction `at` of its time.
    """
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, headless=True, args=ARGUMENTS
        )
        try:
            page = browser.new_page(
                viewport={"width": size[0], "height": size[1]}, color_scheme="dark"
            )
            page.route("**/fonts.g*", lambda route: route.abort())
            page.goto(url, wait_until="commit")
            end_s = time.monotonic() + timeout_s
            picture = _shoot(page, end_s)
            while not done(picture) and time.monotonic() < end_s:
                if click is not None:
                    page.mouse.click(*click)
                page.wait_for_timeout(1000.0 * _PERIOD_S)
                picture = _shoot(page, end_s)
            if settle_s:
                page.wait_for_timeout(1000.0 * settle_s)
            if at is not None:
                left, right, up = _TIME_SLIDER_PX
                page.mouse.click(left + at * (size[0] - right - left), size[1] - up)
                page.mouse.move(size[0] / 2.0, size[1] - up)
                page.wait_for_timeout(1000.0 * SETTLE_S)
            return _shoot(page, end_s) if settle_s or at is not None else picture
        finally:
            browser.close()


@contextlib.contextmanager
def opened(url: str, done: Callable[[Picture], bool], timeout_s: float) -> Iterator[list[int]]:
    """Keep a page open from when it is `done`, or has had its time; the browser's processes."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, headless=True, args=ARGUMENTS
        )
        page = browser.new_page(viewport={"width": 1280, "height": 720}, color_scheme="dark")
        page.route("**/fonts.g*", lambda route: route.abort())
        page.goto(url, wait_until="commit")
        end_s = time.monotonic() + timeout_s
        while not done(_shoot(page, end_s)) and time.monotonic() < end_s:
            page.wait_for_timeout(1000.0 * _PERIOD_S)
        try:
            yield _descendants(os.getpid(), "chrom")
        finally:
            browser.close()


def _descendants(pid: int, name: str) -> list[int]:
    """The processes below one of ours whose program has a name."""
    found: list[int] = []
    for children in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, children.read_text().split()):
            with contextlib.suppress(OSError):
                if name in Path(f"/proc/{child}/comm").read_text():
                    found.append(child)
                found += _descendants(child, name)
    return found


def _shoot(page: Page, end_s: float) -> Picture:
    """What the page shows; asked again until `end_s` where the browser is too busy to say."""
    from playwright.sync_api import Error

    while True:
        try:
            # A page that still compiles the viewer answers late.
            data = page.screenshot(timeout=60_000.0)
            break
        except Error:
            if time.monotonic() >= end_s:
                raise
            page.wait_for_timeout(1000.0 * _PERIOD_S)
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture, np.uint8)


def count_near(picture: Picture, bgr: tuple[int, int, int], tolerance: int = 30) -> int:
    """Pixels within `tolerance` of a colour in every channel."""
    difference = np.abs(picture.astype(np.int16) - np.array(bgr, np.int16))
    return int((difference.max(axis=2) <= tolerance).sum())


def many_colors(picture: Picture) -> bool:
    """Whether the page shows textures: a welcome page has few colours."""
    return len(np.unique(picture[::8, ::8].reshape(-1, 3), axis=0)) > 600
