"""The live page beside a run: what it is told, what it may ask for, and what it costs."""

from __future__ import annotations

import contextlib
import gc
import json
import math
import time
from collections.abc import Iterator

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from mazebot.common.client.robot import RobotError
from mazebot.common.maths.frames import wrap_angle
from mazebot.common.messages.documents import GetEntities, SetEntityState
from mazebot.common.messages.slam_documents import ExplorationStatus
from mazebot.common.messages.topics import EXPLORATION_STATUS, GET_ENTITIES, SET_ENTITY_STATE
from mazebot.console.live import feed
from mazebot.embedded.demo import DemoOptions
from tests.console.live.running import Page, Run, running, wait_until

pytestmark = pytest.mark.timeout(180)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    options = DemoOptions(
        world_name="original", camera=False, renderer="none", record=False, tour=False,
        out_dir=tmp_path_factory.mktemp("live") / "run",
    )  # fmt: skip
    with running(options) as started:
        with started.page() as page:
            page.wait_for(lambda: page.newest.get("navigation", {}).get("navigation_active"))
        yield started


@pytest.fixture
def page(run: Run) -> Iterator[Page]:
    with run.page() as opened:
        yield opened
        # The next test finds time as it expects it, also after one that has sent too much.
        wait_until(lambda: opened.ask_quietly(do="simulation", speed=1.0, pause=False))


def truth(page: Page) -> tuple[float, float, float]:
    page.wait_for(lambda: page.newest.get("pose", {}).get("truth"))
    x, y, yaw = page.newest["pose"]["truth"]
    return x, y, yaw


def test_a_page_is_told_of_the_world_the_robot_and_every_service(page: Page) -> None:
    world = page.wait_kind("world")
    assert world["name"] == "sim_house"
    assert len(world["walls"]) > 20
    grid = page.wait_kind("map")
    cells = np.frombuffer(grid["data"], np.int8).reshape(grid["rows"], grid["columns"])
    assert {0, 100} <= set(np.unique(cells).tolist())
    scan = page.wait_kind("scan")
    ranges = np.frombuffer(scan["data"], "<u2")
    assert len(ranges) == 360
    assert scan["angle_end_rad"] - scan["angle_min_rad"] == pytest.approx(2 * math.pi, abs=0.03)
    page.wait_for(lambda: page.newest.get("pose", {}).get("estimate"))
    pose = page.newest["pose"]
    assert pose["estimate"] == pytest.approx(pose["truth"], abs=0.2)
    assert len(pose["covariance"]) == 4
    services = set(page.wait_kind("stack")["services"])
    assert {"physics", "navigation", "localization"} <= services
    # Without a camera perception never steps, and says nothing of itself.
    told = {f"service {name}" for name in services - {"perception"}}
    page.wait_for(lambda: told <= page.newest.keys())
    page.wait_for(lambda: page.newest["service physics"]["message"] == "active")
    for kind in ("entities", "global_costmap", "local_costmap", "navigation", "stats"):
        page.wait_kind(kind)


def test_a_goal_is_driven_to_and_its_result_is_told(page: Page) -> None:
    x, y, _ = truth(page)
    # The tree of a goal that has ended is empty: as fast as can be, one may end before it is shown.
    page.done(do="simulation", speed=0.2)
    said = page.done(do="goal", pose={"x_m": x + 0.4, "y_m": y - 0.1, "yaw_rad": 0.0})
    assert said.startswith("driving to")
    page.wait_for(lambda: page.newest.get("plan", {}).get("points_m"))
    page.wait_for(lambda: page.newest.get("tree", {}).get("nodes"))
    page.done(do="simulation", speed=0.0)
    results = page.wait_for(
        lambda: [content for kind, content in page.events if kind == "action_result"]
    )
    assert results[-1]["status"] == "succeeded"
    page.wait_for(lambda: math.dist(truth(page)[:2], (x + 0.4, y - 0.1)) < 0.25)


def test_a_place_without_a_heading_is_arrived_at_as_the_way_leads(page: Page) -> None:
    start = truth(page)
    page.done(do="simulation", speed=0.0)
    for place in ((1.82, 2.13, None), start):
        page.events.clear()
        page.done(do="goal", pose=dict(zip(("x_m", "y_m", "yaw_rad"), place, strict=True)))
        results = page.wait_for(
            lambda: [content for kind, content in page.events if kind == "action_result"]
        )
        assert results[-1]["status"] == "succeeded"
        if place is not start:
            # The way leads round a wall, and not straight there, to the upper right.
            page.wait_for(lambda: math.dist(truth(page)[:2], (1.82, 2.13)) < 0.25)
            assert abs(wrap_angle(truth(page)[2] - math.pi)) < 0.5
    page.done(do="simulation", speed=1.0)


def test_a_page_that_comes_late_gets_what_it_has_missed_at_once(page: Page, run: Run) -> None:
    x, y, _ = truth(page)
    page.done(do="simulation", speed=0.0)
    begin_s = page.newest["pose"]["time_s"]
    page.done(do="goal", pose={"x_m": x - 0.5, "y_m": y, "yaw_rad": 0.0})
    # Results of before come as well.
    page.wait_for(
        lambda: [
            content
            for kind, content in page.events
            if kind == "action_result" and content["start_time_s"] >= begin_s
        ]
    )
    page.done(do="simulation", speed=1.0)
    page.newest.pop("plan", None)
    page.done(do="goal", pose={"x_m": x, "y_m": y, "yaw_rad": 0.0})
    page.wait_for(
        lambda: (
            math.dist(page.newest.get("plan", {}).get("points_m", [(9.0, 9.0)])[-1], (x, y)) < 0.1
        )
    )
    plan = page.newest["plan"]["points_m"]
    results = [content for kind, content in page.events if kind == "action_result"]
    with run.page() as late:
        late.wait_kind("trails")
        late.wait_for(
            lambda: (
                [one for kind, one in late.events if kind == "action_result"][: len(results)]
                == results
            )
        )
        trail = late.newest["trails"]["truth"]
        assert max(math.dist(point, (x - 0.5, y)) for point in trail) > 0.2
        assert late.newest["plan"]["points_m"][-1] == pytest.approx(plan[-1], abs=0.01)
    page.done(do="cancel")


def test_a_page_that_is_loaded_again_misses_nothing(run: Run) -> None:
    with run.page() as first:
        before = first.wait_kind("trails")["truth"]
        first.done(do="spin", angle_rad=0.2)
        first.wait_for(lambda: first.events)
    with run.page() as again:
        assert again.wait_kind("trails")["truth"][: len(before)] == before
        again.wait_for(lambda: again.events[: len(first.events)] == first.events)


def test_waypoints_are_taken_up_and_canceled(page: Page) -> None:
    x, y, _ = truth(page)
    places = [{"x_m": x + shift, "y_m": y, "yaw_rad": 0.0} for shift in (-0.1, -0.3)]
    for stops in (True, False):
        assert page.done(do="waypoints", poses=places, stops=stops) == "driving to 2 waypoints"
        assert page.done(do="cancel") == "canceled: the robot stops"


def test_other_tasks_are_begun_paused_and_canceled(page: Page) -> None:
    page.done(do="simulation", speed=0.0)
    _, _, yaw = truth(page)
    assert page.done(do="spin", angle_rad=0.5) == "turning by 29 degrees"
    page.wait_for(lambda: abs(math.remainder(truth(page)[2] - yaw - 0.5, 2 * math.pi)) < 0.1)
    x, y, _ = truth(page)
    assert page.done(do="back_up", distance_m=0.1) == "backing up by 0.1 m"
    page.wait_for(lambda: math.dist(truth(page)[:2], (x, y)) > 0.08)
    page.done(do="simulation", speed=1.0)
    page.done(do="goal", pose={"x_m": 1.35, "y_m": -0.6, "yaw_rad": 0.0})
    assert page.done(do="pause_task", pause=True) == "paused: the robot stops"
    page.wait_for(lambda: page.newest["feedback"]["paused"])
    assert page.done(do="pause_task", pause=False) == "resumed: the robot continues"
    assert page.done(do="emergency_stop", stop=True) == "stopped: the robot is held at rest"
    page.wait_for(lambda: page.newest["stats"]["emergency_stop"] == "Stop in the console")
    page.wait_for(lambda: page.newest["navigation"]["stop_level"] == "hold")
    assert page.done(do="emergency_stop", stop=False) == "cleared: the robot may move"
    page.wait_for(lambda: page.newest["navigation"]["stop_level"] == "none")
    assert page.done(do="clear_costmaps") == "costmaps cleared"
    assert page.done(do="cancel") == "canceled: the robot stops"


def test_the_robot_is_found_on_the_whole_map(page: Page) -> None:
    page.wait_kind("localization")
    assert page.done(do="global_localization").startswith("global localization started")
    page.wait_for(lambda: page.newest["localization"]["state"] == "searching")
    page.done(do="simulation", speed=0.0)
    page.wait_for(lambda: page.newest["localization"]["state"] == "localized")
    page.wait_for(lambda: page.newest["pose"]["estimate"] == pytest.approx(truth(page), abs=0.2))


def test_what_a_service_refuses_is_said_in_its_words(page: Page, run: Run) -> None:
    answer = page.ask(do="goal", pose={"x_m": 500.0, "y_m": 0.0, "yaw_rad": 0.0})
    assert "error code" in answer["error"]
    nothing = page.ask(do="remove", name="nothing")
    with pytest.raises(RobotError):
        run.robot.publish(EXPLORATION_STATUS, ExplorationStatus(state="complete"))
    moved = SetEntityState(name="nothing", position_m=(0.0, 0.0, 0.0))
    assert "nothing" in nothing["error"]
    assert nothing["error"] == run.robot.ask(SET_ENTITY_STATE, moved, 5.0).error
    outside = page.ask(do="initial_pose", pose={"x_m": 500.0, "y_m": 0.0, "yaw_rad": 0.0})
    assert outside["error"].endswith("must be inside the map")
    assert page.ask(do="cancel")["error"]
    assert page.ask(do="explore", resume=True)["error"] == "explore: no explorer service is running"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("no json", "message: (whole): Invalid JSON"),
        ("[]", "message: (whole): must be an object"),
        ('{"id": 4711, "action": {"do": "fly"}}', "message: action: Input tag 'fly'"),
        ('{"id": 4711, "action": {"do": "goal"}}', "message: action.goal.pose: Field required"),
        (
            '{"id": 4711, "action": {"do": "goal", "pose": {"x_m": NaN, "y_m": 0}}}',
            "message: action.goal.pose.x_m",
        ),
        (
            '{"id": 4711, "action": {"do": "drive", "linear_m_s": 9, "angular_rad_s": 0}}',
            "message: action.drive.linear_m_s: must be",
        ),
        (json.dumps({"id": 4711, "action": {"do": "x" * 20_000}}), "message: 2"),
    ],
)
def test_a_wrong_message_gets_one_line_and_the_page_stays(page: Page, text: str, said: str) -> None:
    page.socket.send(text)
    page.wait_for(lambda: page.answers)
    (answer,) = page.answers.values()
    assert answer["error"].startswith(said[:40]), answer
    assert "\n" not in answer["error"]
    assert page.done(do="simulation", pause=False)


def test_a_page_that_sends_too_much_is_told_once_and_ignored(page: Page) -> None:
    for _ in range(400):
        page.socket.send('{"id": 7, "action": {"do": "stop"}}')
    page.wait_for(lambda: None in page.answers)
    assert "too many" in page.answers[None]["error"]
    end_s = time.monotonic() + 10.0
    while page.ask_quietly(do="simulation", pause=False) is None:
        assert time.monotonic() < end_s


def test_a_box_is_dropped_into_the_world_and_removed(page: Page, run: Run) -> None:
    x, y, _ = truth(page)
    page.wait_kind("entities")
    said = page.done(do="drop_box", pose={"x_m": x - 0.7, "y_m": y, "yaw_rad": 0.3})
    name = said.split()[0]
    # It has come before the answer, so that a person can remove it at once.
    (box,) = page.newest["entities"]["bodies"]
    assert box["name"] == name
    assert np.mean(box["polygons_m"][0][:-1], axis=0) == pytest.approx([x - 0.7, y], abs=0.01)
    assert name in {one.name for one in run.robot.ask(GET_ENTITIES, GetEntities(), 5.0).entities}
    page.done(do="remove", name=name)
    assert not page.newest["entities"]["bodies"]
    # In the robot itself it cannot stand, and the reason is the service's.
    x, y, _ = truth(page)
    refused = page.ask(do="drop_box", pose={"x_m": x, "y_m": y, "yaw_rad": 0.0})
    if not refused["error"]:
        page.wait_for(lambda: page.newest["entities"]["refused"])
        page.ask(do="remove", name=refused["said"].split()[0])


@pytest.fixture
def at_start(page: Page) -> None:
    """Before a drive the robot has room around it, wherever another test has left it."""
    epoch = page.wait_kind("stats")["epoch"]
    page.done(do="simulation", reset="all")
    page.wait_for(lambda: page.newest["stats"]["epoch"] > epoch)
    page.wait_for(lambda: math.hypot(*truth(page)[:2]) < 0.05)


def drive(page: Page, until: float = 0.05) -> None:
    """Turn on the spot until the robot does."""
    before = truth(page)[2]
    end_s = time.monotonic() + 20.0
    while abs(truth(page)[2] - before) < until:
        assert time.monotonic() < end_s
        page.tell(do="drive", linear_m_s=0.0, angular_rad_s=1.0)
        page.take(0.05)
        page.wait_kind("pose")


def stands(page: Page) -> bool:
    velocity = page.newest["pose"].get("velocity")
    return velocity is not None and abs(velocity[1]) < 0.02


@pytest.mark.usefixtures("at_start")
def test_driving_by_hand_ends_when_the_page_says_so(page: Page) -> None:
    drive(page)
    page.tell(do="stop")
    page.wait_for(lambda: stands(page), 5.0)
    yaw = truth(page)[2]
    begin_s = page.newest["pose"]["time_s"]
    page.wait_for(lambda: page.newest["pose"]["time_s"] > begin_s + 0.5)
    assert truth(page)[2] == pytest.approx(yaw, abs=0.05)


@pytest.mark.usefixtures("at_start")
def test_driving_by_hand_ends_when_the_page_is_silent(page: Page) -> None:
    drive(page)
    page.wait_for(lambda: stands(page), 5.0)


@pytest.mark.usefixtures("at_start")
@pytest.mark.parametrize("politely", [True, False])
def test_driving_by_hand_ends_when_the_page_has_gone(page: Page, run: Run, politely: bool) -> None:
    with run.page() as driver:
        drive(driver)
        if not politely:
            driver.socket.socket.close()
    page.wait_for(lambda: "pose" in page.newest and stands(page), 5.0)


def test_an_order_of_a_page_that_goes_at_once_is_carried_out(page: Page, run: Run) -> None:
    page.wait_for(lambda: not page.newest.get("stats", {"paused": True})["paused"])
    with run.page() as other:
        other.tell(do="simulation", pause=True)
    page.wait_for(lambda: page.newest["stats"]["paused"])


def test_nobody_misses_the_refusal_of_an_order_whose_page_has_gone(
    page: Page, run: Run, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(5):
        with run.page() as other:
            other.tell(do="remove", name="nothing")
    assert page.ask(do="remove", name="nothing")["error"]
    gc.collect()
    assert [record for record in caplog.records if record.name == "asyncio"] == []


def test_time_is_paused_stepped_and_sped_up(page: Page) -> None:
    assert page.done(do="simulation", pause=True).startswith("paused at")
    at_s = page.wait_for(
        lambda: page.newest.get("stats", {}).get("paused") and page.newest["stats"]["sim_time_s"]
    )
    said = page.done(do="simulation", step=24)
    assert said.startswith("paused at")
    page.wait_for(lambda: page.newest["stats"]["sim_time_s"] == pytest.approx(at_s + 0.1, abs=0.01))
    assert page.done(do="simulation", pause=False, speed=2.0).startswith("running at 2x real time")
    page.wait_for(lambda: page.newest["stats"]["speed"] == 2.0)
    assert "speed" in page.ask(do="simulation", speed=0.001)["error"]


def test_a_page_that_takes_nothing_costs_the_others_nothing(page: Page, run: Run) -> None:
    page.wait_kind("stats")
    with contextlib.ExitStack() as stack:
        for _ in range(3):
            stack.enter_context(run.page(takes_all=False))
        begin_s = page.wait_kind("pose")["time_s"]
        page.wait_for(lambda: page.newest["pose"]["time_s"] > begin_s + 1.0, 30.0)
        assert page.done(do="simulation", pause=False)


def test_nothing_is_watched_while_no_page_is_open(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed, "LINGER_S", 0.5)
    with run.page() as page:
        page.wait_kind("pose")
    wait_until(lambda: not run.beside.transport.is_watched)
    with run.page() as page:
        page.wait_kind("pose")
        assert run.beside.transport.is_watched
    wait_until(lambda: not run.beside.transport.is_watched)


def test_a_page_of_another_site_is_refused(run: Run) -> None:
    address = run.beside.url.rstrip("/").replace("http:", "ws:") + "/live/feed"
    for origin in (Origin("http://evil.example"), None):
        with (
            pytest.raises((InvalidStatus, ConnectionClosed)),
            connect(address, origin=origin) as socket,
        ):
            socket.recv(5.0)


def test_a_reset_tells_the_page_to_begin_anew(page: Page, run: Run) -> None:
    page.wait_kind("stats")
    epoch = page.newest["stats"]["epoch"]
    page.done(do="simulation", reset="all")
    page.wait_for(lambda: page.newest["stats"]["epoch"] > epoch and "restarted" in page.newest)
    page.wait_for(lambda: page.newest["navigation"]["navigation_active"])
    # What a page gets that comes now belongs to the run that is now.
    with run.page() as late:
        trail = late.wait_kind("trails")["truth"]
        assert all(math.hypot(*point) < 0.1 for point in trail)
