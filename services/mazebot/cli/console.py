"""`mazebot console`."""

from __future__ import annotations

import contextlib
import webbrowser
from pathlib import Path
from typing import Annotated, Any

import typer

from mazebot.cli.parsing.options import ROUTER, Connect
from mazebot.cli.parsing.patience import wait_quietly


def console(
    directory: Annotated[
        Path | None, typer.Option("--dir", help="folder of recordings [default: ./recordings]")
    ] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="port; 0: any free one [default: 8080]")
    ] = None,
    bind: Annotated[
        str | None,
        typer.Option(help="address; 0.0.0.0: for the whole network [default: 127.0.0.1]"),
    ] = None,
    login: Annotated[
        str | None,
        typer.Option(
            help="auto, always or never: whether those who open the pages need the token in the "
            "printed address; auto: where --bind is more than this machine [default: auto]"
        ),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live/--no-live", help="show and drive a running stack")
    ] = True,
    connect: Connect = ROUTER,
    open_browser: Annotated[
        bool, typer.Option("--open", help="open it in a browser, if this machine has one")
    ] = False,
) -> None:
    """Serve the console, a page with all runs and, while a stack runs, its live view and controls,
    to browsers on this machine until Ctrl-C.
    """
    # The web server takes long to import.
    from mazebot.common.bus.config import BusConfig  # noqa: PLC0415
    from mazebot.common.config import ConfigError  # noqa: PLC0415
    from mazebot.common.settings.load import load  # noqa: PLC0415
    from mazebot.console.config import ConsoleConfig  # noqa: PLC0415
    from mazebot.console.start import log_to_stdout, serve  # noqa: PLC0415

    if directory is not None and not directory.is_dir():
        raise ConfigError(f"--dir: {directory}: must be a folder of recordings")
    options: dict[str, Any] = {"recordings_dir": directory, "port": port, "bind": bind}
    options["login"] = login
    given = {name: value for name, value in options.items() if value is not None}
    if not live:
        given["live"] = False
    config = load(ConsoleConfig, "console", [], given)
    log_to_stdout()
    wait_quietly()
    bus_config = load(BusConfig, "bus", [], {"connect": connect})
    # That is how it ends, as a service does.
    with contextlib.suppress(KeyboardInterrupt):
        serve(config, bus_config, webbrowser.open if open_browser else None)
