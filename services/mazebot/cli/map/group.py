"""`mazebot map save`: the map of a running stack, as files."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Annotated

import typer

from mazebot.cli.map.build import build
from mazebot.cli.parsing.command import App
from mazebot.cli.parsing.options import ROUTER, Connect, Json, print_json
from mazebot.common.config import ConfigError

app = App(help="Save maps, and build them from recorded logs.")
app.command()(build)

_MAP_PATIENCE_S = 3.0
_GRAPH_PATIENCE_S = 1.0
"""Time to wait for a pose graph; without slam there is none."""


@app.command()
def save(
    name: Annotated[
        Path, typer.Argument(metavar="NAME", help="path of the files without their endings")
    ],
    connect: Connect = ROUTER,
    as_json: Json = False,
) -> None:
    """Save the map of a running stack: NAME.yaml and NAME.pgm as Nav2 reads them, and from mapping
    NAME.pose_graph.json and NAME.markers.yaml.
    """
    from mazebot.common.client.over_zenoh import ZenohRobot  # noqa: PLC0415 - loads Zenoh
    from mazebot.common.client.subscription import first_message  # noqa: PLC0415
    from mazebot.common.messages.action_documents import SaveMap  # noqa: PLC0415
    from mazebot.common.messages.topics import MAP, POSE_GRAPH, WORLD  # noqa: PLC0415
    from mazebot.common.recordings.saved_map import save_map  # noqa: PLC0415
    from mazebot.common.world.map_files import FREE_THRESH  # noqa: PLC0415

    if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", name.name, re.ASCII):
        raise ConfigError(f"NAME: {str(name)!r:.80}: must end in letters, digits, '_', '-' or '.'")
    with ZenohRobot(connect) as robot:
        grid = first_message(robot, MAP, _MAP_PATIENCE_S, "no map")
        slam = first_message(robot, WORLD, _MAP_PATIENCE_S, "no world").slam
        graph = first_message(robot, POSE_GRAPH, _GRAPH_PATIENCE_S) if slam else None
    wanted = SaveMap(name=name.name, free_thresh=FREE_THRESH)
    files = [str(path) for path in save_map(name.parent, wanted, grid, graph)]
    if as_json:
        print_json({"files": files})
        return
    sys.stdout.write("".join(f"{file}\n" for file in files))
