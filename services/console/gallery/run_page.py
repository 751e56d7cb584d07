"""The page of one run."""

from __future__ import annotations

import asyncio
import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from services.common.config import ConfigError
from services.common.recordings.run_folder import CONFIG, MESSAGES, RECORDING, REPORT, parts_of
from services.common.recordings.series import RunSeries, read_series
from services.console.file_answer import FileAnswer
from services.console.gallery.figures import Figure, figures_of
from services.console.gallery.index import Runs
from services.console.gallery.routes import current_runs, index_of
from services.console.gallery.run_card import RunCard, read_summary, visible_files
from services.console.pages import page
from services.console.safe_files import NoSuchFileError, is_plain_name, open_inside
from services.console.security import content_policy
from services.console.viewer_assets import viewer_version

VIEWER_POLICY = content_policy(
    script_src="'self' 'wasm-unsafe-eval'",
    connect_src="'self' data: blob:",
    worker_src="'self' blob:",
)
"""Of pages with Rerun's viewer, which is compiled from WebAssembly."""
_REPORT_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; font-src data:; "
    "frame-ancestors 'self'; base-uri 'none'; form-action 'none'; sandbox allow-popups"
)
_FILE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'; sandbox"
_TYPES = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".json": "application/json",
    ".yaml": "text/plain; charset=utf-8",
    ".txt": "text/plain; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".xml": "text/plain; charset=utf-8",
}
_SHOWN = {".png", ".jpg", ".json", ".yaml", ".txt", ".xml"}
"""Files of these kinds are shown by browsers, all others saved."""
_MOST_CONFIG_BYTES = 1024 * 1024
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def run_routes() -> list[BaseRoute]:
    """The routes of one run."""
    return [
        Route("/runs/{run}", _run_page),
        Route("/runs/{run}/report", _report),
        Route("/runs/{run}/files/{path:path}", _file),
    ]


async def run_of(request: Request, at_once: bool = False) -> RunCard:
    """The run that an address names. Raises HTTPException 404."""
    name = request.path_params["run"]
    card = None
    if is_plain_name(name):
        card = (await current_runs(request, at_once)).find(name)
        if card is None and not at_once:
            card = (await current_runs(request, at_once=True)).find(name)
    if card is None:
        raise HTTPException(404, f"there is no run {name!r:.100}")
    return card


@dataclass(frozen=True)
class _Content:
    """What the files of a run say."""

    figures: tuple[Figure, ...]
    summary: dict[str, Any]
    series: RunSeries | None
    problem: str
    files: dict[str, int]
    parts: tuple[str, ...]
    """Names of the files that the viewer opens."""
    settings: tuple[tuple[str, str], ...]


def _read(folder: Path) -> _Content:
    summary = read_summary(folder)
    series, problem = None, ""
    try:
        series = read_series(folder)
    except ConfigError as error:
        problem = str(error).replace(str(folder), folder.name)
    return _Content(
        figures=figures_of(summary),
        summary=summary,
        series=series,
        problem=problem,
        files=visible_files(folder),
        parts=tuple(path.name for path in parts_of(folder) if not path.is_symlink()),
        settings=settings_of(folder),
    )


def settings_of(folder: Path) -> tuple[tuple[str, str], ...]:
    """Name and value of each setting of a run, as its config.yaml has them; none if unreadable."""
    try:
        file = open_inside(folder, [CONFIG])
    except (NoSuchFileError, PermissionError):
        return ()
    with os.fdopen(file, "rb") as opened:
        try:
            content = yaml.load(opened.read(_MOST_CONFIG_BYTES), _LOADER)
        except (yaml.YAMLError, ValueError, RecursionError):
            return ()
    found: list[tuple[str, str]] = []
    _flatten("", content, found, 0)
    return tuple(found)


def _flatten(prefix: str, value: object, found: list[tuple[str, str]], depth: int) -> None:
    if isinstance(value, dict) and value and depth < 8:
        for name, below in value.items():
            start = "" if prefix in ("", "services") else f"{prefix}."
            _flatten(f"{start}{name}", below, found, depth + 1)
    else:
        found.append((prefix, "none" if value is None else str(value)))


async def _run_page(request: Request) -> Response:
    card = await run_of(request)
    runs = await current_runs(request)
    content = await asyncio.to_thread(_read, index_of(request).folder / card.name)
    newer, older = _neighbours(runs, card.name)
    answer = page(
        request,
        "run.html",
        headers={"content-security-policy": VIEWER_POLICY},
        section="runs",
        card=card,
        newer=newer,
        older=older,
        others=[one for one in runs.cards[:200] if one.name != card.name],
        viewer=viewer_version(),
        downloads=[name for name in (RECORDING, MESSAGES) if name in card.has],
        has_report=REPORT in card.has,
        content=content,
    )
    tag = f'"{hashlib.blake2b(bytes(answer.body), digest_size=12).hexdigest()}"'
    answer.headers["etag"] = tag
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers={"etag": tag, "cache-control": "no-cache"})
    return answer


def _neighbours(runs: Runs, name: str) -> tuple[str, str]:
    """Names of the next newer and the next older run; empty: none."""
    names: Sequence[str] = [card.name for card in runs.cards]
    if name not in names:
        return "", ""
    place = names.index(name)
    newer = names[place - 1] if place > 0 else ""
    return newer, names[place + 1] if place + 1 < len(names) else ""


async def _file(request: Request) -> Response:
    names = request.path_params["path"].split("/")
    file = await _open(request, names)
    kind = Path(names[-1]).suffix.lower()
    is_shown = kind in _SHOWN and "download" not in request.query_params
    return FileAnswer(
        file,
        _TYPES.get(kind, "application/octet-stream"),
        headers={"content-security-policy": _FILE_POLICY},
        download_name="" if is_shown else f"{request.path_params['run']}_{names[-1]}",
    )


async def _report(request: Request) -> Response:
    file = await _open(request, [REPORT])
    headers = {"content-security-policy": _REPORT_POLICY, "x-frame-options": "SAMEORIGIN"}
    return FileAnswer(file, _TYPES[".html"], headers=headers)


async def _open(request: Request, names: Sequence[str]) -> int:
    """A descriptor of a run's file. Raises HTTPException."""
    path = [request.path_params["run"], *names]
    try:
        return await asyncio.to_thread(open_inside, index_of(request).folder, path)
    except NoSuchFileError:
        raise HTTPException(404, "the run has no such file") from None
    except PermissionError:
        raise HTTPException(403, "the console may not read this file") from None
