"""What the gallery changes: tags, notes, and the deletion of runs."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from urllib.parse import parse_qs

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Route

from mazebot.common.config import ConfigError
from mazebot.common.recordings.labels import Labels, read_labels, relabelled, write_labels
from mazebot.common.recordings.retention import delete_run
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


async def _set_labels(request: Request) -> Response:
    run = await run_of(request)
    fields = await _fields(request, ("tags", "note"))
    tags = fields.get("tags", "").replace(",", " ").split()
    folder = run.path
    try:
        labels = await asyncio.to_thread(_relabel, folder, tuple(tags), fields.get("note", ""))
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
    fields = await _fields(request, ("confirm",))
    if fields.get("confirm") != run.name:
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


async def _fields(request: Request, known: Sequence[str]) -> Mapping[str, str]:
    """The fields of a form, or of a JSON object, which may have only the `known` ones.

    Raises HTTPException.
    """
    body = await request.body()
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    try:
        if kind == "application/json":
            content = json.loads(body)
            if not isinstance(content, dict):
                raise HTTPException(422, "the body must be a JSON object")
            _check_known(content, known)
            return {name: _text(value) for name, value in content.items()}
        if kind == "application/x-www-form-urlencoded":
            found = parse_qs(body.decode(), keep_blank_values=True, max_num_fields=20)
            return {name: values[-1] for name, values in found.items()}
    except (ValueError, RecursionError):
        raise HTTPException(400, "the body does not match its content type") from None
    raise HTTPException(415, "the body must be a form or JSON")


def _check_known(names: Iterable[str], known: Sequence[str]) -> None:
    unknown = ", ".join(f"{name!r:.80}" for name in names if name not in known)
    if unknown:
        allowed = " and ".join(f"`{name}`" for name in known)
        raise HTTPException(400, f"unknown field {unknown:.300}: allowed: {allowed}")


def _text(value: object) -> str:
    """A field as text; the words of a list are joined."""
    if isinstance(value, list):
        return " ".join(str(one) for one in value)
    return str(value)
