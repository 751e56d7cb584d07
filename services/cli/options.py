"""Options that several commands have."""

from __future__ import annotations

from typing import Annotated

import typer

ROUTER = "tcp/127.0.0.1:7447"
Connect = Annotated[
    str,
    typer.Option(envvar="MAZEBOT_BUS_CONNECT", help="Zenoh endpoint of the stack's router"),
]
