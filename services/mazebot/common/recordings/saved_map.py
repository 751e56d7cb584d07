"""The files of a map that a user saves: Nav2's, and in a run in which the robot makes the map, its
pose graph and markers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mazebot.common.config import ConfigError
from mazebot.common.files.folder_writing import write_file
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import SaveMap
from mazebot.common.messages.slam_documents import PoseGraph
from mazebot.common.world.map_files import write_map
from mazebot.common.world.marker_file import write_markers


def save_map(
    folder: Path, wanted: SaveMap, grid: msg.OccupancyGrid, graph: PoseGraph | None
) -> list[Path]:
    """Write NAME.yaml with its image as map_saver does, and of a graph NAME.pose_graph.json and
    NAME.markers.yaml; returns the files, the YAML file first.

    Raises ConfigError where one cannot be written as wanted.
    """
    cells = np.array(msg.cells_from_grid(grid), np.int8)
    origin = msg.se2_from_pose(grid.info.origin)
    resolution_m = float(grid.info.resolution)
    path = write_map(
        folder, wanted.name, cells, resolution_m, origin,
        wanted.mode, wanted.image_format,  # type: ignore[arg-type]
        wanted.free_thresh, wanted.occupied_thresh,
    )  # fmt: skip
    files = [path, path.with_suffix(f".{wanted.image_format}")]
    if graph is None:
        return files
    for ending in ("pose_graph.json", "markers.yaml"):
        path = folder / f"{wanted.name}.{ending}"
        try:
            if ending == "markers.yaml":
                write_markers(path, graph.landmarks)
            else:
                write_file(path, graph.model_dump_json().encode())
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
        files.append(path)
    return files
