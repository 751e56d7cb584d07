"""The live page of a stack on a router, which comes after the console, goes, and comes again."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from mazebot.bench.parts.loopback_router import free_port, running_router
from mazebot.bringup.config import BringupConfig
from mazebot.bringup.node import BringupNode
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.client.reconnecting import ReconnectingRobot
from mazebot.common.client.robot import HOW_TO_START, RobotError
from mazebot.common.messages.documents import SimulationControl
from mazebot.common.messages.topics import SIMULATION_CONTROL
from mazebot.common.node.executive import Executive
from mazebot.common.node.node import ClockNode
from mazebot.console.config import ConsoleConfig
from mazebot.console.live.routes import live_routes
from mazebot.console.server import build_app
from mazebot.console.serving import ConsoleServer
from mazebot.embedded.demo import DemoOptions, robot_nodes
from tests.console.live.running import Page
from tests.parity.transport import ZenohTransport

pytestmark = pytest.mark.timeout(180)


@contextmanager
def stack_on(endpoint: str) -> Iterator[None]:
    """The robot's services, each with a session of its own, at most in real time."""
    options = DemoOptions(camera=False, renderer="none")
    nodes = [
        *robot_nodes(options),
        BringupNode(BringupConfig(world_name="original", only_ask=True)),
    ]
    transport = ZenohTransport(endpoint)
    executive = Executive(nodes, transport)
    transport.wait_until_matched()
    (clock,) = (node for node in executive.nodes if isinstance(node, ClockNode))
    stopped = threading.Event()

    def run() -> None:
        while not stopped.is_set():
            begin_s, before_ns = time.monotonic(), executive.now_ns
            executive.turn()
            passed_s = (executive.now_ns - before_ns) * 1e-9
            stopped.wait(max(passed_s - (time.monotonic() - begin_s), 0.0 if passed_s else 0.005))

    assert clock.speed == 0.0
    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        thread.join()
        executive.close()


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
def test_the_page_follows_a_stack_that_comes_goes_and_comes_again(tmp_path: Path) -> None:
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    robot = ReconnectingRobot(lambda: ZenohRobot(endpoint, start_s=1.0))
    config = ConsoleConfig(port=0, recordings_dir=tmp_path)
    server = ConsoleServer(build_app(config, live_routes(robot)), config)
    server.start()
    with ExitStack() as cleanup:
        cleanup.callback(robot.close)
        cleanup.callback(server.stop)
        page = cleanup.enter_context(Page(server.url))
        assert page.wait_kind("stack") == {"services": [], "how_to_start": HOW_TO_START}
        assert page.ask(do="cancel")["error"] == "no stack is running"
        page.tell(do="drive", linear_m_s=0.1, angular_rad_s=0.0)
        with running_router(port):
            with stack_on(endpoint):
                page.wait_for(lambda: "physics" in page.newest["stack"]["services"])
                check_control(page)
                with pytest.raises(RobotError):
                    robot.ask(SIMULATION_CONTROL, SimulationControl(step=1), 1e-4)
            page.wait_for(lambda: not page.newest["stack"]["services"])
        # What the page was told of a stack that is gone says nothing of the next one.
        page.newest = {"stack": page.newest["stack"]}
        with running_router(port), stack_on(endpoint):
            page.wait_for(lambda: "physics" in page.newest["stack"]["services"])
            check_control(page)


def check_control(page: Page) -> None:
    """What the page is told, and that what it asks for is done."""
    assert page.wait_kind("world")["name"] == "sim_house"
    page.wait_for(lambda: page.newest.get("navigation", {}).get("navigation_active"))
    page.wait_for(lambda: page.newest.get("pose", {}).get("estimate"))
    for kind in ("map", "scan", "global_costmap", "stats", "service physics"):
        page.wait_kind(kind)
    assert page.done(do="spin", angle_rad=0.2).startswith("turning")
    page.wait_for(lambda: [one for kind, one in page.events if kind == "action_result"])
    yaw = page.newest["pose"]["truth"][2]
    while abs(page.newest["pose"]["truth"][2] - yaw) < 0.1:
        page.tell(do="drive", linear_m_s=0.0, angular_rad_s=1.0)
        page.newest.pop("pose")
        page.wait_kind("pose")
    page.tell(do="stop")
    page.wait_for(lambda: abs(page.newest["pose"]["velocity"][1]) < 0.02, 5.0)
    assert "Wall" in page.ask(do="drop_box", pose=page_wall(page))["error"]
    page.events.clear()


def page_wall(page: Page) -> dict[str, float]:
    """The middle of the first wall."""
    corners = page.newest["world"]["walls"][0]
    x, y = (sum(corner[axis] for corner in corners) / 4 for axis in (0, 1))
    return {"x_m": x, "y_m": y, "yaw_rad": 0.0}
