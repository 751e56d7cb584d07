"""Who may do what on the pages: logins by a token, sessions in a cookie, and the roles of both."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import ipaddress
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Route
from starlette.types import ASGIApp, Receive, Scope, Send

from mazebot.console.config import ConsoleConfig
from mazebot.console.forms import Fields, fields_of
from mazebot.console.pages import page, wants_json
from mazebot.console.security import SAFE_METHODS

OPERATOR, VIEWER = "operator", "viewer"
COOKIE = "mazebot_session"
TOKEN = "token"
"""The field of the address, and of the form, that has the token."""
IDLE_S = 12.0 * 3600.0
"""A session that is not used for so long has ended."""
MAX_SESSIONS = 1000
"""At the same time; the one that was not used for longest makes room."""
MAX_WAIT_S = 60.0
"""The longest time for which an address must wait after wrong tokens."""
FREE_TRIES = 3
"""Wrong tokens of an address before it must wait: 1 s, then twice as long each time."""
_MAX_ADDRESSES = 10_000
_OPEN_TO_ALL = ("/healthz", "/login")
_SESSION = "mazebot.session"


@dataclass(eq=False)
class Session:
    """Somebody who has logged in."""

    role: str
    address: str
    """From which they did."""
    now_s: Callable[[], float] = time.monotonic
    id: str = field(default_factory=lambda: secrets.token_hex(4))
    """By which it is ended; it opens nothing."""
    begun_s: float = 0.0
    used_s: float = 0.0
    tasks: set[asyncio.Task[None]] = field(default_factory=set)
    """Live connections, which end with it."""

    def __post_init__(self) -> None:
        self.begun_s = self.used_s = self.now_s()


class Logins:
    """The tokens of a console, and who is logged in. For one thread, that of the server."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self.tokens = {role: secrets.token_urlsafe(24) for role in (OPERATOR, VIEWER)}
        """By role; made anew each time the console starts."""
        self._now_s = now_s
        self._sessions: dict[str, Session] = {}
        self._wrong: dict[str, tuple[int, float]] = {}

    def sessions(self) -> list[Session]:
        """All that have not ended, the oldest first."""
        now_s = self._now_s()
        for secret, session in list(self._sessions.items()):
            if now_s - session.used_s > IDLE_S:
                self._end(secret)
        return list(self._sessions.values())

    def role_of(self, token: str) -> str | None:
        """The role that a token gives."""
        for role, right in self.tokens.items():
            if hmac.compare_digest(token.encode(), right.encode()):
                return role
        return None

    def wait_s(self, address: str) -> float:
        """For how long an address must wait before it may try again."""
        count, last_s = self._wrong.get(address, (0, 0.0))
        if count < FREE_TRIES:
            return 0.0
        wait_s = min(2.0 ** (count - FREE_TRIES), MAX_WAIT_S)
        return max(last_s + wait_s - self._now_s(), 0.0)

    def log_in(self, token: str, address: str) -> tuple[str, Session] | None:
        """The cookie's value and a new session; None where the token is wrong. See `wait_s`."""
        role = self.role_of(token)
        if role is None:
            if len(self._wrong) >= _MAX_ADDRESSES:
                self._wrong.pop(next(iter(self._wrong)))
            count, _ = self._wrong.pop(address, (0, 0.0))
            self._wrong[address] = min(count + 1, 100), self._now_s()
            return None
        self._wrong.pop(address, None)
        if len(self.sessions()) >= MAX_SESSIONS:
            self._end(min(self._sessions, key=lambda one: self._sessions[one].used_s))
        secret, session = secrets.token_urlsafe(24), Session(role, address, self._now_s)
        self._sessions[secret] = session
        return secret, session

    def session_of(self, headers: Headers) -> Session | None:
        """The session of a request, by its cookie, which has been used now."""
        cookies: SimpleCookie = SimpleCookie()
        with contextlib.suppress(CookieError):
            cookies.load(headers.get("cookie", ""))
        if COOKIE not in cookies:
            return None
        self.sessions()
        session = self._sessions.get(cookies[COOKIE].value)
        if session is not None:
            session.used_s = self._now_s()
        return session

    def end(self, wanted: Callable[[Session], bool]) -> int:
        """End some sessions with their live connections; return how many."""
        ended = [secret for secret, session in self._sessions.items() if wanted(session)]
        for secret in ended:
            self._end(secret)
        return len(ended)

    def _end(self, secret: str) -> None:
        for task in self._sessions.pop(secret).tasks:
            task.cancel()


def logins_of(config: ConsoleConfig) -> Logins | None:
    """The logins of a console; None where nobody need log in."""
    asks = config.login == "always" or (config.login == "auto" and not _is_local(config.bind))
    return Logins() if asks else None


def role_of(scope: Scope) -> str:
    """The role of whoever asks; without logins everyone is an operator."""
    session = scope.get(_SESSION)
    return OPERATOR if session is None else str(session.role)


class LoginGate:
    """ASGI middleware: lets in those who have logged in, and viewers only look on."""

    def __init__(self, app: ASGIApp, logins: Logins) -> None:
        self._app = app
        self._logins = logins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection of ASGI."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        session = self._logins.session_of(headers) or self._of_program(scope, headers)
        scope[_SESSION] = session
        if scope["type"] == "websocket":
            if session is None:
                await receive()
                reason = "log in first: reload the page"
                await send({"type": "websocket.close", "code": 1008, "reason": reason})
                return
            await self._live(session, scope, receive, send)
            return
        request = Request(scope, receive)
        query = dict(parse_qsl(request.url.query))
        if request.method in ("GET", "HEAD") and TOKEN in query:
            response = _logged_in(request, self._logins, query.pop(TOKEN), _without(request, query))
            await response(scope, receive, send)
        elif session is None and not _is_open(request.url.path):
            response = _login_page(request, 401, "log in first" if wants_json(request) else "")
            await response(scope, receive, send)
        elif session is not None and session.role != OPERATOR and not _only_looks(request):
            raise HTTPException(403, "a viewer may only look on: log in with the operator's token")
        else:
            await self._app(scope, receive, send)

    def _of_program(self, scope: Scope, headers: Headers) -> Session | None:
        """That of a program that sends a token with each request, which is not kept."""
        kind, _, token = headers.get("authorization", "").partition(" ")
        address = _address(scope)
        if kind.lower() != "bearer" or self._logins.wait_s(address) > 0.0:
            return None
        role = self._logins.role_of(token.strip())
        if role is None:
            self._logins.log_in("", address)
            return None
        return Session(role, address)

    async def _live(self, session: Session, scope: Scope, receive: Receive, send: Send) -> None:
        task = asyncio.ensure_future(self._app(scope, receive, send))
        session.tasks.add(task)
        try:
            with contextlib.suppress(asyncio.CancelledError):
                await task
        finally:
            session.tasks.discard(task)
            task.cancel()


class _Login(Fields):
    token: str = ""


class _Ending(Fields):
    id: str = ""


def login_routes(logins: Logins) -> list[BaseRoute]:
    """The routes of logging in and out."""

    async def show(request: Request) -> Response:
        return _login_page(request, 200, "")

    async def log_in(request: Request) -> Response:
        token = (await fields_of(request, _Login)).token.strip()
        return _logged_in(request, logins, token, "/")

    async def log_out(request: Request) -> Response:
        session = request.scope[_SESSION]
        logins.end(lambda one: one is session)
        response = RedirectResponse("/login", 303)
        response.delete_cookie(COOKIE)
        return response

    async def list_sessions(request: Request) -> Response:
        _only_operator(request)
        now_s = time.monotonic()
        own = request.scope[_SESSION]
        rows = [
            {
                "id": one.id, "role": one.role, "address": one.address, "own": one is own,
                "begun_s": now_s - one.begun_s, "used_s": now_s - one.used_s,
            }
            for one in logins.sessions()
        ]  # fmt: skip
        if wants_json(request):
            return JSONResponse(rows)
        return page(request, "sessions.html", sessions=rows)

    async def end(request: Request) -> Response:
        _only_operator(request)
        wanted = (await fields_of(request, _Ending)).id
        if not logins.end(lambda one: one.id == wanted):
            raise HTTPException(404, f"{wanted!r:.20}: there is no such session")
        return RedirectResponse("/sessions", 303)

    return [
        Route("/login", show, methods=["GET"]),
        Route("/login", log_in, methods=["POST"]),
        Route("/logout", log_out, methods=["POST"]),
        Route("/sessions", list_sessions, methods=["GET"]),
        Route("/sessions", end, methods=["POST"]),
    ]


def _only_operator(request: Request) -> None:
    if role_of(request.scope) != OPERATOR:
        raise HTTPException(403, "only an operator may see and end sessions")


def _logged_in(request: Request, logins: Logins, token: str, then: str) -> Response:
    """To another page with the cookie of a new session, or why not."""
    address = _address(request.scope)
    wait_s = logins.wait_s(address)
    if wait_s > 0.0:
        told = f"too many wrong tokens: try again in {wait_s:.0f} s"
        return _login_page(request, 429, told, {"retry-after": f"{wait_s + 1.0:.0f}"})
    found = logins.log_in(token, address)
    if found is None:
        return _login_page(
            request, 401, "the token is wrong: take the address that the console has printed"
        )
    response = RedirectResponse(then, 303)
    # Another site's link may open the pages, but scripts, also our own, cannot read it.
    response.set_cookie(COOKIE, found[0], httponly=True, samesite="lax", path="/")
    return response


def _login_page(
    request: Request, status: int, message: str, headers: dict[str, str] | None = None
) -> Response:
    if wants_json(request):
        return JSONResponse({"error": message}, status, headers)
    return page(request, "login.html", status=status, headers=headers, message=message)


def _without(request: Request, query: dict[str, str]) -> str:
    """The path with what is left of the query; never another site's address."""
    path = "/" + request.url.path.lstrip("/")
    return f"{path}?{urlencode(query)}" if query else path


def _is_open(path: str) -> bool:
    return path in _OPEN_TO_ALL or path.startswith("/static/")


def _only_looks(request: Request) -> bool:
    return request.method in SAFE_METHODS or request.url.path in ("/login", "/logout")


def _address(scope: Scope) -> str:
    client = scope.get("client")
    return str(client[0]) if client else ""


def _is_local(bind: str) -> bool:
    if bind == "localhost":
        return True
    try:
        return ipaddress.ip_address(bind).is_loopback
    except ValueError:
        return False
