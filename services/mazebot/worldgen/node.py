"""World generator: replies to a world request with the world's assets, description and map."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from mazebot.common.messages.action_documents import (
    GetWorldsReply,
    LoadMap,
    LoadMapReply,
    LoadWorld,
    LoadWorldReply,
)
from mazebot.common.messages.documents import (
    MappedMarker,
    UnseenArea,
    WorldRequest,
    WorldStatus,
)
from mazebot.common.messages.messages import occupancy_grid
from mazebot.common.messages.topics import (
    ASSETS,
    GET_MODELS,
    GET_WORLDS,
    LOAD_MAP,
    LOAD_WORLD,
    MAP,
    READ_MODEL,
    WORLD,
    WORLD_REQUEST,
    WORLD_STATUS,
)
from mazebot.common.node.node import Inbox, Node, Outbox
from mazebot.common.problems import WorldError
from mazebot.common.ros.map_exchange import MapDataError, map_of_document
from mazebot.common.world.assets import asset_message
from mazebot.common.world.map_files import MapFile, read_map
from mazebot.common.world.marker_file import MarkerFile, marker_file_of, read_markers
from mazebot.worldgen.config import WorldgenConfig
from mazebot.worldgen.map.unseen import unseen_areas
from mazebot.worldgen.models.model_reading import entity_of
from mazebot.worldgen.models.spawnable_models import SpawnableModels
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world
from mazebot.worldgen.recipe.sources import full_name, known_worlds

Load = Callable[[str, bool, Path, Path | None, tuple[str, ...]], LoadedWorld]

_log = logging.getLogger("worldgen")


class WorldgenNode(Node):
    """Loads the first requested world, and keeps it until it is told to load another one in its
    place: further requests for another one are refused.
    """

    name = "worldgen"
    _config: WorldgenConfig
    wakes = (WORLD_REQUEST,)

    def __init__(self, config: WorldgenConfig, load: Load = load_world) -> None:
        """Raises ConfigError where the map cannot be read."""
        self._config = config
        self._load = load
        self._model_roots = (config.worlds_dir / "models",)
        """Folders of models, beside those that are shipped."""
        self._models = SpawnableModels(self._model_roots)
        self._map = None if config.map_file is None else read_map(config.map_file)
        self._mapped_markers: tuple[MappedMarker, ...] | None = None
        self._running: LoadedWorld | None = None
        self._mode = WorldRequest(world_name="")
        """The request of the world that runs."""
        self._before: WorldStatus | None = None
        """The last word of the process before this one,"""
        self._resumed = False
        """and whether its world was taken up, or there was none."""
        self._error = ""

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Process each request."""
        is_first = False
        if not self._resumed:
            self._before = inbox.latest(WORLD_STATUS) or self._before
            if not inbox.is_handed_over:
                return
            self._resumed = True
            is_first = self._resume(outbox)
        for request in inbox.new(WORLD_REQUEST):
            self._error = self._answer(request, outbox)
            if self._error:
                # What was requested before this process began may have been replaced since.
                _log.log(logging.INFO if is_first else logging.ERROR, "%s", self._error)
            self._publish_status(request, outbox)
        for wanted in inbox.requests(LOAD_WORLD):
            wanted.respond(self._load_world(wanted.message, outbox))
        for asked in inbox.requests(GET_WORLDS):
            asked.respond(self._worlds())
        for listing in inbox.requests(GET_MODELS):
            listing.respond(self._models.answer())
        for read in inbox.requests(READ_MODEL):
            read.respond(entity_of(read.message, *self._model_roots))
        for map_wanted in inbox.requests(LOAD_MAP):
            map_wanted.respond(self._load_map(map_wanted.message, outbox))

    def _resume(self, outbox: Outbox) -> bool:
        """Take up the world of the process before this one; whether there was one."""
        before, self._before = self._before, None
        if before is None or before.running is None:
            return False
        error = self._answer(before.running, outbox)
        if error:
            _log.error("the world that was running cannot be loaded again: %s", error)
            return False
        self._publish_status(before.running, outbox)
        return True

    def _publish_status(self, request: WorldRequest, outbox: Outbox) -> None:
        running = self._mode if self._running is not None else None
        status = WorldStatus(
            request=request, world_hash=self.world_hash, error=self._error, running=running
        )
        outbox.put(WORLD_STATUS, status)

    def waiting_for(self) -> str | None:
        """A valid request."""
        if self._running:
            return None
        return f"a valid world request: {self._error}" if self._error else "a world request"

    def _answer(self, request: WorldRequest, outbox: Outbox) -> str:
        try:
            loaded = self._loaded(request)
            markers = self._markers_beside_map(loaded)
        except WorldError as error:
            return str(error)
        if request.slam and self._map is not None:
            return (
                f"slam: {self._config.map_file}: must be without a map (map_file), or without slam"
            )
        if self._running is None:
            self._run(loaded, request, markers, outbox)
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
            f"{running.name!r} ({_about(self._running)}): stop that one first (docker compose "
            f"down), or put this one in its place (mazebot sim load-world {asked.name})"
        )

    def _loaded(self, request: WorldRequest) -> LoadedWorld:
        """Raises WorldError."""
        config = self._config
        return self._load(
            request.world_name,
            request.use_aruco,
            config.worlds_dir,
            config.texture_base,
            request.overrides,
        )

    def _run(
        self,
        loaded: LoadedWorld,
        request: WorldRequest,
        beside_map: MarkerFile | None,
        outbox: Outbox,
    ) -> None:
        self._running, self._mode = loaded, request
        self._mapped_markers = None if beside_map is None else beside_map.markers
        for warning in () if beside_map is None else beside_map.warnings:
            _log.warning("%s", warning)
        self.world_hash = loaded.world.hash
        self._publish(loaded, outbox)

    def _load_world(self, wanted: LoadWorld, outbox: Outbox) -> LoadWorldReply:
        """Put another world in the place of the one that runs; with or without slam, as it is."""
        running, map_file = self._running, self._config.map_file
        try:
            if running is not None and map_file is not None:
                raise WorldError(
                    f"map_file: {map_file}: is of the world that is running: must be left out "
                    "where worlds are loaded in its place"
                )
            name = full_name(wanted.world_name, self._config.worlds_dir)
            request = self._mode.model_copy(update={**dict(wanted), "world_name": name})
            loaded = self._loaded(request)
            markers = self._markers_beside_map(loaded)
        except WorldError as error:
            return self._of_running(str(error))
        if running is not None and loaded.world.hash == running.world.hash:
            return self._of_running()
        self._error = ""
        self._run(loaded, request, markers, outbox)
        self._publish_status(request, outbox)
        return self._of_running().model_copy(update={"is_new": True})

    def _of_running(self, error: str = "") -> LoadWorldReply:
        name = "" if self._running is None else self._running.world.name
        return LoadWorldReply(world_name=name, world_hash=self.world_hash, error=error)

    def _worlds(self) -> GetWorldsReply:
        try:
            names = known_worlds(self._config.worlds_dir)
        except WorldError as error:
            _log.error("%s", error)
            names = []
        running = self._of_running()
        world = None if self._running is None else self._running.world
        return GetWorldsReply(
            names=tuple(names),
            running=running.world_name,
            running_hash=running.world_hash,
            start=None if world is None else world.start,
            locations=() if world is None else world.locations,
        )

    def _markers_beside_map(self, loaded: LoadedWorld) -> MarkerFile | None:
        """Raises WorldError where they cannot be read."""
        map_file = self._config.map_file
        path = None if map_file is None else marker_file_of(map_file)
        if path is None:
            return None
        world = loaded.world
        return read_markers(path, world.walls, dictionaries=world.dictionaries, chart=self._map)

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
        unseen: tuple[UnseenArea, ...] = ()
        if not (mode.slam or self._map or loaded.world.map_sha256):
            unseen = unseen_areas(loaded.world, loaded.meshes, loaded.map_cells, loaded.map_origin)
        world = loaded.world.model_copy(
            update={
                "slam": mode.slam,
                "explore": mode.explores,
                "mapped_markers": self._mapped_markers,
                "unseen": unseen,
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
