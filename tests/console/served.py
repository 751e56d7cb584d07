"""A console on a free port, and requests to it as no browser would send them."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mazebot.console.config import ConsoleConfig
from mazebot.console.server import build_app
from mazebot.console.serving import ConsoleServer

Headers = dict[str, str]
_PATIENCE_S = 20.0


@dataclass(frozen=True)
class Answer:
    """What the console has answered."""

    status: int
    headers: Headers
    """With names in small letters."""
    body: bytes

    @property
    def text(self) -> str:
        """The body as text."""
        return self.body.decode()

    @property
    def json(self) -> Any:
        """The body as JSON."""
        return json.loads(self.body)


@dataclass(frozen=True)
class Served:
    """A running console."""

    port: int
    folder: Path

    @property
    def url(self) -> str:
        """The address for a browser."""
        return f"http://localhost:{self.port}"

    def ask(
        self,
        path: str,
        method: str = "GET",
        headers: Headers | None = None,
        body: bytes | str | None = None,
    ) -> Answer:
        """One request on a connection of its own. The path is sent as it is."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=_PATIENCE_S)
        try:
            connection.putrequest(method, path, skip_host="Host" in (headers or {}))
            data = body.encode() if isinstance(body, str) else body
            for name, value in (headers or {}).items():
                connection.putheader(name, value)
            if data is not None and "Transfer-Encoding" not in (headers or {}):
                connection.putheader("Content-Length", str(len(data)))
            connection.endheaders(data)
            with connection.getresponse() as answer:
                names = {name.lower(): value for name, value in answer.getheaders()}
                return Answer(answer.status, names, answer.read())
        finally:
            connection.close()

    def post(self, path: str, fields: dict[str, Any], headers: Headers | None = None) -> Answer:
        """A POST of JSON, as one of our pages sends it."""
        sent = {
            "Content-Type": "application/json",
            "Accept": "application/json",
            "Origin": f"http://127.0.0.1:{self.port}",
            **(headers or {}),
        }
        return self.ask(path, "POST", sent, json.dumps(fields))

    def connect(self) -> socket.socket:
        """A bare connection."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=_PATIENCE_S)


@contextlib.contextmanager
def console(folder: Path, **settings: Any) -> Iterator[Served]:
    """A console that shows a folder, on a free port."""
    config = ConsoleConfig(recordings_dir=folder, port=0, live=False, **settings)
    server = ConsoleServer(build_app(config), config)
    server.start()
    try:
        yield Served(server.port, folder)
    finally:
        server.stop()


def wait_until(condition: Callable[[], bool], what: str, deadline_s: float = _PATIENCE_S) -> None:
    """Raises AssertionError where a condition does not hold before the deadline."""
    end_s = time.monotonic() + deadline_s
    while not condition():
        assert time.monotonic() < end_s, what
        time.sleep(0.02)
