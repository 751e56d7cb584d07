"""The page that a browser opens."""

from __future__ import annotations

import contextlib
import http.client
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from mazebot.bench.parts.loopback_router import free_port
from mazebot.common.config import ConfigError
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.keeping import live as live_module
from mazebot.recorder.keeping.live import LiveView, WebPage, check_port_free
from mazebot.recorder.node import RecorderNode
from tests.cli.stack.running import wait_until


@pytest.fixture
def taken_port() -> Iterator[int]:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield listener.getsockname()[1]


def get(port: int, path: str, host: str = "maze.local") -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
    connection.request("GET", path, headers={"Host": f"{host}:{port}"})
    return connection.getresponse()


@pytest.mark.parametrize("name", ["web_port", "grpc_port"])
def test_a_taken_port_is_told_in_one_line_before_anything_starts(
    tmp_path: Path, taken_port: int, name: str
) -> None:
    ports = {"web_port": free_port(), "grpc_port": free_port(), name: taken_port}
    config = RecorderConfig(recordings_dir=tmp_path, live=True, bind="127.0.0.1", **ports)
    with pytest.raises(ConfigError, match=f"^{name}: port {taken_port} on 127.0.0.1: ") as told:
        RecorderNode(config)
    assert "\n" not in str(told.value)


def test_the_bare_address_leads_to_the_live_recording_by_the_browser_s_name_for_us() -> None:
    web_port, grpc_port = free_port(), free_port()
    live = LiveView("127.0.0.1", web_port, grpc_port, 64)
    try:
        answer = get(web_port, "/")
        assert answer.status == 302
        source = f"rerun%2Bhttp%3A%2F%2Fmaze.local%3A{grpc_port}%2Fproxy"
        assert answer.getheader("Location") == f"/?url={source}"
        page = get(web_port, f"/?url={source}")
        assert page.status == 200
        assert page.getheader("Content-Type") == "text/html"
        assert b"the_canvas_id" in page.read()
        with socket.create_connection(("127.0.0.1", grpc_port), 5.0):
            pass
    finally:
        live.close()
    check_port_free("given back", "127.0.0.1", web_port)
    # Rerun's server ends by itself, a little later.
    deadline_s = time.monotonic() + 10.0
    while True:
        try:
            check_port_free("given back", "127.0.0.1", grpc_port)
            break
        except ConfigError:
            assert time.monotonic() < deadline_s


def test_a_finished_recording_is_served_beside_the_viewer(tmp_path: Path) -> None:
    recording = tmp_path / "anything.rrd"
    recording.write_bytes(bytes(range(256)) * 100)
    later = tmp_path / "later.rrd"
    later.write_bytes(b"later")
    port = free_port()
    page = WebPage("127.0.0.1", port, recording=[recording, later])
    try:
        location = get(port, "/").getheader("Location")
        assert location == f"/?url=http%3A%2F%2Fmaze.local%3A{port}%2Frun.rrd"
        assert get(port, "/run.rrd").read() == recording.read_bytes() + b"later"
        assert get(port, "/no_such_file").status == 404
    finally:
        page.close()


@pytest.fixture
def page(tmp_path: Path) -> Iterator[int]:
    """The port of a page with a recording."""
    recording = tmp_path / "anything.rrd"
    recording.write_bytes(bytes(1000))
    port = free_port()
    served = WebPage("127.0.0.1", port, recording=[recording])
    yield port
    served.close()


def test_requests_that_are_never_finished_keep_nobody_out(page: int) -> None:
    before = threading.active_count()
    with contextlib.ExitStack() as stack:
        for number in range(200):
            stuck = stack.enter_context(socket.create_connection(("127.0.0.1", page), 5.0))
            if number % 2:
                stuck.sendall(b"GET / HTTP/1.1\r\nHost: ")
        start_s = time.monotonic()
        assert get(page, "/run.rrd").status == 200
        # Before those that are not finished would have been dropped anyway.
        assert time.monotonic() - start_s < live_module.REQUEST_S
        # Dropped ones take a moment to return.
        wait_until(
            lambda: threading.active_count() <= before + live_module.MAX_CONNECTIONS + 2, 30.0
        )


def test_a_request_that_waits_for_its_thread_is_not_dropped_for_newer_connections(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(live_module, "MAX_CONNECTIONS", 4)
    # Its threads never run.
    server = live_module._Server(("127.0.0.1", 0), live_module._Handler)
    with contextlib.ExitStack() as stack:
        stack.callback(server.server_close)
        browsers = []
        for number in range(6):
            here, browser = map(stack.enter_context, socket.socketpair())
            browser.sendall(b"GET / HTTP/1.1\r\n" + b"\r\n" * (number == 0))
            assert server.verify_request(here, None)
            browser.setblocking(False)
            browsers.append(browser)
        with pytest.raises(BlockingIOError):
            browsers[0].recv(1)
        assert [browser.recv(1) for browser in browsers[1:3]] == [b"", b""]


def test_who_takes_nothing_of_what_they_asked_for_is_let_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_module, "MAX_CONNECTIONS", 4)
    monkeypatch.setattr(live_module._Handler, "timeout", 0.3)
    recording = tmp_path / "anything.rrd"
    with recording.open("wb") as file:
        # More than two ends of a connection hold between them.
        file.truncate(64 * 1024 * 1024)
    port = free_port()
    page = WebPage("127.0.0.1", port, recording=[recording])
    try:
        with contextlib.ExitStack() as stack:
            for _ in range(4):
                idle = stack.enter_context(socket.create_connection(("127.0.0.1", port), 5.0))
                idle.sendall(b"GET /run.rrd HTTP/1.1\r\n\r\n")
                assert idle.recv(1) == b"H"
            with pytest.raises(ConnectionError):
                get(port, "/")
            deadline_s = time.monotonic() + 10.0
            while True:
                try:
                    assert get(port, "/").status == 302
                    break
                except ConnectionError:
                    assert time.monotonic() < deadline_s
    finally:
        page.close()


def test_a_request_that_takes_too_long_is_given_up(
    page: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_module, "REQUEST_S", 0.2)
    with socket.create_connection(("127.0.0.1", page), 5.0) as slow:
        slow.sendall(b"GET")
        # The other side closes it.
        assert slow.recv(1) == b""
