"""What a page that comes late has missed of the run: driven trails, plots, results, the log."""

from __future__ import annotations

import math
from collections import deque

from mazebot.common.messages.documents import SimulationStats
from mazebot.console.live.frame import Frame, text_frame

MOST_LINES = 200
"""Lines of the log, and results, that are kept."""
MOST_POINTS = 3000
"""Points of a trail; a longer one gets coarser."""
STEP_M = 0.05
MOST_ROWS = 1500
"""Rows of the plots; more get coarser."""
ROW_S = 0.1
_BACK_S = 1.0
"""A clock that goes back by more is that of another run."""
_RESULTS = ("action_result", "navigation_result", "contact")


class Trail:
    """Where something has been, from the beginning on, with a bounded number of points."""

    def __init__(self) -> None:
        self.points: list[tuple[float, float]] = []
        """x and y, m."""
        self._step_m = STEP_M

    def add(self, x_m: float, y_m: float) -> None:
        """Add a point, unless it is near the last one."""
        if self.points and math.dist(self.points[-1], (x_m, y_m)) < self._step_m:
            return
        self.points.append((x_m, y_m))
        if len(self.points) >= MOST_POINTS:
            self.points = self.points[::2]
            self._step_m *= 2.0


class Plots:
    """Numbers over time, with a bounded number of rows."""

    def __init__(self) -> None:
        self.rows: list[tuple[float | None, ...]] = []
        """Time, s, and the numbers; None where one is not known."""
        self._step_s = ROW_S

    def add(self, time_s: float, *numbers: float | None) -> None:
        """Add a row, unless the last one is of nearly the same time."""
        last_s = self.rows[-1][0] if self.rows else None
        if last_s is not None and time_s - last_s < self._step_s:
            return
        self.rows.append((time_s, *numbers))
        if len(self.rows) >= MOST_ROWS:
            self.rows = self.rows[::2]
            self._step_s *= 2.0


class History:
    """Of one run, from one start of its simulation to the next."""

    def __init__(self) -> None:
        self._run: tuple[str, int] | None = None
        self._time_s = 0.0
        self.clear()

    @property
    def time_s(self) -> float:
        """The newest simulation time."""
        return self._time_s

    def clear(self) -> None:
        """Another run begins."""
        self._trails = {"truth": Trail(), "estimate": Trail()}
        self.plots = Plots()
        self._log: deque[Frame] = deque(maxlen=MOST_LINES)
        self._results: deque[Frame] = deque(maxlen=MOST_LINES)

    def is_restart(self, stats: SimulationStats) -> bool:
        """Whether the simulation has restarted since the last call."""
        run, before = (stats.world_hash, stats.run_epoch), self._run
        is_back = stats.sim_time_s < self._time_s - _BACK_S
        self._run, self._time_s = run, stats.sim_time_s
        return before is not None and (run != before or is_back)

    def add_pose(self, name: str, x_m: float, y_m: float) -> None:
        """Go on with a trail: `truth` or `estimate`."""
        self._trails[name].add(x_m, y_m)

    def add_event(self, frame: Frame) -> None:
        """Keep a line of the log, or a result."""
        if frame.kind == "log":
            # What was said before a page came is sent anew when it comes.
            if frame not in self._log:
                self._log.append(frame)
        elif frame.kind in _RESULTS:
            self._results.append(frame)

    def frames(self) -> list[Frame]:
        """All of it for a page that comes now."""
        trails = {name: trail.points for name, trail in self._trails.items()}
        plots = text_frame("plots", {"rows": self.plots.rows})
        return [text_frame("trails", trails), plots, *self._results, *self._log]
