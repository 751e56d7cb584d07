"""What Rerun shows of one run: the parts of its `run.rrd`, and the live view."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mazebot.common.files.root import ROOT
from mazebot.common.maths.frames import Array
from mazebot.common.messages import documents as doc
from mazebot.common.messages.topics import Topic
from mazebot.common.recordings.run_folder import RunFolder
from mazebot.recorder.drawing.scenery import extent_of
from mazebot.recorder.judging.obstacles import read_meshes
from mazebot.recorder.keeping.repair import Rewriting
from mazebot.recorder.keeping.run.setting import Setting
from mazebot.recorder.stream.file_writer import RecordingError
from mazebot.recorder.stream.pictures import Pictures

if TYPE_CHECKING:
    from mazebot.recorder.drawing.canvas import Canvas

_LOG = logging.getLogger("recorder")

JOIN_TIMEOUT_S = 6.0
"""Wall time at a run's end to merge several parts."""
REPAIR_TIMEOUT_S = 30.0
"""The same where one of them lacks its end: else the run stays incomplete until the next recorder.
Half of what Compose and `mazebot up` give the recorder to end.
"""
MOST_JOINED_BYTES = 200_000_000
"""Whole parts that are larger together stay as they are: a viewer reads them as one."""
MOST_CHUNKS = 50_000
"""In a part: Rerun keeps some 4 KB of each until the part ends, and writes an index of all then."""

_ROBOT = ROOT / "models" / "turtlebot3_waffle" / "model.urdf"


class RunDrawing:
    """Draws into a file, to the live view, or both. Rerun is imported only if something is."""

    def __init__(
        self, setting: Setting, world: doc.World, pictures: Pictures, folder: RunFolder
    ) -> None:
        self._setting = setting
        self._world = world
        self._pictures = pictures
        self._folder = folder
        self._parts = folder.last_part()
        self._are_whole = self._parts == 0
        """Whether every part so far was ended properly."""
        self._canvas: Canvas | None = None
        self._ending: list[threading.Thread] = []
        """Of parts that were large."""
        self._draw: Mapping[Topic[Any], Callable[[Canvas, Any], None]] = {}
        self._not_drawn: set[Topic[Any]] = set()

    @property
    def is_open(self) -> bool:
        """Whether anything is drawn."""
        return self._canvas is not None

    @property
    def part(self) -> Path:
        """The newest file."""
        return self._folder.part(self._parts)

    @property
    def is_large(self) -> bool:
        """Whether the next part shall begin."""
        return self._canvas is not None and self._canvas.recording.chunks >= MOST_CHUNKS

    def move_to(self, folder: RunFolder) -> None:
        """Write the next files to another folder."""
        self._folder, self._parts, self._are_whole = folder, 0, True

    def begin(self, now_ns: int, properties: Mapping[str, str], in_file: bool) -> None:
        """Draw the current state, into the next part (`in_file`), to the live view, or both.

        Raises RecordingError if the file cannot be created.
        """
        setting = self._setting
        from mazebot.recorder.drawing.archetypes import DRAW, draw_start  # noqa: PLC0415
        from mazebot.recorder.drawing.canvas import Canvas  # noqa: PLC0415
        from mazebot.recorder.drawing.layouts.layouts import run_blueprint  # noqa: PLC0415
        from mazebot.recorder.drawing.layouts.views import Scene  # noqa: PLC0415
        from mazebot.recorder.drawing.mesh import robot_from_urdf  # noqa: PLC0415
        from mazebot.recorder.drawing.world_drawing import draw_world  # noqa: PLC0415
        from mazebot.recorder.stream.recording import Recording  # noqa: PLC0415

        extent = extent_of(self._world, read_meshes(self._world.bodies, setting.assets))
        scene = Scene(extent, self._world.slam)
        recording = Recording(
            self._folder.path.name,
            path=self._folder.part(self._parts + 1) if in_file else None,
            live=setting.live,
            blueprint=run_blueprint(scene, setting.config.layout),
            properties={**properties, **scene.properties()},
        )
        self._end_beside()
        self._parts += in_file
        self._draw = DRAW
        self._canvas = canvas = Canvas(
            recording=recording,
            robot=robot_from_urdf(_ROBOT.read_text(encoding="utf-8")),
            world=self._world,
            assets=setting.assets,
            wall_clock_s=setting.wall_clock_s,
            pictures=self._pictures,
            now_ns=now_ns,
        )
        draw_start(canvas)
        draw_world(canvas, self._world)
        for topic, message in setting.fixed.items():
            self.draw(topic, message, now_ns)

    def draw(self, topic: Topic[Any], message: Any, now_ns: int) -> None:
        """Draw a message. One that cannot be drawn is recorded all the same; it is told once."""
        if self._canvas is None:
            return
        self._canvas.now_ns = now_ns
        try:
            self._draw[topic](self._canvas, message)
        except RecordingError:
            raise
        except Exception:
            if topic not in self._not_drawn:
                self._not_drawn.add(topic)
                _LOG.exception("%s cannot be drawn", topic.name)

    def show(self, evaluation: doc.Evaluation, true_faces_m: Array | None, final: bool) -> None:
        """Draw the run's evaluation, and the walls that its map is judged by."""
        canvas = self._canvas
        if canvas is None:
            return
        from mazebot.recorder.drawing.text_drawing import draw_evaluation  # noqa: PLC0415

        draw_evaluation(canvas, evaluation, final)
        if evaluation.mapping is None:
            return
        from mazebot.recorder.drawing.mapping_drawing import (  # noqa: PLC0415
            draw_map_evaluation,
            draw_true_walls,
        )

        draw_map_evaluation(canvas, evaluation.mapping)
        if true_faces_m is not None and canvas.changed("mapping/true_walls", id(true_faces_m)):
            draw_true_walls(canvas, true_faces_m)

    def send(self) -> None:
        """Send what is new to the live view."""
        if self._canvas is not None:
            self._canvas.recording.send()

    def flush(self) -> None:
        """Write everything to disk. Raises RecordingError if it cannot be."""
        if self._canvas is not None:
            try:
                self._canvas.recording.flush()
            except RecordingError:
                self._are_whole = False
                raise

    def end_file(self) -> None:
        """End the file; the live view continues."""
        if self._canvas is not None and self._setting.live is not None:
            self._end(self._canvas.recording.end_file)
        else:
            self.close()

    def close(self) -> None:
        """End the file and the live view."""
        self._end_beside()
        while self._ending:
            self._ending.pop().join()

    def _end_beside(self) -> None:
        """End the file in a thread: the index of a large one takes its time."""
        canvas, self._canvas = self._canvas, None
        if canvas is not None:
            end = canvas.recording.close
            ending = threading.Thread(target=self._end, args=(end,), name="end of part")
            ending.start()
            self._ending.append(ending)

    def _end(self, end: Callable[[], None]) -> None:
        try:
            end()
        except RecordingError as error:
            self._are_whole = False
            _LOG.error("%s: %s", self.part, error)

    def join_parts(self) -> bool:
        """Merge all parts into one compact run.rrd, unless they are large; returns whether the
        recording is complete.
        """
        parts = self._folder.parts()
        timeout_s, must = self._setting.config.compact_timeout_s, not self._are_whole
        is_large = sum(part.stat().st_size for part in parts) > MOST_JOINED_BYTES
        if not parts or (not must and (is_large or (len(parts) == 1 and timeout_s <= 0.0))):
            return True
        if must:
            timeout_s = max(timeout_s, REPAIR_TIMEOUT_S)
        elif len(parts) > 1:
            timeout_s = max(timeout_s, JOIN_TIMEOUT_S)
        # If this times out, parts that were properly ended stay as they are.
        problem = Rewriting(parts).run(timeout_s)
        if problem and must:
            _LOG.warning(
                "%s: not merged; the next recorder will repair it: %s", self._folder.path, problem
            )
        return not (problem and must)
