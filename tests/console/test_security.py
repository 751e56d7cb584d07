"""What a foreign page, a hostile address or a broken client gets from the console."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from mazebot.console.config import ConsoleConfig
from mazebot.console.security import host_of, is_known_host
from mazebot.console.server import build_app
from mazebot.console.serving import ConsoleServer
from tests.console.conftest import FIRST, SECOND
from tests.console.runs import make_run
from tests.console.served import Served, console, wait_until

LABELS = f"/runs/{FIRST}/labels"

OUTSIDE = [
    "/runs/../secret.txt",
    "/runs/%2e%2e/secret.txt",
    "/runs/..%2fsecret.txt",
    f"/runs/{FIRST}/files/../../../secret.txt",
    f"/runs/{FIRST}/files/..%2f..%2f..%2fsecret.txt",
    f"/runs/{FIRST}/files/%2e%2e/%2e%2e/secret.txt",
    f"/runs/{FIRST}/files/..%5c..%5csecret.txt",
    f"/runs/{FIRST}/files/%252e%252e%252fsecret.txt",
    f"/runs/{FIRST}/files//etc/passwd",
    f"/runs/{FIRST}/files/%2fetc%2fpasswd",
    f"/runs/{FIRST}/files/summary.json%00.txt",
    f"/runs/{FIRST}/files/summary.json%0a",
    f"/runs/{FIRST}/files/.",
    f"/runs/{FIRST}/files/",
    f"/runs/{FIRST}/files/{'x' * 300}",
    f"/runs/{FIRST}/files/{'x/' * 500}",
    f"/runs/{FIRST}/files/.recording",
    f"/runs/{FIRST}/files/%ff%fe",
    "/runs/%00",
    f"/runs/{'x' * 300}",
    "/static/../server.py",
    "/static/%2e%2e/server.py",
    "/viewer/0.41.0/../../../secret.txt",
    "/viewer/0.41.0/__init__.py",
    "/viewer/none/widget.js",
    "/nothing",
    "//evil.example/runs",
]


@pytest.mark.parametrize("path", OUTSIDE)
def test_nothing_outside_of_a_run_can_be_read(shared: Served, path: str) -> None:
    answer = shared.ask(path)
    assert answer.status in (400, 404)
    assert b"outside" not in answer.body
    assert b"root:" not in answer.body
    assert b"Traceback" not in answer.body


def test_links_are_not_followed(served: Served) -> None:
    secret = served.folder.parent / "secret.txt"
    run = served.folder / FIRST
    (run / "link.txt").symlink_to(secret)
    (run / "up").symlink_to(served.folder.parent)
    (served.folder / "linked").symlink_to(served.folder.parent)
    (run / "config.yaml").symlink_to(secret)
    for path in (f"{FIRST}/files/link.txt", f"{FIRST}/files/up/secret.txt", "linked"):
        assert served.ask(f"/runs/{path}").status == 404
    page = served.ask(f"/runs/{FIRST}")
    assert page.status == 200
    assert "config.yaml: is a symbolic link" in page.text
    assert "outside" not in page.text


def test_a_pipe_in_a_run_blocks_nobody(served: Served) -> None:
    os.mkfifo(served.folder / FIRST / "pipe.txt")
    assert served.ask(f"/runs/{FIRST}/files/pipe.txt").status == 404


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example", "192.168.0.9", "[::2]"])
def test_a_page_whose_name_was_rebound_to_us_gets_nothing(shared: Served, host: str) -> None:
    answer = shared.ask("/runs", headers={"Host": f"{host}:{shared.port}"})
    assert answer.status == 421
    assert FIRST not in answer.text


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST", "127.0.0.1", "[::1]", "localhost."])
def test_our_own_names_are_known(shared: Served, host: str) -> None:
    assert shared.ask("/healthz", headers={"Host": f"{host}:{shared.port}"}).status == 200


@pytest.mark.parametrize(
    "host", ["", "a b", "localhost@evil.example", "localhost/x", "localhost:x"]
)
def test_a_host_that_is_none_is_refused(shared: Served, host: str) -> None:
    assert shared.ask("/healthz", headers={"Host": host}).status in (400, 421)


def test_names_can_be_added_and_addresses_hold_where_all_are_bound() -> None:
    config = ConsoleConfig(hosts="lab.example, robot")
    assert config.hosts == ("lab.example", "robot")
    assert host_of("Lab.Example:8080") == "lab.example"
    assert is_known_host("192.168.0.9:8080", {"localhost"}, any_address=True)
    assert not is_known_host("evil.example", {"localhost"}, any_address=True)


FOREIGN = [
    {"Origin": "http://evil.example"},
    {"Origin": "null"},
    {"Origin": "http://localhost:1"},
    {"Origin": "file://"},
    {"Sec-Fetch-Site": "cross-site"},
    {"Sec-Fetch-Site": "same-site"},
]


@pytest.mark.parametrize("headers", FOREIGN)
@pytest.mark.parametrize("method", ["POST", "DELETE", "PUT", "PATCH"])
def test_a_foreign_page_changes_nothing(
    shared: Served, headers: dict[str, str], method: str
) -> None:
    sent = {"Content-Type": "application/x-www-form-urlencoded", **headers}
    for path in (LABELS, f"/runs/{FIRST}/delete", "/healthz"):
        body = f"tags=bad&confirm={FIRST}"
        assert shared.ask(path, method, sent, body).status == 403
    assert (shared.folder / FIRST / "summary.json").exists()
    assert not (shared.folder / FIRST / "labels.json").exists()


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("POST", "/runs"),
        ("DELETE", f"/runs/{FIRST}"),
        ("PUT", f"/runs/{FIRST}/files/summary.json"),
        ("GET", LABELS),
        ("POST", "/static/console.css"),
        ("PATCH", "/compare"),
        ("NONSENSE", "/runs"),
    ],
)
def test_a_wrong_method_is_405(shared: Served, method: str, path: str) -> None:
    assert shared.ask(path, method).status == 405


TRIES = 10


def refusal(ask: Callable[[], int]) -> int:
    """The status of an answer. Who answers and closes before he has read all that was sent resets
    the connection, and with it may go the answer that was under way: then it is asked again.
    """
    for _ in range(TRIES):
        with contextlib.suppress(ConnectionResetError, BrokenPipeError):
            return ask()
    raise AssertionError(f"{TRIES} connections were reset, and nothing was answered")


def told_after(served: Served, sent: bytes) -> int:
    """The status of what is answered to some bytes."""
    with served.connect() as connection:
        connection.sendall(sent)
        version, status, _ = connection.recv(200).split(b" ", 2)
    assert version == b"HTTP/1.1"
    return int(status)


def test_a_huge_body_is_413_whether_it_says_so_or_not(shared: Served) -> None:
    form = {"Content-Type": "application/x-www-form-urlencoded"}
    huge = b"x" * 70_000
    assert refusal(lambda: shared.ask(LABELS, "POST", form, huge).status) == 413
    told = {**form, "Content-Length": "9" * 12}
    assert shared.ask(LABELS, "POST", told).status == 413
    head = f"POST {LABELS} HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n"
    chunk = (b"%x\r\n" % len(huge)) + huge + b"\r\n0\r\n\r\n"
    sent = head.encode() + b"Content-Type: application/json\r\n\r\n" + chunk
    assert refusal(lambda: told_after(shared, sent)) == 413


def test_huge_addresses_and_headers_are_refused(shared: Served) -> None:
    assert shared.ask("/runs?q=" + "x" * 5000).status == 414
    long = {"X-Long": "x" * 100_000}
    assert refusal(lambda: shared.ask("/runs", headers=long).status) in (400, 431)
    sent = b"GET /" + b"x" * 100_000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n"
    assert refusal(lambda: told_after(shared, sent)) in (400, 414)


@pytest.mark.parametrize(
    "sent",
    [b"\x16\x03\x01\x02\x00", b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"\0" * 100 + b"\r\n\r\n"],
)
def test_what_is_no_request_is_400_or_closed(shared: Served, sent: bytes) -> None:
    with shared.connect() as broken:
        broken.sendall(sent)
        broken.shutdown(socket.SHUT_WR)
        answer = broken.recv(200)
    assert answer == b"" or b" 400 " in answer


@pytest.mark.parametrize(
    ("kind", "body", "status"),
    [
        ("application/json", "{", 400),
        ("application/json", "[" * 60_000, 400),
        ("application/json", "[]", 422),
        ("text/plain", "tags=a", 415),
        ("multipart/form-data", "tags=a", 415),
        ("application/x-www-form-urlencoded", "&".join("a=b" for _ in range(100)), 400),
        ("application/x-www-form-urlencoded", b"\xff\xfe", 400),
    ],
)
def test_a_body_that_cannot_be_read_is_refused(
    shared: Served, kind: str, body: str | bytes, status: int
) -> None:
    assert shared.ask(LABELS, "POST", {"Content-Type": kind}, body).status == status


def test_a_client_that_sends_slowly_is_let_go(tmp_path: Path) -> None:
    with console(tmp_path, request_timeout_s=0.3) as served:
        with served.connect() as silent, served.connect() as slow, served.connect() as half:
            half.sendall(b"GET /healthz HTTP/1.1\r\nHost: lo")
            slow.sendall(
                b"POST /runs/x/labels HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\nx"
            )
            assert silent.recv(10) == b""
            assert half.recv(10) == b""
            answer = slow.recv(1000)
        assert b" 404 " in answer or b" 408 " in answer
        assert served.ask("/healthz").status == 200


def test_two_hundred_connections_at_once_are_answered(shared: Served) -> None:
    held = [shared.connect() for _ in range(200)]
    try:
        with ThreadPoolExecutor(16) as pool:
            statuses = set(pool.map(lambda _: shared.ask("/runs").status, range(64)))
        assert statuses == {200}
        for connection in held:
            connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert all(b" 200 " in connection.recv(100) for connection in held)
    finally:
        for connection in held:
            connection.close()


def test_more_connections_than_allowed_are_503_and_it_recovers(tmp_path: Path) -> None:
    with console(tmp_path, max_connections=8) as served:
        held = [served.connect() for _ in range(12)]
        wait_until(lambda: served.ask("/healthz").status == 503, "too many")
        for connection in held:
            connection.close()
        wait_until(lambda: served.ask("/healthz").status == 200, "room again")


def test_every_answer_forbids_what_a_page_does_not_need(shared: Served) -> None:
    for path in ("/runs", f"/runs/{FIRST}", "/compare", "/static/runs.js", "/nothing", "/healthz"):
        headers = shared.ask(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        scripts = next(part for part in policy.split("; ") if part.startswith("script-src"))
        assert "unsafe-inline" not in scripts
        assert "'unsafe-eval'" not in scripts
        assert "http" not in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cross-origin-resource-policy"] == "same-origin"
        assert "server" not in headers
    assert "'wasm-unsafe-eval'" not in shared.ask("/runs").headers["content-security-policy"]


def test_a_report_is_shown_in_our_page_only_and_runs_no_script(served: Served) -> None:
    (served.folder / FIRST / "report.html").write_text("<script>alert(1)</script>")
    headers = served.ask(f"/runs/{FIRST}/report").headers
    assert "sandbox" in headers["content-security-policy"]
    assert "script-src" not in headers["content-security-policy"]
    assert "frame-ancestors 'self'" in headers["content-security-policy"]
    download = served.ask(f"/runs/{FIRST}/files/report.html").headers
    assert download["content-disposition"].startswith("attachment")


def test_what_a_run_says_of_itself_is_no_html(served: Served) -> None:
    evil = "<script>alert(1)</script>"
    make_run(served.folder, "evil", {"world": evil, "changed_settings": {evil: {"value": evil}}})
    (served.folder / "evil" / f"{evil[:7]}.txt").write_text("")
    for path in ("/runs", "/runs/evil", "/runs.json", f"/compare?run=evil&run={FIRST}"):
        answer = served.ask(path, headers={"Accept": "text/html"})
        assert answer.status == 200
        assert "<script>alert" not in answer.text


@pytest.fixture
def failing(tmp_path: Path) -> Iterator[Served]:
    """A console with a route that fails, and a websocket."""

    async def fails(request: Request) -> Response:
        raise RuntimeError("secret\nTraceback of it")

    async def echoes(websocket: WebSocket) -> None:
        await websocket.accept()
        await websocket.send_text("hello")
        await websocket.close()

    config = ConsoleConfig(recordings_dir=tmp_path, port=0)
    app = build_app(config, [Route("/live", fails), WebSocketRoute("/live/feed", echoes)])
    server = ConsoleServer(app, config)
    server.start()
    yield Served(server.port, tmp_path)
    server.stop()


def test_an_error_of_ours_is_one_line_in_the_log_and_none_in_the_answer(
    failing: Served, caplog: pytest.LogCaptureFixture
) -> None:
    answer = failing.ask("/live")
    assert answer.status == 500
    assert "secret" not in answer.text
    assert "content-security-policy" in answer.headers
    (record,) = [one for one in caplog.records if one.levelname == "ERROR"]
    assert record.getMessage() == "GET '/live': RuntimeError: secret Traceback of it"
    assert record.exc_info is None


def test_only_our_own_page_gets_a_websocket(failing: Served) -> None:
    address = f"ws://localhost:{failing.port}/live/feed"
    own = {"Origin": f"http://localhost:{failing.port}"}
    with connect(address, additional_headers=own, proxy=None) as websocket:
        assert websocket.recv() == "hello"
    foreign: list[dict[str, str]] = [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {},
        {**own, "Sec-Fetch-Site": "cross-site"},
    ]
    for headers in foreign:
        with pytest.raises(InvalidStatus) as caught:
            connect(address, additional_headers=headers, proxy=None)
        assert caught.value.response.status_code == 403
    rebound = failing.ask(
        "/live/feed",
        headers={
            "Host": "evil.example",
            "Origin": "http://evil.example",
            "Connection": "Upgrade",
            "Upgrade": "websocket",
            "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        },
    )
    assert rebound.status == 403


def test_scripts_get_their_errors_as_json(shared: Served) -> None:
    answer = shared.ask("/runs/none", headers={"Accept": "application/json"})
    assert answer.status == 404
    assert json.loads(answer.body) == {"error": "no such run: 'none'"}
    assert SECOND not in answer.text
