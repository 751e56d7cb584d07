"""Serves the application on a socket."""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import threading
from typing import Any

import uvicorn
from starlette.applications import Starlette
from uvicorn.protocols.http.h11_impl import H11Protocol

from mazebot.common.config import ConfigError
from mazebot.console.config import ConsoleConfig
from mazebot.console.login import OPERATOR, TOKEN, VIEWER, Logins
from mazebot.console.security import MAX_HEADERS_BYTES

MAX_WEBSOCKET_BYTES = 64 * 1024
_STOP_S = 1


class ConsoleServer:
    """The application on its address, from `start()` or `run()` until `stop()`."""

    def __init__(self, app: Starlette, config: ConsoleConfig) -> None:
        """Raises ConfigError if the address cannot be used."""
        self._logins: Logins | None = app.state.logins
        self._socket = _listening(config.bind, config.port)
        self.port: int = self._socket.getsockname()[1]
        self._server = uvicorn.Server(
            uvicorn.Config(
                app,
                http=_protocol(config.request_timeout_s),
                ws="websockets-sansio",
                ws_max_size=MAX_WEBSOCKET_BYTES,
                log_config=None,
                access_log=False,
                server_header=False,
                proxy_headers=False,
                limit_concurrency=config.max_connections,
                h11_max_incomplete_event_size=MAX_HEADERS_BYTES,
                timeout_keep_alive=10,
                timeout_graceful_shutdown=_STOP_S,
            )
        )
        app.state.is_ending = lambda: self._server.should_exit
        for name in ("uvicorn", "uvicorn.error"):
            logging.getLogger(name).setLevel(logging.ERROR)
            logging.getLogger(name).addFilter(_without_traceback)
        self._thread: threading.Thread | None = None

    @property
    def url(self) -> str:
        """The address of the first page, for a browser on this machine; where one must log in, it
        makes an operator.
        """
        return self._address(OPERATOR)

    @property
    def viewers_url(self) -> str:
        """The address for those who may only look on; "": nobody need log in."""
        return "" if self._logins is None else self._address(VIEWER)

    def _address(self, role: str) -> str:
        host = self._socket.getsockname()[0]
        if host in ("0.0.0.0", "127.0.0.1", "::", "::1"):
            host = "localhost"
        page = f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"
        return page if self._logins is None else f"{page}?{TOKEN}={self._logins.tokens[role]}"

    def run(self) -> None:
        """Serve until SIGTERM, SIGINT or `stop()`."""
        asyncio.run(self._server.serve(sockets=[self._socket]))

    def start(self) -> None:
        """Serve in a thread of its own."""
        self._thread = threading.Thread(target=self.run, name="console", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Close all connections."""
        self._server.should_exit = True
        if self._thread is not None:
            self._thread.join(2.0 * _STOP_S + 2.0)
            self._thread = None
        self._socket.close()


def _listening(bind: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            bind, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, kind, protocol)
    except (OSError, UnicodeError) as error:
        raise ConfigError(f"bind: {bind!r:.80}: must be an address of this machine") from error
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(512)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRNOTAVAIL:
            raise ConfigError(f"bind: {bind!r:.80}: must be an address of this machine") from error
        reason = error.strerror or str(error)
        raise ConfigError(f"port: {port}: cannot be used on {bind}: {reason}") from error
    return listener


def _protocol(patience_s: float) -> type[asyncio.Protocol]:
    """HTTP protocol of uvicorn that also ends a connection whose request does not come."""

    class PatientProtocol(H11Protocol):
        _timer: asyncio.TimerHandle | None = None
        _seen: object = None

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self._timer = self.loop.call_later(patience_s, self._check)

        def connection_lost(self, exc: Exception | None) -> None:
            self._cancel()
            super().connection_lost(exc)

        def handle_websocket_upgrade(self, event: Any) -> None:
            self._cancel()
            super().handle_websocket_upgrade(event)

        def _cancel(self) -> None:
            if self._timer is not None:
                self._timer.cancel()

        def _check(self) -> None:
            """Close the connection if no new request was complete since the last check."""
            idle = self.cycle is None or self.cycle.response_complete
            if idle and self._seen is self.cycle and not self.transport.is_closing():
                self.transport.close()
                return
            self._seen = self.cycle
            self._timer = self.loop.call_later(patience_s, self._check)

    return PatientProtocol


def _without_traceback(record: logging.LogRecord) -> bool:
    """Leave one line of an error that was not handled."""
    if record.exc_info and record.exc_info[1] is not None:
        error: Any = record.exc_info[1]
        record.msg = f"{record.getMessage().strip()}: {type(error).__name__}: {error}"
        record.args, record.exc_info, record.exc_text = (), None, None
    return True
