"""How a page drives the viewer, with a viewer of our own making that does what Rerun's does."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.browser.viewer import ARGUMENTS, CHROMIUM
from tests.console.served import Served, console

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
    pytest.mark.timeout(120),
]

# It shows the first moment when it has opened a recording, ignores what it is told for some time,
# and then follows the newest moment until it is told again.
WIDGET = """
export default { render({ model }) {
  let opened = Infinity, sought = null;
  const say = (message) => model.send(JSON.stringify(message));
  const shows = (time) => say({ type: "time_update", time: Math.round(time * 1e9) });
  model.on("msg:custom", (message) => {
    if (message.type === "open_url") {
      opened = performance.now();
      say({ type: "recording_open", recording_id: "run" });
      shows(0);
      setInterval(() => {
        const s = (performance.now() - opened) / 1000;
        if (s > 1.5) shows(sought ?? s);
      }, 50);
    }
    if (message.type === "time_ctrl" && performance.now() - opened > 2500) {
      sought = Number(message.duration_nanos) / 1e9;
    }
  });
  setTimeout(() => model.send("ready"), 0);
} };
"""
SEEK = """
async (wanted) => {
  const { Viewer } = await import("/static/viewer.js");
  const viewer = await Viewer.start(document.createElement("div"), "test");
  const told = document.body.dataset;
  viewer.onTime = (time) => {
    told.shown = time;
    if (time > 1.5) told.followed = "yes";
  };
  await viewer.open(["/run.rrd"]);
  viewer.seek(wanted);
}
"""


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    from playwright.sync_api import sync_playwright

    (tmp_path / "recordings").mkdir()
    with sync_playwright() as playwright, console(tmp_path / "recordings") as served:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, headless=True, args=ARGUMENTS
        )
        yield opened(browser.new_page(), served)
        browser.close()


def opened(page: Page, served: Served) -> Page:
    page.route(
        "**/viewer/test/widget.js",
        lambda route: route.fulfill(body=WIDGET, content_type="text/javascript"),
    )
    page.goto(f"{served.url}/runs")
    return page


@pytest.mark.parametrize("wanted_s", [0.0, 1.25])
def test_a_moment_that_is_wanted_stays_even_if_it_was_shown_by_chance(
    page: Page, wanted_s: float
) -> None:
    page.evaluate(SEEK, wanted_s)
    page.locator("body[data-followed=yes]").wait_for(timeout=60_000.0)
    page.locator(f"body[data-shown='{wanted_s:g}']").wait_for(timeout=60_000.0)
