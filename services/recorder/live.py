"""What a browser opens: the page that shows a recording, and the server of a live one."""

from __future__ import annotations

import contextlib
import http.client
import os
import shutil
import socket
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar
from urllib.parse import quote, urlsplit

import rerun as rr

from services.common.config import ConfigError

_RECORDING = "run.rrd"
_WAITING = "waiting for a run"
_LOOK_S = 0.05
"""How often the page looks whether it is to end."""
_PASSED_HEADERS = ("Content-Type", "Content-Length", "rerun-final-length")


def check_port_free(name: str, bind: str, port: int) -> None:
    """Raise ConfigError with one line where something listens on a port already, or nothing may."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((bind, port))
        except OSError as error:
            raise ConfigError(f"{name}: port {port} on {bind}: {error.strerror}") from error


class LiveView:
    """Serves what is recorded to any number of browsers, from before the first run to the last.

    The bare address shows the live recording, by whatever name the machine is called.
    """

    def __init__(self, bind: str, web_port: int, grpc_port: int, memory_mib: int) -> None:
        """Raises ConfigError, naming the port, where one is taken."""
        check_port_free("web_port", bind, web_port)
        check_port_free("grpc_port", bind, grpc_port)
        loopback = "127.0.0.1" if bind in ("", "0.0.0.0") else bind
        self.url = f"rerun+http://{loopback}:{grpc_port}/proxy"
        # The server outlives every run, so it hangs on a recording of its own.
        self._server = rr.RecordingStream(_WAITING, recording_id="waiting", send_properties=False)
        try:
            self._server.set_sinks(
                rr.GrpcServerSink(bind, grpc_port, server_memory_limit=f"{memory_mib}MiB")
            )
        except (RuntimeError, OSError) as error:
            raise ConfigError(f"grpc_port: port {grpc_port} on {bind}: {error}") from error
        self._server.send_recording_name(_WAITING)
        text = rr.TextDocument("Waiting for a run. It will show here.")
        self._server.log("waiting", text, static=True)
        self._page = WebPage(bind, web_port, grpc_port=grpc_port)

    def close(self) -> None:
        """Stop serving."""
        self._page.close()
        self._server.disconnect()


class WebPage:
    """The Rerun web viewer of the installed package, with `/` leading to the recording to show.

    It shows what comes from `grpc_port` on the same machine, or else the file `recording`.
    """

    def __init__(
        self, bind: str, web_port: int, *, grpc_port: int = 0, recording: Path | None = None
    ) -> None:
        """Raises ConfigError where the port is taken."""
        values = {
            "web_port": web_port,
            "grpc_port": grpc_port,
            "recording": recording,
            "files_port": _serve_viewer_files(),
        }
        handler = type("Handler", (_Handler,), values)
        try:
            self._http = ThreadingHTTPServer((bind, web_port), handler)
        except OSError as error:
            raise ConfigError(f"web_port: port {web_port} on {bind}: {error.strerror}") from error
        self._http.daemon_threads = True
        threading.Thread(
            target=self._http.serve_forever, args=(_LOOK_S,), name="web", daemon=True
        ).start()

    def close(self) -> None:
        """Stop serving."""
        self._http.shutdown()
        self._http.server_close()


class _Handler(BaseHTTPRequestHandler):
    web_port: ClassVar[int]
    grpc_port: ClassVar[int]
    recording: ClassVar[Path | None]
    files_port: ClassVar[int]

    def do_GET(self) -> None:
        """Lead `/` to the recording; pass what is not ours on to the package's own file server."""
        parts = urlsplit(self.path)
        if parts.path == "/" and "url=" not in parts.query:
            host = urlsplit(f"//{self.headers.get('Host', '')}").hostname or "localhost"
            host = f"[{host}]" if ":" in host else host
            source = f"rerun+http://{host}:{self.grpc_port}/proxy"
            if self.recording is not None:
                source = f"http://{host}:{self.web_port}/{_RECORDING}"
            self.send_response(302)
            self.send_header("Location", f"/?url={quote(source, safe='')}")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        with contextlib.suppress(ConnectionError):
            if self.recording is not None and parts.path == f"/{_RECORDING}":
                self._send_recording(self.recording)
            else:
                self._pass_on()

    def _send_recording(self, recording: Path) -> None:
        with recording.open("rb") as file:
            self.send_response(200)
            self.send_header("Content-Type", "application/octet-stream")
            self.send_header("Content-Length", str(os.fstat(file.fileno()).st_size))
            self.end_headers()
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
        """Requests are nobody's news."""


def _serve_viewer_files() -> int:
    """Start the file server inside the Rerun package on a free port; that port."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    rr.serve_web_viewer(web_port=port, open_browser=False)
    return port
