"""Pages from templates, and the page of an error."""

from __future__ import annotations

import json
from http import HTTPStatus
from pathlib import Path
from typing import Any

import jinja2
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response

from mazebot.console.loading import LOADING_SCRIPT
from mazebot.console.security import is_of_script

HERE = Path(__file__).parent
STATIC = HERE / "static"


def size(size_bytes: float) -> str:
    """A size as text for a page."""
    for unit in ("B", "kB", "MB"):
        if size_bytes < 1000.0:
            return f"{size_bytes:.0f} {unit}" if unit == "B" else f"{size_bytes:.1f} {unit}"
        size_bytes /= 1000.0
    return f"{size_bytes:.2f} GB"


def seconds(time_s: float | None) -> str:
    """A duration as text for a page."""
    if time_s is None:
        return "-"
    if time_s < 120.0:
        return f"{time_s:.1f} s"
    minutes, rest_s = divmod(round(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest_s:02d} s"


def metres(length_m: float | None) -> str:
    """A length as text for a page."""
    return "-" if length_m is None else f"{length_m:.1f} m"


def millimetres(length_m: float | None) -> str:
    """A small length as text for a page."""
    return "-" if length_m is None else f"{1000.0 * length_m:.0f} mm"


def in_words(value: object) -> str:
    """A setting's value as text for a page."""
    if value is None:
        return "none"
    return value if isinstance(value, str) else json.dumps(value, default=str)


TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(HERE / "templates"),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
TEMPLATES.globals.update(zip=zip, loading_script=LOADING_SCRIPT)
TEMPLATES.filters.update(
    size=size, seconds=seconds, metres=metres, millimetres=millimetres, in_words=in_words
)


def page(
    request: Request,
    template: str,
    *,
    status: int = 200,
    headers: dict[str, str] | None = None,
    **context: Any,
) -> HTMLResponse:
    """A page of the console; its template extends `base.html`.

    `section` in the context (`live` or `runs`) marks the entry of the navigation.
    """
    session = request.scope.get("mazebot.session")
    text = TEMPLATES.get_template(template).render(
        {
            "request": request, "section": "", "has_live": request.app.state.has_live,
            "role": session.role if session else "", **context,
        }
    )  # fmt: skip
    return HTMLResponse(text, status, headers={"cache-control": "no-cache", **(headers or {})})


def wants_json(request: Request) -> bool:
    """Whether a script asks, not a browser's user."""
    return is_of_script(request.headers)


async def error_page(request: Request, error: Exception) -> Response:
    """The answer to a request that cannot be done: a page, or `{"error": ...}` for a script."""
    assert isinstance(error, HTTPException)
    headers = dict(error.headers or {})
    phrase = HTTPStatus(error.status_code).phrase
    if wants_json(request):
        return JSONResponse({"error": error.detail}, error.status_code, headers)
    message = "" if error.detail == phrase else error.detail
    return page(
        request,
        "error.html",
        status=error.status_code,
        headers=headers,
        heading=phrase,
        message=message,
    )
