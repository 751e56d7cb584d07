"""Control of simulation time: pause, single steps, run until a time, and speed."""

from __future__ import annotations

from mazebot.common.messages.documents import SimulationControl, SimulationControlReply
from mazebot.common.node.node import Request
from mazebot.physics.config import STEPS_PER_SECOND, time_of_step_ns

ControlRequest = Request[SimulationControl, SimulationControlReply]


class RunControl:
    """Pause, steps and speed as last requested.

    A request is first checked by `problem`, which changes nothing, and then applied by `apply`.
    """

    def __init__(self) -> None:
        self.speed = 1.0
        """Simulated seconds a second; 0: as fast as possible."""
        self.interventions = 0
        """Times that a request changed how time passes, or a requested run of steps ended."""
        self._paused = False
        self._last_step: int | None = None
        """The step after which a run of steps ends."""
        self._running: ControlRequest | None = None
        """The request for that run, replied to at its end."""

    def restore(self, paused: bool, speed: float) -> None:
        """Let time pass as in a simulation before, whose runs of steps have ended with it."""
        self._paused, self.speed = paused, speed

    def stands(self, steps_done: int) -> bool:
        """Whether time is stopped after the steps done."""
        if self._last_step is not None:
            return steps_done >= self._last_step
        return self._paused

    def problem(self, asked: SimulationControl, steps_done: int) -> str:
        """Why a request is refused, in one line; empty if it is not."""
        if asked.seed is not None and asked.reset in (None, "time"):
            return f"seed: {asked.seed}: requires reset: all, which restarts the random streams"
        if asked.step is not None and asked.run_until_s is not None:
            return f"step: {asked.step}: must not be combined with run_until_s"
        if asked.pause and (asked.step is not None or asked.run_until_s is not None):
            return "pause: true: must not be combined with step or run_until_s, which end paused"
        if asked.run_until_s is not None:
            begin = 0 if asked.reset is not None else steps_done
            if first_step_at(asked.run_until_s) < begin:
                now_s = time_of_step_ns(begin) * 1e-9
                return f"run_until_s: {asked.run_until_s:g}: must not be before now, {now_s:.6g} s"
        return ""

    def apply(self, request: ControlRequest, steps_done: int) -> ControlRequest | None:
        """Apply a request without a problem, except its reset, which has been done.

        Returns the request whose run of steps this one cuts short.
        """
        asked = request.message
        if asked.model_dump(exclude_none=True):
            self.interventions += 1
        if asked.speed is not None:
            self.speed = asked.speed
        last_step: int | None = None
        if asked.step is not None:
            last_step = steps_done + asked.step
        elif asked.run_until_s is not None:
            last_step = first_step_at(asked.run_until_s)
        if last_step is None and asked.pause is None and asked.reset is None:
            return None
        cut, self._running = self._running, None
        if last_step is not None:
            self._running = request
            self._paused = True
        elif asked.pause is not None:
            self._paused = asked.pause
        self._last_step = last_step
        return cut

    def running(self, request: ControlRequest) -> bool:
        """Whether a request's reply has to wait until its run of steps has ended."""
        return self._running is request

    def ended(self, steps_done: int) -> ControlRequest | None:
        """The request whose run of steps has ended."""
        if self._running is None or not self.stands(steps_done):
            return None
        ended, self._running, self._last_step = self._running, None, None
        self.interventions += 1
        return ended


def first_step_at(time_s: float) -> int:
    """The first step whose end is not before a time, which is taken to the nanosecond."""
    return -(-round(time_s * 1e9) * STEPS_PER_SECOND // 1_000_000_000)
