"""The web page that shows a recording, and the server of a live one."""

from __future__ import annotations

import contextlib
import http.client
import os
import shutil
import socket
import threading
import time
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar, cast
from urllib.parse import quote, urlsplit

import rerun as rr

from mazebot.common.config import ConfigError
from mazebot.recorder.stream.live_feed import LiveFeed

_RECORDING = "run.rrd"
_WAITING = "waiting for a run"
_MEMORY_SHARE = 2
"""Rerun counts the data alone: with small chunks, what they take is twice that and more."""
_LOOK_S = 0.05
"""How often the page server checks whether to stop."""
_END_TIMEOUT_S = 0.5
MAX_CONNECTIONS = 32
"""Connections served at once by the page, one thread each; a browser uses six."""
REQUEST_S = 10.0
"""Timeout for a browser's request to be complete."""
STALL_S = 30.0
"""Timeout for a browser to accept a part of the response."""
_MOST_HEADERS = 65_536
"""Bytes of a request that are looked at."""
_PASSED_HEADERS = ("Content-Type", "Content-Length", "rerun-final-length")


def check_port_free(name: str, bind: str, port: int) -> None:
    """Raise ConfigError with one line if a port is in use or may not be bound."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((bind, port))
        except OSError as error:
            raise ConfigError(f"{name}: port {port} on {bind}: {error.strerror}") from error


class LiveView:
    """Serves the live recording to any number of browsers, from before the first run to the last.

    The page's root URL shows the live recording, under any host name of the machine.
    """

    def __init__(self, bind: str, web_port: int, grpc_port: int, memory_mib: int) -> None:
        """Raises ConfigError, naming the port, if one is in use."""
        check_port_free("web_port", bind, web_port)
        check_port_free("grpc_port", bind, grpc_port)
        loopback = "127.0.0.1" if bind in ("", "0.0.0.0") else bind
        url = f"rerun+http://{loopback}:{grpc_port}/proxy"
        # The server outlives every run, so it is owned by a separate recording.
        self._server = rr.RecordingStream(_WAITING, recording_id="waiting", send_properties=False)
        try:
            self._server.set_sinks(
                rr.GrpcServerSink(
                    bind, grpc_port, server_memory_limit=f"{memory_mib // _MEMORY_SHARE}MiB"
                )
            )
        except (RuntimeError, OSError) as error:
            raise ConfigError(f"grpc_port: port {grpc_port} on {bind}: {error}") from error
        self._server.send_recording_name(_WAITING)
        text = rr.TextDocument("Waiting for a run. It will appear here.")
        self._server.log("waiting", text, static=True)
        self._page = WebPage(bind, web_port, grpc_port=grpc_port)
        self.feed = LiveFeed(url)

    def close(self) -> None:
        """Stop serving; unresponsive viewers are not waited for."""
        self._page.close()
        self.feed.close()
        # Disconnecting waits for the viewers.
        ending = threading.Thread(target=self._server.disconnect, name="end of view", daemon=True)
        ending.start()
        ending.join(_END_TIMEOUT_S)


class WebPage:
    """The Rerun web viewer of the installed package, with `/` redirecting to the recording.

    It shows the stream of `grpc_port` on the same machine, or else the parts of a `recording`.
    """

    def __init__(
        self, bind: str, web_port: int, *, grpc_port: int = 0, recording: Sequence[Path] = ()
    ) -> None:
        """Raises ConfigError if the port is in use."""
        values = {
            "web_port": web_port,
            "grpc_port": grpc_port,
            "recording": tuple(recording),
            "files_port": _serve_viewer_files(),
        }
        handler = type("Handler", (_Handler,), values)
        try:
            self._http = _Server((bind, web_port), handler)
        except OSError as error:
            raise ConfigError(f"web_port: port {web_port} on {bind}: {error.strerror}") from error
        threading.Thread(
            target=self._http.serve_forever, args=(_LOOK_S,), name="web", daemon=True
        ).start()

    def close(self) -> None:
        """Stop serving."""
        self._http.shutdown()
        self._http.server_close()


class _Server(ThreadingHTTPServer):
    """Serves a limited number of connections. A new one beyond that replaces the oldest without a
    complete request; if there is none, the new one is refused.
    """

    daemon_threads = True
    request_queue_size = 256

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._guard = threading.Lock()
        self._unfinished: dict[socket.socket, float] = {}
        """Connections without a complete request, oldest first, with their arrival times."""
        self._served: set[socket.socket] = set()
        super().__init__(address, handler)

    def asks(self, connection: socket.socket) -> None:
        """A connection's request is complete."""
        with self._guard:
            self._unfinished.pop(connection, None)

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Whether one more connection is accepted."""
        with self._guard:
            if len(self._served) >= MAX_CONNECTIONS:
                oldest = next((one for one in self._unfinished if not _waits(one)), None)
                if oldest is None:
                    return False
                self._drop(oldest)
            self._served.add(request)
            self._unfinished[request] = time.monotonic()
        return True

    def service_actions(self) -> None:
        """Drop connections whose request times out, even if they send a byte now and then."""
        now_s = time.monotonic()
        with self._guard:
            late = [one for one, came_s in self._unfinished.items() if now_s - came_s > REQUEST_S]
            for connection in late:
                self._drop(connection)

    def _drop(self, connection: socket.socket) -> None:
        del self._unfinished[connection]
        self._served.discard(connection)
        with contextlib.suppress(OSError):
            # The thread that reads from it then returns, and closes it.
            connection.shutdown(socket.SHUT_RDWR)

    def shutdown_request(self, request: Any) -> None:
        """Remove an ended connection."""
        with self._guard:
            self._unfinished.pop(request, None)
            self._served.discard(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that disconnects early is not logged."""


def _waits(connection: socket.socket) -> bool:
    """Whether a complete request has come, which its thread has not got to yet."""
    # Of itself a socket with a timeout would wait for something to come.
    with (
        contextlib.suppress(OSError),
        socket.socket(fileno=os.dup(connection.fileno())) as same,
    ):
        return b"\r\n\r\n" in same.recv(_MOST_HEADERS, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    return False


class _Handler(BaseHTTPRequestHandler):
    timeout = STALL_S
    web_port: ClassVar[int]
    grpc_port: ClassVar[int]
    recording: ClassVar[tuple[Path, ...]]
    files_port: ClassVar[int]

    def do_GET(self) -> None:
        """Redirect `/` to the recording; pass other requests to the package's own file server."""
        cast("_Server", self.server).asks(self.connection)
        parts = urlsplit(self.path)
        if parts.path == "/" and "url=" not in parts.query:
            host = urlsplit(f"//{self.headers.get('Host', '')}").hostname or "localhost"
            host = f"[{host}]" if ":" in host else host
            source = f"rerun+http://{host}:{self.grpc_port}/proxy"
            if self.recording:
                source = f"http://{host}:{self.web_port}/{_RECORDING}"
            self.send_response(302)
            self.send_header("Location", f"/?url={quote(source, safe='')}")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        with contextlib.suppress(ConnectionError, TimeoutError):
            if self.recording and parts.path == f"/{_RECORDING}":
                self._send_recording(self.recording)
            else:
                self._pass_on()

    def _send_recording(self, parts: Sequence[Path]) -> None:
        """One file after the other: a viewer reads them as one."""
        with contextlib.ExitStack() as stack:
            files = [stack.enter_context(part.open("rb")) for part in parts]
            size_bytes = sum(os.fstat(file.fileno()).st_size for file in files)
            self.send_response(200)
            self.send_header("Content-Type", "application/octet-stream")
            self.send_header("Content-Length", str(size_bytes))
            self.end_headers()
            for file in files:
                shutil.copyfileobj(file, self.wfile)

    def _pass_on(self) -> None:
        connection = http.client.HTTPConnection("127.0.0.1", self.files_port, timeout=30.0)
        try:
            connection.request("GET", self.path)
            answer = connection.getresponse()
            self.send_response(answer.status)
            for name in _PASSED_HEADERS:
                value = answer.getheader(name)
                if value is not None:
                    self.send_header(name, value)
            self.end_headers()
            shutil.copyfileobj(answer, self.wfile)
        finally:
            connection.close()

    def log_message(self, format: str, *args: object) -> None:
        """Requests are not logged."""


def _serve_viewer_files() -> int:
    """Start the file server of the Rerun package on a free port; returns the port."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    rr.serve_web_viewer(web_port=port, open_browser=False)
    return port
