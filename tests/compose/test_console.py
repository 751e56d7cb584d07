"""`docker compose up console`: alone with the runs that are there, and beside a demo."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from collections.abc import Iterator
from typing import Any

import pytest

from tests.compose.checks import is_active
from tests.compose.stack import DEMOS, SERVICES, Stack, stack_of, wait_until
from tests.console.live.running import Page

pytestmark = [pytest.mark.compose, pytest.mark.usefixtures("image")]

DEMO = DEMOS["enhanced"]


def url_of(stack: Stack) -> str:
    return f"http://127.0.0.1:{stack.console_port}"


def ask(stack: Stack, path: str, fields: dict[str, Any] | None = None) -> Any:
    """The JSON of an answer; None while the console is not there."""
    data = None if fields is None else json.dumps(fields).encode()
    headers = {"Content-Type": "application/json", "Accept": "application/json"}
    request = urllib.request.Request(url_of(stack) + path, data, headers)
    try:
        with urllib.request.urlopen(request, timeout=5) as answer:
            return json.load(answer)
    except (urllib.error.URLError, ConnectionError):
        return None


def names(stack: Stack) -> list[str]:
    """The runs that the gallery shows."""
    answer = ask(stack, "/runs.json")
    return [card["name"] for card in answer["cards"]] if answer else []


@pytest.fixture(scope="module")
def beside(person: int) -> Iterator[tuple[Stack, Page]]:
    """A tour with a console beside it, and the page /live of it."""
    with stack_of(person) as stack:
        for stanza in (DEMO, "console"):
            started = stack.compose("up", "--detach", stanza)
            assert started.returncode == 0, started.stdout
        wait_until(lambda: bool(names(stack)), 60.0, "a run in the gallery")
        with Page(url_of(stack)) as page:
            page.wait_for(lambda: is_active(stack, DEMO))
            yield stack, page


def test_a_page_sees_the_robot_and_every_service(beside: tuple[Stack, Page]) -> None:
    _, page = beside
    assert page.wait_kind("world")["name"] == "sim_house_enhanced"
    page.wait_for(lambda: page.newest.get("pose", {}).get("estimate"))
    told = {f"service {name}" for name in SERVICES if name != "router"}
    page.wait_for(lambda: told <= page.newest.keys())
    page.tell(do="show", camera=True)
    for kind in ("map", "scan", "global_costmap", "camera"):
        page.wait_kind(kind)


def test_what_the_page_sends_reaches_the_services(beside: tuple[Stack, Page]) -> None:
    _, page = beside
    box = page.done(do="drop_box", pose={"x_m": 3.0, "y_m": -3.0}).split()[0]
    page.wait_for(lambda: box in [one["name"] for one in page.newest["entities"]["bodies"]])
    assert page.done(do="remove", name=box) == f"{box} removed"
    assert page.done(do="simulation", pause=True).startswith("paused")
    assert page.done(do="simulation", pause=False).startswith("running")
    assert page.done(do="goal", pose={"x_m": 0.5, "y_m": -0.9}).startswith("driving to")
    assert page.done(do="cancel") == "canceled: the robot stops"


def test_alone_it_shows_what_a_demo_has_left(beside: tuple[Stack, Page]) -> None:
    stack, _ = beside
    assert stack.down() <= 5.0
    assert stack.compose("up", "--detach", "console").returncode == 0
    wait_until(lambda: bool(names(stack)), 30.0, "a run in the gallery")
    assert stack.containers() == ["console"]
    (name,) = names(stack)
    assert ask(stack, f"/runs/{name}/labels", {"tags": ["kept"], "note": "of a test"})
    labels = stack.recordings / name / "labels.json"
    assert json.loads(labels.read_text())["tags"] == ["kept"]
    assert labels.stat().st_uid == stack.uid
    wait_until(lambda: "healthy" in stack.compose("ps").stdout, 60.0, "its health")
    assert ask(stack, f"/runs/{name}/delete", {"confirm": name}) is not None
    assert not (stack.recordings / name).exists()
    assert stack.down() <= 5.0
