"""Rerun's viewer for the browser, from the package of the same version as the recorder's."""

from __future__ import annotations

import functools
import importlib.util
import os
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from mazebot.console.file_answer import FileAnswer
from mazebot.console.loading import LOADING_SOURCE
from mazebot.console.security import address_of, content_policy

SCRIPT = "widget.js"
MODULE = "re_viewer_bg.wasm"
_TYPES = {SCRIPT: "text/javascript; charset=utf-8", MODULE: "application/wasm"}


@functools.cache
def assets_folder() -> Path | None:
    """The folder of the viewer's script and module; None: not installed."""
    # Found without importing it: the package is made for notebooks, and needs their libraries.
    found = importlib.util.find_spec("rerun_notebook")
    if found is None or found.origin is None:
        return None
    folder = Path(found.origin).parent / "static"
    known = (folder / SCRIPT, folder / f"{SCRIPT}.gz")
    return folder if any(path.is_file() for path in known) else None


@functools.cache
def viewer_version() -> str:
    """The version of the viewer; empty: not installed."""
    try:
        return version("rerun-notebook") if assets_folder() else ""
    except PackageNotFoundError:
        return ""


def viewer_routes() -> list[Route]:
    """The viewer's two files, at addresses with its version, so that browsers keep them."""
    return [Route("/viewer/{version}/{name}", _asset)]


def live_data_of(request: Request) -> str:
    """Host and port from which the recorder shows its run live; empty: not at all."""
    port: int = request.app.state.config.live_data_port
    return address_of(request.headers["host"], port) if port else ""


def viewer_policy(live_data: str) -> str:
    """The content security policy of a page with the viewer: WebAssembly, elements with a `style`,
    and the recorder's data at `live_data`, a host with a port, or empty.
    """
    live = f" http://{live_data}" if live_data else ""
    return content_policy(
        script_src=f"'self' {LOADING_SOURCE} 'wasm-unsafe-eval'",
        style_src_attr="'unsafe-inline'",
        connect_src=f"'self' data: blob:{live}",
        worker_src="'self' blob:",
    )


async def _asset(request: Request) -> Response:
    folder = assets_folder()
    name = request.path_params["name"]
    if folder is None or name not in _TYPES or request.path_params["version"] != viewer_version():
        raise HTTPException(404)
    headers = {"cache-control": "public, max-age=31536000, immutable", "vary": "accept-encoding"}
    packed = folder / f"{name}.gz"
    accepts = "gzip" in request.headers.get("accept-encoding", "")
    # In the container image there is only the packed one.
    is_packed = packed.is_file() and (accepts or not (folder / name).is_file())
    if is_packed:
        headers["content-encoding"] = "gzip"
    file = os.open(packed if is_packed else folder / name, os.O_RDONLY | os.O_CLOEXEC)
    return FileAnswer(file, _TYPES[name], headers=headers)
