"""Records every run: draws its messages, evaluates it against the ground truth, in a folder."""

from __future__ import annotations

import functools
import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Collection
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mazebot.common.config import ConfigError
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.action_documents import SaveMap, SaveMapReply
from mazebot.common.messages.pending_image import PendingImage
from mazebot.common.messages.topics import (
    ACTION_RESULT,
    ASSETS,
    CLOCK,
    CONTACTS,
    DESIRED_ENTITIES,
    DIAGNOSTICS,
    ENTITIES,
    EVALUATION,
    EXPLORATION_STATUS,
    GOAL_POSE,
    MAP,
    NAVIGATION_RESULT,
    PARAMETERS,
    POSE_GRAPH,
    ROSOUT,
    SAVE_MAP,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    WORLD,
    WORLD_REQUEST,
    WORLD_STATUS,
    Delivery,
    Topic,
    read_by,
)
from mazebot.common.node.frame_tree import FrameNames, FrameTree
from mazebot.common.node.node import Envelope, Inbox, Node, Outbox, Received
from mazebot.common.recordings.run_folder import RunFolder, check_free, check_writable
from mazebot.common.recordings.saved_map import save_map
from mazebot.common.world.assets import assets_of
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.keeping.beginnings import Beginnings
from mazebot.recorder.keeping.closing import Closings, delete_old_runs
from mazebot.recorder.keeping.progress import Progress
from mazebot.recorder.keeping.repair import Repair, interrupted
from mazebot.recorder.keeping.run.judge import JUDGED
from mazebot.recorder.keeping.run.map_folder import SAVED_MAPS
from mazebot.recorder.keeping.run.run import Run
from mazebot.recorder.keeping.run.setting import Setting
from mazebot.recorder.keeping.versions import hardware, versions
from mazebot.recorder.stream.message_log import Taken

if TYPE_CHECKING:
    from mazebot.common.client.robot import Robot
    from mazebot.recorder.foxglove.server import FoxgloveServer
    from mazebot.recorder.keeping.live import LiveView

_LOG = logging.getLogger("recorder")

EVALUATION_PERIOD_NS = 1_000_000_000
OVERLAP_S = 10.0
"""Overlap of the messages received again with the dead recorder's progress: a message that both
received counts once, one that either missed is lost.
"""
SIMULATION_PATIENCE_S = 5.0
"""Wall time within which simulation stats must arrive for an interrupted run to be resumed."""
_READ: tuple[Topic[Any], ...] = tuple(read_by("recorder"))
_EARLY: tuple[Topic[Any], ...] = (
    WORLD_REQUEST,
    WORLD_STATUS,
    PARAMETERS,
    DIAGNOSTICS,
    ROSOUT,
    GOAL_POSE,
    NAVIGATION_RESULT,
    ACTION_RESULT,
    CONTACTS,
)
"""Messages that are queued until there is a run."""
_FIXED: tuple[Topic[Any], ...] = (
    MAP,
    TF_STATIC,
    DESIRED_ENTITIES,
    ENTITIES,
    POSE_GRAPH,
    EXPLORATION_STATUS,
)
"""Latched messages, which stay valid until the next one, even in the next run;"""
_OF_A_RUN: tuple[Topic[Any], ...] = (MAP, POSE_GRAPH, EXPLORATION_STATUS)
"""but of these none is, where the robot makes the map."""

_UNRECORDED: tuple[Topic[Any], ...] = tuple(
    topic
    for topic in (*JUDGED, *_EARLY, *_FIXED, WORLD, ASSETS, SIMULATION_STATS)
    if topic is not CLOCK
)
"""What the evaluation of a run needs that is neither recorded nor drawn: the time of its own steps
takes the place of the clock's messages.
"""

_MOST_ASSETS = 1000
_MOST_ASSET_BYTES = 256 * 1024 * 1024


def _no_frames() -> dict[Topic[Any], FrameNames | FrameTree]:
    """Checks of messages with transforms, by topic. A cycle of moving frames is resolved by their
    next message, one of fixed frames never is.
    """
    return {TF: FrameNames(), TF_STATIC: FrameTree()}


class RecorderNode(Node):
    """Writes a folder per run. A run is one world, from one start of its simulation to its end."""

    name = "recorder"
    _config: RecorderConfig
    period_ns = 100_000_000
    # Stats announce a pause while simulation time stands still.
    wakes = (
        SIMULATION_STATS,
        *(topic for topic in _READ if topic.rate_hz is None),
    )
    depth = 64

    def __init__(
        self,
        config: RecorderConfig,
        wall_clock_s: Callable[[], float] = time.monotonic,
        local_time: Callable[[], datetime] = datetime.now,
        robot: Callable[[], Robot] | None = None,
    ) -> None:
        """`robot`: to which clients of Foxglove send goals and queries; called if it is enabled.

        Raises ConfigError if a folder cannot be written or a port is in use.
        """
        self._config = config
        self._local_time = local_time
        self._seed = config.seed
        """The simulation's seed, as soon as it is known: a reset may change it."""
        if config.out_dir is None:
            check_writable(config.recordings_dir)
        else:
            check_free("out_dir", config.out_dir)
        self._live: LiveView | None = None
        if config.live:
            from mazebot.recorder.keeping.live import LiveView  # noqa: PLC0415 - loads Rerun

            self._live = LiveView(
                config.bind, config.web_port, config.grpc_port, config.live_memory_mib
            )
            _LOG.info("live view on http://localhost:%d", config.web_port)
        self._robot: Robot | None = None
        self._foxglove: FoxgloveServer | None = None
        if config.foxglove:
            from mazebot.recorder.foxglove.server import (  # noqa: PLC0415 - loads its SDK
                LAYOUT,
                FoxgloveServer,
            )

            self._robot = robot() if robot is not None else None
            self._foxglove = FoxgloveServer(config.foxglove_bind, config.foxglove_port, self._robot)
            where = f"ws://localhost:{self._foxglove.port}"
            _LOG.info("Foxglove: open connection %s; layout: %s", where, LAYOUT)
        self._setting = Setting(
            config,
            wall_clock_s,
            versions(),
            hardware(),
            live=self._live.feed if self._live else None,
            foxglove=self._foxglove,
            resumable=config.out_dir is None,
        )
        self._parameters = self._setting.parameters
        self._interrupted = interrupted(config.recordings_dir) if config.out_dir is None else None
        """Folder and progress of a run whose recorder died and that may still be resumed."""
        if self._interrupted is not None:
            # The last messages that it received may not be in its progress.
            self.hears_from_s = self._interrupted[1].written_s - OVERLAP_S
        self._offered: tuple[doc.World, float] | None = None
        """A world that may belong to that run, and the wall time of its arrival."""
        self._simulation: tuple[doc.SimulationStats, Envelope] | None = None
        self._run: Run | None = None
        self._unrecorded: str | None = None
        self._closings = Closings()
        self._repair: Repair | None = None
        if config.record and config.repair and config.out_dir is None:
            is_idle = (lambda: self._run is None) if config.video else None
            self._repair = Repair(config.recordings_dir, may_compress=is_idle)
            if self._interrupted is not None:
                self._repair.spare(self._interrupted[0])
            self._repair.start()
        self._delete_old_runs()
        self._request: doc.WorldRequest | None = None
        self._early: deque[tuple[Topic[Any], Taken]] = deque(maxlen=1000)
        self._missed = Counter[str]()
        """What came while it was not known whether the run is resumed, by topic."""
        self._beginnings = Beginnings()
        self._frames = _no_frames()
        self._evaluated_ns: int | None = None

    @property
    def foxglove_port(self) -> int | None:
        """Where Foxglove is served; None: it is not."""
        return None if self._foxglove is None else self._foxglove.port

    @property
    def unrecorded(self) -> str | None:
        """From when on the newest run is not recorded, and why; None: it is, or was to its end, or
        should not be.
        """
        return self._unrecorded if self._run is None else self._run.unrecorded

    def reads(self) -> Collection[Topic[Any]]:
        """Everything, if it is recorded or drawn."""
        return _READ if self._config.keeps_messages else _UNRECORDED

    def waiting_for(self) -> str | None:
        """A world, or free space for the recording."""
        return "a world" if self._run is None else self._run.trouble

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Take all queued messages, and publish the evaluation."""
        stats = inbox.received(SIMULATION_STATS)
        stats_ns = [round(message.sim_time_s * 1e9) for message, _, _ in stats]
        begins = self._beginnings.look(now_ns, stats_ns) and self._run is not None
        now_ns = self._beginnings.now_ns
        if self._foxglove is not None:
            self._foxglove.set_time(now_ns)
        ended = inbox.pending(NAVIGATION_RESULT) or inbox.pending(ACTION_RESULT)
        later: list[tuple[Topic[Any], Taken]] = []
        for topic in _READ:
            if topic is not SIMULATION_STATS and not inbox.pending(topic):
                continue
            frames = self._frames.get(topic)
            arrivals: list[Received[Any]] = (
                stats if topic is SIMULATION_STATS else inbox.received(topic)
            )
            for arrival in arrivals:
                # A conflict with earlier messages; empty: none.
                problem = "" if frames is None else frames.add(arrival.message)
                taken = self._taken(topic, arrival, inbox) if not problem else None
                if problem:
                    inbox.reject(topic, problem)
                elif taken is None:
                    continue
                elif not begins:
                    self._take(topic, taken, now_ns)
                elif self._beginnings.is_before(arrival.envelope.sent_ns):
                    self._take(topic, taken, self._beginnings.ended_ns)
                else:
                    later.append((topic, taken))
        if self._offered is not None:
            self._choose_run(*self._offered, now_ns)
        if begins and self._run is not None:
            _LOG.info("simulation restarted; starting a new run")
            self._begin(self._run.world, now_ns)
            for topic, taken in later:
                self._take(topic, taken, now_ns)
        for wanted in inbox.requests(SAVE_MAP):
            wanted.respond(self._save_map(wanted.message))
        if self._run is None:
            return
        self._run.tick(now_ns, inbox.counts)
        last_ns = self._evaluated_ns
        if ended or last_ns is None or now_ns - last_ns >= EVALUATION_PERIOD_NS:
            self._evaluated_ns = now_ns
            evaluation = self._run.evaluation()
            self._run.show(evaluation)
            outbox.put(EVALUATION, evaluation)

    def _save_map(self, wanted: SaveMap) -> SaveMapReply:
        try:
            files = self._saved(wanted)
        except ConfigError as error:
            _LOG.error("/map_saver/save_map: the map was not saved: %s", error)
            result: Literal[1, 255] = 1 if self._newest_map() is None else 255
            return SaveMapReply(result=result, error=str(error))
        _LOG.info("Map saved to %s", files[0])
        return SaveMapReply(files=tuple(map(str, files)))

    def _newest_map(self) -> msg.OccupancyGrid | None:
        """The map of the run, once there is one."""
        grid: msg.OccupancyGrid | None = self._setting.fixed.get(MAP)
        return None if self._run is None or grid is None or not grid.data.size else grid

    def _saved(self, wanted: SaveMap) -> list[Path]:
        """The files of the map. Raises ConfigError where they cannot be written."""
        run, grid = self._run, self._newest_map()
        if wanted.topic.strip("/") != MAP.name.strip("/"):
            raise ConfigError(f"topic: {wanted.topic!r:.80}: must be {MAP.name}")
        if run is None or grid is None:
            raise ConfigError(f"waiting for {'a world' if run is None else 'a map'}")
        if run.folder.is_gone:
            raise ConfigError(f"{run.folder.path}: the folder of the run was removed")
        graph = self._setting.fixed.get(POSE_GRAPH) if run.world.slam else None
        if graph is None and wanted.needs_pose_graph:
            raise ConfigError("there is no pose graph: mapping makes one, in a run with slam")
        return save_map(run.folder.path / SAVED_MAPS, wanted, grid, graph)

    def close(self) -> None:
        """End the run: its summary is written, and all recordings are closed."""
        if self._repair is not None:
            self._repair.stop()
        self._end_run()
        self._closings.wait()
        if self._live is not None:
            self._live.close()
            self._live = None
        if self._foxglove is not None:
            self._foxglove.close()
        if self._robot is not None:
            self._robot.close()

    def _end_run(self) -> None:
        """End the current run, if there is one; its files are finished beside what comes next."""
        run, self._run = self._run, None
        if run is None:
            return
        run.end()
        self._unrecorded = run.unrecorded

        def finish() -> None:
            run.finish()
            self._delete_old_runs()

        self._closings.start(finish)

    def _delete_old_runs(self) -> None:
        delete_old_runs(self._config, self._local_time())

    def _taken(self, topic: Topic[Any], arrival: Received[Any], inbox: Inbox) -> Taken | None:
        """A message with its CDR, if it is to be recorded; None: it cannot be encoded."""
        message, envelope, data = arrival
        if not self._config.record and self._foxglove is None:
            return Taken(message, envelope, ())
        if data is not None:
            return Taken(message, envelope, (data,))
        if isinstance(message, PendingImage):
            later = functools.partial(wire.encode_in_pieces, topic, message)
            return Taken(message, envelope, functools.cache(later))
        try:
            return Taken(message, envelope, wire.encode_in_pieces(topic, message))
        except wire.WireError as error:
            inbox.reject(topic, error.reason)
            return None

    def _take(self, topic: Topic[Any], taken: Taken, now_ns: int) -> None:
        message = taken.message
        self._setting.latched.keep(topic, taken)
        if self._foxglove is not None and topic.delivery is Delivery.LATCHED:
            self._foxglove.keep(topic, taken, now_ns)
        if topic is WORLD:
            run = self._run
            self._take_world(message, now_ns)
            if run is not None and run is self._run:
                run.messages.add(topic, taken, now_ns)
            return
        if topic is ASSETS:
            self._setting.assets[message.header.frame_id] = message.data.tobytes()
            self._let_go_of_assets()
        elif topic in _FIXED:
            self._setting.fixed[topic] = message
        elif topic is WORLD_REQUEST and message != self._request:
            self._request = message
            self._write_config()
        elif topic is WORLD_STATUS and message.running not in (None, self._request):
            # It was loaded in the place of the one that had been requested.
            self._request = message.running
            if self._run is not None and self._run.world.hash == message.world_hash:
                self._write_config()
        elif topic is PARAMETERS and self._parameters.get(message.service) != message:
            self._parameters[message.service] = message
            self._write_config()
        elif topic is SIMULATION_STATS:
            self._simulation = message, taken.envelope
            if message.seed != self._seed:
                self._seed = message.seed
                self._write_config()
        if self._run is not None:
            self._run.take(topic, taken, now_ns)
        elif topic in _EARLY:
            self._early.append((topic, taken))
        elif topic.delivery is not Delivery.LATCHED:
            self._missed[topic.name] += 1

    def _take_world(self, world: doc.World, now_ns: int) -> None:
        run = self._run.world if self._run is not None else None
        if run is not None and (run.hash, run.slam) == (world.hash, world.slam):
            return
        interrupted, self._offered = self._interrupted, None
        if interrupted is not None and interrupted[1].world_hash == world.hash:
            # Only the simulation's stats show whether it is the same simulation.
            self._offered = world, self._setting.wall_clock_s()
        else:
            self._begin(world, now_ns)

    def _choose_run(self, world: doc.World, offered_s: float, now_ns: int) -> None:
        """Resume the run whose recorder died, or start a new one, as soon as it is known which."""
        simulation = self._simulation
        if simulation is None or simulation[0].world_hash != world.hash:
            if self._setting.wall_clock_s() - offered_s >= SIMULATION_PATIENCE_S:
                self._begin(world, now_ns)
            return
        stats, envelope = simulation
        time_ns = round(stats.sim_time_s * 1e9)
        assert self._interrupted is not None
        folder, progress = self._interrupted
        if not progress.is_before(world.hash, envelope.source, stats.epoch, time_ns):
            self._begin(world, now_ns)
            return
        taken: RunFolder | None = None
        try:
            taken = RunFolder.take_over(folder)
            self._begin(world, now_ns, taken, progress)
        except (OSError, ValueError, KeyError, TypeError) as error:
            if taken is not None:
                taken.let_go()
            _LOG.warning("failed to resume %s: %s", folder, error)
            self._begin(world, now_ns)

    def _let_go_of_assets(self) -> None:
        """Drop the oldest textures and meshes that are not in use, if there are too many."""
        assets = self._setting.assets
        size_bytes = sum(map(len, assets.values()))
        if len(assets) <= _MOST_ASSETS and size_bytes <= _MOST_ASSET_BYTES:
            return
        used = set(assets_of(self._run.world)) if self._run is not None else set()
        for topic in (DESIRED_ENTITIES, ENTITIES):
            entities = self._setting.fixed.get(topic)
            used |= assets_of(*(entities.entities if entities is not None else ())).keys()
        # The newest may belong to entities still to come.
        for sha256 in list(assets)[: -ASSETS.depth]:
            if len(assets) <= _MOST_ASSETS and size_bytes <= _MOST_ASSET_BYTES:
                return
            if sha256 not in used:
                size_bytes -= len(assets.pop(sha256))

    def _make_folder(self, world: doc.World) -> RunFolder:
        """Raises OSError if none can be created."""
        if self._config.out_dir is not None:
            return RunFolder.exactly(self._config.out_dir)
        return RunFolder.in_folder(self._config.recordings_dir, self._local_time(), world.name)

    def _begin(
        self,
        world: doc.World,
        now_ns: int,
        interrupted: RunFolder | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Start a new run in a new folder, with what is known already; or resume one."""
        before = None
        if self._run is not None:
            before = self._run.counted
            self._end_run()
            if self._foxglove is not None:
                self._foxglove.begin()
            if world.slam:
                for topic in _OF_A_RUN:
                    self._setting.fixed.pop(topic, None)
                    self._setting.latched.forget(topic)
                    if self._foxglove is not None:
                        self._foxglove.forget(topic)
        folders = [interrupted] if interrupted is not None else []

        def make_folder() -> RunFolder:
            return folders.pop() if folders else self._make_folder(world)

        self.world_hash = world.hash
        self._frames = _no_frames()
        self._evaluated_ns = None
        self._run = Run(self._setting, make_folder, world, now_ns, progress, before)
        if progress is None and self.hears_from_s is not None:
            # These belong to a simulation that has ended.
            self.hears_from_s = None
            self._early = deque(
                (entry for entry in self._early if entry[0].delivery is not Delivery.EVERY),
                self._early.maxlen,
            )
        if progress is not None:
            self._run.messages.wanted += self._missed
        self._interrupted = self._offered = None
        if self._repair is not None:
            self._repair.spare(None)
        self._write_config()
        if progress is not None:
            what = "resuming"
        elif self._config.record:
            what = "recording to"
        else:
            what = "recording is off; writing only the summary to"
        _LOG.info("%s %s", what, self._run.folder.path)
        while self._early:
            topic, taken = self._early.popleft()
            # The latched ones stand at the head of its messages.
            self._run.take(topic, taken, now_ns, is_recorded=topic.delivery is Delivery.LATCHED)

    def _write_config(self) -> None:
        """Write config.yaml: the requested world, the running one, and all services' parameters."""
        if self._run is None:
            return
        world = self._run.world
        content = {
            "world_request": self._request.model_dump(mode="json") if self._request else None,
            "world": world.name,
            "world_hash": world.hash,
            "seed": self._seed,
            "services": {name: entry.values for name, entry in sorted(self._parameters.items())},
        }
        self._run.write_config(content)
