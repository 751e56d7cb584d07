"""A run's report in a real browser without any network and without scripts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mazebot.common.recordings.report.report import write_report
from tests.browser.viewer import CHROMIUM
from tests.common.recordings.made_run import made_run

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here"),
]

TRUE_PATH = {"light": (31, 102, 193), "dark": (108, 176, 255)}
"""Its colour, RGB."""
GOAL = {"light": (207, 34, 46), "dark": (255, 123, 114)}


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = made_run(tmp_path_factory.mktemp("runs") / "run", 20.0)
    write_report(folder)
    return folder / "report.html"


def pixels_of(png: bytes) -> NDArray[np.int64]:
    """(h, w, 3), RGB."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR_RGB)
    return np.asarray(picture, np.int64)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width_px", [390, 1280])
def test_it_shows_plan_and_plots_on_a_phone_and_on_a_desk(
    browser: Any, report: Path, width_px: int, scheme: str
) -> None:
    context = browser.new_context(
        viewport={"width": width_px, "height": 900},
        color_scheme=scheme,
        offline=True,
        java_script_enabled=False,
    )
    page = context.new_page()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(report.as_uri())
    assert asked == [report.as_uri()]
    plan = page.get_by_role("img", name="from above")
    box = plan.bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= width_px
    picture = pixels_of(plan.screenshot())
    for colour, least in ((TRUE_PATH[scheme], 100), (GOAL[scheme], 15)):
        near = (np.abs(picture - colour).max(axis=2) < 40).sum()
        assert near > least, colour
    for name in ("Localisation error over simulation time", "Speed over simulation time"):
        assert page.get_by_role("img", name=name).is_visible()
    assert page.get_by_role("heading", level=1).inner_text() == "run"
    assert page.get_by_role("cell", name="no (105)").is_visible()
    # Nothing is cut off at the side.
    assert pixels_of(page.screenshot(full_page=True)).shape[1] == width_px
    context.close()


def test_it_can_be_printed(browser: Any, report: Path, tmp_path: Path) -> None:
    page = browser.new_page(color_scheme="dark")
    page.goto(report.as_uri())
    page.emulate_media(media="print")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert page.pdf(path=str(tmp_path / "report.pdf")).startswith(b"%PDF")
    page.close()
