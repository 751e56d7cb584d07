"""Whether time goes on: pause, steps one by one, a run up to a time, and at what speed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from services.common.documents import SimulationControl, SimulationControlReply
from services.common.node import Request
from services.physics.config import STEPS_PER_SECOND, time_of_step_ns

ControlRequest = Request[SimulationControl, SimulationControlReply]


@dataclass
class RunControl:
    """What people asked of the simulation. `paused` is whether it stands still between their runs
    of steps.
    """

    speed: float = 1.0
    paused: bool = False
    _last_step: int | None = None
    """The step after which a run of steps ends."""
    _waiting: list[ControlRequest] = field(default_factory=list)

    def stands(self, steps_done: int) -> bool:
        """Whether no step may follow the ones done."""
        if self._last_step is not None:
            return steps_done >= self._last_step
        return self.paused

    def apply(self, request: ControlRequest, steps_done: int) -> str | None:
        """Do what a request asks, but for its reset; one line where it cannot be, None where its
        answer has to wait until a run of steps has ended.
        """
        asked = request.message
        if asked.step is not None and asked.run_until_s is not None:
            return "step: must not come with run_until_s: they are two ways to say the same"
        last_step = None
        if asked.step is not None:
            last_step = steps_done + asked.step
        elif asked.run_until_s is not None:
            last_step = first_step_at(asked.run_until_s)
            if last_step < steps_done:
                now_s = time_of_step_ns(steps_done) * 1e-9
                return f"run_until_s: {asked.run_until_s:g}: must not be before now, {now_s:g} s"
        if last_step is not None and asked.pause:
            return "pause: must not be true with step or run_until_s, which leave it paused"
        if asked.speed is not None:
            self.speed = asked.speed
        if last_step is not None:
            self._last_step = last_step
            self.paused = True
            self._waiting.append(request)
            return None
        if asked.pause is not None:
            self.paused = asked.pause
            self._last_step = None
        return ""

    def ended(self, steps_done: int) -> list[ControlRequest]:
        """The requests whose run of steps has come to its end, or was cut short by another."""
        if self._last_step is not None and steps_done < self._last_step:
            return []
        self._last_step = None
        waiting, self._waiting = self._waiting, []
        return waiting


def first_step_at(time_s: float) -> int:
    """The first step whose end is not before a time."""
    step = max(math.floor(time_s * STEPS_PER_SECOND) - 1, 0)
    while time_of_step_ns(step) < round(time_s * 1e9):
        step += 1
    return step
