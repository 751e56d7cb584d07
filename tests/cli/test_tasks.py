"""`mazebot waypoints`, `spin`, `backup`, `dock`, `undock` and `localize --global` against somebody
who answers as navigation and localisation do.
"""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.liveliness import alive_key
from mazebot.common.bus.publisher import publish
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    CancelGoal,
    CancelGoalReply,
    Entities,
    LocalizationStatus,
    Location,
    MappedMarker,
    NavigationStatus,
    Planar,
    StopCause,
)
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    AMCL_POSE,
    EMERGENCY_STOP,
    GET_ENTITIES,
    LOCALIZATION_STATUS,
    NAVIGATION_STATUS,
    PHOTO,
    PHOTO_REQUEST,
    REINITIALIZE_GLOBAL_LOCALIZATION,
    SEND_GOAL,
    WORLD,
    Topic,
)
from mazebot.common.messages.wire import encode
from tests.cli.test_app import assert_one_line, mazebot
from tests.cli.test_goal import DEADLINE_S, STATS, Navigation
from tests.common.samples import ENTITIES, HEADER, SAMPLES
from tests.physics.driver import world

PLACES = (
    Location(name="kitchen", x_m=1.0, y_m=2.0, yaw_rad=0.5),
    Location(name="hall", x_m=-1.0, y_m=0.0, yaw_rad=0.0),
)


class Robot(Navigation):
    """Takes actions, tells feedback, and ends each as it is told to, or when it is cancelled."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(endpoint)
        self.sent: list[act.SendGoal] = []
        self.reply = act.SendGoalReply(accepted=True)
        self.result: dict[str, Any] | None = {"status": "succeeded"}
        """Fields of the result with which an action ends at once; None: when it is cancelled."""
        self.photo = False
        self.entities = Entities(world_hash="0" * 16)
        self.statuses: list[LocalizationStatus] = []
        topics: tuple[Topic[Any], ...] = (
            ACTION_FEEDBACK, ACTION_RESULT, AMCL_POSE, LOCALIZATION_STATUS, PHOTO, PHOTO_REQUEST,
            NAVIGATION_STATUS, WORLD,
        )  # fmt: skip
        self.out = {topic.name: publish(self.session, topic) for topic in topics}
        self._also = [
            self._answer(SEND_GOAL, self._send_goal),
            self._answer(GET_ENTITIES, lambda _: self.entities),
            self._answer(EMERGENCY_STOP, lambda _: act.Reply()),
            self._answer(REINITIALIZE_GLOBAL_LOCALIZATION, self._search),
            self.session.liveliness().declare_token(alive_key("localization", "a")),
        ]
        self.put(WORLD, world().model_copy(update={"locations": PLACES}))

    def put(self, topic: Any, message: Any) -> None:
        self.out[topic.name].put(encode(topic, message))

    def _send_goal(self, send: act.SendGoal) -> act.SendGoalReply:
        self.sent.append(send)
        if not self.reply.accepted:
            return self.reply
        goal = send.goal
        self.put(
            ACTION_FEEDBACK,
            act.ActionFeedback(
                goal_id=send.goal_id, action=goal.action, navigation_time_s=1.5,
                distance_remaining_m=2.25, number_of_recoveries=1,
            ),
        )  # fmt: skip
        if self.photo:
            self.put(PHOTO_REQUEST, act.PhotoRequest(waypoint=3, stamp_ns=0))
            picture = np.arange(9, dtype=np.uint8)
            self.put(PHOTO, msg.CompressedImage(HEADER, "rgb8; png compressed", picture))
        if self.result is not None:
            self._end_action(**self.result)
        self.came.set()
        return self.reply

    def _end_action(self, **fields: Any) -> None:
        send = self.sent[-1]
        result = act.ActionResult(
            goal_id=send.goal_id, action=send.goal.action, start_time_s=1.0, end_time_s=8.5,
            **fields,
        )  # fmt: skip
        self.put(ACTION_RESULT, result)

    def _cancel(self, asked: CancelGoal) -> CancelGoalReply:
        if not self.sent:
            return super()._cancel(asked)
        self.cancelled.append(asked)
        self._end_action(status="canceled", error_code=9012, error_msg="canceled")
        return CancelGoalReply()

    def _search(self, _: act.Empty) -> act.Reply:
        for status in self.statuses:
            self.put(LOCALIZATION_STATUS, status)
        self.put(AMCL_POSE, SAMPLES[AMCL_POSE])
        return act.Reply()


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_router() as endpoint:
        yield endpoint


@pytest.fixture
def robot(endpoint: str) -> Iterator[Robot]:
    robot = Robot(endpoint)
    yield robot
    robot.session.close()  # type: ignore[no-untyped-call]


def run(robot: Robot, *words: str) -> subprocess.CompletedProcess[str]:
    return mazebot(*words, "--connect", robot.endpoint)


def test_each_behaviour_is_asked_for_and_its_end_told(robot: Robot) -> None:
    assert run(robot, "spin", "-1.5").stdout.splitlines() == [
        "turning by -1.5 rad", "done after 7.5 s"
    ]  # fmt: skip
    assert run(robot, "backup", "0.3", "--speed", "0.05").returncode == 0
    assert run(robot, "dock", "aruco_7", "--no-navigate").returncode == 0
    assert run(robot, "undock").returncode == 0
    assert [send.goal for send in robot.sent] == [
        act.Spin(target_yaw_rad=-1.5),
        act.BackUp(distance_m=0.3, speed_m_s=0.05),
        act.DockRobot(dock_id="aruco_7", navigate_to_staging_pose=False),
        act.UndockRobot(),
    ]
    done = run(robot, "spin", "1", "--json")
    assert json.loads(done.stdout)["status"] == "succeeded"


def dock_chosen(robot: Robot) -> str:
    """The dock of a goal that names none."""

    def tell_pose() -> None:
        while not robot.came.wait(0.05):
            robot.put(AMCL_POSE, SAMPLES[AMCL_POSE])

    with ThreadPoolExecutor() as pool:
        told = pool.submit(tell_pose)
        assert run(robot, "dock").returncode == 0
        told.result(DEADLINE_S)
    assert isinstance(robot.sent[-1].goal, act.DockRobot)
    return robot.sent[-1].goal.dock_id


def test_the_nearest_marker_is_docked_at(robot: Robot) -> None:
    assert_one_line(run(robot, "dock"), "the world has no markers")
    robot.entities = ENTITIES
    assert dock_chosen(robot) in {marker.name for marker in ENTITIES.markers}


def test_the_nearest_marker_is_the_one_that_is_nearest_on_the_robots_map(robot: Robot) -> None:
    (marker,) = ENTITIES.markers
    here = np.array(marker.position_m)
    far = marker.model_copy(update={"name": "far", "marker_id": 9, "position_m": tuple(here + 9)})
    robot.entities = ENTITIES.model_copy(update={"entities": (marker, far)})
    fields = set(MappedMarker.model_fields)
    # The one that hangs far away is near on the map, and the other way round.
    mapped = tuple(
        MappedMarker.model_validate({**one.model_dump(include=fields), "position_m": at})
        for one, at in ((marker, far.position_m), (far, marker.position_m))
    )
    world_of_map = world().model_copy(update={"mapped_markers": mapped})
    robot.put(WORLD, world_of_map)
    assert dock_chosen(robot) == "far"
    robot.put(WORLD, world_of_map.model_copy(update={"mapped_markers": ()}))
    assert_one_line(run(robot, "dock"), "the robot knows no marker", "not among the markers")


def test_waypoints_are_driven_to_without_standard_input(robot: Robot) -> None:
    robot.result = None
    words = f"waypoints hall --timeout 1 --connect {robot.endpoint} <&-"
    done = subprocess.run(
        ["sh", "-c", f"{sys.executable} -m mazebot.cli {words}"],
        capture_output=True, text=True, check=False,
        env={**os.environ, "MAZEBOT_PROGRESS": "false"},
    )  # fmt: skip
    assert done.stdout == "driving to 1 waypoint\n"
    assert done.stderr == "error: waypoints: --timeout: 1 s: timed out: canceled\n"


def test_a_refusal_has_its_code_and_the_nearest_free_pose(robot: Robot) -> None:
    robot.reply = act.SendGoalReply(
        accepted=False, error_code=901, error_msg="dock 'x': must be one of a, b",
        nearest_free=Planar(x_m=1.0, y_m=0.5, yaw_rad=0.0),
    )  # fmt: skip
    done = run(robot, "dock", "x")
    assert_one_line(done, "dock 'x'", "one of a, b", "(1.00, 0.50, 0.00)", "901", "DOCK_NOT_IN_DB")
    assert done.returncode == 1
    done = run(robot, "dock", "x", "--json")
    assert (done.returncode, json.loads(done.stdout)["error_code"]) == (1, 901)


def test_a_failure_has_its_code_and_missed_waypoints_their_lines(robot: Robot) -> None:
    robot.result = {"status": "aborted", "error_code": 703, "error_msg": "something is near"}
    done = run(robot, "spin", "1")
    assert_one_line(done, "spin", "something is near", "error code 703", "COLLISION_AHEAD")
    assert done.returncode == 1
    missed = act.WaypointStatus(status="failed", index=1, error_code=206, error_msg="occupied")
    robot.result = {"status": "succeeded", "waypoints": (missed,), "number_of_recoveries": 2}
    done = run(robot, "waypoints", "hall", "kitchen")
    assert done.stdout.splitlines() == [
        "driving to 2 waypoints",
        "waypoint 1 failed: occupied (error code 206, ComputePathToPose GOAL_OCCUPIED)",
    ]
    assert done.stderr == ("error: waypoints: reached 1 of 2 waypoints after 7.5 s, 2 recoveries\n")
    assert done.returncode == 1
    assert run(robot, "waypoints", "hall", "kitchen", "--json").returncode == 1
    robot.result = {"status": "succeeded"}
    done = run(robot, "waypoints", "hall", "kitchen", "--loops", "1")
    assert done.stdout.splitlines()[-1] == "reached 4 of 4 waypoints after 7.5 s"
    assert done.returncode == 0


@pytest.mark.parametrize(
    ("state", "task"), [("idle", ""), ("held", "; its task goes on, unless it is paused")]
)
def test_a_stop_that_is_cleared_tells_of_a_task_that_waits(
    robot: Robot, state: Any, task: str
) -> None:
    robot.stats = STATS.model_copy(update={"emergency_stop": "smoke"})
    status = NavigationStatus(localization_active=True, navigation_active=True, state=state)
    robot.put(NAVIGATION_STATUS, status)
    assert run(robot, "stop", "--clear").stdout == f"cleared: the robot may move{task}\n"


def test_waypoints_are_sent_with_their_tasks(robot: Robot, tmp_path: Path) -> None:
    assert run(robot, "waypoints", "hall", "kitchen", "--loops", "3", "--photo").returncode == 0
    assert robot.sent[-1].goal == act.FollowWaypoints(
        poses=tuple(Planar(x_m=p.x_m, y_m=p.y_m, yaw_rad=p.yaw_rad) for p in PLACES[::-1]),
        tasks=(act.WaypointTask(photo=True),) * 2,
        number_of_loops=3,
    )
    assert_one_line(run(robot, "waypoints", "cellar"), "'cellar'", "hall, kitchen")
    robot.photo = True
    done = run(robot, "waypoints", "hall", "--photos", str(tmp_path / "album"))
    (picture,) = (tmp_path / "album").iterdir()
    assert picture.name.startswith("3_")
    assert picture.read_bytes() == bytes(range(9))
    assert f"photo at waypoint 3: {picture}" in done.stdout


def test_a_task_is_cancelled_when_its_time_is_over(robot: Robot) -> None:
    robot.result = None
    done = run(robot, "undock", "--timeout", "0.3")
    assert_one_line(done, "--timeout", "0.3 s", "canceled")
    # As a task that failed, not as words that are wrong.
    assert done.returncode == 1
    assert "held" not in done.stderr
    assert robot.cancelled == [CancelGoal(goal_id=robot.sent[-1].goal_id)]


def test_what_holds_the_robot_is_told_while_a_task_waits_and_when_its_time_is_over(
    robot: Robot,
) -> None:
    robot.result = None
    stop = StopCause(level="hold", cause="emergency stop: smoke", cleared_by="a person")
    status = NavigationStatus(
        localization_active=True, navigation_active=True, state="held", stop_level="hold",
        stop_causes=(stop,),
    )  # fmt: skip
    # It is kept for the command, which starts later.
    robot.put(NAVIGATION_STATUS, status)
    done = run(robot, "undock", "--timeout", "1")
    assert_one_line(done, "canceled; held at last: emergency stop: smoke; cleared by a person")


@pytest.mark.parametrize(("after", "words"), [([], "has ended"), (["b"], "was restarted")])
def test_a_navigation_that_is_gone_is_told(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, after: list[str], words: str
) -> None:
    monkeypatch.setattr("mazebot.common.client.service_watch.PATIENCE_S", 0.5)
    robot.result = None
    with ThreadPoolExecutor() as pool:
        done = pool.submit(run, robot, "undock")
        assert robot.came.wait(DEADLINE_S)
        robot.token.undeclare()  # type: ignore[no-untyped-call]
        kept = [robot.session.liveliness().declare_token(alive_key("navigation", s)) for s in after]
        assert_one_line(done.result(DEADLINE_S), "navigation", words)
    del kept


def test_ctrl_c_cancels_after_progress_in_one_line(robot: Robot) -> None:
    robot.result = None
    master, slave = pty.openpty()
    command = subprocess.Popen(
        [sys.executable, "-m", "mazebot.cli", "waypoints", "hall", "--connect", robot.endpoint],
        stdin=slave, stdout=slave, stderr=slave, start_new_session=True,
    )  # fmt: skip
    try:
        said = ""
        while "1 recoveries" not in said:
            said += os.read(master, 4096).decode()
        command.send_signal(signal.SIGINT)
        assert command.wait(timeout=DEADLINE_S) == 130
        said += os.read(master, 4096).decode()
    finally:
        command.kill()
        for fd in (master, slave):
            os.close(fd)
    assert "driving to 1 waypoint\r\n" in said
    assert "\r\x1b[K1.5 s, 2.25 m left, 1 recoveries" in said
    assert "canceled: the robot stops" in said
    assert robot.cancelled == [CancelGoal(goal_id=robot.sent[-1].goal_id)]


@pytest.mark.parametrize("output", ["unread", "full", "closed"])
@pytest.mark.parametrize("words", ["goal 1 -0.5", "spin 12", "waypoints hall"])
def test_output_that_ends_cancels_the_task(robot: Robot, words: str, output: str) -> None:
    robot.result = None
    read, write = os.pipe()
    os.close(read)
    redirected = {"unread": "", "full": "> /dev/full", "closed": ">&-"}[output]
    command = f"{sys.executable} -m mazebot.cli {words} --connect {robot.endpoint} {redirected}"
    done = subprocess.run(
        ["sh", "-c", command], stdout=write, stderr=subprocess.PIPE, text=True, check=False,
        env={**os.environ, "MAZEBOT_PROGRESS": "false"},
    )  # fmt: skip
    os.close(write)
    assert done.stderr.startswith("error: standard output: ")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert len(robot.cancelled) == 1


def test_the_robot_finds_itself_after_a_search(robot: Robot) -> None:
    def status(state: Any, reason: str = "") -> LocalizationStatus:
        return LocalizationStatus(state=state, quality=0.5, reason=reason)

    find = ("localize", "--global", "--timeout", "1")
    # The first one is of before the search.
    robot.statuses = [status("localized"), status("searching", "two places look alike")]
    done = run(robot, *find)
    assert_one_line(done, "--timeout: 1 s", "searching: two places look alike")
    assert done.returncode == 1
    robot.statuses.append(status("localized"))
    done = run(robot, *find)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("localized at (")
    assert json.loads(run(robot, *find, "--json").stdout)["quality"] == 0.5
