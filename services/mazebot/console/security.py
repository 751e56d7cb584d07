"""What every request must pass, and the headers of every answer.

A page of another site cannot read or send anything here: its requests carry its own Host (DNS
rebinding) or Origin, which are refused.
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import logging
from collections.abc import Collection
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mazebot.console.config import ConsoleConfig
from mazebot.console.loading import LOADING_SOURCE

LOGGER = logging.getLogger("console")

MAX_TARGET = 4096
"""Characters of path and query."""
MAX_HEADERS_BYTES = 32 * 1024
SAFE_METHODS = ("GET", "HEAD", "OPTIONS")
LOCAL_HOSTS = ("localhost", "127.0.0.1", "::1")
_ANY_ADDRESS = ("0.0.0.0", "::")

_POLICY = {
    "default-src": "'none'",
    "script-src": f"'self' {LOADING_SOURCE}",
    "style-src": "'self'",
    "img-src": "'self' data: blob:",
    "font-src": "'self'",
    "connect-src": "'self'",
    "frame-src": "'self'",
    "manifest-src": "'self'",
    "form-action": "'self'",
    "base-uri": "'none'",
    "frame-ancestors": "'none'",
}
"""The content security policy of the pages."""


def content_policy(**changes: str) -> str:
    """The pages' content security policy with some directives replaced; `_` stands for `-`."""
    policy = _POLICY | {name.replace("_", "-"): value for name, value in changes.items()}
    return "; ".join(f"{name} {value}".rstrip() for name, value in policy.items())


HEADERS = {
    "content-security-policy": content_policy(),
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=(), payment=(), usb=()",
}
"""Of each answer that does not set them itself."""


def host_of(authority: str) -> str:
    """The host of a Host header or an origin's authority, without its port, in small letters; empty
    where it is none.
    """
    try:
        parts = urlsplit(f"//{authority}")
        _ = parts.port
    except ValueError:
        return ""
    if parts.path or parts.query or parts.fragment or parts.username is not None:
        return ""
    return (parts.hostname or "").rstrip(".")


def address_of(authority: str, port: int) -> str:
    """`host:port` on the host of a Host header."""
    host = host_of(authority)
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def is_known_host(authority: str, hosts: Collection[str], any_address: bool) -> bool:
    """Whether a Host header names this server; `any_address`: every IP address does.

    An IP address cannot be rebound by a foreign name server.
    """
    host = host_of(authority)
    if host in hosts:
        return True
    if not any_address or not host:
        return False
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def is_own_origin(headers: Headers, needs_origin: bool) -> bool:
    """Whether a request was made by one of our pages, or by no page at all.

    Browsers send Origin with every POST and websocket; a program that is no browser need not,
    except for a websocket (`needs_origin`).
    """
    if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
        return False
    origin = headers.get("origin")
    if origin is None:
        return not needs_origin
    scheme, _, authority = origin.partition("://")
    same = authority.lower() == headers.get("host", "").lower()
    return scheme in ("http", "https") and same


def is_of_script(headers: Headers) -> bool:
    """Whether a request is of a script: it sends JSON, or accepts it."""
    kinds = (headers.get("accept", ""), headers.get("content-type", ""))
    return any("application/json" in kind.lower() for kind in kinds)


class Guard:
    """ASGI middleware: refuses what is foreign, too large or too slow, without tracebacks."""

    def __init__(self, app: ASGIApp, config: ConsoleConfig) -> None:
        self._app = app
        self._max_body = config.max_body_kib * 1024
        self._timeout_s = config.request_timeout_s
        self._any_address = config.bind in _ANY_ADDRESS
        named = (name.strip("[]").lower() for name in (*LOCAL_HOSTS, *config.hosts, config.bind))
        self._hosts = frozenset(named) - {*_ANY_ADDRESS}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection of ASGI."""
        if scope["type"] == "websocket":
            await self._websocket(scope, receive, send)
        elif scope["type"] == "http":
            await self._http(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        """Status and reason for which a request is refused."""
        if len(headers.getlist("host")) != 1:
            return 400, "the request must have one Host header"
        host = headers["host"]
        if not is_known_host(host, self._hosts, self._any_address):
            return 421, (
                f"{host!r:.80} is not a name of this console: add it to its setting `hosts`, or "
                "use http://localhost"
            )
        size = len(scope.get("raw_path") or b"") + len(scope.get("query_string") or b"")
        if size > MAX_TARGET:
            return 414, f"the address must have at most {MAX_TARGET} characters"
        if sum(len(name) + len(value) for name, value in scope["headers"]) > MAX_HEADERS_BYTES:
            return 431, f"the headers must have at most {MAX_HEADERS_BYTES} bytes"
        if not scope["path"].isprintable():
            return 400, "the address must have no control characters"
        if scope["type"] == "websocket":
            own = is_own_origin(headers, needs_origin=True)
        else:
            own = scope["method"] in SAFE_METHODS or is_own_origin(headers, needs_origin=False)
        if not own:
            return 403, "only the console's own pages may do this"
        length = headers.get("content-length", "0")
        if not (length.isascii() and length.isdigit()):
            return 400, "Content-Length must be a number"
        if len(length) > 18 or int(length) > self._max_body:
            return 413, f"the body must have at most {self._max_body} bytes"
        return None

    async def _websocket(self, scope: Scope, receive: Receive, send: Send) -> None:
        refusal = self._refusal(scope, Headers(scope=scope))
        if refusal is not None:
            LOGGER.warning("websocket %s rejected: %s", _path(scope), refusal[1])
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": refusal[1][:120]})
            return
        try:
            await self._app(scope, receive, send)
        except Exception as error:
            LOGGER.error("websocket %s: %s", _path(scope), _one_line(error))

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        started = False

        async def sending(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        refusal = self._refusal(scope, Headers(scope=scope))
        if refusal is not None:
            await _answer(sending, scope, *refusal)
            return
        try:
            await self._app(scope, self._limited(receive), sending)
        except Exception as error:
            if isinstance(error, HTTPException):
                status, text = error.status_code, str(error.detail)
            else:
                LOGGER.error("%s %s: %s", scope["method"], _path(scope), _one_line(error))
                status, text = 500, "internal error: see the log of the console"
            if not started:
                await _answer(sending, scope, status, text)

    def _limited(self, receive: Receive) -> Receive:
        """The same, with the limits of the body's size and duration."""
        received = 0
        complete = False
        loop = asyncio.get_running_loop()
        end_s = loop.time() + self._timeout_s

        async def limited() -> Message:
            nonlocal received, complete
            if complete:
                return await receive()
            try:
                async with asyncio.timeout_at(end_s):
                    message = await receive()
            except TimeoutError:
                raise HTTPException(408, "timed out while receiving the request body") from None
            received += len(message.get("body", b""))
            complete = not message.get("more_body", False)
            if received > self._max_body:
                raise HTTPException(413, f"the body must have at most {self._max_body} bytes")
            return message

        return limited


async def _answer(send: Send, scope: Scope, status: int, text: str) -> None:
    """A short text, for a script as JSON; the connection ends, as the rest of the body is not
    read.
    """
    kind, body = b"text/plain; charset=utf-8", f"{text}\n".encode()
    if is_of_script(Headers(scope=scope)):
        kind, body = b"application/json", json.dumps({"error": text}).encode()
    headers = [
        (b"content-type", kind),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
    ]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": b"" if scope["method"] == "HEAD" else body})


def _path(scope: Scope) -> str:
    return f"{scope['path']!r:.200}"


def _one_line(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split()):.300}"
