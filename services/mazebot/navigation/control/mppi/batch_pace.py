"""How many trajectories a sampling controller tries where control steps come late.

Time is an argument of a step: a period that no step fell into was missed. In lockstep none is ever
missed, so that there the same seed gives the same bytes.
"""

from __future__ import annotations

import logging
from typing import Protocol, runtime_checkable

_LOG = logging.getLogger("navigation")

_SHRINK = 0.7
_GROW = 1.1
_LEAST = 0.25
"""Share of the configured batch that is always tried."""
_IN_TIME = 100
"""After so many steps in time the batch grows again."""


@runtime_checkable
class Batched(Protocol):
    """A controller whose computing time grows with the number of its trajectories."""

    batch_size: int
    shortfalls: int
    """How often the batch was made smaller."""


class BatchPace:
    """Makes the batch smaller at a missed control period, and slowly larger again."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._last_ns: int | None = None
        self._controller: object = None
        self._batched: Batched | None = None
        """That controller, if it is one. A lookup takes longer than the rest of a step."""
        self._full = 0
        """That controller's configured batch."""
        self._in_time = 0
        self.missed = 0
        """Control periods missed so far."""

    def rest(self) -> None:
        """The robot is not controlled in this step: whether the next one is in time is unknown."""
        self._last_ns = None

    def step(self, now_ns: int, controller: object) -> None:
        """Note a step of a controller."""
        last_ns, self._last_ns = self._last_ns, now_ns
        if controller is not self._controller:
            if self._batched is not None:
                # It may come back, and then begins anew.
                self._batched.batch_size = self._full
            self._controller = controller
            self._batched = controller if isinstance(controller, Batched) else None
            self._full = 0 if self._batched is None else self._batched.batch_size
        batched = self._batched
        if last_ns is None or batched is None:
            return
        before, full = batched.batch_size, self._full
        missed = now_ns // self._period_ns - last_ns // self._period_ns - 1
        if missed > 0:
            self.missed += missed
            self._in_time = 0
            batched.batch_size = max(int(before * _SHRINK), int(full * _LEAST), 1)
        elif before < full:
            self._in_time += 1
            if self._in_time >= _IN_TIME:
                self._in_time = 0
                batched.batch_size = min(int(before * _GROW) + 1, full)
        self._log_change(before, batched.batch_size, full)

    def _log_change(self, before: int, now: int, full: int) -> None:
        if before == full and now < full:
            _LOG.warning(
                "Control loop missed its desired rate: sampling %d trajectories instead of %d",
                now,
                full,
            )
        elif before < full and now == full:
            _LOG.info("Control loop is back at its desired rate: sampling %d trajectories", full)
