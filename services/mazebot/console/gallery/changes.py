"""What the gallery changes: tags, notes, and the deletion of runs."""

from __future__ import annotations

import asyncio
from pathlib import Path

from pydantic import Field
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Route

from mazebot.common.config import ConfigError
from mazebot.common.recordings.labels import Labels, read_labels, relabelled, write_labels
from mazebot.common.recordings.retention import delete_run
from mazebot.console.forms import Fields, fields_of
from mazebot.console.gallery.routes import index_of
from mazebot.console.gallery.run_page import run_of
from mazebot.console.pages import page, wants_json


def change_routes() -> list[BaseRoute]:
    """The routes that change a run."""
    return [
        Route("/runs/{run}/labels", _set_labels, methods=["POST"]),
        Route("/runs/{run}/delete", _confirm, methods=["GET"]),
        Route("/runs/{run}/delete", _delete, methods=["POST"]),
    ]


class _NewLabels(Fields):
    tags: list[str] = Field([])
    note: str = ""


class _Deletion(Fields):
    confirm: str = ""


async def _set_labels(request: Request) -> Response:
    run = await run_of(request)
    wanted = await fields_of(request, _NewLabels)
    folder = run.path
    try:
        labels = await asyncio.to_thread(_relabel, folder, tuple(wanted.tags), wanted.note)
    except ConfigError as error:
        message = str(error).replace(str(folder), run.name)
        raise HTTPException(422, message) from error
    if wants_json(request):
        return JSONResponse({"tags": labels.tags, "note": labels.note})
    return RedirectResponse(request.url.path.removesuffix("/labels"), 303)


def _relabel(folder: Path, tags: tuple[str, ...], note: str) -> Labels:
    """Raises ConfigError where they are not valid, or the file cannot be written."""
    wanted = relabelled(Labels(), add=tags, note=note.replace("\r\n", "\n").strip())
    try:
        before = read_labels(folder)
    except ConfigError:
        # What is there is no labels: it is replaced.
        before = None
    if wanted != before:
        write_labels(folder, wanted)
    return wanted


async def _confirm(request: Request) -> Response:
    run = await run_of(request)
    return page(request, "delete.html", section="runs", run=run)


async def _delete(request: Request) -> Response:
    run = await run_of(request)
    if (await fields_of(request, _Deletion)).confirm != run.name:
        raise HTTPException(422, "to delete a run, `confirm` must be its name")
    if run.state == "running":
        raise HTTPException(409, f"{run.name} is being recorded: stop that run first")
    try:
        await asyncio.to_thread(delete_run, run.path)
    except ConfigError as error:
        raise HTTPException(409, str(error).replace(str(run.path), run.name)) from error
    await asyncio.to_thread(index_of(request).runs, True)
    if wants_json(request):
        return JSONResponse({"deleted": run.name})
    return RedirectResponse("/runs", 303)
