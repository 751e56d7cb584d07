"""The page that compares runs."""

from __future__ import annotations

import asyncio
import math
from urllib.parse import urlencode

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from mazebot.common.config import ConfigError
from mazebot.common.recordings.catalog import run_at
from mazebot.common.recordings.comparing.compare_runs import compare_runs
from mazebot.common.recordings.figures import FIGURES
from mazebot.common.recordings.run_folder import CONFIG, DIGESTS, SERIES, SUMMARY
from mazebot.common.recordings.run_settings import settings_of
from mazebot.console.gallery.routes import current_runs, index_of
from mazebot.console.pages import page
from mazebot.console.safe_files import check_no_link, is_plain_name, is_real_folder

MOST_RUNS = 10
_DIGITS = {figure.name: figure.digits for figure in FIGURES}


def compare_routes() -> list[BaseRoute]:
    """The route of the comparison: `/compare?run=A&run=B`, with `all` also what is the same."""
    return [Route("/compare", _compare)]


async def _compare(request: Request) -> Response:
    names = list(dict.fromkeys(request.query_params.getlist("run")))
    if len(names) > MOST_RUNS:
        raise HTTPException(400, f"at most {MOST_RUNS} runs can be compared at once")
    shows_all = "all" in request.query_params
    folder = index_of(request).folder
    folders = [folder / name for name in names if is_plain_name(name)]
    runs = [run_at(path) if is_real_folder(path) else None for path in folders]
    for name in names:
        if name not in {run.name for run in runs if run is not None}:
            raise HTTPException(404, f"no such run: {name!r:.100}")
    others = [run.name for run in (await current_runs(request)).all[:200] if run.name not in names]
    comparison, problem, same = None, "", {}
    if len(names) >= 2:
        try:
            for path in folders:
                for name in (SUMMARY, CONFIG, DIGESTS):
                    check_no_link(path / name)
            comparison = await asyncio.to_thread(compare_runs, folders)
            if shows_all:
                first = await asyncio.to_thread(settings_of, folders[0])
                changed = {row.name for row in comparison.settings}
                same = {name: value for name, value in first.items() if name not in changed}
        except ConfigError as error:
            problem = str(error).replace(f"{folder}/", "")
    query = [("run", name) for name in names]
    return page(
        request,
        "compare.html",
        section="runs",
        names=names,
        runs=[run for run in runs if run is not None],
        comparison=comparison,
        problem=problem,
        same=same,
        shows_all=shows_all,
        toggle=f"/compare?{urlencode(query if shows_all else [*query, ('all', '1')])}",
        without={name: _address([one for one in names if one != name]) for name in names},
        as_first={name: _address(sorted(names, key=lambda one: one != name)) for name in names},
        others=others,
        series=[run.name for run in runs if run is not None and SERIES in run.files],
        number=_number,
        shortened=lambda line: line.replace(f"{folder}/", ""),
    )


def _address(names: list[str]) -> str:
    return f"/compare?{urlencode([('run', name) for name in names])}"


def _number(figure: str, value: float | None, signed: bool = False) -> str:
    """A figure's value with its decimals; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:{'+' if signed else ''}.{_DIGITS.get(figure, 3)}f}"
