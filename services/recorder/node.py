"""Keeps every run: draws its messages, judges it by the ground truth, keeps both in a folder."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from datetime import datetime
from typing import TYPE_CHECKING, Any

from services.common import documents as doc
from services.common.assets import assets_of
from services.common.node import Envelope, Inbox, Node, Outbox
from services.common.topics import (
    ASSETS,
    DESIRED_ENTITIES,
    DIAGNOSTICS,
    ENTITIES,
    EVALUATION,
    MAP,
    NAVIGATION_RESULT,
    PARAMETERS,
    ROSOUT,
    SIMULATION_STATS,
    TF_STATIC,
    WORLD,
    WORLD_REQUEST,
    WORLD_STATUS,
    Topic,
    read_by,
)
from services.recorder.beginnings import Beginnings
from services.recorder.config import RecorderConfig
from services.recorder.repair import Repair
from services.recorder.run import Run, Setting
from services.recorder.run_folder import RunFolder, check_unused, check_writable
from services.recorder.versions import versions

if TYPE_CHECKING:
    from services.recorder.live import LiveView

_LOG = logging.getLogger("recorder")

EVALUATION_PERIOD_NS = 1_000_000_000
_EARLY: tuple[Topic[Any], ...] = (WORLD_REQUEST, WORLD_STATUS, PARAMETERS, DIAGNOSTICS, ROSOUT)
"""What is kept for the run until there is one."""
_FIXED: tuple[Topic[Any], ...] = (MAP, TF_STATIC, DESIRED_ENTITIES, ENTITIES)
"""What is said once and holds until it is said anew, in the next run as well."""

_MOST_ASSETS = 1000
_MOST_ASSET_BYTES = 256 * 1024 * 1024

_Arrival = tuple[Any, Envelope]
# As Inbox.arrivals() has it.


class RecorderNode(Node):
    """Keeps one folder a run. A run is one world, from one start of its simulation to its end."""

    name = "recorder"
    _config: RecorderConfig
    period_ns = 100_000_000
    wakes = tuple(topic for topic in read_by("recorder") if topic.rate_hz is None)
    depth = 64

    def __init__(
        self,
        config: RecorderConfig,
        wall_clock_s: Callable[[], float] = time.monotonic,
        local_time: Callable[[], datetime] = datetime.now,
    ) -> None:
        """Raises ConfigError where a folder cannot be written or a port is taken."""
        self._config = config
        self._local_time = local_time
        self._parameters: dict[str, Any] = {}
        if config.out_dir is None:
            check_writable(config.recordings_dir)
        else:
            check_unused(config.out_dir)
            check_writable(config.out_dir.parent)
        self._live: LiveView | None = None
        if config.live:
            from services.recorder.live import LiveView  # noqa: PLC0415 - loads Rerun

            self._live = LiveView(
                config.bind, config.web_port, config.grpc_port, config.live_memory_mib
            )
            _LOG.info("live view on http://localhost:%d", config.web_port)
        self._setting = Setting(
            config, wall_clock_s, versions(), self._live.url if self._live else None
        )
        self._repair: Repair | None = None
        if config.record and config.repair and config.out_dir is None:
            self._repair = Repair(config.recordings_dir)
            self._repair.start()
        self._request: doc.WorldRequest | None = None
        self._early: deque[tuple[Topic[Any], _Arrival]] = deque(maxlen=1000)
        self._run: Run | None = None
        self._beginnings = Beginnings()
        self._evaluated_ns: int | None = None

    def waiting_for(self) -> str | None:
        """A world, or room for the recording."""
        return "a world" if self._run is None else self._run.trouble

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Take in everything that came, and say how the run goes."""
        stats = inbox.arrivals(SIMULATION_STATS)
        told_ns = [round(message.sim_time_s * 1e9) for message, _ in stats]
        begins = self._beginnings.look(now_ns, told_ns) and self._run is not None
        now_ns = self._beginnings.now_ns
        ended = inbox.pending(NAVIGATION_RESULT)
        later: list[tuple[Topic[Any], _Arrival]] = []
        for topic in read_by(self.name):
            for arrival in stats if topic is SIMULATION_STATS else inbox.arrivals(topic):
                if not begins:
                    self._take(topic, arrival, now_ns)
                elif self._beginnings.is_before(arrival[1].sent_ns):
                    self._take(topic, arrival, self._beginnings.ended_ns)
                else:
                    later.append((topic, arrival))
        if begins and self._run is not None:
            _LOG.info("the simulation began anew")
            self._begin(self._run.world, now_ns)
            for topic, arrival in later:
                self._take(topic, arrival, now_ns)
        if self._run is None:
            return
        self._run.tick(now_ns, inbox.counts)
        last_ns = self._evaluated_ns
        if ended or last_ns is None or now_ns - last_ns >= EVALUATION_PERIOD_NS:
            self._evaluated_ns = now_ns
            outbox.put(EVALUATION, self._run.evaluation())

    def close(self) -> None:
        """End the run: its summary is written and its recording closed."""
        if self._repair is not None:
            self._repair.stop()
        if self._run is not None:
            self._run.close()
            self._run = None
        if self._live is not None:
            self._live.close()
            self._live = None

    def _take(self, topic: Topic[Any], arrival: _Arrival, now_ns: int) -> None:
        message = arrival[0]
        if topic is WORLD:
            if self._run is None or message.hash != self._run.world.hash:
                self._begin(message, now_ns)
            return
        if topic is ASSETS:
            self._setting.assets[message.header.frame_id] = message.data.tobytes()
            self._let_go_of_assets()
        elif topic in _FIXED:
            self._setting.fixed[topic] = message
        elif topic is WORLD_REQUEST and message != self._request:
            self._request = message
            self._write_config()
        elif topic is PARAMETERS and self._parameters.get(message.service) != message.values:
            self._parameters[message.service] = message.values
            self._write_config()
        if self._run is not None:
            self._run.take(topic, arrival, now_ns)
        elif topic in _EARLY:
            self._early.append((topic, arrival))

    def _let_go_of_assets(self) -> None:
        """Forget the oldest textures and meshes that nothing has, where there are too many."""
        assets = self._setting.assets
        size_bytes = sum(map(len, assets.values()))
        if len(assets) <= _MOST_ASSETS and size_bytes <= _MOST_ASSET_BYTES:
            return
        used = set(assets_of(self._run.world)) if self._run is not None else set()
        for topic in (DESIRED_ENTITIES, ENTITIES):
            entities = self._setting.fixed.get(topic)
            used |= assets_of(*(entities.entities if entities is not None else ())).keys()
        # The newest may be of what is still to come.
        for sha256 in list(assets)[: -ASSETS.depth]:
            if len(assets) <= _MOST_ASSETS and size_bytes <= _MOST_ASSET_BYTES:
                return
            if sha256 not in used:
                size_bytes -= len(assets.pop(sha256))

    def _begin(self, world: doc.World, now_ns: int) -> None:
        """Begin a new run in a folder of its own, with what is known already."""
        if self._run is not None:
            self._run.close()
        if self._config.out_dir is not None:
            folder = RunFolder.exactly(self._config.out_dir)
        else:
            recordings_dir = self._config.recordings_dir
            folder = RunFolder.in_folder(recordings_dir, self._local_time(), world.name)
        self.world_hash = world.hash
        self._evaluated_ns = None
        self._run = Run(self._setting, folder, world, now_ns)
        self._write_config()
        _LOG.info("recording to %s", folder.path)
        while self._early:
            topic, arrival = self._early.popleft()
            self._run.take(topic, arrival, now_ns)

    def _write_config(self) -> None:
        """Write config.yaml: what was asked for, what runs, and how every service is configured."""
        if self._run is None:
            return
        world = self._run.world
        content = {
            "world_request": self._request.model_dump(mode="json") if self._request else None,
            "world": world.name,
            "world_hash": world.hash,
            "seed": self._config.seed,
            "services": dict(sorted(self._parameters.items())),
        }
        self._run.write_config(content)
