"""One run: its folder, its recording, its evaluation."""

from __future__ import annotations

import contextlib
import logging
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from pydantic_core import to_json

from mazebot.common.files.root import ROOT
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages.messages import ns_from_time
from mazebot.common.messages.slam_documents import PoseGraph
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    AMCL_POSE,
    CAMERA_IMAGE,
    CLOCK,
    CONTACTS,
    DETECTIONS,
    DIAGNOSTICS,
    ENTITIES,
    EXPLORATION_STATUS,
    GOAL_POSE,
    GROUND_TRUTH_ODOM,
    MAP,
    NAVIGATION_RESULT,
    ODOM,
    POSE_GRAPH,
    ROSOUT,
    SCAN,
    SIMULATION_STATS,
    TF_STATIC,
    Delivery,
    Topic,
)
from mazebot.common.node.diagnostics import REJECTED_KEY
from mazebot.common.node.node import MAX_SOURCES, Envelope, TopicCounts
from mazebot.common.recordings.comparing.digests import DigestWriter
from mazebot.common.recordings.run_folder import (
    CONFIG,
    DIGESTS,
    RECORDING,
    SERIES,
    SUMMARY,
    TO_COMPRESS,
    RunFolder,
    write_atomically,
)
from mazebot.common.recordings.summary import Hardware
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.drawing.scenery import extent_of
from mazebot.recorder.judging.evaluation import RunEvaluation
from mazebot.recorder.judging.obstacles import read_meshes
from mazebot.recorder.judging.summary import build_summary, summary_text
from mazebot.recorder.judging.wall_time import WallTime
from mazebot.recorder.keeping.closing import leave_report
from mazebot.recorder.keeping.latched import Latched
from mazebot.recorder.keeping.map_folder import MapFolder
from mazebot.recorder.keeping.progress import Progress, write_progress
from mazebot.recorder.keeping.repair import Rewriting
from mazebot.recorder.keeping.run_messages import RunMessages
from mazebot.recorder.stream.file_writer import RecordingError
from mazebot.recorder.stream.message_log import Taken
from mazebot.recorder.stream.pictures import Pictures

if TYPE_CHECKING:
    from mazebot.recorder.drawing.canvas import Canvas
    from mazebot.recorder.stream.live_feed import LiveFeed

_LOG = logging.getLogger("recorder")

_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
"""The C implementation is ten times as fast, if available."""

FLUSH_PERIOD_S = 0.4
"""Wall time: together with a step of the recorder, the most that is lost if it is killed."""
SEND_PERIOD_S = 0.25
"""Wall time by which the live view may lag behind."""
SUMMARY_PERIOD_S = 5.0
PROGRESS_PERIOD_S = 2.0
"""Wall time: the evaluation loses at most this duration if the recorder is killed."""
SPACE_PERIOD_S = 2.0
"""Wall time between checks whether the folder exists, and whether a full disk has room again."""
GO_ON_MIB = 16
"""Free space beyond the minimum that is needed to resume the recording with a new part."""
JOIN_TIMEOUT_S = 6.0
"""Wall time at a run's end to merge several parts, or to repair one without its end."""

_MIB = 1024 * 1024
_ROBOT = ROOT / "models" / "turtlebot3_waffle" / "model.urdf"


@dataclass(frozen=True)
class Setting:
    """State that all runs of a recorder share."""

    config: RecorderConfig
    wall_clock_s: Callable[[], float]
    versions: Mapping[str, str]
    hardware: Hardware | None = None
    live: LiveFeed | None = None
    resumable: bool = False
    """Whether a recorder resumes a run whose recorder died."""
    assets: dict[str, bytes] = field(default_factory=dict)
    """Textures (PNG) and meshes (npz) by their sha256."""
    parameters: dict[str, doc.Parameters] = field(default_factory=dict)
    """The parameters of each service, by its name."""
    fixed: dict[Topic[Any], Any] = field(default_factory=dict)
    """The newest message of each latched topic that is drawn or judged in every run."""
    latched: Latched = field(default_factory=Latched)
    """Those of all latched topics, for the head of `run.mcap`."""


class Run:
    """One world, from one start of its simulation to its end."""

    def __init__(
        self,
        setting: Setting,
        make_folder: Callable[[], RunFolder],
        world: doc.World,
        now_ns: int,
        progress: Progress | None = None,
    ) -> None:
        """`make_folder` is called again if the run's folder is removed; with `progress` the run is
        resumed from there. Raises OSError if no folder can be created.
        """
        self.world = world
        self.folder = make_folder()
        self._make_folder = make_folder
        self.trouble: str | None = None
        """Why the recording cannot be written."""
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
            ACTION_FEEDBACK: self._evaluation.add_feedback,
            ACTION_RESULT: self._evaluation.add_result,
            SIMULATION_STATS: self._take_stats,
            DIAGNOSTICS: self._take_diagnostics,
            ROSOUT: self._evaluation.history.add_log,
        }
        self._maps: MapFolder | None = None
        if world.slam:
            self._maps = MapFolder()
            self._judge |= {
                MAP: self._take_map,
                POSE_GRAPH: self._take_pose_graph,
                EXPLORATION_STATUS: self._evaluation.add_exploration,
                SCAN: self._evaluation.add_scan,
            }
        self._digests = self._open_digests()
        self._pictures = Pictures(setting.config.jpeg_quality)
        self.messages = RunMessages(setting.config, world, setting.latched, self._pictures)
        self._has_pictures = False
        self._canvas: Canvas | None = None
        self._parts = 0
        self._are_whole = True
        """Whether every part so far was ended properly."""
        self._content: Mapping[str, Any] = {}
        self._stats: doc.SimulationStats | None = None
        self._rebuilds = 0
        self._wall_time = WallTime()
        self._rejected: dict[tuple[str, str, str], int] = {}
        self._counts: Mapping[str, TopicCounts] = {}
        self._tick_ns: int | None = None
        """Time of the newest clock message."""
        now_s = setting.wall_clock_s()
        self._end: tuple[float, int] = (now_s, now_ns)
        self._known: tuple[str, int] | None = None
        """Source id of the simulation's messages, and its epoch."""
        self._taken: dict[str, dict[str, int]] = {}
        """By topic and source, the last sequence number, of topics with delivery EVERY."""
        self._carried: Mapping[str, Any] = {}
        """Message counts of the previous recorder of this run."""
        if progress is not None:
            self._go_on_from(progress)
        self._kept_s, self._kept_goals = now_s, self._evaluation.goals_ended
        self._sent_s = self._flushed_s = self._summarised_s = self._looked_s = now_s
        for topic, message in setting.fixed.items():
            self._judge_one(topic, message)
        self._open_recording(now_ns)

    def take(self, topic: Topic[Any], taken: Taken, now_ns: int, is_recorded: bool = False) -> None:
        """Evaluate, draw, record and digest one message; `is_recorded`: `run.mcap` has it."""
        message, envelope, pieces = taken
        if topic.delivery is Delivery.EVERY and not self._is_new(topic, envelope):
            return
        self._end = self._setting.wall_clock_s(), now_ns
        if topic is CLOCK:
            self._tick_ns = ns_from_time(message.clock)
        if topic is SIMULATION_STATS and message.world_hash == self.world.hash:
            self._known = envelope.source, message.epoch
        self._has_pictures |= topic is CAMERA_IMAGE
        judge = self._judge.get(topic)
        if judge is not None:
            judge(message)
        if self._digests is not None:
            self._digests.add(topic, pieces, envelope)
        if not is_recorded:
            self.messages.add(topic, taken, now_ns)
        if self._canvas is not None:
            self._draw(self._canvas, topic, message, now_ns)

    def _is_new(self, topic: Topic[Any], envelope: Envelope) -> bool:
        """Whether a message was not taken yet, by this recorder or the previous one."""
        if not envelope.source:
            return True
        taken = self._taken.setdefault(topic.name, {})
        is_new = envelope.sequence > taken.get(envelope.source, -1)
        if is_new:
            taken[envelope.source] = envelope.sequence
            while len(taken) > MAX_SOURCES:
                del taken[next(iter(taken))]
        return is_new

    def tick(self, now_ns: int, counts: Mapping[str, TopicCounts]) -> None:
        """Write to disk what is due."""
        self._counts = counts
        self.messages.tick()
        now_s = self._setting.wall_clock_s()
        if self._tick_ns is not None:
            # Only the newest of the queued messages arrived just now.
            self._wall_time.tick(now_s, self._tick_ns)
            is_paused = self._stats is not None and self._stats.paused
            self._evaluation.history.tick(now_s, self._tick_ns, is_paused)
            self._tick_ns = None
        if self._setting.live is not None and now_s - self._sent_s >= SEND_PERIOD_S:
            self._sent_s = now_s
            if self._canvas is not None:
                self._canvas.recording.send_transforms()
        if now_s - self._flushed_s >= FLUSH_PERIOD_S:
            self._flushed_s = now_s
            self._flush()
        if now_s - self._looked_s >= SPACE_PERIOD_S:
            self._looked_s = now_s
            self._look_again(now_ns)
        self._keep_map(now_ns)
        if now_s - self._summarised_s >= SUMMARY_PERIOD_S:
            self._summarised_s = now_s
            self._write_summary()
        # The true pose at a goal's end is not sent again.
        has_news = self._evaluation.goals_ended != self._kept_goals
        if now_s - self._kept_s >= PROGRESS_PERIOD_S or has_news:
            self._kept_s = now_s
            self.keep_progress()
            self._kept_goals = self._evaluation.goals_ended

    def keep_progress(self) -> None:
        """Write the state that a new recorder needs to resume this run."""
        if self._known is None or not self._setting.resumable or self.folder.is_gone:
            return
        source, epoch = self._known
        run = {
            "rebuilds": self._rebuilds,
            "wall_time": asdict(self._wall_time),
            "counts": {
                topic: [counts.received, counts.sent, counts.lost, dict(counts.rejected)]
                for topic, counts in self._all_counts().items()
            },
        }
        verdict, arrays = self._evaluation.state()
        progress = Progress(
            *(self.world.hash, source, epoch, self._end[1], self._taken, run),
            verdict=verdict,
            arrays=arrays,
        )
        try:
            write_progress(self.folder.path, progress)
        except OSError as error:
            _LOG.debug("%s: %s", self.folder.path, error.strerror)

    def _go_on_from(self, progress: Progress) -> None:
        """Take over the state of the previous recorder of the run."""
        run = progress.run
        self._evaluation.restore(progress.verdict, progress.arrays)
        self._rebuilds = run["rebuilds"]
        self._wall_time = WallTime.restored(run["wall_time"])
        self._end = self._setting.wall_clock_s(), progress.time_ns
        self._known = progress.source, progress.epoch
        self._carried = run["counts"]
        self._taken = {topic: dict(numbers) for topic, numbers in progress.taken.items()}
        self._parts = self.folder.last_part()
        self._are_whole = False

    def _all_counts(self) -> dict[str, TopicCounts]:
        """Message counts by topic, including those of the previous recorder."""
        counts = dict(self._counts)
        for topic, (received, sent, lost, rejected) in self._carried.items():
            ours = counts.get(topic, TopicCounts())
            counts[topic] = TopicCounts(
                ours.received + received,
                # A publisher's sequence numbers include those sent before.
                max(ours.sent, sent),
                ours.lost + lost,
                ours.rejected + Counter(rejected),
                ours.last_sequence,
            )
        return counts

    def evaluation(self) -> doc.Evaluation:
        """The evaluation of the run so far, against the ground truth."""
        return self._evaluation.evaluation(str(self.folder.path))

    def show(self, evaluation: doc.Evaluation, final: bool = False) -> None:
        """Draw the run's evaluation."""
        if self._canvas is not None:
            from mazebot.recorder.drawing.text_drawing import draw_evaluation  # noqa: PLC0415

            draw_evaluation(self._canvas, evaluation, final)
            if evaluation.mapping is not None:
                self._show_mapping(self._canvas, evaluation.mapping)

    def _show_mapping(self, canvas: Canvas, mapping: doc.MapEvaluation) -> None:
        from mazebot.recorder.drawing.mapping_drawing import (  # noqa: PLC0415
            draw_map_evaluation,
            draw_true_walls,
        )

        draw_map_evaluation(canvas, mapping)
        faces_m = self._evaluation.true_faces_m
        if faces_m is not None and canvas.changed("mapping/true_walls", id(faces_m)):
            draw_true_walls(canvas, faces_m)

    def write_config(self, content: Mapping[str, Any]) -> None:
        """Write config.yaml."""
        self._content = content
        text = yaml.dump(dict(content), Dumper=_DUMPER, sort_keys=False, allow_unicode=True)
        self._write(CONFIG, [text.encode()])

    def close(self) -> None:
        """Write the summary, end the recording, and mark the run as complete."""
        config = self._setting.config
        self._keep_map(self._end[1], all_of_it=True)
        self.messages.wait()
        self._write_summary()
        self.show(self.evaluation(), final=True)
        self._write_digests(close=True)
        canvas, self._canvas = self._canvas, None
        if canvas is not None:
            self._end_recording(canvas.recording.close)
        is_whole = self.messages.end()
        self._pictures.close()
        is_gone = self.folder.is_gone
        if self._has_pictures and config.record and config.video and not is_gone:
            with contextlib.suppress(OSError):
                (self.folder.path / TO_COMPRESS).touch()
        if self._join_parts() and is_whole:
            self.folder.release()
        else:
            # A later recorder will repair it.
            self.folder.let_go()
        if self._setting.config.record and not is_gone:
            leave_report(self.folder.path)

    def _judge_one(self, topic: Topic[Any], message: Any) -> None:
        judge = self._judge.get(topic)
        if judge is not None:
            judge(message)

    def _take_map(self, grid: msg.OccupancyGrid) -> None:
        self._evaluation.add_map(grid)
        if self._maps is not None:
            self._maps.add_map(grid)

    def _take_pose_graph(self, graph: PoseGraph) -> None:
        if graph.world_hash in ("", self.world.hash):
            self._evaluation.add_pose_graph(graph)
            if self._maps is not None:
                self._maps.add_pose_graph(graph)

    def _keep_map(self, now_ns: int, all_of_it: bool = False) -> None:
        if self._maps is not None and not self.folder.is_gone:
            self._maps.write(self.folder.path, now_ns, all_of_it)

    def _judge_entities(self, entities: doc.Entities) -> None:
        if entities.world_hash == self.world.hash:
            self._evaluation.set_entities(entities)

    def _take_stats(self, stats: doc.SimulationStats) -> None:
        if stats.world_hash != self.world.hash:
            return
        before, self._stats = self._stats, stats
        if before is not None and before.epoch != stats.epoch and stats.sim_time_s > 0.0:
            self._rebuilds += abs(stats.epoch - before.epoch)
        change = self._wall_time.pause if stats.paused else self._wall_time.resume
        change(self._setting.wall_clock_s())

    def _take_diagnostics(self, array: Any) -> None:
        self._evaluation.history.add_diagnostics(array)
        for status in array.status:
            if status.name == "recorder":
                continue
            for value in status.values:
                if value.key.startswith(REJECTED_KEY) and value.value.isdecimal():
                    topic, _, reason = value.key.removeprefix(REJECTED_KEY).partition(": ")
                    self._rejected[status.name, topic, reason] = int(value.value)

    def _look_again(self, now_ns: int) -> None:
        """Resume the recording if what prevented it is gone."""
        if self.folder.is_gone:
            removed = self.folder.path
            self._stop(f"{removed} was removed")
            try:
                folder = self._make_folder()
            except OSError as error:
                _LOG.error("%s was removed, and no other can be made: %s", removed, error.strerror)
                return
            _LOG.warning("going on in %s", folder.path)
            self.folder.let_go()
            self.folder, self._parts, self._are_whole = folder, 0, True
            self._write_digests(close=True)
            self._digests = self._open_digests()
            if self._maps is not None:
                self._maps.begin_anew()
            self.write_config(self._content)
            self._open_recording(now_ns)
        elif self.trouble is not None and self._no_room(GO_ON_MIB) is None:
            self._open_recording(now_ns)

    def _open_recording(self, now_ns: int) -> None:
        """Start run.rrd, or its next part, with the current state."""
        is_kept = self._setting.config.record
        trouble = self._no_room() if is_kept else None
        if trouble is not None:
            self._stop(trouble)
        elif is_kept:
            try:
                self._begin_drawing(self.folder.part(self._parts + 1), now_ns)
                self._parts += 1
                self.messages.begin(self.folder, self._properties(), now_ns)
            except RecordingError as error:
                self._stop(str(error))
            else:
                if self.trouble is not None:
                    _LOG.info("recording goes on: %s", self.folder.part(self._parts))
                self.trouble = None
        if self._canvas is None and self._setting.live is not None:
            self._begin_drawing(None, now_ns)

    def _properties(self) -> dict[str, str]:
        return {
            "world": self.world.name,
            "world_hash": self.world.hash,
            "seed": str(self._setting.config.seed),
            **self._setting.versions,
        }

    def _begin_drawing(self, path: Path | None, now_ns: int) -> None:
        """Draw the current state, into a file, to the live view, or both.

        Raises RecordingError if the file cannot be created.
        """
        setting = self._setting
        # Rerun is imported only if something is drawn.
        from mazebot.recorder.drawing.archetypes import draw_start  # noqa: PLC0415
        from mazebot.recorder.drawing.canvas import Canvas  # noqa: PLC0415
        from mazebot.recorder.drawing.layouts.layouts import run_blueprint  # noqa: PLC0415
        from mazebot.recorder.drawing.layouts.views import Scene  # noqa: PLC0415
        from mazebot.recorder.drawing.mesh import robot_from_urdf  # noqa: PLC0415
        from mazebot.recorder.drawing.world_drawing import draw_world  # noqa: PLC0415
        from mazebot.recorder.stream.recording import Recording  # noqa: PLC0415

        extent = extent_of(self.world, read_meshes(self.world.bodies, setting.assets))
        scene = Scene(extent, self.world.slam)
        recording = Recording(
            self.folder.path.name,
            path=path,
            live=setting.live,
            blueprint=run_blueprint(scene, setting.config.layout),
            properties={**self._properties(), **scene.properties()},
        )
        before, self._canvas = self._canvas, None
        if before is not None:
            self._end_recording(before.recording.close)
        self._canvas = canvas = Canvas(
            recording=recording,
            robot=robot_from_urdf(_ROBOT.read_text(encoding="utf-8")),
            world=self.world,
            assets=setting.assets,
            wall_clock_s=setting.wall_clock_s,
            pictures=self._pictures,
            now_ns=now_ns,
        )
        draw_start(canvas)
        draw_world(canvas, self.world)
        for topic, message in setting.fixed.items():
            self._draw(canvas, topic, message, now_ns)

    def _draw(self, canvas: Canvas, topic: Topic[Any], message: Any, now_ns: int) -> None:
        from mazebot.recorder.drawing.archetypes import DRAW  # noqa: PLC0415

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
        """Write the digests to disk; unwritten ones are kept for the next time."""
        digests = self._digests
        if digests is None:
            return
        path, had_trouble, lost = self.folder.path / DIGESTS, digests.waits, digests.lost
        try:
            if close:
                digests.close()
            else:
                digests.flush()
        except OSError as error:
            if close or not had_trouble:
                kept = "the rest of them is lost" if close else "kept until there is room"
                _LOG.error("%s: %s; %s", path, error.strerror, kept)
        else:
            if had_trouble:
                _LOG.info("%s: written again", path)
        if digests.lost and not lost:
            _LOG.error("%s: too many wait to be written; there will be a gap", path)

    def _flush(self) -> None:
        if self.folder.is_gone:
            return
        self._write_digests()
        try:
            self.messages.flush(self._end[1])
        except RecordingError as error:
            self._stop(self._no_room() or str(error))
            return
        canvas = self._canvas
        if canvas is None:
            return
        try:
            canvas.recording.flush()
        except RecordingError as error:
            self._are_whole = False
            self._stop(self._no_room() or str(error))
            return
        trouble = self._no_room()
        if trouble is not None and self._setting.config.record:
            self._stop(trouble)

    def _stop(self, reason: str) -> None:
        """End the file before its disk is full; evaluation and live view go on."""
        recording = self.folder.path / RECORDING
        trouble = f"room for {recording}: {reason}"
        if trouble != self.trouble:
            _LOG.error("recording stopped: %s: %s", recording, reason)
        self.trouble = trouble
        self.messages.end()
        canvas = self._canvas
        if canvas is None:
            return
        if self._setting.live is not None:
            self._end_recording(canvas.recording.end_file)
        else:
            self._canvas = None
            self._end_recording(canvas.recording.close)

    def _end_recording(self, end: Callable[[], None]) -> None:
        try:
            end()
        except RecordingError as error:
            self._are_whole = False
            _LOG.error("%s: %s", self.folder.part(self._parts), error)

    def _join_parts(self) -> bool:
        """Merge all parts into one compact run.rrd; returns whether it is complete."""
        parts = self.folder.parts()
        timeout_s = self._setting.config.compact_timeout_s
        must = len(parts) > 1 or not self._are_whole
        if not parts or (timeout_s <= 0.0 and not must):
            return True
        # If this times out, a properly ended single part stays as it is.
        problem = Rewriting(parts).run(max(timeout_s, JOIN_TIMEOUT_S) if must else timeout_s)
        if problem and must:
            _LOG.warning(
                "%s is left to the next recorder to be made whole: %s", self.folder.path, problem
            )
        return not (problem and must)

    def _no_room(self, more_mib: int = 0) -> str | None:
        """Why a file cannot be written, as a phrase."""
        minimum_mib = self._setting.config.min_free_mib + more_mib
        try:
            free_mib = self._free_mib()
        except FileNotFoundError:
            return f"{self.folder.path} was removed"
        except OSError as error:
            return f"{self.folder.path}: {error.strerror}"
        return f"less than {minimum_mib} MiB are free" if free_mib < minimum_mib else None

    def _free_mib(self) -> float:
        return shutil.disk_usage(self.folder.path).free / _MIB

    def _write_summary(self) -> None:
        end_s, end_ns = self._end
        evaluation = self.evaluation()
        summary = build_summary(
            world=self.world,
            seed=self._stats.seed if self._stats else self._setting.config.seed,
            stats=self._stats,
            rebuilds=self._rebuilds,
            sim_time_s=end_ns * 1e-9 if end_ns or self._wall_time.ticked else None,
            wall_time=self._wall_time,
            now_s=end_s,
            evaluation=evaluation,
            totals=self._evaluation.totals(),
            counts=self._all_counts(),
            recorded=self.messages.recorded,
            rejected_elsewhere=self._rejected,
            versions=self._setting.versions,
            hardware=self._setting.hardware,
            parameters=self._setting.parameters.values(),
        )
        self._write(SUMMARY, summary_text(summary))
        self._write(SERIES, [to_json(self._evaluation.series(evaluation, end_ns * 1e-9)), b"\n"])

    def _write(self, name: str, pieces: Iterable[bytes]) -> None:
        if self.folder.is_gone:
            return
        try:
            write_atomically(self.folder.path / name, pieces)
        except OSError as error:
            _LOG.error("%s: %s", self.folder.path / name, error.strerror)
