"""Wait: stands for a time, since what is in the way may move."""

from __future__ import annotations

from mazebot.navigation.behavior.motions.motion import DONE, STANDING, Moment, Motion, MotionStep


class Wait(Motion):
    """One wait; its feedback is the time left."""

    def __init__(self, time_s: float) -> None:
        super().__init__()
        self._time_s = time_s
        self.feedback = time_s

    def _advance(self, at: Moment) -> MotionStep:
        self.feedback = max(self._time_s - at.running_s, 0.0)
        return DONE if at.running_s >= self._time_s else STANDING
