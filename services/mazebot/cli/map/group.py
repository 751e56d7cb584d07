"""`mazebot map save`: the map of a running stack, as files."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mazebot.cli.map.build import build
from mazebot.cli.parsing.command import App
from mazebot.cli.parsing.options import ROUTER, Connect, Json, print_json
from mazebot.common.config import ConfigError

if TYPE_CHECKING:
    from mazebot.common.messages.slam_documents import PoseGraph

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
    from mazebot.common.messages.topics import MAP, POSE_GRAPH, WORLD  # noqa: PLC0415

    if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", name.name, re.ASCII):
        raise ConfigError(f"NAME: {str(name)!r:.80}: must end in letters, digits, '_', '-' or '.'")
    with ZenohRobot(connect) as robot:
        grid = first_message(robot, MAP, _MAP_PATIENCE_S, "no map")
        slam = first_message(robot, WORLD, _MAP_PATIENCE_S, "no world").slam
        graph = first_message(robot, POSE_GRAPH, _GRAPH_PATIENCE_S) if slam else None
    files = [str(path) for path in _write(name, grid, graph)]
    if as_json:
        print_json({"files": files})
        return
    sys.stdout.write("".join(f"{file}\n" for file in files))


def _write(name: Path, grid: object, graph: PoseGraph | None) -> list[Path]:
    """The files written. Raises ConfigError where one cannot be."""
    import numpy as np  # noqa: PLC0415

    from mazebot.common.files.folder_writing import write_file  # noqa: PLC0415
    from mazebot.common.messages import messages as msg  # noqa: PLC0415
    from mazebot.common.world.map_files import write_map  # noqa: PLC0415
    from mazebot.common.world.marker_file import write_markers  # noqa: PLC0415

    assert isinstance(grid, msg.OccupancyGrid)
    cells = np.array(msg.cells_from_grid(grid), np.int8)
    origin = msg.se2_from_pose(grid.info.origin)
    files = [write_map(name.parent, name.name, cells, grid.info.resolution, origin)]
    files.append(files[0].with_suffix(".pgm"))
    if graph is None:
        return files
    for ending in ("pose_graph.json", "markers.yaml"):
        path = name.with_name(f"{name.name}.{ending}")
        try:
            if ending == "markers.yaml":
                write_markers(path, graph.landmarks)
            else:
                write_file(path, graph.model_dump_json().encode())
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
        files.append(path)
    return files
