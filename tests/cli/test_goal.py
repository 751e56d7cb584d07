"""`mazebot goal`, `cancel` and `topic pub` against somebody who answers as navigation does."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import alive_key
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import (
    CancelGoal,
    CancelGoalReply,
    NavigationResult,
    Planar,
    SimulationControlReply,
    SimulationStats,
)
from mazebot.common.messages.keys import DEFAULT_KEYS
from mazebot.common.messages.topics import (
    CANCEL_GOAL,
    CMD_VEL,
    GOAL_POSE,
    NAVIGATION_RESULT,
    SIMULATION_CONTROL,
)
from mazebot.common.messages.wire import (
    decode,
    decode_json,
    encode,
    encode_json,
)
from mazebot.common.node.node import Envelope
from tests.cli.test_app import assert_one_line, mazebot

DEADLINE_S = 20.0
STATS = SimulationStats(
    world_hash="0" * 16, sim_time_s=12.5, iterations=3000, step_size_s=1 / 240, renderer="none",
    state_hash="0" * 16,
)  # fmt: skip


class Navigation:
    """Takes goals, and ends each when it is told to, or when it is cancelled."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self.session = open_session(BusConfig(connect=endpoint), timeout_s=5.0)
        self.goals: list[msg.PoseStamped] = []
        self.commands: list[msg.TwistStamped] = []
        self.cancelled: list[CancelGoal] = []
        self.came = threading.Event()
        self.stats = STATS
        self.ends: dict[str, Any] | None = None
        """Fields of the result with which a goal ends at once."""
        self._results = publish(self.session, NAVIGATION_RESULT)
        self._kept = [
            subscribe(self.session, GOAL_POSE, self._take_goal),
            subscribe(self.session, CMD_VEL, self._take_command),
            self._answer(SIMULATION_CONTROL, lambda _: SimulationControlReply(stats=self.stats)),
            self._answer(CANCEL_GOAL, self._cancel),
            self.session.liveliness().declare_token(alive_key("physics", "a")),
        ]
        self.token = self.session.liveliness().declare_token(alive_key("navigation", "a"))

    def _answer(self, query: Any, respond: Any) -> Any:
        def answer(asked: zenoh.Query) -> None:
            with asked:
                data = asked.payload.to_bytes() if asked.payload else b""
                said = respond(decode_json(query.request, data))
                asked.reply(asked.key_expr, encode_json(said))

        return self.session.declare_queryable(DEFAULT_KEYS.of_query(query), answer)

    def _take_goal(self, payload: bytes, _: Envelope) -> None:
        self.goals.append(decode(GOAL_POSE, payload))
        self.came.set()
        if self.ends is not None:
            self._end(**self.ends)

    def _take_command(self, payload: bytes, _: Envelope) -> None:
        self.commands.append(decode(CMD_VEL, payload))

    def _cancel(self, asked: CancelGoal) -> CancelGoalReply:
        self.cancelled.append(asked)
        if not self.goals:
            return CancelGoalReply(error="no active goal", return_code=2)
        self._end(error_code=9012, error_msg="canceled")
        goal = msg.se2_from_pose(self.goals.pop().pose)
        return CancelGoalReply(goal=Planar(x_m=goal.x_m, y_m=goal.y_m, yaw_rad=goal.yaw_rad))

    def _end(self, **fields: Any) -> None:
        goal = self.goals[-1]
        at = msg.se2_from_pose(goal.pose)
        result = NavigationResult(
            goal=Planar(x_m=at.x_m, y_m=at.y_m, yaw_rad=at.yaw_rad),
            goal_stamp_ns=msg.ns_from_time(goal.header.stamp),
            start_time_s=12.5, end_time_s=20.0, **fields,
        )  # fmt: skip
        self._results.put(encode(NAVIGATION_RESULT, result))


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with running_router() as endpoint:
        yield endpoint


@pytest.fixture
def navigation(endpoint: str) -> Iterator[Navigation]:
    navigation = Navigation(endpoint)
    yield navigation
    navigation.session.close()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_what_stops_the_command_cancels_the_goal(
    navigation: Navigation, number: signal.Signals
) -> None:
    command = subprocess.Popen(
        [sys.executable, "-m", "mazebot.cli", "goal", "1", "-0.5", "0.25",
         "--connect", navigation.endpoint],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert command.stdout is not None
    assert command.stdout.readline() == "driving to (1, -0.5, 0.25)\n"
    assert navigation.came.wait(DEADLINE_S)
    command.send_signal(number)
    _, error = command.communicate(timeout=DEADLINE_S)
    assert command.returncode == 128 + number
    assert error == "canceled: the robot stops\n"
    assert navigation.cancelled == [CancelGoal(goal_stamp_ns=12_500_000_000)]


def test_a_goal_is_cancelled_when_its_time_is_over(navigation: Navigation) -> None:
    done = mazebot("goal", "1", "-0.5", "--timeout", "0.3", "--connect", navigation.endpoint)
    assert_one_line(done, "--timeout", "0.3 s", "canceled")
    assert navigation.cancelled == [CancelGoal(goal_stamp_ns=12_500_000_000)]


def test_the_end_of_a_goal_is_told_in_words_and_in_json(navigation: Navigation) -> None:
    to = ("goal", "1", "-0.5", "0.25", "--connect", navigation.endpoint)
    navigation.ends = {"error_code": 0}
    done = mazebot(*to)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "reached after 7.5 s")
    assert json.loads(mazebot(*to, "--json").stdout)["goal"]["y_m"] == -0.5
    navigation.ends = {"error_code": 206, "error_msg": "goal occupied"}
    assert_one_line(mazebot(*to), "(1, -0.5, 0.25)", "goal occupied", "206")
    done = mazebot(*to, "--json")
    assert (done.returncode, json.loads(done.stdout)["error_code"]) == (1, 206)


def test_whatever_is_driven_to_can_be_cancelled(navigation: Navigation) -> None:
    cancel = ("cancel", "--connect", navigation.endpoint)
    assert_one_line(mazebot(*cancel), "no active goal")
    assert navigation.cancelled == [CancelGoal()]
    goal = msg.PoseStamped(header=msg.header(1, "map"), pose=msg.pose_from_se2(SE2(2.0, 1.0, 0.0)))
    navigation.goals += [goal, goal]
    assert mazebot(*cancel).stdout == "canceled: (2, 1, 0); the robot stops\n"
    assert json.loads(mazebot(*cancel, "--json").stdout)["goal"]["x_m"] == 2.0


def test_a_message_is_published_as_often_as_is_said(navigation: Navigation) -> None:
    text = "{twist: {linear: {x: 0.2}, angular: {z: -1}}}"
    words = ("--times", "5", "--rate", "50", "--connect", navigation.endpoint)
    done = mazebot("topic", "pub", "/cmd_vel", text, *words)
    assert done.returncode == 0, done.stderr
    end_s = time.monotonic() + DEADLINE_S
    while len(navigation.commands) < 5 and time.monotonic() < end_s:
        time.sleep(0.01)
    assert len(navigation.commands) == 5
    command = navigation.commands[-1]
    assert (command.twist.linear.x, command.twist.angular.z) == (0.2, -1.0)
    assert command.header.frame_id == "base_footprint"
    assert msg.ns_from_time(command.header.stamp) == 12_500_000_000
    json_text = '{"pose": {"position": {"x": 1.5}}, "header": {"frame_id": "odom"}}'
    done = mazebot("topic", "pub", "goal_pose", json_text, "-1", "--connect", navigation.endpoint)
    assert navigation.came.wait(DEADLINE_S)
    goal = navigation.goals[-1]
    assert (goal.pose.position.x, goal.pose.orientation.w) == (1.5, 1.0)
    assert goal.header.frame_id == "odom"


def test_who_writes_and_reads_a_topic_is_told(navigation: Navigation) -> None:
    words = ("topic", "info", "/cmd_vel", "--connect", navigation.endpoint)
    told = json.loads(mazebot(*words, "--json").stdout)
    assert told["type"] == "geometry_msgs/msg/TwistStamped"
    assert told["publishers"] == {"navigation": True, "cli": False}
    assert told["subscribers"] == {"physics": True, "recorder": False}
    text = mazebot(*words).stdout
    assert "publishers: navigation, cli\n" in text
    assert "subscribers: physics, recorder (not running)\n" in text
    words = ("topic", "list", "--json", "--connect", navigation.endpoint)
    names = [row["name"] for row in json.loads(mazebot(*words).stdout)]
    assert "/scan" in names
    assert "/map" not in names


def test_nobody_to_read_is_told(endpoint: str) -> None:
    done = mazebot("topic", "pub", "/cmd_vel", "{}", "--once", "--connect", endpoint)
    assert_one_line(done, "/cmd_vel", "no physics or recorder is running")
