"""The map that the robot makes, as files in a run's folder: the newest of each."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.slam_documents import PoseGraph
from mazebot.common.recordings.run_folder import write_atomically
from mazebot.common.world.map_files import write_map
from mazebot.common.world.marker_file import write_markers

MAP_FOLDER = "map"
MAP_NAME = "map"
MARKERS = "markers.yaml"
POSE_GRAPH_FILE = "pose_graph.json"
SAVED_MAPS = "saved_maps"
"""The folder of those that a user has asked for."""
WRITE_PERIOD_NS = 2_000_000_000
"""Simulation time between two versions of a file, at least."""

_LOG = logging.getLogger("recorder")


class MapFolder:
    """Writes the files when something new has come, each one atomically: map.yaml and map.pgm for
    Nav2, markers.yaml, and pose_graph.json.
    """

    def __init__(self) -> None:
        self._grid: msg.OccupancyGrid | None = None
        self._graph: PoseGraph | None = None
        self._unwritten: set[str] = set()
        self._written_ns: dict[str, int] = {}
        self._in_trouble: set[str] = set()

    def add_map(self, grid: msg.OccupancyGrid) -> None:
        """Set the newest map."""
        self._grid = grid
        self._unwritten.add(MAP_NAME)

    def add_pose_graph(self, graph: PoseGraph) -> None:
        """Set the newest pose graph."""
        self._graph = graph
        self._unwritten.add(POSE_GRAPH_FILE)

    def write_all_again(self) -> None:
        """Write everything again: the run's folder is another one."""
        if self._grid is not None:
            self._unwritten.add(MAP_NAME)
        if self._graph is not None:
            self._unwritten.add(POSE_GRAPH_FILE)
        self._written_ns.clear()

    def write(self, folder: Path, now_ns: int, all_of_it: bool = False) -> None:
        """Write what is new to a run's folder, unless it was written just before. A failure is
        logged once, and retried.
        """
        for name, write in ((MAP_NAME, self._write_map), (POSE_GRAPH_FILE, self._write_graph)):
            before_ns = self._written_ns.get(name)
            is_due = before_ns is None or not 0 <= now_ns - before_ns < WRITE_PERIOD_NS
            if name in self._unwritten and (is_due or all_of_it):
                self._written_ns[name] = now_ns
                self._try(name, write, folder / MAP_FOLDER)

    def _try(self, name: str, write: Callable[[Path], None], folder: Path) -> None:
        try:
            folder.mkdir(exist_ok=True)
            write(folder)
        except (OSError, ConfigError) as error:
            if name not in self._in_trouble:
                reason = error.strerror if isinstance(error, OSError) else error
                _LOG.error("failed to write the map %s: %s", folder / name, reason)
            self._in_trouble.add(name)
            return
        self._unwritten.discard(name)
        if name in self._in_trouble:
            self._in_trouble.discard(name)
            _LOG.info("%s: recovered; written again", folder / name)

    def _write_map(self, folder: Path) -> None:
        grid = self._grid
        if grid is None or not grid.data.size:
            return
        origin: SE2 = msg.se2_from_pose(grid.info.origin)
        cells = msg.cells_from_grid(grid)
        write_map(folder, MAP_NAME, cells, float(grid.info.resolution), origin)

    def _write_graph(self, folder: Path) -> None:
        graph = self._graph
        if graph is None:
            return
        # A killed process loses nothing that was passed to the kernel.
        text = graph.model_dump_json().encode()
        write_atomically(folder / POSE_GRAPH_FILE, [text, b"\n"], sync=False)
        write_markers(folder / MARKERS, graph.landmarks)
