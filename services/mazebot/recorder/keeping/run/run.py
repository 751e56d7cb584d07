"""One run: its folder, its recording, its evaluation."""

from __future__ import annotations

import contextlib
import logging
import math
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import yaml
from pydantic_core import to_json

from mazebot.common.messages import documents as doc
from mazebot.common.messages.topics import CAMERA_IMAGE, PARAMETERS, SIMULATION_STATS, Topic
from mazebot.common.node.node import TopicCounts
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
from mazebot.recorder.judging.summary import build_summary, summary_text
from mazebot.recorder.judging.wall_time import WallTime
from mazebot.recorder.keeping.closing import leave_report
from mazebot.recorder.keeping.progress import Progress, write_progress
from mazebot.recorder.keeping.run.counts import MessageCounts
from mazebot.recorder.keeping.run.digests import RunDigests
from mazebot.recorder.keeping.run.drawing import RunDrawing
from mazebot.recorder.keeping.run.judge import RunJudge
from mazebot.recorder.keeping.run.messages import RunMessages
from mazebot.recorder.keeping.run.setting import Setting
from mazebot.recorder.stream.file_writer import RecordingError
from mazebot.recorder.stream.message_log import Taken
from mazebot.recorder.stream.pictures import Pictures

if TYPE_CHECKING:
    pass

_LOG = logging.getLogger("recorder")

_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
"""The C implementation is ten times as fast, if available."""

FLUSH_PERIOD_S = 0.4
"""Wall time: together with a step of the recorder, the most that is lost if it is killed."""
SEND_PERIOD_S = FLUSH_PERIOD_S
"""Wall time by which the live view may lag behind. The file gets a chunk of each entity at each of
both periods.
"""
SUMMARY_PERIOD_S = 5.0
NEWS_PERIOD_S = 0.5
"""Wall time after which a goal that was sent or has ended stands in the summary."""
PROGRESS_PERIOD_S = 2.0
"""Wall time: the evaluation loses at most this duration if the recorder is killed."""
SPACE_PERIOD_S = 2.0
"""Wall time between checks whether the folder exists, and whether a full disk has room again."""
RESUME_MIB = 16
"""Free space beyond the minimum that is needed to resume the recording with a new part."""

_MIB = 1024 * 1024


class Run:
    """One world, from one start of its simulation to its end."""

    def __init__(
        self,
        setting: Setting,
        make_folder: Callable[[], RunFolder],
        world: doc.World,
        now_ns: int,
        progress: Progress | None = None,
        before: Mapping[str, TopicCounts] | None = None,
    ) -> None:
        """`make_folder` is called again if the run's folder is removed; with `progress` the run is
        resumed from there; `before`: what the recorder had counted in earlier runs. Raises OSError
        if no folder can be created.
        """
        self.world = world
        self.folder = make_folder()
        self._make_folder = make_folder
        self.trouble: str | None = None
        """What the recording lacks to be written."""
        self.unrecorded: str | None = None
        """From when on it is not written, and why."""
        self._has_recording = False
        self._setting = setting
        self._judge = RunJudge(world, setting)
        self._evaluation = self._judge.evaluation
        self._counts = MessageCounts(before)
        self._digests = self._open_digests()
        self._pictures = Pictures(setting.config.jpeg_quality)
        self.messages = RunMessages(
            setting.config, world, setting.latched, self._pictures, setting.foxglove
        )
        self._drawing = RunDrawing(setting, world, self._pictures, self.folder)
        self._has_pictures = False
        self._content: Mapping[str, Any] = {}
        now_s = setting.wall_clock_s()
        self._end: tuple[float, int] = (now_s, now_ns)
        """Wall time and simulation time of the newest message."""
        self._known: tuple[str, int] | None = None
        """Source id of the simulation's messages, and its epoch."""
        if progress is not None:
            self._resume_from(progress)
        self._kept_goals = self._evaluation.goals_ended
        self._sent_s = self._flushed_s = self._checked_s = now_s
        # At once: a run whose recorder is killed in its first seconds is resumed, too.
        self._kept_s = self._summarised_s = -math.inf
        self._summarised_goals: tuple[int, tuple[int, int]] | None = None
        for topic, message in setting.fixed.items():
            self._judge.take(topic, message)
        for told in setting.parameters.values():
            self._judge.take(PARAMETERS, told)
        self._open_recording(now_ns)

    def take(self, topic: Topic[Any], taken: Taken, now_ns: int, is_recorded: bool = False) -> None:
        """Evaluate, draw, record and digest one message; `is_recorded`: `run.mcap` has it."""
        message, envelope, _ = taken
        if not self._counts.is_new(topic, envelope):
            return
        self._end = self._setting.wall_clock_s(), now_ns
        if topic is SIMULATION_STATS and message.world_hash == self.world.hash:
            self._known = envelope.source, message.epoch
        self._has_pictures |= topic is CAMERA_IMAGE
        self._judge.take(topic, message)
        if self._digests is not None:
            self._digests.add(topic, taken)
        if not is_recorded:
            self.messages.add(topic, taken, now_ns)
        self._drawing.draw(topic, message, now_ns)

    def tick(self, now_ns: int, counts: Mapping[str, TopicCounts]) -> None:
        """Write to disk what is due."""
        self._counts.ours = counts
        self.messages.tick()
        now_s = self._setting.wall_clock_s()
        self._judge.tick(now_s, now_ns)
        if self._setting.live is not None and now_s - self._sent_s >= SEND_PERIOD_S:
            self._sent_s = now_s
            self._drawing.send()
        if now_s - self._flushed_s >= FLUSH_PERIOD_S:
            self._flushed_s = now_s
            self._flush()
        if now_s - self._checked_s >= SPACE_PERIOD_S:
            self._checked_s = now_s
            self._resume_recording(now_ns)
        self._judge.write_map(self.folder, now_ns)
        goals = self._evaluation.goals_sent, self._evaluation.goals_ended
        period_s = SUMMARY_PERIOD_S if goals == self._summarised_goals else NEWS_PERIOD_S
        if now_s - self._summarised_s >= period_s:
            self._summarised_s, self._summarised_goals = now_s, goals
            self._write_summary()
        # The true pose at a goal's end is not sent again.
        has_news = self._evaluation.goals_ended != self._kept_goals
        if self._known and (now_s - self._kept_s >= PROGRESS_PERIOD_S or has_news):
            self._kept_s = now_s
            self.keep_progress()
            self._kept_goals = self._evaluation.goals_ended

    def keep_progress(self) -> None:
        """Write the state that a new recorder needs to resume this run."""
        if self._known is None or not self._setting.resumable or self.folder.is_gone:
            return
        source, epoch = self._known
        run = {
            "rebuilds": self._judge.rebuilds,
            "wall_time": asdict(self._judge.wall_time),
            "counts": self._counts.values(),
            "wanted": dict(self.messages.wanted),
        }
        verdict, arrays = self._evaluation.state()
        progress = Progress(
            *(self.world.hash, source, epoch, self._end[1], self._counts.taken, run),
            verdict=verdict,
            arrays=arrays,
        )
        try:
            write_progress(self.folder.path, progress)
        except OSError as error:
            _LOG.debug("%s: %s", self.folder.path, error.strerror)

    def _resume_from(self, progress: Progress) -> None:
        """Take over the state of the previous recorder of the run."""
        run = progress.run
        self._evaluation.restore(progress.verdict, progress.arrays)
        self._judge.rebuilds = run["rebuilds"]
        self._judge.wall_time = WallTime.restored(run["wall_time"])
        self._end = self._setting.wall_clock_s(), progress.time_ns
        self._known = progress.source, progress.epoch
        self._counts.restore(run["counts"], progress.taken)
        self.messages.restore(run["wanted"])

    @property
    def counted(self) -> Mapping[str, TopicCounts]:
        """All messages that this recorder has counted, in earlier runs as well."""
        return self._counts.ours

    def evaluation(self) -> doc.Evaluation:
        """The evaluation of the run so far, against the ground truth."""
        return self._evaluation.evaluation(str(self.folder.path))

    def show(self, evaluation: doc.Evaluation, final: bool = False) -> None:
        """Draw the run's evaluation."""
        self._drawing.show(evaluation, self._evaluation.true_faces_m, final)

    def write_config(self, content: Mapping[str, Any]) -> None:
        """Write config.yaml."""
        self._content = content
        text = yaml.dump(dict(content), Dumper=_DUMPER, sort_keys=False, allow_unicode=True)
        self._write(CONFIG, [text.encode()])

    def close(self) -> None:
        """Write the summary, end the recording, and mark the run as complete."""
        self.end()
        self.finish()

    def end(self) -> None:
        """Take no more messages: write the summary, and end what another run needs as well."""
        self._judge.write_map(self.folder, self._end[1], all_of_it=True)
        self.messages.wait()
        self._write_summary(ended=True)
        self.show(self.evaluation(), final=True)
        self._write_digests(close=True)
        self._drawing.close()

    def finish(self) -> None:
        """End the files of an ended run and mark it as complete. It takes long, and may be done in
        a thread beside the next run.
        """
        config = self._setting.config
        is_whole = self.messages.end()
        self._pictures.close()
        is_gone = self.folder.is_gone
        if self._has_pictures and config.record and config.video and not is_gone:
            with contextlib.suppress(OSError):
                (self.folder.path / TO_COMPRESS).touch()
        if self._drawing.join_parts() and is_whole:
            self.folder.release()
        else:
            # A later recorder will repair it.
            self.folder.let_go()
        if config.record and not is_gone:
            leave_report(self.folder.path)

    def _resume_recording(self, now_ns: int) -> None:
        """Resume the recording if what prevented it is gone."""
        if self.folder.is_gone:
            removed = self.folder.path
            self._stop(f"{removed} was removed")
            try:
                folder = self._make_folder()
            except OSError as error:
                _LOG.error("%s was removed; failed to create another: %s", removed, error.strerror)
                return
            _LOG.warning("continuing in %s", folder.path)
            self.folder.let_go()
            self.folder = folder
            self._drawing.move_to(folder)
            self._write_digests(close=True)
            self._digests = self._open_digests()
            self._judge.write_map_again()
            self.write_config(self._content)
            self._open_recording(now_ns)
        elif self.trouble is not None and self._lack_of_space(RESUME_MIB) is None:
            self._open_recording(now_ns)

    def _open_recording(self, now_ns: int) -> None:
        """Start run.rrd, or its next part, with the current state."""
        config = self._setting.config
        trouble = self._lack_of_space() if config.record else None
        properties = self._properties()
        if trouble is not None:
            self._stop(trouble)
        elif config.record:
            try:
                self._drawing.begin(now_ns, properties, in_file=True)
                self.messages.begin(self.folder, properties, now_ns)
            except RecordingError as error:
                self._stop(str(error))
            else:
                if self.trouble is not None:
                    _LOG.info("recording resumed: %s", self._drawing.part)
                self.trouble = self.unrecorded = None
                self._has_recording = True
        if not self._drawing.is_open and self._setting.live is not None:
            self._drawing.begin(now_ns, properties, in_file=False)

    def _properties(self) -> dict[str, str]:
        return {
            "world": self.world.name,
            "world_hash": self.world.hash,
            "seed": str(self._setting.config.seed),
            **self._setting.versions,
        }

    def _open_digests(self) -> RunDigests | None:
        return RunDigests(self.folder.path / DIGESTS) if self._setting.config.record else None

    def _write_digests(self, close: bool = False) -> None:
        if self._digests is not None:
            self._digests.write(close)

    def _flush(self) -> None:
        if self.folder.is_gone:
            return
        self._write_digests()
        try:
            self.messages.flush(self._end[1])
            self._drawing.flush()
            if self._drawing.is_large:
                self._drawing.begin(self._end[1], self._properties(), in_file=True)
        except RecordingError as error:
            self._stop(self._lack_of_space() or str(error))
            return
        trouble = self._lack_of_space()
        if self._drawing.is_open and trouble is not None and self._setting.config.record:
            self._stop(trouble)

    def _stop(self, reason: str) -> None:
        """End the file before its disk is full; evaluation and live view continue."""
        recording = self.folder.path / RECORDING
        trouble = f"disk space for {recording}: {reason}"
        if trouble != self.trouble:
            _LOG.error("recording stopped: %s: %s", recording, reason)
            when = f"stopped at {self._end[1] * 1e-9:.1f} s" if self._has_recording else "none"
            self.unrecorded = f"{when}: {reason}"
        self.trouble = trouble
        self.messages.end()
        self._drawing.end_file()

    def _lack_of_space(self, more_mib: int = 0) -> str | None:
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

    def _write_summary(self, ended: bool = False) -> None:
        end_s, end_ns = self._end
        evaluation = self.evaluation()
        summary = build_summary(
            ended=ended,
            world=self.world,
            seed=self._judge.stats.seed if self._judge.stats else self._setting.config.seed,
            stats=self._judge.stats,
            rebuilds=self._judge.rebuilds,
            sim_time_s=end_ns * 1e-9 if end_ns or self._judge.wall_time.ticked else None,
            wall_time=self._judge.wall_time,
            now_s=end_s,
            evaluation=evaluation,
            totals=self._evaluation.totals(),
            counts=self._counts.totals(),
            recorded=self.messages.recorded,
            wanted=self.messages.wanted,
            rejected_elsewhere=self._judge.rejected,
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
