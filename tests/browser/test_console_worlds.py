"""The live page while one world takes another's place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from playwright.sync_api import expect

from mazebot.common.messages.documents import NavigationStatus
from mazebot.console.live.drawing import world_frame
from tests.browser.test_console_live import Opened, lonely_console
from tests.browser.viewer import CHROMIUM
from tests.navigation.house_tour import house

if TYPE_CHECKING:
    from playwright.sync_api import Browser, WebSocketRoute

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
    pytest.mark.timeout(900),
]


def test_waypoints_of_one_world_are_not_driven_to_in_another(
    browser: Browser, tmp_path: Path
) -> None:
    context = browser.new_context(viewport={"width": 1300, "height": 900})
    sockets: list[WebSocketRoute] = []
    world = house().world
    status = NavigationStatus(localization_active=True, navigation_active=True)

    def tell(kind: str, **content: Any) -> None:
        sockets[-1].send(json.dumps({"kind": kind, "content": content}))

    def stand_in(socket: WebSocketRoute) -> None:
        sockets.append(socket)
        socket.on_message(lambda _: None)
        tell("stack", services=["localization", "navigation", "physics"], how_to_start="")
        socket.send(world_frame(world).content)
        tell("navigation", **status.model_dump(mode="json"))
        tell("pose", time_s=0.0, truth=(0.5, 0.25, 0.0), estimate=None, velocity=(0.0, 0.0))

    with lonely_console(tmp_path) as url:
        opened = Opened(context.new_page())
        page = opened.page
        page.route_web_socket("**/live/feed", stand_in)
        page.goto(f"{url}live")
        opened.wait(lambda: opened.figure("true pose")[:1] == [0.5])
        count = page.locator("#waypoint-count")
        page.get_by_role("button", name="Waypoints").press("Enter")
        for key in ("ArrowDown", "Enter", "ArrowDown", "Enter"):
            page.keyboard.press(key)
        expect(count).to_have_text("2 waypoints")
        # The same world is told again, as to a page that comes late.
        sockets[-1].send(world_frame(world).content)
        tell("pose", time_s=1.0, truth=(0.75, 0.25, 0.0), estimate=None, velocity=(0.0, 0.0))
        opened.wait(lambda: opened.figure("true pose")[:1] == [0.75])
        expect(count).to_have_text("2 waypoints")
        sockets[-1].send(world_frame(world.model_copy(update={"hash": "0" * 16})).content)
        expect(count).to_have_text("0 waypoints")
        assert opened.said() == "another world: 2 waypoints dropped"
        context.close()
