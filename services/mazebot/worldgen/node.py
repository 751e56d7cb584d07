"""World generator: replies to a world request with the world's assets, description and map."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from mazebot.common.messages.action_documents import LoadMap, LoadMapReply
from mazebot.common.messages.documents import MappedMarker, WorldRequest, WorldStatus
from mazebot.common.messages.messages import occupancy_grid
from mazebot.common.messages.topics import ASSETS, LOAD_MAP, MAP, WORLD, WORLD_REQUEST, WORLD_STATUS
from mazebot.common.node.node import Inbox, Node, Outbox
from mazebot.common.problems import WorldError
from mazebot.common.ros.map_exchange import MapDataError, map_of_document
from mazebot.common.world.assets import asset_message
from mazebot.common.world.map_files import MapFile, read_map
from mazebot.common.world.marker_file import marker_file_of, read_markers
from mazebot.worldgen.config import WorldgenConfig
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world

Load = Callable[[str, bool, Path, Path | None, tuple[str, ...]], LoadedWorld]

_log = logging.getLogger("worldgen")


class WorldgenNode(Node):
    """Loads the first requested world, and keeps it: requests for another one are refused."""

    name = "worldgen"
    _config: WorldgenConfig
    wakes = (WORLD_REQUEST,)

    def __init__(self, config: WorldgenConfig, load: Load = load_world) -> None:
        """Raises ConfigError where the map cannot be read."""
        self._config = config
        self._load = load
        self._map = None if config.map_file is None else read_map(config.map_file)
        self._mapped_markers: tuple[MappedMarker, ...] | None = None
        self._running: LoadedWorld | None = None
        self._mode = WorldRequest(world_name="")
        """The request of the world that runs."""
        self._error = ""

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Process each request."""
        for request in inbox.new(WORLD_REQUEST):
            self._error = self._answer(request, outbox)
            if self._error:
                _log.error("%s", self._error)
            status = WorldStatus(request=request, world_hash=self.world_hash, error=self._error)
            outbox.put(WORLD_STATUS, status)
        for wanted in inbox.requests(LOAD_MAP):
            wanted.respond(self._load_map(wanted.message, outbox))

    def waiting_for(self) -> str | None:
        """A valid request."""
        if self._running:
            return None
        return f"a valid world request: {self._error}" if self._error else "a world request"

    def _answer(self, request: WorldRequest, outbox: Outbox) -> str:
        config = self._config
        try:
            loaded = self._load(
                request.world_name,
                request.use_aruco,
                config.worlds_dir,
                config.texture_base,
                request.overrides,
            )
            markers = self._markers_beside_map(loaded)
        except WorldError as error:
            return str(error)
        if request.slam and self._map is not None:
            return f"slam: {config.map_file}: must be without a map (map_file), or without slam"
        if self._running is None:
            self._running, self._mode, self._mapped_markers = loaded, request, markers
            self.world_hash = loaded.world.hash
            self._publish(loaded, outbox)
            return ""
        running, asked = self._running.world, loaded.world
        if asked.hash == running.hash:
            if (request.slam, request.explores) == (self._mode.slam, self._mode.explores):
                return ""
            return (
                f"slam: {_mode(request)}: must be as {running.name!r} is running, "
                f"{_mode(self._mode)}: stop that one first (docker compose down)"
            )
        return (
            f"world_name: {asked.name!r} ({_about(loaded)}): must be the world that is running, "
            f"{running.name!r} ({_about(self._running)}): stop that one first (docker compose down)"
        )

    def _markers_beside_map(self, loaded: LoadedWorld) -> tuple[MappedMarker, ...] | None:
        """Raises WorldError where they cannot be read."""
        map_file = self._config.map_file
        path = None if map_file is None else marker_file_of(map_file)
        return None if path is None else read_markers(path, loaded.world.walls)

    def _load_map(self, wanted: LoadMap, outbox: Outbox) -> LoadMapReply:
        """Publish a map in place of the world's own."""
        if self._running is None:
            return LoadMapReply(result=255, error=f"worldgen is waiting for {self.waiting_for()}")
        if self._mode.slam:
            return LoadMapReply(result=255, error="slam: mapping makes the map of this run")
        try:
            chart = map_of_document(wanted)
        except MapDataError as error:
            return LoadMapReply(result=2, error=str(error))
        outbox.put(MAP, occupancy_grid(0, chart.resolution_m, chart.origin, chart.cells))
        _log.info("Loaded a map of %d x %d cells", wanted.columns, wanted.rows)
        _warn_of("of the request", chart, self._running)
        return LoadMapReply()

    def _publish(self, loaded: LoadedWorld, outbox: Outbox) -> None:
        mode = self._mode
        world = loaded.world.model_copy(
            update={
                "slam": mode.slam,
                "explore": mode.explores,
                "mapped_markers": self._mapped_markers,
            }
        )
        for sha256, data in loaded.assets.items():
            outbox.put(ASSETS, asset_message(sha256, data))
        outbox.put(WORLD, world)
        about = "no map: mapping will build it"
        if not mode.slam:
            chart = self._map or MapFile(
                loaded.map_cells, world.map_resolution_m, loaded.map_origin
            )
            # The map of a static world has no time.
            outbox.put(MAP, occupancy_grid(0, chart.resolution_m, chart.origin, chart.cells))
            rows, columns = chart.cells.shape
            about = f"map of {columns} x {rows} cells"
            if self._map or world.map_sha256:
                name = self._config.map_file or (loaded.recipe.map if loaded.recipe else "")
                _warn_of(str(name), chart, loaded)
        _log.info(
            "Loaded world %s (%s): %s, %d textures, %d meshes",
            world.name, _about(loaded), about,
            len(loaded.assets) - len(loaded.meshes), len(loaded.meshes),
        )  # fmt: skip


def _warn_of(name: str, chart: MapFile, loaded: LoadedWorld) -> None:
    """Say what is wrong with a map that was not made of this world, before it is used."""
    from mazebot.worldgen.map.disagreement import misfit_in  # noqa: PLC0415 - loads scipy

    if chart.warning:
        _log.warning("%s", chart.warning)
    found = misfit_in(chart, loaded.world, loaded.meshes)
    if found:
        _log.warning("map %s does not fit the world %s: %s", name, loaded.world.name, found)


def _mode(request: WorldRequest) -> str:
    if not request.slam:
        return "with a map"
    return "exploring" if request.explore else "mapping without exploring"


def _about(loaded: LoadedWorld) -> str:
    world = loaded.world
    bodies = f"{len(world.bodies)} bodies, " if world.bodies else ""
    return f"{len(world.walls)} walls, {bodies}{len(world.markers)} markers, hash {world.hash}"
