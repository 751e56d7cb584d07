"""The page of all runs."""

from __future__ import annotations

import asyncio
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from mazebot.common.recordings.catalog import RecordingInfo
from mazebot.console.gallery.index import RunIndex, Runs
from mazebot.console.gallery.query import RESULTS, SORTS, STATES, RunQuery, options, select
from mazebot.console.pages import TEMPLATES, in_words, page


def gallery_routes() -> list[BaseRoute]:
    """The routes of the page of all runs."""
    return [Route("/runs", _runs_page), Route("/runs.json", _cards)]


def index_of(request: Request) -> RunIndex:
    """The application's index."""
    index: RunIndex = request.app.state.index
    return index


async def current_runs(request: Request, at_once: bool = False) -> Runs:
    """The runs as they are, looked up beside the server's other work."""
    return await asyncio.to_thread(index_of(request).runs, at_once)


def searched(card: RecordingInfo) -> str:
    """The text of a run in which words are searched."""
    changed = (f"{name}={in_words(value)}" for name, value in changed_of(card))
    parts = (card.name, card.world, f"seed:{card.seed}", *card.tags, card.note, *changed)
    return "\n".join(parts).lower()


def changed_of(card: RecordingInfo) -> list[tuple[str, object]]:
    """Name and value of each setting that is not the default."""
    return list((card.changed_settings or {}).items())


async def _runs_page(request: Request) -> Response:
    runs = await current_runs(request)
    return page(request, "runs.html", **_context(runs, RunQuery.of(request.query_params)))


def _context(runs: Runs, query: RunQuery) -> dict[str, Any]:
    return {
        "section": "runs",
        "query": query,
        "selection": select(runs.all, query, searched),
        "problem": runs.problem,
        "version": runs.version,
        "worlds": options(card.world for card in runs.all),
        "tags": options(tag for card in runs.all for tag in card.tags),
        "results": RESULTS,
        "states": STATES,
        "sorts": {name: label for name, (label, _, _) in SORTS.items()},
    }


async def _cards(request: Request) -> Response:
    """The cards of a query as HTML, and what stands around them, for the page to change itself.

    304 where nothing has changed since the version in If-None-Match.
    """
    runs = await current_runs(request)
    etag = f'"{id(index_of(request)):x}-{runs.version}"'
    headers = {"etag": etag, "cache-control": "no-cache"}
    if request.headers.get("if-none-match") == etag:
        return Response(status_code=304, headers=headers)
    context = _context(runs, RunQuery.of(request.query_params))
    cards = context["selection"].cards
    card = TEMPLATES.get_template("card.html")
    answer = {
        "status": TEMPLATES.get_template("runs_status.html").render(context),
        "pages": TEMPLATES.get_template("runs_pages.html").render(context),
        "cards": [{"name": one.name, "html": card.render(run=one)} for one in cards],
    }
    return JSONResponse(answer, headers=headers)
