"""What the gallery changes: tags, notes, and the deletion of runs."""

from __future__ import annotations

import asyncio
import errno
import fcntl
import json
import os
import secrets
import shutil
from collections.abc import Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qs

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Route

from services.common.config import ConfigError
from services.common.recordings.labels import Labels, read_labels, relabelled, write_labels
from services.common.recordings.run_folder import LOCK
from services.console.gallery.routes import index_of
from services.console.gallery.run_page import run_of
from services.console.pages import page, wants_json

if TYPE_CHECKING:
    from collections.abc import Iterator

_DELETED = ".deleted."
"""Start of the name of a folder that is being removed; hidden from every list of runs."""


def change_routes() -> list[BaseRoute]:
    """The routes that change a run."""
    return [
        Route("/runs/{run}/labels", _set_labels, methods=["POST"]),
        Route("/runs/{run}/delete", _confirm, methods=["GET"]),
        Route("/runs/{run}/delete", _delete, methods=["POST"]),
    ]


async def _set_labels(request: Request) -> Response:
    card = await run_of(request)
    fields = await _fields(request)
    tags = fields.get("tags", "").replace(",", " ").split()
    folder = index_of(request).folder / card.name
    try:
        labels = await asyncio.to_thread(_relabel, folder, tuple(tags), fields.get("note", ""))
    except ConfigError as error:
        said = str(error).replace(str(folder), card.name)
        raise HTTPException(422, said) from error
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
    card = await run_of(request)
    return page(request, "delete.html", section="runs", card=card)


async def _delete(request: Request) -> Response:
    card = await run_of(request, at_once=True)
    fields = await _fields(request)
    if fields.get("confirm") != card.name:
        raise HTTPException(422, "to delete a run, `confirm` must be its name")
    await asyncio.to_thread(delete_run, index_of(request).folder, card.name)
    await asyncio.to_thread(index_of(request).runs, True)
    if wants_json(request):
        return JSONResponse({"deleted": card.name})
    return RedirectResponse("/runs", 303)


def delete_run(recordings_dir: Path, name: str) -> None:
    """Remove a run's folder; at once for everybody who looks, or not at all.

    Raises HTTPException 409 if it is being recorded, 404 if there is none, 403 if it cannot be.
    """
    folder = recordings_dir / name
    gone = recordings_dir / f"{_DELETED}{secrets.token_hex(4)}.{name}"[:200]
    try:
        with _not_recorded(folder):
            folder.rename(gone)
    except FileNotFoundError:
        raise HTTPException(404, f"there is no run {name!r:.100}") from None
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EAGAIN):
            raise HTTPException(409, f"{name} is being recorded; it can be deleted later") from None
        raise HTTPException(403, f"{name} cannot be deleted: {error.strerror}") from error
    shutil.rmtree(gone, ignore_errors=True)


@contextmanager
def _not_recorded(folder: Path) -> Iterator[None]:
    """Hold the lock of a killed run, so that no recorder resumes it meanwhile. Raises OSError."""
    try:
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        folder.lstat()
        yield
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(lock)


def finish_deletions(recordings_dir: Path) -> None:
    """Remove what a console that was killed has left of deleted runs."""
    with suppress(OSError):
        for path in recordings_dir.iterdir():
            if path.name.startswith(_DELETED) and path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)


async def _fields(request: Request) -> Mapping[str, str]:
    """The fields of a form, or of a JSON object. Raises HTTPException."""
    body = await request.body()
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    try:
        if kind == "application/json":
            content = json.loads(body)
            if not isinstance(content, dict):
                raise HTTPException(422, "the body must be a JSON object")
            return {str(name): _text(value) for name, value in content.items()}
        if kind == "application/x-www-form-urlencoded":
            found = parse_qs(body.decode(), keep_blank_values=True, max_num_fields=20)
            return {name: values[-1] for name, values in found.items()}
    except (ValueError, RecursionError):
        raise HTTPException(400, "the body cannot be read as its type says") from None
    raise HTTPException(415, "the body must be a form or JSON")


def _text(value: object) -> str:
    """A field as text; the words of a list are joined."""
    if isinstance(value, list):
        return " ".join(str(one) for one in value)
    return str(value)
