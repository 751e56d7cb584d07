"""One run: its folder, its recording, its verdict."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import yaml

from services.common import documents as doc
from services.common.diagnostics import REJECTED_KEY
from services.common.node import Envelope, TopicCounts
from services.common.root import ROOT
from services.common.topics import (
    AMCL_POSE,
    CLOCK,
    CONTACTS,
    DETECTIONS,
    DIAGNOSTICS,
    ENTITIES,
    GOAL_POSE,
    GROUND_TRUTH_ODOM,
    NAVIGATION_RESULT,
    ODOM,
    SIMULATION_STATS,
    TF_STATIC,
    Topic,
)
from services.recorder.config import RecorderConfig
from services.recorder.digests import DigestWriter
from services.recorder.evaluation import RunEvaluation
from services.recorder.obstacles import read_meshes
from services.recorder.repair import Rewriting
from services.recorder.run_folder import (
    CONFIG,
    DIGESTS,
    RECORDING,
    SUMMARY,
    RunFolder,
    write_atomically,
)
from services.recorder.scenery import extent_of
from services.recorder.summary import build_summary, summary_text

if TYPE_CHECKING:
    from services.recorder.canvas import Canvas

_LOG = logging.getLogger("recorder")

_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
"""The one in C is ten times as fast, where there is one."""

FLUSH_PERIOD_S = 0.5
"""Wall time: what a killed recorder may lose."""
SEND_PERIOD_S = 0.25
"""Wall time by which the live view may lag."""
SUMMARY_PERIOD_S = 5.0
SPACE_PERIOD_S = 5.0
"""Wall time between looks at a disk that was full."""

_MIB = 1024 * 1024
_ROBOT = ROOT / "models" / "turtlebot3_waffle" / "model.urdf"


@dataclass(frozen=True)
class Setting:
    """What every run of a recorder shares."""

    config: RecorderConfig
    wall_clock_s: Callable[[], float]
    versions: Mapping[str, str]
    live_url: str | None = None
    assets: dict[str, bytes] = field(default_factory=dict)
    """Textures (PNG) and meshes (npz) by their sha256."""
    fixed: dict[Topic[Any], Any] = field(default_factory=dict)
    """The newest message of each topic whose messages hold until the next one."""


class Run:
    """One world, from one start of its simulation to its end."""

    def __init__(self, setting: Setting, folder: RunFolder, world: doc.World, now_ns: int) -> None:
        self.world = world
        self.folder = folder
        self.trouble: str | None = None
        """What keeps the recording from being written."""
        self._setting = setting
        self._evaluation = RunEvaluation(world, setting.assets)
        self._judge: dict[Topic[Any], Callable[[Any], None]] = {
            ENTITIES: self._judge_entities,
            TF_STATIC: self._evaluation.add_static_transforms,
            GROUND_TRUTH_ODOM: self._evaluation.add_ground_truth,
            ODOM: self._evaluation.add_odometry,
            AMCL_POSE: self._evaluation.add_estimate,
            DETECTIONS: self._evaluation.add_detections,
            CONTACTS: self._evaluation.add_contact,
            GOAL_POSE: self._evaluation.add_goal,
            NAVIGATION_RESULT: self._evaluation.add_result,
            SIMULATION_STATS: self._take_stats,
            DIAGNOSTICS: self._take_diagnostics,
        }
        self._digests = self._open_digests()
        self._canvas: Canvas | None = None
        self._parts = 0
        self._stats: doc.SimulationStats | None = None
        self._rebuilds = 0
        self._pauses = 0
        self._paused_s = 0.0
        self._paused_since_s: float | None = None
        self._rejected: dict[tuple[str, str, str], int] = {}
        self._counts: Mapping[str, TopicCounts] = {}
        self._start: tuple[float, int] | None = None
        self._end: tuple[float, int] = (0.0, now_ns)
        now_s = setting.wall_clock_s()
        self._sent_s = self._flushed_s = self._summarised_s = self._looked_s = now_s
        for topic, message in setting.fixed.items():
            self._judge_one(topic, message)
        self._open_recording(now_ns)

    def take(self, topic: Topic[Any], arrival: tuple[Any, Envelope], now_ns: int) -> None:
        """Judge, draw and digest one message, as Inbox.arrivals() has it."""
        message, envelope = arrival
        self._end = self._setting.wall_clock_s(), now_ns
        if self._start is None and topic is CLOCK:
            self._start = self._end
        self._judge_one(topic, message)
        if self._digests is not None:
            self._digests.add(topic, message, envelope)
        if self._canvas is not None:
            self._draw(self._canvas, topic, message, now_ns)

    def tick(self, now_ns: int, counts: Mapping[str, TopicCounts]) -> None:
        """Bring what is due to the disk."""
        self._counts = counts
        now_s = self._setting.wall_clock_s()
        if self._setting.live_url is not None and now_s - self._sent_s >= SEND_PERIOD_S:
            self._sent_s = now_s
            if self._canvas is not None:
                self._canvas.recording.send_transforms()
        if now_s - self._flushed_s >= FLUSH_PERIOD_S:
            self._flushed_s = now_s
            self._flush()
        if self.trouble is not None and now_s - self._looked_s >= SPACE_PERIOD_S:
            self._looked_s = now_s
            self._open_recording(now_ns)
        if now_s - self._summarised_s >= SUMMARY_PERIOD_S:
            self._summarised_s = now_s
            self._write_summary()

    def evaluation(self) -> doc.Evaluation:
        """The run so far, judged by the ground truth."""
        return self._evaluation.evaluation(str(self.folder.path))

    def write_config(self, content: Mapping[str, Any]) -> None:
        """Keep what the run was told."""
        text = yaml.dump(dict(content), Dumper=_DUMPER, sort_keys=False, allow_unicode=True)
        self._write(CONFIG, [text.encode()])

    def close(self) -> None:
        """Write the summary, end the recording, and say that the run is whole."""
        self._write_summary()
        self._write_digests(close=True)
        if self._canvas is not None:
            self._close_recording(self._canvas)
            self._compact()
        self.folder.release()

    def _judge_one(self, topic: Topic[Any], message: Any) -> None:
        judge = self._judge.get(topic)
        if judge is not None:
            judge(message)

    def _judge_entities(self, entities: doc.Entities) -> None:
        if entities.world_hash == self.world.hash:
            self._evaluation.set_entities(entities)

    def _take_stats(self, stats: doc.SimulationStats) -> None:
        if stats.world_hash != self.world.hash:
            return
        before, self._stats = self._stats, stats
        if before is not None and before.epoch != stats.epoch and stats.sim_time_s > 0.0:
            self._rebuilds += abs(stats.epoch - before.epoch)
        if stats.paused and self._paused_since_s is None:
            self._pauses += 1
            self._paused_since_s = self._setting.wall_clock_s()
        elif not stats.paused:
            self._paused_s = self._paused_until_s(self._setting.wall_clock_s())
            self._paused_since_s = None

    def _paused_until_s(self, now_s: float) -> float:
        """Wall time for which the simulation has been paused, since the clock first came."""
        since_s = self._paused_since_s
        if since_s is None or self._start is None:
            return self._paused_s
        return self._paused_s + max(now_s - max(since_s, self._start[0]), 0.0)

    def _take_diagnostics(self, array: Any) -> None:
        for status in array.status:
            if status.name == "recorder":
                continue
            for value in status.values:
                if value.key.startswith(REJECTED_KEY) and value.value.isdecimal():
                    topic, _, reason = value.key.removeprefix(REJECTED_KEY).partition(": ")
                    self._rejected[status.name, topic, reason] = int(value.value)

    def _open_recording(self, now_ns: int) -> None:
        """Begin run.rrd, or its next part, with everything that holds already."""
        setting = self._setting
        config = setting.config
        if not (config.record or setting.live_url):
            return
        if self._free_mib() < config.min_free_mib:
            self._stop(f"less than {config.min_free_mib} MiB are free")
            return
        # Rerun is loaded only where something is drawn.
        from services.recorder.archetypes import draw_start  # noqa: PLC0415
        from services.recorder.blueprint import run_blueprint  # noqa: PLC0415
        from services.recorder.canvas import Canvas  # noqa: PLC0415
        from services.recorder.mesh import robot_from_urdf  # noqa: PLC0415
        from services.recorder.recording import Recording, RecordingError  # noqa: PLC0415
        from services.recorder.world_drawing import draw_world  # noqa: PLC0415

        extent = extent_of(self.world, read_meshes(self.world.bodies, setting.assets))
        self._parts += 1
        name = RECORDING if self._parts == 1 else f"run_{self._parts}.rrd"
        try:
            recording = Recording(
                self.folder.path.name,
                path=self.folder.path / name if config.record else None,
                live_url=setting.live_url,
                blueprint=run_blueprint(extent),
                properties={
                    "world": self.world.name,
                    "world_hash": self.world.hash,
                    "seed": str(config.seed),
                    **setting.versions,
                },
            )
        except RecordingError as error:
            self._stop(str(error))
            return
        self._canvas = canvas = Canvas(
            recording=recording,
            robot=robot_from_urdf(_ROBOT.read_text(encoding="utf-8")),
            world=self.world,
            assets=setting.assets,
            wall_clock_s=setting.wall_clock_s,
            jpeg_quality=config.jpeg_quality,
            now_ns=now_ns,
        )
        self.trouble = None
        draw_start(canvas)
        draw_world(canvas, self.world)
        for topic, message in setting.fixed.items():
            self._draw(canvas, topic, message, now_ns)

    def _draw(self, canvas: Canvas, topic: Topic[Any], message: Any, now_ns: int) -> None:
        from services.recorder.archetypes import DRAW  # noqa: PLC0415

        canvas.now_ns = now_ns
        DRAW[topic](canvas, message)

    def _open_digests(self) -> DigestWriter | None:
        if not self._setting.config.record:
            return None
        path = self.folder.path / DIGESTS
        try:
            return DigestWriter(path)
        except OSError as error:
            _LOG.error("%s: %s", path, error.strerror)
            return None

    def _write_digests(self, close: bool = False) -> None:
        if self._digests is None:
            return
        try:
            if close:
                self._digests.close()
            else:
                self._digests.flush()
        except OSError as error:
            _LOG.error("%s: %s", self.folder.path / DIGESTS, error.strerror)
            self._digests = None

    def _flush(self) -> None:
        self._write_digests()
        canvas = self._canvas
        if canvas is None:
            return
        from services.recorder.recording import RecordingError  # noqa: PLC0415

        minimum_mib = self._setting.config.min_free_mib
        try:
            canvas.recording.flush()
        except RecordingError as error:
            self._stop(str(error))
            return
        if self._free_mib() < minimum_mib:
            self._stop(f"less than {minimum_mib} MiB are free")

    def _stop(self, reason: str) -> None:
        """End the recording before its disk is full; the run goes on, judged and unseen."""
        trouble = f"room for {self.folder.path / RECORDING}: {reason}"
        if trouble != self.trouble:
            _LOG.error("recording stopped: %s: %s", self.folder.path / RECORDING, reason)
        self.trouble = trouble
        canvas, self._canvas = self._canvas, None
        if canvas is not None:
            self._close_recording(canvas)

    def _close_recording(self, canvas: Canvas) -> None:
        from services.recorder.recording import RecordingError  # noqa: PLC0415

        try:
            canvas.recording.close()
        except RecordingError as error:
            _LOG.error("%s: %s", self.folder.path / RECORDING, error)

    def _compact(self) -> None:
        timeout_s = self._setting.config.compact_timeout_s
        if timeout_s > 0.0:
            for path in sorted(self.folder.path.glob("run*.rrd")):
                # One that takes longer is whole all the same, and stays as it is.
                problem = Rewriting(path).run(timeout_s)
                _LOG.debug("%s: %s", path, problem or "compacted")

    def _free_mib(self) -> float:
        try:
            return shutil.disk_usage(self.folder.path).free / _MIB
        except OSError:
            return 0.0

    def _write_summary(self) -> None:
        end_s, end_ns = self._end
        start_s, start_ns = self._start or self._end
        paused_s = self._paused_until_s(end_s)
        summary = build_summary(
            world=self.world,
            seed=self._stats.seed if self._stats else self._setting.config.seed,
            stats=self._stats,
            rebuilds=self._rebuilds,
            pauses=self._pauses,
            paused_s=paused_s,
            sim_time_s=end_ns * 1e-9,
            recorded_s=(end_ns - start_ns) * 1e-9,
            wall_time_s=end_s - start_s - paused_s,
            evaluation=self.evaluation(),
            totals=self._evaluation.totals(),
            counts=self._counts,
            rejected_elsewhere=self._rejected,
            versions=self._setting.versions,
        )
        self._write(SUMMARY, summary_text(summary))

    def _write(self, name: str, pieces: Iterable[bytes]) -> None:
        try:
            write_atomically(self.folder.path / name, pieces)
        except OSError as error:
            _LOG.error("%s: %s", self.folder.path / name, error.strerror)
