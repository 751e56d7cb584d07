"""State that drawing one run keeps from message to message."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mazebot.common.maths.frames import MAP_FRAME
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Entities, World
from mazebot.recorder.drawing.mesh import RobotMesh
from mazebot.recorder.drawing.scenery import Part
from mazebot.recorder.judging.errors import TruthComparison
from mazebot.recorder.stream.pictures import Pictures
from mazebot.recorder.stream.recording import Recording

_PATH_STEP_M = 0.03
_PATH_POINTS = 4000
_CONTACTS = 1000
PATH_NS = 500_000_000
"""Period at which paths and steadily changing values are drawn."""
LATCH_NS = 10_000_000_000
"""Unchanged values are drawn again this often, for viewers that have only the newest data."""
_TRAIL_POINTS = 400
"""A path is drawn less often by this many of its points."""


class Trail:
    """A driven path: a point every 3 cm, the newest 4000 of them."""

    def __init__(self) -> None:
        self._points: list[tuple[float, float]] = []

    def add(self, x_m: float, y_m: float) -> bool:
        """Add a point; returns whether it was far enough from the last one."""
        if self._points:
            last_x, last_y = self._points[-1]
            if (x_m - last_x) ** 2 + (y_m - last_y) ** 2 < _PATH_STEP_M**2:
                return False
        self._points.append((x_m, y_m))
        if len(self._points) > 2 * _PATH_POINTS:
            del self._points[:_PATH_POINTS]
        return True

    def __len__(self) -> int:
        return min(len(self._points), _PATH_POINTS)

    def points(self, z_m: float) -> NDArray[np.float32]:
        """(n, 3), oldest first."""
        xy = np.array(self._points[-_PATH_POINTS:], np.float32).reshape(-1, 2)
        return np.column_stack([xy, np.full(len(xy), z_m, np.float32)])


@dataclass
class Canvas:
    """The recording of one run, and the state needed to draw its messages."""

    recording: Recording
    robot: RobotMesh
    world: World
    assets: dict[str, bytes]
    """Textures (PNG) and meshes (npz) by their sha256, of every world so far."""
    wall_clock_s: Callable[[], float]
    pictures: Pictures = field(default_factory=lambda: Pictures(75))
    now_ns: int = 0
    entities: Entities | None = None
    camera: msg.CameraInfo | None = None
    comes_compressed: bool = False
    """Whether the camera image is also published as JPEG, and need not be encoded."""
    parts: list[Part] = field(default_factory=list)
    """The drawn parts of the world."""
    drawn: dict[str, list[str]] = field(default_factory=dict)
    """Entity paths on which each entity is drawn, by its name."""
    start_ns: int = field(init=False)
    comparison: TruthComparison = field(init=False)
    trails: dict[str, Trail] = field(default_factory=dict)
    contacts_m: deque[tuple[float, float, float]] = field(
        default_factory=lambda: deque(maxlen=_CONTACTS)
    )
    markers_seen: set[str] = field(default_factory=set)
    """Ids of the markers that were detected so far,"""
    markers_in_view: set[str] = field(default_factory=set)
    """and of those that were in the newest picture."""
    last: dict[str, object] = field(default_factory=dict)
    """Newest logged value of each entity that is logged only on change."""
    real_time: tuple[float, int] | None = None
    """Wall time (s) and simulation time (ns) at which the real time factor was last measured."""
    _drawn_ns: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.start_ns = self.now_ns
        self.comparison = TruthComparison(self.world.start.se2())

    def at(self, time: msg.Time) -> int:
        """Set the log time to a message's stamp; returns that stamp in nanoseconds."""
        stamp_ns = msg.ns_from_time(time)
        self.recording.at(stamp_ns)
        return stamp_ns

    def due(self, path: str, stamp_ns: int, period_ns: int) -> bool:
        """Whether an entity logged every `period_ns` is due."""
        last_ns = self._drawn_ns.get(path)
        if last_ns is not None and 0 <= stamp_ns - last_ns < period_ns:
            return False
        self._drawn_ns[path] = stamp_ns
        return True

    def changed(self, path: str, value: object) -> bool:
        """Whether an entity logged on change is due."""
        if path in self.last and self.last[path] == value:
            return False
        self.last[path] = value
        return True

    def measured(self, path: str, value: float | None) -> None:
        """Log a number to an entity, or, where it is None, a gap in its plot. The time must be
        set.
        """
        if value is not None:
            self.recording.scalar(path, value)
        if self.changed(f"{path}#measured", value is not None) and value is None:
            self.recording.log(path, rr.Clear(recursive=False))

    def frame(
        self, path: str, frame: str, looks: Callable[[], rr.AsComponents] | None = None
    ) -> None:
        """Set the frame of an entity's coordinates, and its style, once."""
        if self.changed(f"{path}#frame", frame):
            style = () if looks is None else (looks(),)
            self.recording.log(path, rr.CoordinateFrame(frame), *style, static=True)

    def event(self, kind: str, text: str, level: str = "INFO") -> None:
        """Log what a user may want to jump to: `kind` is `goal`, `contact`, `recovery`, `marker`,
        `localization` or `fault`. The time must be set.
        """
        self.recording.log(f"events/{kind}", rr.TextLog(text, level=level))

    def log_text(self, path: str, text: str, level: str = "INFO") -> None:
        """Log a line of text that is not on /rosout."""
        self.recording.at(self.now_ns)
        self.recording.log(path, rr.TextLog(text, level=level))


def draw_trail(
    canvas: Canvas,
    path: str,
    pose: msg.Pose,
    z_m: float,
    color: tuple[int, int, int],
    radius_m: float,
) -> None:
    """Draw the path so far: twice per second while it grows, and less often the longer it is. The
    time must be set.
    """
    trail = canvas.trails.setdefault(path, Trail())
    if trail.add(pose.position.x, pose.position.y):
        canvas.last[f"{path}#grown"] = True
    period_ns = PATH_NS * (1 + len(trail) // _TRAIL_POINTS)
    if canvas.last.get(f"{path}#grown") and canvas.due(path, canvas.now_ns, period_ns):
        canvas.last[f"{path}#grown"] = False
        canvas.frame(
            path, MAP_FRAME, lambda: rr.LineStrips3D.from_fields(colors=color, radii=radius_m)
        )
        canvas.recording.log(path, rr.LineStrips3D([trail.points(z_m)]))


def entity_part(name: str) -> str:
    """An arbitrary name as one part of an entity path."""
    return rr.escape_entity_path_part(name)
