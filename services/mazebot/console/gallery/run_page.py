"""The page of one run."""

from __future__ import annotations

import asyncio
import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from mazebot.common.config import ConfigError
from mazebot.common.recordings.catalog import RecordingInfo, run_at
from mazebot.common.recordings.figures import FIGURES, Figure, figure_text, figures_of
from mazebot.common.recordings.run_folder import (
    CONFIG,
    MESSAGES,
    RECORDING,
    REPORT,
    SERIES,
    SUMMARY,
    is_recording,
    parts_of,
)
from mazebot.common.recordings.run_settings import read_summary, settings_of
from mazebot.common.recordings.series import RunSeries, read_series
from mazebot.console.file_answer import FileAnswer, GrowingAnswer
from mazebot.console.gallery.goals import GoalRow, goals_of
from mazebot.console.gallery.index import Runs
from mazebot.console.gallery.routes import current_runs, index_of
from mazebot.console.pages import page
from mazebot.console.safe_files import (
    NoSuchFileError,
    check_no_link,
    is_plain_name,
    is_real_folder,
    open_inside,
)
from mazebot.console.viewer_assets import live_data_of, viewer_policy, viewer_version

T = TypeVar("T")

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
_MOST_FILES = 1000
_MOST_OTHERS = 200


def run_routes() -> list[BaseRoute]:
    """The routes of one run."""
    return [
        Route("/runs/{run}", _run_page),
        Route("/runs/{run}/report", _report),
        Route("/runs/{run}/files/{path:path}", _file),
        Route("/runs/{run}/growing/{name}", _growing),
    ]


async def run_of(request: Request) -> RecordingInfo:
    """The run that an address names, as it is now. Raises HTTPException 404."""
    name = request.path_params["run"]
    run = None
    if is_plain_name(name):
        run = await asyncio.to_thread(_run_at, index_of(request).folder / name)
    if run is None:
        raise HTTPException(404, f"no such run: {name!r:.100}")
    return run


def _run_at(folder: Path) -> RecordingInfo | None:
    return run_at(folder) if is_real_folder(folder) else None


@dataclass(frozen=True)
class _Content:
    """The content of the files of a run."""

    goals: tuple[GoalRow, ...]
    figures: tuple[tuple[Figure, str], ...]
    """Those that were measured, each with its value."""
    series: RunSeries | None
    settings: tuple[tuple[str, Any], ...]
    files: Mapping[str, int]
    """The size of each file that can be had, by its path in the folder."""
    parts: tuple[str, ...]
    """The files that the viewer opens, by their addresses below the run's."""
    problems: tuple[str, ...]
    """Why a file cannot be read, a line each."""


def _read(folder: Path) -> _Content:
    problems: list[str] = []

    def read(name: str, reader: Callable[[Path], T], default: T) -> T:
        try:
            check_no_link(folder / name)
            return reader(folder)
        except ConfigError as error:
            problems.append(str(error).replace(str(folder), folder.name))
            return default

    nothing: dict[str, Any] = {}
    summary = read(SUMMARY, read_summary, nothing)
    values = figures_of(summary)
    return _Content(
        goals=goals_of(summary),
        figures=tuple(
            (figure, figure_text(figure, values[figure.name]))
            for figure in FIGURES
            if values[figure.name] is not None
        ),
        series=read(SERIES, read_series, None),
        settings=tuple(read(CONFIG, settings_of, nothing).items()),
        files=_visible_files(folder),
        parts=_shown_parts(folder),
        problems=tuple(problems),
    )


def _shown_parts(folder: Path) -> tuple[str, ...]:
    names = [path.name for path in parts_of(folder) if not path.is_symlink()]
    # To the last one a recorder appends.
    grows = names[-1:] if is_recording(folder) else []
    return tuple(f"{'growing' if name in grows else 'files'}/{name}" for name in names)


def _visible_files(folder: Path) -> dict[str, int]:
    found: dict[str, int] = {}
    waiting = [""]
    while waiting:
        below = waiting.pop()
        try:
            entries = list(os.scandir(folder / below))
        except OSError:
            # Removed meanwhile, or not readable.
            continue
        for entry in entries:
            if not is_plain_name(entry.name) or len(found) >= _MOST_FILES:
                continue
            with suppress(OSError):
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(f"{below}{entry.name}/")
                elif entry.is_file(follow_symlinks=False):
                    found[below + entry.name] = entry.stat(follow_symlinks=False).st_size
    return dict(sorted(found.items(), key=lambda one: ("/" in one[0], one[0])))


async def _run_page(request: Request) -> Response:
    run = await run_of(request)
    runs = await current_runs(request)
    content = await asyncio.to_thread(_read, run.path)
    live_data = live_data_of(request) if run.state == "running" else ""
    newer, older = _neighbours(runs, run.name)
    answer = page(
        request,
        "run.html",
        headers={"content-security-policy": viewer_policy(live_data)},
        section="runs",
        run=run,
        newer=newer,
        older=older,
        others=[one for one in runs.all[:_MOST_OTHERS] if one.name != run.name],
        viewer=viewer_version(),
        live=f"rerun+http://{live_data}/proxy" if live_data else "",
        downloads=[
            part.name
            for name in (RECORDING, MESSAGES)
            for part in parts_of(run.path, name)
            if part.name in content.files
        ],
        has_report=REPORT in content.files,
        content=content,
    )
    tag = f'"{hashlib.blake2b(bytes(answer.body), digest_size=12).hexdigest()}"'
    answer.headers["etag"] = tag
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers={"etag": tag, "cache-control": "no-cache"})
    return answer


def _neighbours(runs: Runs, name: str) -> tuple[str, str]:
    """Names of the next newer and the next older run; empty: none."""
    names = [run.name for run in runs.all]
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


async def _growing(request: Request) -> Response:
    """The file as it grows; HEAD, which asks whether there is one yet, gets 204 for none."""
    try:
        run = await run_of(request)
        file = await _open(request, [request.path_params["name"]])
    except HTTPException as error:
        if request.method == "HEAD" and error.status_code == 404:
            return Response(status_code=204)
        raise

    def grows() -> bool:
        return is_recording(run.path) and not request.app.state.is_ending()

    return GrowingAnswer(file, grows)


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
        raise HTTPException(403, "the console has no permission to read this file") from None
