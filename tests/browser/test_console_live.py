"""The live page in a real browser, beside a run: what a person does there happens to the robot."""

from __future__ import annotations

import contextlib
import json
import math
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from playwright.sync_api import expect

from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.client.reconnecting import ReconnectingRobot
from mazebot.console.config import ConsoleConfig
from mazebot.console.live.frame import binary_frame
from mazebot.console.live.routes import live_routes
from mazebot.console.server import build_app
from mazebot.console.serving import ConsoleServer
from tests.browser.viewer import CHROMIUM
from tests.console.live.running import Page as Bystander
from tests.console.runs import make_run

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page, WebSocketRoute

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
    pytest.mark.timeout(900),
]

DEADLINE_S = 60.0
START_S = 240.0
"""For a demo that may have to compile its kernels first."""
DRIVE_S = 60.0
"""Of simulation time, for a short drive."""
VIEWER_S = 150.0
"""For the viewer with a software renderer."""


@dataclass
class Opened:
    """The live page in a browser, and what went wrong in it."""

    page: Page
    wrong: list[str] = field(default_factory=list)

    def figure(self, name: str) -> list[float]:
        """The numbers of a figure beside the plan; none before it is shown."""
        term = self.page.locator("#figures dt", has_text=re.compile(f"^{name}$"))
        if term.count() == 0:
            return []
        shown = term.locator("xpath=following-sibling::dd[1]").inner_text()
        return [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", shown)]

    def pose(self) -> list[float]:
        """The true x and y, m, and heading, degrees."""
        self.wait(lambda: self.figure("true pose"))
        return self.figure("true pose")

    def wait(self, holds: Callable[[], Any], timeout_s: float = DEADLINE_S) -> None:
        """Return as soon as a condition holds."""
        end_s = time.monotonic() + timeout_s
        while not holds():
            assert time.monotonic() < end_s, self.page.locator("body").inner_text()
            self.page.wait_for_timeout(50)

    def time_s(self) -> float:
        """Simulation time."""
        return float(self.page.locator("#time").inner_text().split()[0])

    def wait_simulated(self, holds: Callable[[], Any], within_s: float) -> None:
        """The same with a limit of simulation time: on a busy machine the robot is slower, too."""
        end_s = self.time_s() + within_s
        while not holds():
            assert self.time_s() < end_s, self.page.locator("body").inner_text()
            self.page.wait_for_timeout(50)

    def said(self) -> str:
        """The last answer of the services."""
        self.wait(lambda: self.page.locator("#message").inner_text() not in ("", "…"))
        return self.page.locator("#message").inner_text()

    def pixel(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Where a place of the map is on the screen, from the place of two clicks."""
        found: list[float] = self.page.locator("#plan").evaluate(
            "(canvas, place) => canvas.pixelOf(...place)", [x_m, y_m]
        )
        return found[0], found[1]


@contextlib.contextmanager
def demo(folder: Path, *options: str) -> Iterator[str]:
    """The address of the console of `mazebot demo --console`."""
    output = folder / "output.txt"
    with output.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "mazebot.cli", "demo", "--console", "--console-port", "0",
             "--router-port", "0", "--no-tour", "--no-camera", "--out", str(folder / "run"),
             *options],
            stdout=file, stderr=subprocess.STDOUT,
        )  # fmt: skip
    try:
        yield address_in(output, process)
    finally:
        process.send_signal(signal.SIGINT)
        code = process.wait(30.0)
    said = output.read_text()
    assert code == 0, said
    assert "Traceback" not in said


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with demo(tmp_path_factory.mktemp("console"), "--no-record") as address:
        yield address


def address_in(output: Path, process: subprocess.Popen[bytes]) -> str:
    end_s = time.monotonic() + START_S
    while True:
        found = re.search(r"console: (http://\S+)", output.read_text())
        if found:
            return found[1].rstrip("/")
        assert process.poll() is None, output.read_text()
        assert time.monotonic() < end_s, output.read_text()
        time.sleep(0.1)


def opened_in(context: BrowserContext, url: str) -> Opened:
    opened = Opened(context.new_page())
    page, wrong = opened.page, opened.wrong
    page.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on(
        "request",
        lambda asked: None if asked.url.startswith((url, "blob:")) else wrong.append(asked.url),
    )
    page.goto(f"{url}/live")
    return opened


@pytest.fixture
def live(browser: Browser, url: str) -> Iterator[Opened]:
    # Each test begins where the run began, not where the test before has driven to.
    with Bystander(url) as bystander:
        epoch = bystander.wait_kind("stats")["epoch"]
        bystander.done(do="emergency_stop", stop=False)
        bystander.done(do="simulation", reset="all", pause=False, speed=1.0)
        bystander.wait_for(lambda: bystander.newest["stats"]["epoch"] > epoch)
        bystander.wait_for(lambda: "restarted" in bystander.newest)
    context = browser.new_context(viewport={"width": 1300, "height": 900})
    opened = opened_in(context, url)
    # With what the page says where it does not come.
    opened.wait(lambda: opened.page.locator("#task-state.good").count())
    # The time comes with the pose.
    opened.pose()
    yield opened
    context.close()
    assert opened.wrong == []


def test_a_goal_clicked_on_the_plan_is_reached(live: Opened) -> None:
    x, y, _ = live.pose()
    page = live.page
    before = page.locator("#results .good").count()
    page.get_by_label("Speed").select_option("4")
    page.get_by_role("button", name="Goal").click()
    # Where there is room for every heading.
    from_px = live.pixel(x - 0.55, y - 0.45)
    page.mouse.move(*from_px)
    page.mouse.down()
    page.mouse.move(from_px[0] + 60, from_px[1], steps=3)
    page.mouse.up()
    assert live.said().startswith("driving to")
    live.wait_simulated(lambda: page.locator("#results .good").count() > before, DRIVE_S)
    assert "done" in page.locator("#results .good").last.inner_text()
    reached = live.pose()
    assert math.dist(reached[:2], (x - 0.55, y - 0.45)) < 0.3
    assert abs(reached[2]) < 20.0
    page.get_by_label("Speed").select_option("1")
    live.wait(lambda: page.locator("#message").inner_text().startswith("running at 1x"))


def test_a_box_dropped_stands_in_the_world_and_is_removed(live: Opened, url: str) -> None:
    x, y, _ = live.pose()
    page = live.page
    place = live.pixel(x - 0.8, y + 0.4)
    page.get_by_role("button", name="Box").click()
    page.mouse.click(*place)
    name = live.said().split()[0]
    assert re.fullmatch(r"box(_\d+)?", name)
    with Bystander(url) as bystander:
        # What physics says that there is.
        bodies = bystander.wait_for(lambda: bystander.newest.get("entities", {}).get("bodies"))
        assert math.dist(bodies[0]["pose"][:2], (x - 0.8, y + 0.4)) < 0.02
        # Into a wall physics lets none, and the page says why.
        corners = bystander.wait_kind("world")["walls"][0]
    middle = [sum(corner[axis] for corner in corners) / 4 for axis in (0, 1)]
    page.get_by_role("button", name="Box").click()
    page.locator("#message").evaluate("one => { one.textContent = ''; }")
    page.mouse.click(*live.pixel(*middle))
    assert "penetrates" in live.said()
    assert page.locator("#message.bad").count() == 1
    page.get_by_role("button", name="Remove").click()
    page.locator("#message").evaluate("one => { one.textContent = ''; }")
    page.mouse.click(*place)
    assert live.said() == f"{name} removed"


def turned(live: Opened, since_deg: float) -> float:
    return abs((live.pose()[2] - since_deg + 180.0) % 360.0 - 180.0)


def stands(live: Opened) -> bool:
    speed = live.figure("speed")
    return len(speed) == 2 and max(map(abs, speed)) < 0.02


def test_a_held_key_drives_and_the_robot_stops_when_it_is_released(live: Opened) -> None:
    before_deg = live.pose()[2]
    live.page.keyboard.down("a")
    live.wait_simulated(lambda: turned(live, before_deg) > 15.0, DRIVE_S)
    live.page.keyboard.up("a")
    live.wait_simulated(lambda: stands(live), 5.0)
    at_deg = live.pose()[2]
    live.page.wait_for_timeout(500)
    assert turned(live, at_deg) <= 2.0


def test_the_joystick_drives_while_it_is_held(live: Opened) -> None:
    before_deg = live.pose()[2]
    box = live.page.locator("#joystick").bounding_box()
    assert box is not None
    live.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    live.page.mouse.down()
    live.page.mouse.move(box["x"] + box["width"] - 4, box["y"] + box["height"] / 2, steps=4)
    live.wait_simulated(lambda: turned(live, before_deg) > 15.0, DRIVE_S)
    live.page.mouse.up()
    live.wait_simulated(lambda: stands(live), 5.0)


def test_the_robot_stops_when_the_page_is_closed(live: Opened, browser: Browser, url: str) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True)
    driver = opened_in(context, url)
    driver.page.wait_for_selector("#task-state.good", timeout=1000 * DEADLINE_S)
    before_deg = live.pose()[2]
    driver.page.keyboard.down("ArrowLeft")
    live.wait_simulated(lambda: turned(live, before_deg) > 15.0, DRIVE_S)
    context.close()
    live.wait_simulated(lambda: stands(live), 5.0)
    assert driver.wrong == []


def test_on_a_phone_a_goal_is_tapped_and_canceled(live: Opened, browser: Browser, url: str) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True)
    phone = opened_in(context, url)
    phone.page.wait_for_selector("#task-state.good", timeout=1000 * DEADLINE_S)
    phone.page.get_by_role("button", name="Goal").tap()
    # Where the world has room, whatever stands beside the robot by now.
    phone.page.touchscreen.tap(*phone.pixel(-0.95, 1.0))
    assert phone.said().startswith("driving to")
    phone.page.get_by_role("button", name="Cancel").tap()
    live.wait(lambda: "canceled" in live.page.locator("#results").inner_text())
    live.wait(lambda: stands(live), 5.0)
    wide = phone.page.evaluate("document.documentElement.scrollWidth")
    assert wide <= 390
    context.close()
    assert phone.wrong == []


def test_time_is_paused_and_stepped(live: Opened) -> None:
    page = live.page
    page.get_by_role("button", name="Pause", exact=True).click()
    page.get_by_role("button", name="Resume", exact=True).wait_for()
    page.get_by_role("button", name="Step").click()
    live.wait(lambda: page.locator("#message").inner_text().startswith("paused at"))
    page.get_by_role("button", name="Resume", exact=True).click()
    page.get_by_role("button", name="Pause", exact=True).wait_for()


@contextlib.contextmanager
def lonely_console(folder: Path) -> Iterator[str]:
    """The address of a console that finds no stack: nothing listens on port 1."""
    robot = ReconnectingRobot(lambda: ZenohRobot("tcp/127.0.0.1:1"))
    config = ConsoleConfig(port=0, recordings_dir=folder)
    server = ConsoleServer(build_app(config, live_routes(robot)), config)
    server.start()
    try:
        yield server.url
    finally:
        server.stop()
        robot.close()


def test_a_page_without_a_stack_says_so_and_how_to_start_one(
    browser: Browser, tmp_path: Path
) -> None:
    with lonely_console(tmp_path) as url:
        context = browser.new_context()
        opened = opened_in(context, url.rstrip("/"))
        opened.page.get_by_role("heading", name="No stack is running").wait_for()
        assert "docker compose up" in opened.page.locator("#how-to-start").inner_text()
        assert opened.page.locator("#live").is_hidden()
        assert opened.wrong == []
        # One comes, with a service that is not well and a run whose files come later.
        values = {"waiting_for": "", "rejected scan: old epoch": "4", "rate_hz scan": "10.00"}
        status = {"name": "navigation", "level": 1, "message": "active", "values": values}
        error = {"mean": None, "max": None}
        frames = {
            "stack": {"services": ["navigation"], "how_to_start": ""},
            "service navigation": status,
            "evaluation": {"recording": "runs/late", "goals": [], "localisation_error_m": error,
                           "contacts": [], "markers_seen": {}, "mapping": None},
        }  # fmt: skip

        def stand_in(socket: WebSocketRoute) -> None:
            for kind, content in frames.items():
                socket.send(json.dumps({"kind": kind, "content": content}))

        opened.page.route_web_socket("**/live/feed", stand_in)
        opened.page.reload()
        service = opened.page.locator("#services .waits")
        service.wait_for()
        assert service.inner_text().split("\n")[-1] == "active; rejected scan: old epoch (4)"
        opened.page.get_by_role("button", name="3D view").click()
        told = opened.page.locator("#rerun p")
        opened.wait(lambda: told.inner_text().startswith("late: no recording"))
        make_run(tmp_path, "late")
        opened.wait(lambda: not told.inner_text().startswith("late"), 20.0)
        context.close()


def test_the_3d_view_follows_the_run_goes_back_in_time_and_opens_the_next_run(
    browser: Browser, tmp_path: Path
) -> None:
    context = browser.new_context(viewport={"width": 1300, "height": 900})
    with demo(tmp_path) as url:
        opened = opened_in(context, url)
        page = opened.page
        page.set_default_timeout(1000 * VIEWER_S)
        page.wait_for_selector("#task-state.good", timeout=1000 * DEADLINE_S)
        page.get_by_role("button", name="3D view").click()
        page.locator("#rerun[data-recording=run]").wait_for(timeout=1000 * VIEWER_S)

        def shown_s() -> float:
            return float(page.locator("#rerun").get_attribute("data-time") or 0.0)

        # The keys are the page's: the viewer has not taken the focus.
        page.keyboard.press("f")
        expect(page.locator("#follow")).to_have_attribute("aria-pressed", "true")
        page.keyboard.press("f")
        # It shows what is recorded after it was opened.
        at_s = opened.time_s()
        opened.wait(lambda: shown_s() > at_s + 1.0, VIEWER_S)

        back = page.locator("#log .seek").first
        back.click()
        time_s = float(str(back.get_attribute("data-time")))
        opened.wait(lambda: abs(shown_s() - time_s) < 0.01, VIEWER_S)
        page.wait_for_timeout(1500)
        assert abs(shown_s() - time_s) < 0.01
        page.get_by_role("button", name="Follow the run").click()
        at_s = opened.time_s()
        opened.wait(lambda: shown_s() > at_s, VIEWER_S)

        # Keys in the viewer move its camera, and not the robot.
        page.locator("#rerun canvas").click(position={"x": 150, "y": 120})
        before_deg = opened.pose()[2]
        page.keyboard.down("a")
        page.wait_for_timeout(1000)
        page.keyboard.up("a")
        assert turned(opened, before_deg) <= 1.0

        page.evaluate("window.kept = true")
        page.on("dialog", lambda dialog: dialog.accept())
        page.get_by_role("button", name="Reset").click()
        page.locator("#rerun[data-recording=run_2]").wait_for(timeout=1000 * VIEWER_S)
        assert page.evaluate("window.kept")
        expect(back).to_be_disabled()
        page.locator("#figures").get_by_role("link", name="run_2").click()
        page.locator("[data-part=head][data-run=run_2][data-state=running]").wait_for()
        context.close()
    # The viewer would like to know whether there is a newer one: the policy refuses it.
    assert [one for one in opened.wrong if not re.search("github|Failed to fetch", one)] == []


def test_a_click_on_a_time_shows_it_in_the_3d_view(browser: Browser, tmp_path: Path) -> None:
    context = browser.new_context(viewport={"width": 1300, "height": 900})
    with demo(tmp_path) as url:
        opened = opened_in(context, url)
        page = opened.page
        page.set_default_timeout(1000 * VIEWER_S)
        page.wait_for_selector("#task-state.good", timeout=1000 * DEADLINE_S)
        page.locator("#log .seek").first.click()
        page.locator("#rerun[data-recording=run]").wait_for(timeout=1000 * VIEWER_S)
        time_s = float(str(page.locator("#log .seek").first.get_attribute("data-time")))
        shown = page.locator("#rerun")
        opened.wait(
            lambda: abs(float(shown.get_attribute("data-time") or "inf") - time_s) < 0.01, VIEWER_S
        )
        page.get_by_role("button", name="3D view", pressed=True).click()
        expect(shown).to_be_hidden()
        context.close()


def test_a_goal_where_the_robot_stands_keeps_its_heading(live: Opened) -> None:
    page = live.page
    before_deg = live.pose()[2]
    page.keyboard.down("d")
    live.wait_simulated(lambda: turned(live, before_deg) > 60.0, DRIVE_S)
    page.keyboard.up("d")
    live.wait_simulated(lambda: stands(live), 5.0)
    x, y, before_deg = live.pose()
    results = page.locator("#results .good").count()
    page.get_by_role("button", name="Goal").click()
    page.mouse.click(*live.pixel(x, y))
    assert live.said().startswith("driving to")
    live.wait_simulated(lambda: page.locator("#results .good").count() > results, DRIVE_S)
    assert turned(live, before_deg) < 20.0


def test_the_joystick_is_in_no_tool_s_way(live: Opened) -> None:
    page = live.page

    def hit() -> str:
        """What a click in the middle of the joystick would reach."""
        found: str = page.locator("#joystick").evaluate(
            """(one) => {
              const box = one.getBoundingClientRect();
              return document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2).id;
            }"""
        )
        return found

    live.wait(lambda: hit() == "joystick")
    page.keyboard.press("g")
    live.wait(lambda: hit() == "plan")
    page.keyboard.press("Escape")
    live.wait(lambda: hit() == "joystick")


def test_every_tool_aims_by_keys(live: Opened) -> None:
    page = live.page

    def answer() -> str:
        said = live.said()
        page.locator("#message").evaluate("one => { one.textContent = ''; }")
        return said

    x, y, before_deg = live.pose()
    page.get_by_role("button", name="Box").press("Enter")
    for key in (*(6 * ["ArrowLeft"]), *(5 * ["Shift+ArrowDown"]), "Enter"):
        page.keyboard.press(key)
    said = answer()
    match = re.fullmatch(r"(box\S*) spawned at \((\S+), (\S+)\)", said)
    assert match, said
    assert math.dist((float(match[2]), float(match[3])), (x - 0.6, y - 0.1)) < 0.03
    # Arrows have not driven the robot.
    assert turned(live, before_deg) < 2.0

    page.get_by_role("button", name="Remove").press("Enter")
    for key in (*(6 * ["ArrowLeft"]), "Enter"):
        page.keyboard.press(key)
    assert answer() == f"{match[1]} removed"

    page.get_by_role("button", name="Waypoints").press("Enter")
    for key in ("ArrowDown", "Enter", "ArrowDown", ",", "Enter"):
        page.keyboard.press(key)
    expect(page.locator("#waypoint-count")).to_have_text("2 waypoints")

    page.keyboard.press("p")
    for key in (*(6 * [","]), "Enter", "Enter"):
        page.keyboard.press(key)
    assert answer().startswith("initial pose")
    # It believes now to look to the left of the map.
    live.wait_simulated(lambda: abs(live.figure("estimate")[2] - 90.0) < 30.0, 10.0)
    page.keyboard.press("p")
    for key in ("ArrowUp", "ArrowDown", "Enter"):
        page.keyboard.press(key)


def test_keys_aim_from_the_newest_pose_though_it_is_not_drawn_yet(
    browser: Browser, tmp_path: Path
) -> None:
    context = browser.new_context(viewport={"width": 1300, "height": 900})
    asked: list[dict[str, Any]] = []

    def stand_in(socket: WebSocketRoute) -> None:
        def take(text: str | bytes) -> None:
            asked.append(json.loads(text)["action"])
            if asked[-1]["do"] == "show":
                for number, at in enumerate(((0.0, 0.0, 0.0), (0.5, 0.25, 0.0))):
                    pose = {"time_s": number, "truth": at, "estimate": None}
                    socket.send(json.dumps({"kind": "pose", "content": pose}))

        socket.on_message(take)
        stack = {"services": ["physics"], "how_to_start": ""}
        socket.send(json.dumps({"kind": "stack", "content": stack}))

    with lonely_console(tmp_path) as url:
        opened = Opened(context.new_page())
        page = opened.page
        page.add_init_script("window.requestAnimationFrame = () => 0;")
        page.route_web_socket("**/live/feed", stand_in)
        page.goto(f"{url}live")
        opened.wait(lambda: opened.figure("true pose")[:1] == [0.5])
        page.keyboard.press("p")
        for key in ("ArrowLeft", "Enter"):
            page.keyboard.press(key)
        opened.wait(lambda: asked[-1]["do"] == "initial_pose")
        assert asked[-1]["pose"] == {
            "x_m": pytest.approx(0.4), "y_m": pytest.approx(0.25), "yaw_rad": pytest.approx(0.0)
        }  # fmt: skip
        context.close()


def test_waypoints_are_shown_until_they_are_reached_or_canceled(live: Opened) -> None:
    page = live.page
    x, y, _ = live.pose()
    far = (x - 0.8, y + 0.3)

    def goals_drawn() -> int:
        """Pixels in the colour of goals where the last waypoint is."""
        px, py = live.pixel(*far)
        drawn: int = page.locator("#plan").evaluate(
            """(canvas, [x, y]) => {
              const box = canvas.getBoundingClientRect();
              const ratio = canvas.width / box.width;
              const at = [(x - box.left) * ratio - 8, (y - box.top) * ratio - 8, 16, 16];
              const { data } = canvas.getContext("2d").getImageData(...at);
              let count = 0;
              for (let i = 0; i < data.length; i += 4) {
                count += data[i] < 40 && data[i + 1] > 60 && data[i + 1] < 120 && data[i + 2] > 170;
              }
              return count;
            }""",
            [px, py],
        )
        return drawn

    page.get_by_role("button", name="Waypoints").click()
    for place in ((x - 0.8, y - 0.3), far):
        page.mouse.click(*live.pixel(*place))
    page.get_by_role("button", name="Go, stop at each").click()
    assert live.said() == "driving to 2 waypoints"
    live.wait(lambda: goals_drawn() > 10)
    page.get_by_role("button", name="Cancel").click()
    live.wait(lambda: goals_drawn() == 0)


def test_missed_waypoints_are_told(live: Opened, url: str) -> None:
    page = live.page
    with Bystander(url) as bystander:
        corners = bystander.wait_kind("world")["walls"][0]
    wall = [sum(corner[axis] for corner in corners) / 4 for axis in (0, 1)]
    results = page.locator("#results li").count()
    page.get_by_role("button", name="Waypoints").click()
    page.mouse.click(*live.pixel(*wall))
    page.mouse.click(*live.pixel(*wall))
    page.get_by_role("button", name="Go, stop at each").click()
    assert live.said() == "driving to 2 waypoints"
    live.wait(lambda: page.locator("#results li").count() >= results + 3)
    said = page.locator("#results li").all_inner_texts()[results:]
    assert "done, 2 missed" in said[0]
    assert said[1].startswith("waypoint 1 missed: ")
    assert said[2].startswith("waypoint 2 missed: ")
    assert page.locator("#results li.bad").count() >= 3


def drawn(page: Page, place: tuple[float, float], half_px: int = 2) -> list[list[int]]:
    """The colours of the plan around a place of the screen."""
    found: list[list[int]] = page.locator("#plan").evaluate(
        """(canvas, [x, y, half]) => {
          const box = canvas.getBoundingClientRect();
          const ratio = canvas.width / box.width;
          const side = Math.round(2 * half * ratio);
          const left = (x - box.left - half) * ratio;
          const top = (y - box.top - half) * ratio;
          const { data } = canvas.getContext("2d").getImageData(left, top, side, side);
          return Array.from({ length: side * side }, (_, i) => [...data.slice(4 * i, 4 * i + 3)]);
        }""",
        [*place, half_px],
    )
    return found


def layer(page: Page, key: str) -> Any:
    page.locator(".layers").evaluate("one => { one.open = true; }")
    return page.locator(f"[data-layer={key}]")


def middle_of(corners: list[list[float]]) -> tuple[float, float]:
    x, y = (sum(corner[axis] for corner in corners) / len(corners) for axis in (0, 1))
    return x, y


def test_the_plan_stays_where_it_is_whatever_comes_and_goes(live: Opened) -> None:
    page = live.page
    plan = page.locator("#plan")
    before = plan.bounding_box()
    for tool in ("Goal", "Waypoints", "Box", "Measure"):
        page.get_by_role("button", name=tool).click()
        page.locator("#hint").wait_for()
        assert plan.bounding_box() == before, tool
    for text in ("", "one line", 40 * "a reason in many words, "):
        page.locator("#message").evaluate("(one, text) => { one.textContent = text; }", text)
        assert plan.bounding_box() == before, text


def test_the_3d_view_and_the_plots_lie_beside_the_plan(live: Opened) -> None:
    page = live.page
    page.set_viewport_size({"width": 1440, "height": 900})
    plan, rerun, plots = (page.locator(f"#{name}") for name in ("plan", "rerun", "plots-view"))
    stage = page.locator(".stage").bounding_box()
    page.get_by_role("button", name="Plots").click()
    live.wait(lambda: plots.locator("figure path.line").count() >= 4)
    for title in ("localisation error, mm", "speed, m/s"):
        expect(plots.get_by_text(title)).to_be_visible()
    expect(plan).to_be_hidden()
    page.get_by_role("button", name="3D view").click()
    expect(rerun).to_be_visible()
    expect(plan).to_be_hidden()
    expect(plots).to_be_hidden()
    # It looks for a file, and that there is none is no error.
    live.wait(lambda: "no recording" in rerun.inner_text())
    box = rerun.bounding_box()
    assert box is not None
    assert box["y"] + box["height"] <= 900
    # A tool is one of the plan.
    page.keyboard.press("g")
    expect(plan).to_be_visible()
    expect(rerun).to_be_hidden()
    assert page.locator(".stage").bounding_box() == stage


def test_the_place_under_the_pointer_and_its_cost_are_told(live: Opened, url: str) -> None:
    page = live.page
    x, y, _ = live.pose()
    readout = page.locator("#readout")
    page.mouse.move(*live.pixel(x, y))
    # The costmap may come after the pointer.
    free = re.compile(r"(-?[\d.]+), (-?[\d.]+) m · free")
    expect(readout).to_have_text(free)
    told = free.match(readout.inner_text())
    assert told, readout.inner_text()
    assert math.dist((float(told[1]), float(told[2])), (x, y)) < 0.03
    with Bystander(url) as bystander:
        wall = middle_of(bystander.wait_kind("world")["walls"][0])
        bystander.wait_kind("global_costmap")
    page.mouse.move(*live.pixel(*wall))
    live.wait(lambda: "occupied · cost 100 (lethal)" in readout.inner_text())
    page.mouse.move(5, 5)
    expect(readout).to_be_hidden()


def test_the_distance_between_two_places_is_measured(live: Opened) -> None:
    page = live.page
    page.keyboard.press("m")
    page.mouse.click(*live.pixel(0.0, 0.0))
    page.mouse.click(*live.pixel(0.9, -1.2))
    length_m = float(live.said().split()[0])
    assert length_m == pytest.approx(1.5, abs=0.03)
    # By keys, too: from where the robot is, 0.5 m to the right.
    page.locator("#message").evaluate("one => { one.textContent = ''; }")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    for key in (*(5 * ["ArrowRight"]), "Enter"):
        page.keyboard.press(key)
    assert live.said().startswith("0.500 m")


def test_a_box_is_placed_in_the_size_that_is_asked_for(live: Opened, url: str) -> None:
    page = live.page
    x, y, _ = live.pose()
    page.get_by_role("button", name="Box").click()
    for side, value in (("length", "0.2"), ("width", "0.1"), ("height", "0.5")):
        page.locator(f"#box-{side}").fill(value)
    page.mouse.click(*live.pixel(x - 0.8, y + 0.4))
    name = live.said().split()[0]
    with Bystander(url) as bystander:
        bodies = bystander.wait_for(lambda: bystander.newest.get("entities", {}).get("bodies"))
        (box,) = (body for body in bodies if body["name"] == name)
        corners = box["polygons_m"][0]
        for axis, size_m in ((0, 0.2), (1, 0.1)):
            values = [corner[axis] for corner in corners]
            assert max(values) - min(values) == pytest.approx(size_m, abs=0.01)
        # What is no size is refused before it is asked for.
        page.get_by_role("button", name="Box").click()
        page.locator("#box-length").fill("0")
        page.mouse.click(*live.pixel(x - 0.8, y - 0.4))
        expect(page.locator("#message.bad")).to_have_text(re.compile("^length m: "))
        page.keyboard.press("Escape")
        page.get_by_role("button", name="Remove").click()
        page.mouse.click(*live.pixel(x - 0.8, y + 0.4))
        bystander.wait_for(lambda: not bystander.newest["entities"]["bodies"])


def test_layers_are_as_opaque_as_is_asked_for(live: Opened) -> None:
    page = live.page
    x, y, _ = live.pose()
    free = live.pixel(x - 0.6, y + 0.9)
    live.wait(lambda: drawn(page, free)[0] == [255, 255, 255])
    layer(page, "map")
    page.get_by_label("Opacity of Map").fill("50")
    live.wait(lambda: drawn(page, free)[0] != [255, 255, 255])
    page.get_by_label("Opacity of Map").fill("100")
    live.wait(lambda: drawn(page, free)[0] == [255, 255, 255])


def test_walls_are_drawn_once(live: Opened, url: str) -> None:
    page = live.page
    with Bystander(url) as bystander:
        wall = middle_of(bystander.wait_kind("world")["walls"][0])
    place = live.pixel(*wall)

    def black() -> int:
        """Pixels in the colour of the map's occupied cells."""
        return sum(max(color) < 8 for color in drawn(page, place, half_px=30))

    layer(page, "names").uncheck()
    live.wait(lambda: black() == 0)
    layer(page, "map").uncheck()
    layer(page, "map").check()
    assert black() == 0
    layer(page, "names").check()


def test_what_changes_seldom_is_not_drawn_again(live: Opened) -> None:
    page = live.page
    page.get_by_role("button", name="Pause", exact=True).click()
    page.get_by_role("button", name="Resume", exact=True).wait_for()
    page.get_by_role("button", name="Box").click()
    page.evaluate(
        """() => {
          window.count = { plan: 0, others: 0 };
          const { prototype } = CanvasRenderingContext2D;
          for (const name of ["fill", "drawImage"]) {
            const draw = prototype[name];
            prototype[name] = function (...given) {
              window.count[this.canvas.id === "plan" ? "plan" : "others"] += 1;
              return draw.apply(this, given);
            };
          }
        }"""
    )
    move = """async () => {
          window.count = { plan: 0, others: 0 };
          const plan = document.getElementById("plan");
          for (let picture = 0; picture < 20; picture += 1) {
            const at = { clientX: 300 + picture, clientY: 400 };
            plan.dispatchEvent(new PointerEvent("pointermove", at));
            await new Promise((resolve) => requestAnimationFrame(resolve));
          }
          return window.count;
        }"""

    def drawn_by_moves() -> bool:
        """Whether the plan alone is drawn again: what was under way at the pause comes first."""
        count = page.evaluate(move)
        assert count["plan"] >= 15
        return bool(count["others"] == 0)

    live.wait(drawn_by_moves)
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Resume", exact=True).click()


def test_buttons_that_cannot_act_are_off(live: Opened) -> None:
    page = live.page
    x, y, _ = live.pose()
    cancel, pause, resume = (
        page.get_by_role("button", name=name) for name in ("Cancel", "Pause task", "Resume task")
    )
    for button in (cancel, pause, resume):
        expect(button).to_be_disabled()
    expect(page.get_by_role("button", name="Drive there")).to_be_enabled()
    page.get_by_role("button", name="Goal").click()
    page.mouse.click(*live.pixel(x - 0.9, y + 0.6))
    live.wait(cancel.is_enabled)
    assert resume.is_disabled()
    pause.click()
    live.wait(lambda: resume.is_enabled() and pause.is_disabled())
    cancel.click()
    live.wait(lambda: all(button.is_disabled() for button in (cancel, pause, resume)))


def test_the_robot_is_stopped_and_held_until_it_is_cleared(live: Opened) -> None:
    page = live.page
    x, y, _ = live.pose()
    page.get_by_role("button", name="Goal").click()
    page.mouse.click(*live.pixel(x - 0.9, y + 0.6))
    live.wait(lambda: live.figure("speed")[0] > 0.1)
    page.get_by_role("button", name="Stop", exact=True).click()
    clear = page.get_by_role("button", name="Clear stop")
    expect(clear).to_be_visible()
    causes = page.locator("#stop-causes")
    expect(causes).to_have_text("hold: emergency stop: Stop in the console; cleared by Clear stop")
    expect(page.locator("#stop-level")).to_have_text("hold")
    live.wait(lambda: live.figure("speed") == [0.0, 0.0])
    at = live.pose()
    since_s = live.time_s()
    live.wait(lambda: live.time_s() > since_s + 3.0)
    assert live.pose() == at
    # Another page finds it so.
    page.reload()
    expect(clear).to_be_visible()
    clear.click()
    expect(page.get_by_role("button", name="Stop", exact=True)).to_be_visible()
    live.wait(lambda: live.figure("speed")[0] > 0.1)
    expect(causes).to_be_empty()
    page.get_by_role("button", name="Cancel").click()


def test_a_page_that_is_loaded_again_shows_what_it_showed(live: Opened) -> None:
    page = live.page
    page.get_by_role("button", name="Spin").click()
    live.wait(lambda: page.locator("#results li").count())
    live.wait(lambda: page.locator("#log li").count())
    results = page.locator("#results li").all_inner_texts()
    log = page.locator("#log li").all_inner_texts()
    page.reload()
    page.wait_for_selector("#task-state.good", timeout=1000 * DEADLINE_S)
    live.wait(lambda: page.locator("#log li").count() >= len(log))
    live.wait(lambda: page.locator("#results li").all_inner_texts()[: len(results)] == results)
    assert page.locator("#log li").all_inner_texts()[: len(log)] == log


def test_a_phone_shows_the_tools_in_two_rows_and_the_map_with_the_joystick(
    live: Opened, browser: Browser, url: str
) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True)
    phone = opened_in(context, url)
    page = phone.page
    page.wait_for_selector("#task-state.good", timeout=1000 * DEADLINE_S)
    boxes = [one.bounding_box() for one in page.locator(".tools :is(button, .button)").all()]
    assert len({round(box["y"]) for box in boxes if box}) == 2
    for name in ("plan", "joystick"):
        box = page.locator(f"#{name}").bounding_box()
        assert box is not None
        assert box["y"] >= 0
        assert box["y"] + box["height"] <= 844
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    context.close()
    assert phone.wrong == []


def test_the_camera_is_seen_without_scrolling_with_the_outlines_of_markers(
    browser: Browser, tmp_path: Path
) -> None:
    context = browser.new_context(viewport={"width": 1440, "height": 900})
    _, jpeg = cv2.imencode(".jpg", np.full((360, 480, 3), 200, np.uint8))
    corners = [[0.25, 0.25], [0.5, 0.25], [0.5, 0.5], [0.25, 0.5]]
    found = {"time_s": 1.0, "ids": ["60"], "outlines": [{"id": "60", "corners": corners}]}

    def stand_in(socket: WebSocketRoute) -> None:
        for kind, content in (
            ("stack", {"services": ["perception"], "how_to_start": ""}), ("detections", found)
        ):  # fmt: skip
            socket.send(json.dumps({"kind": kind, "content": content}))
        picture = binary_frame("camera", {"time_s": 1.0}, jpeg.tobytes()).content
        socket.send(picture)

    with lonely_console(tmp_path) as url:
        page = context.new_page()
        page.route_web_socket("**/live/feed", stand_in)
        page.goto(f"{url}live")
        outline = page.locator("#camera-panel polygon")
        outline.wait_for(state="attached")
        expect(page.locator("#camera")).to_have_js_property("naturalWidth", 480)
        picture, marker = page.locator("#camera").bounding_box(), outline.bounding_box()
        assert picture is not None
        assert marker is not None
        assert picture["y"] + picture["height"] <= 900
        middle = marker["x"] + marker["width"] / 2, marker["y"] + marker["height"] / 2
        wanted = (
            picture["x"] + 0.375 * picture["width"],
            picture["y"] + 0.375 * picture["height"],
        )
        assert math.dist(middle, wanted) < 3
        # With its line.
        assert marker["width"] == pytest.approx(picture["width"] / 4, abs=10)
        assert page.locator("#camera-panel text").text_content() == "60"
        context.close()
