"""The console's web application."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import AsyncIterator, Sequence

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

from mazebot.common.recordings.retention import delete_rest
from mazebot.console.config import ConsoleConfig
from mazebot.console.gallery.changes import change_routes
from mazebot.console.gallery.compare import compare_routes
from mazebot.console.gallery.index import RunIndex
from mazebot.console.gallery.routes import gallery_routes
from mazebot.console.gallery.run_page import run_routes
from mazebot.console.login import LoginGate, login_routes, logins_of
from mazebot.console.pages import STATIC, error_page
from mazebot.console.security import Guard
from mazebot.console.viewer_assets import viewer_routes


def build_app(config: ConsoleConfig, live: Sequence[BaseRoute] = ()) -> Starlette:
    """The application: the gallery of runs, and the routes of the live page if there are any.

    The first page is `/live` where there is one, else `/runs`.
    """
    logins = logins_of(config)
    gates = [Middleware(Guard, config=config)]
    if logins is not None:
        gates.append(Middleware(LoginGate, logins=logins))
    app = Starlette(
        routes=[
            Route("/", _first_page),
            Route("/healthz", _healthy),
            Mount("/static", StaticFiles(directory=STATIC), name="static"),
            *(() if logins is None else login_routes(logins)),
            *viewer_routes(),
            *gallery_routes(),
            *change_routes(),
            *run_routes(),
            *compare_routes(),
            *live,
        ],
        middleware=gates,
        exception_handlers={HTTPException: error_page},
        lifespan=_lifespan,
    )
    app.state.config = config
    app.state.logins = logins
    app.state.index = RunIndex(config.recordings_dir)
    app.state.has_live = bool(live)
    app.state.is_ending = bool
    return app


@contextlib.asynccontextmanager
async def _lifespan(app: Starlette) -> AsyncIterator[None]:
    """Read the runs before the first page is asked for."""
    threading.Thread(target=_begin, args=(app.state.index,), name="runs", daemon=True).start()
    yield


def _begin(index: RunIndex) -> None:
    delete_rest(index.folder)
    index.runs()


async def _first_page(request: Request) -> Response:
    return RedirectResponse("/live" if request.app.state.has_live else "/runs", 307)


async def _healthy(request: Request) -> Response:
    return Response("ok\n", media_type="text/plain")
