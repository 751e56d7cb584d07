"""Logging in to the console: who gets in, what each role may do, and how it ends."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from mazebot.common.client.reconnecting import ReconnectingRobot
from mazebot.common.client.robot import RobotError
from mazebot.console.config import ConsoleConfig
from mazebot.console.live.routes import live_routes
from mazebot.console.login import COOKIE, FREE_TRIES, IDLE_S, MAX_SESSIONS, MAX_WAIT_S, Logins
from mazebot.console.server import build_app
from mazebot.console.serving import ConsoleServer
from tests.console.conftest import FIRST
from tests.console.runs import make_run
from tests.console.served import Answer, Served

LABELS = f"/runs/{FIRST}/labels"


@dataclass(frozen=True)
class Locked:
    """A console that asks for a login, and its two addresses."""

    served: Served
    operators: str
    viewers: str

    def log_in(self, address: str) -> dict[str, str]:
        """The cookie that a browser gets by an address, as headers."""
        answer = self.served.ask(address)
        assert answer.status == 303
        assert answer.headers["location"] == "/"
        cookie = answer.headers["set-cookie"]
        assert cookie.startswith(f"{COOKIE}=")
        assert {"HttpOnly", "SameSite=lax"} <= set(cookie.split("; "))
        return {"Cookie": cookie.partition(";")[0]}

    def post(self, path: str, who: dict[str, str], **fields: str) -> Answer:
        return self.served.post(path, fields, who)

    def page(self, who: dict[str, str]) -> ClientConnection:
        url = f"127.0.0.1:{self.served.port}"
        return connect(
            f"ws://{url}/live/feed", origin=Origin(f"http://{url}"), additional_headers=who
        )


def no_stack() -> NoReturn:
    raise RobotError("no stack is running")


@pytest.fixture
def locked(tmp_path: Path) -> Iterator[Locked]:
    make_run(tmp_path / "runs", FIRST)
    config = ConsoleConfig(recordings_dir=tmp_path / "runs", port=0, login="always")
    robot = ReconnectingRobot(no_stack)
    server = ConsoleServer(build_app(config, live_routes(robot)), config)
    server.start()
    paths = ["/?" + urlsplit(url).query for url in (server.url, server.viewers_url)]
    yield Locked(Served(server.port, tmp_path / "runs"), *paths)
    server.stop()
    robot.close()


def test_without_a_login_nothing_is_seen(locked: Locked) -> None:
    for path in ("/", "/runs", f"/runs/{FIRST}/files/summary.json", "/live", "/sessions", "/nope"):
        answer = locked.served.ask(path)
        assert answer.status == 401, path
        assert FIRST not in answer.text
        assert "Log in" in answer.text
    answer = locked.served.ask("/runs.json", headers={"Accept": "application/json"})
    assert (answer.status, answer.json) == (401, {"error": "log in first"})
    assert locked.post(LABELS, {}, tags="x").status == 401
    assert locked.post("/sessions", {}, id="x").status == 401
    forged = {"Cookie": f"{COOKIE}=x; {COOKIE}=; a=b; =;"}
    assert locked.served.ask("/runs", headers=forged).status == 401
    with pytest.raises(InvalidStatus) as refused, locked.page(forged):
        pass
    assert refused.value.response.status_code == 403
    # A container's health check has no token, and the page to log in needs its looks.
    assert locked.served.ask("/healthz").status == 200
    assert locked.served.ask("/static/console.css").status == 200


def test_an_operator_does_all_until_the_logout(locked: Locked) -> None:
    who = locked.log_in(locked.operators)
    assert FIRST in locked.served.ask("/runs", headers=who).text
    assert "Log out" in locked.served.ask("/runs", headers=who).text
    assert locked.post(LABELS, who, note="good").json["note"] == "good"
    with locked.page(who) as page:
        page.send(json.dumps({"id": 1, "action": {"do": "cancel"}}))
        assert answer_of(page)["error"] == "no stack is running"
        assert locked.served.ask("/logout", "POST", who, b"").status == 303
        with contextlib.suppress(ConnectionClosed):
            while page.recv(20.0):
                pass
    assert locked.served.ask("/runs", headers=who).status == 401


def test_a_viewer_only_looks_on(locked: Locked) -> None:
    who = locked.log_in(locked.viewers)
    assert FIRST in locked.served.ask("/runs", headers=who).text
    answer = locked.post(LABELS, who, tags="good")
    assert answer.status == 403
    assert answer.json["error"].startswith("a viewer may only look on")
    assert locked.post(f"/runs/{FIRST}/delete", who, confirm=FIRST).status == 403
    assert locked.served.ask("/sessions", headers=who).status == 403
    assert (locked.served.folder / FIRST).is_dir()
    with locked.page(who) as page:
        orders: tuple[dict[str, Any], ...] = (
            {"do": "drive", "linear_m_s": 0.1, "angular_rad_s": 0.0},
            {"do": "cancel"},
            {"do": "simulation", "pause": True},
        )
        told = "a viewer may only look on: log in with the operator's token"
        for number, order in enumerate(orders):
            page.send(json.dumps({"id": number, "action": order}))
            assert answer_of(page)["error"] == f"{order['do']}: {told}"


def answer_of(page: ClientConnection) -> dict[str, Any]:
    while True:
        data = page.recv(20.0)
        frame: dict[str, Any] = json.loads(data) if isinstance(data, str) else {}
        if frame.get("kind") == "answer":
            answer: dict[str, Any] = frame["content"]
            return answer


def test_an_operator_ends_the_session_of_another(locked: Locked) -> None:
    who, other = locked.log_in(locked.operators), locked.log_in(locked.viewers)
    listed = locked.served.ask("/sessions", headers={**who, "Accept": "application/json"}).json
    assert [(one["role"], one["own"]) for one in listed] == [("operator", True), ("viewer", False)]
    assert "127.0.0.1" in locked.served.ask("/sessions", headers=who).text
    assert locked.post("/sessions", who, id="nope").status == 404
    assert locked.post("/sessions", who, id=listed[1]["id"]).status == 303
    assert locked.served.ask("/runs", headers=other).status == 401
    assert locked.served.ask("/runs", headers=who).status == 200


def test_a_program_sends_the_token_with_each_request(locked: Locked) -> None:
    token = locked.viewers.rpartition("=")[2]
    who = {"Authorization": f"Bearer {token}", "Accept": "application/json"}
    assert locked.served.ask("/runs.json", headers=who).status == 200
    assert locked.post(LABELS, who, tags="x").status == 403
    who["Authorization"] = "Bearer nope"
    assert locked.served.ask("/runs.json", headers=who).status == 401
    assert locked.served.ask("/runs.json", headers={"Authorization": "Basic eA=="}).status == 401


def test_a_wrong_token_is_told_and_slowed_down(locked: Locked) -> None:
    for _ in range(FREE_TRIES):
        answer = locked.post("/login", {}, token="nope")
        assert answer.status == 401
        assert answer.json["error"].startswith("the token is wrong")
    # The right one, too, so that nothing is told by the answer.
    answer = locked.served.ask(locked.operators, headers={"Accept": "application/json"})
    assert answer.status == 429
    assert answer.json["error"].startswith("too many wrong tokens")
    assert int(answer.headers["retry-after"]) >= 1
    assert "set-cookie" not in answer.headers


def test_a_token_goes_by_the_form_too_and_leaves_the_address(locked: Locked) -> None:
    form = {"Content-Type": "application/x-www-form-urlencoded"}
    token = locked.operators.rpartition("=")[2]
    answer = locked.served.ask("/login", "POST", form, f"token={token}")
    assert answer.status == 303
    assert answer.headers["location"] == "/"
    answer = locked.served.ask(f"//evil.example/x?page=2&token={token}")
    assert answer.headers["location"] == "/evil.example/x?page=2"


@pytest.mark.parametrize(
    ("bind", "login", "asks"),
    [
        ("127.0.0.1", "auto", False),
        ("localhost", "auto", False),
        ("0.0.0.0", "auto", True),
        ("::", "auto", True),
        ("127.0.0.1", "always", True),
        ("0.0.0.0", "never", False),
    ],
)
def test_who_is_reached_by_others_asks_who_they_are(
    tmp_path: Path, bind: str, login: Any, asks: bool
) -> None:
    config = ConsoleConfig(recordings_dir=tmp_path, bind=bind, login=login)
    assert (build_app(config).state.logins is not None) == asks


class Clock:
    def __init__(self) -> None:
        self.s = 100.0

    def __call__(self) -> float:
        return self.s


def test_an_address_waits_longer_after_each_wrong_token_and_others_do_not() -> None:
    clock = Clock()
    logins = Logins(clock)
    waits = []
    for _ in range(FREE_TRIES + 8):
        assert logins.log_in("nope", "a") is None
        waits.append(logins.wait_s("a"))
        clock.s += waits[-1]
    assert waits == [0.0] * (FREE_TRIES - 1) + [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, *[MAX_WAIT_S] * 3]
    assert logins.wait_s("b") == 0.0
    assert logins.log_in(logins.tokens["viewer"], "a") is not None
    assert logins.wait_s("a") == 0.0


def test_a_session_ends_when_it_is_idle_and_there_is_a_limit() -> None:
    clock = Clock()
    logins = Logins(clock)
    token = logins.tokens["operator"]
    for number in range(MAX_SESSIONS + 5):
        clock.s += 1.0
        assert logins.log_in(token, str(number)) is not None
    assert [one.address for one in logins.sessions()][:1] == ["5"]
    assert len(logins.sessions()) == MAX_SESSIONS
    clock.s += IDLE_S + 1.0
    assert not logins.sessions()
    assert logins.tokens["viewer"] != token
    assert Logins().tokens["operator"] != token
