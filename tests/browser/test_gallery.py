"""The console's gallery in a real browser, with runs that the recorder has written."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from playwright.sync_api import expect

from mazebot.bench.parts.loopback_router import free_port
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.node import RecorderNode
from tests.browser.viewer import CHROMIUM, Picture
from tests.console.runs import make_run, summary
from tests.console.served import Served, console
from tests.recorder.synthetic import Bench, WallClock, driving, opening, room

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Response

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
    pytest.mark.timeout(300),
]

RUNS = ("2026-01-01_10-00-00_first", "2026-01-02_10-00-00_second", "2026-01-03_10-00-00_third")
_PATIENCE_S = 150.0


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("recordings")
    for name, length_s in zip(RUNS, (4.0, 6.0, 1.0), strict=True):
        config = RecorderConfig(recordings_dir=folder, out_dir=folder / name)
        world = room()
        bench = Bench(RecorderNode(config, WallClock()))
        bench.say(opening(world))
        bench.say(driving(world, length_s))
        bench.node.close()
    with console(folder) as running:
        yield running


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page that fails a test in which a script fails or another host is reached."""
    context = browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme="dark")
    opened = context.new_page()
    problems: list[str] = []

    def heard(answer: Response) -> None:
        if "//localhost:" not in answer.url and not answer.url.startswith(("data:", "blob:")):
            problems.append(answer.url)

    opened.on("pageerror", lambda error: problems.append(str(error)))
    opened.on("response", heard)
    yield opened
    context.close()
    assert problems == []


def bricks(page: Page) -> int:
    """Pixels of the red bricks in what the page shows."""
    data = page.screenshot(timeout=60_000.0)
    picture: Picture = np.asarray(
        cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), np.uint8
    )
    blue, green, red = (picture[..., channel].astype(int) for channel in range(3))
    return int(((red > 100) & (red > 2 * green) & (green >= blue - 10)).sum())


def wait_for_bricks(page: Page) -> None:
    end_s = time.monotonic() + _PATIENCE_S
    while bricks(page) < 1500:
        assert time.monotonic() < end_s, "the walls were not drawn"
        page.wait_for_timeout(300.0)


def names(page: Page) -> list[str | None]:
    """The runs whose cards are shown, in order."""
    return [card.get_attribute("data-run") for card in page.locator(".card").all()]


def test_runs_are_found_tagged_and_deleted(served: Served, page: Page) -> None:
    first, second, third = RUNS
    page.goto(f"{served.url}/")
    cards = page.locator(".card")
    expect(cards).to_have_count(3)
    assert names(page) == [third, second, first]
    picture = page.locator(f'[data-run="{first}"] img')
    page.wait_for_function("image => image.naturalWidth > 0", arg=picture.element_handle())

    page.keyboard.press("/")
    page.keyboard.type("second")
    # A pause in the typing asks, too: the last of what was typed counts.
    expect(page).to_have_url(f"{served.url}/runs?q=second")
    expect(cards).to_have_count(1)
    page.reload()
    expect(cards).to_have_count(1)
    page.locator("[name=q]").fill("")
    page.select_option("[name=sort]", "oldest")
    expect(cards).to_have_count(3)
    expect(cards.first).to_have_attribute("data-run", first)

    page.locator(f'[data-run="{third}"] h2 a').focus()
    page.keyboard.press("Enter")
    page.locator("[name=tags]").fill("slow corner")
    page.locator("[name=note]").fill("at the end")
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#labels-status")).to_have_text("saved")
    page.goto(f"{served.url}/runs?tag=corner")
    expect(cards).to_have_count(1)
    expect(cards.first).to_contain_text("at the end")

    page.goto(f"{served.url}/runs/{third}")
    page.get_by_role("link", name="Delete").click()
    page.get_by_role("button", name="Delete").click()
    expect(cards).to_have_count(2)
    assert not (served.folder / third).exists()


def test_a_new_run_appears_without_a_reload(served: Served, page: Page) -> None:
    page.goto(f"{served.url}/runs")
    page.evaluate("window.kept = true")
    before = page.locator(".card").count()
    bench = Bench(RecorderNode(RecorderConfig(recordings_dir=served.folder), WallClock()))
    world = room()
    bench.say(opening(world))
    running = page.locator(".card", has=page.locator(".badge.running"))
    expect(running).to_have_count(1, timeout=20_000.0)
    name = running.get_attribute("data-run")
    bench.say(driving(world, 1.0))
    bench.node.close()
    expect(running).to_have_count(0, timeout=20_000.0)
    expect(page.locator(".card")).to_have_count(before + 1)
    assert page.evaluate("window.kept")
    assert served.post(f"/runs/{name}/delete", {"confirm": name}).status == 200


def test_runs_open_in_the_viewer_one_after_the_other(served: Served, page: Page) -> None:
    first, second, *_ = RUNS
    page.goto(f"{served.url}/runs/{second}")
    page.evaluate("window.kept = true")
    page.get_by_role("button", name="Open in the viewer").click()
    viewer = page.locator("#viewer[data-recording]")
    expect(viewer).to_be_visible(timeout=1000.0 * _PATIENCE_S)
    opened = viewer.get_attribute("data-recording")
    wait_for_bricks(page)
    # It has not taken the keys: those of the page go on.
    assert page.evaluate("!document.querySelector('#viewer').contains(document.activeElement)")

    event = page.locator("button.seek").last
    time_s = event.get_attribute("data-time")
    event.click()
    marked = page.locator("#events tr[aria-current]")
    expect(marked).to_have_attribute("data-time", str(time_s))
    expect(page).to_have_url(re.compile(re.escape(f"?t={float(str(time_s)):g}")))

    page.keyboard.press("j")
    expect(page.locator("h1 ~ .mono")).to_have_text(first)
    expect(viewer).not_to_have_attribute(
        "data-recording", str(opened), timeout=1000.0 * _PATIENCE_S
    )
    assert page.evaluate("window.kept")
    wait_for_bricks(page)


def test_a_running_run_is_shown_as_it_is_recorded(tmp_path: Path, browser: Browser) -> None:
    data_port = free_port()
    config = RecorderConfig(
        recordings_dir=tmp_path,
        live=True,
        bind="127.0.0.1",
        web_port=free_port(),
        grpc_port=data_port,
    )
    world = room()
    bench = Bench(RecorderNode(config))
    bench.say(opening(world))
    bench.say(driving(world, 3.0))
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    context = browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme="dark")
    page = context.new_page()
    try:
        with console(tmp_path, live_data_port=data_port) as served:
            page.goto(f"{served.url}/runs/{folder.name}")
            page.get_by_role("button", name="Open in the viewer").click()
            viewer = page.locator(f'#viewer[data-recording="{folder.name}"]')
            expect(viewer).to_be_visible(timeout=1000.0 * _PATIENCE_S)
            wait_for_bricks(page)
            bench.node.close()
            head = page.locator("[data-part=head][data-state=ended]")
            expect(head).to_be_visible(timeout=20_000.0)
            wait_for_bricks(page)
    finally:
        context.close()
        bench.node.close()


def test_a_report_opens_and_runs_are_compared(served: Served, page: Page) -> None:
    first, second, *_ = RUNS
    page.goto(f"{served.url}/runs/{first}")
    expect(page.locator("[data-plot=plan] path.way.s0")).to_be_attached()
    page.locator("#report summary").click()
    expect(page.frame_locator("#report iframe").locator("body")).to_contain_text(first)

    page.goto(f"{served.url}/runs")
    for name in (first, second):
        page.locator(f'[data-run="{name}"] input[name=run]').check()
    page.get_by_role("button", name="Compare 2 runs").click()
    expect(page.locator("#legend li")).to_have_count(2)
    for which in ("s0", "s1"):
        expect(page.locator(f"[data-plot=plan] path.way.{which}")).to_be_attached()
        expect(page.locator(f"[data-plot=time] path.line.{which}").first).to_be_attached()
    page.get_by_text("Full output of mazebot diff").click()
    expect(page.locator(".verdict")).to_contain_text("continues for another")
    expect(page.get_by_role("row", name="simulated time")).to_be_visible()


def test_a_comparison_needs_two_runs(served: Served, page: Page) -> None:
    page.goto(f"{served.url}/runs")
    button = page.locator("#compare button")
    for count, text in enumerate(
        ("Choose runs to compare", "Choose one more run to compare", "Compare 2 runs")
    ):
        if count:
            page.locator(f'[data-run="{RUNS[count - 1]}"] input[name=run]').check()
        expect(button).to_have_text(text)
        expect(button).to_be_enabled(enabled=count == 2)


@pytest.mark.parametrize("width", [390, 700, 1024, 1440])
def test_cards_and_tables_show_all_their_text(tmp_path: Path, page: Page, width: int) -> None:
    name = "2026-01-01_10-00-00_a_world_with_a_rather_long_name"
    said = summary(1, sim_time_s=754.0, distance_m=133.9, world="a_world_with_a_rather_long_name")
    make_run(tmp_path, name, said)
    page.set_viewport_size({"width": width, "height": 900})
    cut = """(boxes) => boxes.filter((box) => box.scrollWidth > box.clientWidth)
      .map((box) => box.textContent)"""
    with console(tmp_path) as one:
        page.goto(f"{one.url}/runs")
        card = page.locator(".card .about")
        assert name in card.inner_text()
        assert "133.9 m" in card.inner_text()
        assert page.locator(".card, .card .about").evaluate_all(cut) == []
        page.goto(f"{one.url}/runs/{name}")
        goals = page.locator(".panel:has(#goals-title) .scroll")
        assert "location1" in goals.inner_text()
        assert goals.evaluate_all(cut) == []
        lines = """(cells) => cells.map((cell) => {
          const text = document.createRange();
          text.selectNodeContents(cell);
          return text.getClientRects().length;
        })"""
        assert set(page.locator(".goals td.number").evaluate_all(lines)) == {1}


def test_a_phone_needs_no_scrolling_sideways(served: Served, browser: Browser) -> None:
    first, second, *_ = RUNS
    context = browser.new_context(viewport={"width": 360, "height": 740})
    page = context.new_page()
    for path in ("/runs", f"/runs/{first}", f"/compare?run={first}&run={second}"):
        page.goto(served.url + path)
        page.wait_for_load_state("networkidle")
        assert page.evaluate("document.documentElement.scrollWidth") <= 360, path
    context.close()


def test_without_scripts_all_but_plots_and_viewer_works(served: Served, browser: Browser) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(f"{served.url}/runs")
    page.locator("[name=q]").fill("first")
    page.get_by_role("button", name="Show").click()
    expect(page.locator(".card")).to_have_count(1)
    page.locator(".card h2 a").click()
    page.locator("[name=note]").fill("by hand")
    page.get_by_role("button", name="Save").click()
    expect(page.locator("[name=note]")).to_have_value("by hand")
    context.close()


@pytest.mark.parametrize("lost", ["**/static/runs.js", "**/static/console.css"])
def test_a_page_of_which_a_part_did_not_come_is_loaded_again(
    served: Served, page: Page, lost: str
) -> None:
    # As a browser says where the machine's networks change meanwhile.
    page.route(lost, lambda route: route.abort("internetdisconnected"), times=2)
    loads: list[str] = []
    page.on("load", lambda _: loads.append(page.url))
    page.goto(f"{served.url}/runs")
    end_s = time.monotonic() + _PATIENCE_S
    while len(loads) < 3:
        assert time.monotonic() < end_s, loads
        page.wait_for_timeout(50.0)
    expect(page.get_by_role("alert")).to_have_count(0)
    # Whole at last, it stays.
    page.wait_for_timeout(1500.0)
    assert len(loads) == 3
    assert not page.evaluate("Object.keys(sessionStorage).some((key) => key.startsWith('loads'))")


def test_a_page_that_is_never_whole_says_what_did_not_load(served: Served, page: Page) -> None:
    page.route("**/static/runs.js", lambda route: route.abort("internetdisconnected"))
    loads: list[str] = []
    page.on("load", lambda _: loads.append(page.url))
    page.goto(f"{served.url}/runs")
    told = page.get_by_role("alert")
    told.wait_for(timeout=60_000.0)
    assert "/static/runs.js did not load" in told.inner_text()
    assert len(loads) <= 5
