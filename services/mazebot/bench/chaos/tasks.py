"""What the robot does while faults are done: it is sent from place to place, or explores."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod

from mazebot.bench.chaos.trial import Trial
from mazebot.bench.chaos.witness import Witness
from mazebot.common.config import ConfigError
from mazebot.common.messages.documents import Planar
from mazebot.common.messages.slam_documents import ExplorationStatus
from mazebot.common.node.node import random_generator

RECOVERY_S = 60.0
GOAL_S = 180.0
EXPLORED_S = 600.0
_LEAST_SPEED_M_S = 0.1
_LEAST_DRIVE_M = 1.0
_KEPT_SHARE = 0.8
"""Of the floor seen before, when the map is drawn anew."""
_SETTLED_S = 2.0
"""Within this time the explorer takes in the map that mapping publishes."""


class Task(ABC):
    """What the robot is about."""

    def __init__(self, witness: Witness) -> None:
        self._witness = witness

    @abstractmethod
    def is_over(self) -> bool:
        """Whether there is nothing, or nothing more, to drive for."""

    @abstractmethod
    def begin(self) -> None:
        """Give the robot something to drive for. Raises ConfigError."""

    @abstractmethod
    def conclude(self, trial: Trial) -> None:
        """Wait for what becomes of it after a fault. Raises ConfigError."""

    def finish(self) -> None:  # noqa: B027 - only what lasts longer than a trial has anything left
        """Wait for what becomes of it after the last fault. Raises ConfigError."""

    def is_driving(self) -> bool:
        """Whether the robot is on its way at a fair speed."""
        moves = self._witness.motions[-1].speed_m_s > _LEAST_SPEED_M_S
        return moves and not self.is_over()


class Drive(Task):
    """From place to place, by goals."""

    def __init__(self, witness: Witness, seed: int) -> None:
        super().__init__(witness)
        self._random = random_generator(seed, "chaos/goals")
        self._stamp_ns = 0
        """Names the last goal."""

    def is_over(self) -> bool:
        """See Task."""
        return self._stamp_ns == 0 or bool(self.outcome())

    def begin(self) -> None:
        """Send the robot to another place of the world."""
        world = self._witness.world
        assert world is not None
        here = self._witness.motions[-1]
        places = [
            one
            for one in (world.start, *world.locations)
            if math.hypot(one.x_m - here.x_m, one.y_m - here.y_m) > _LEAST_DRIVE_M
        ]
        place = places[int(self._random.integers(len(places)))]
        self._stamp_ns += 1
        self._witness.send_goal(
            Planar(x_m=place.x_m, y_m=place.y_m, yaw_rad=place.yaw_rad), self._stamp_ns
        )

    def conclude(self, trial: Trial) -> None:
        """The goal ends, and the robot reaches another one."""
        trial.goal = trial.goal or self._awaited()
        self.begin()
        trial.next_goal = self._awaited()

    def _awaited(self) -> str:
        self._witness.wait(self.outcome, GOAL_S, "the result of a goal")
        return self.outcome()

    def outcome(self) -> str:
        """How the last goal has ended, in words; empty: it has not."""
        result = self._witness.result_of(self._stamp_ns)
        if result is None:
            return ""
        return f"{result.error_code}: {result.error_msg}" if result.error_code else "reached"


class Exploration(Task):
    """Until all floor is seen, and once more."""

    def __init__(self, witness: Witness) -> None:
        super().__init__(witness)
        self._during: list[Trial] = []
        """The faults of this exploration."""
        self._seen_m2 = 0.0

    def is_over(self) -> bool:
        """See Task."""
        return bool(self.outcome())

    def begin(self) -> None:
        """Begin anew, once the one before has ended."""
        if self.outcome():
            self._settle()
            self._witness.exploration = None
            self._witness.reset()
            self._seen_m2 = 0.0

    def conclude(self, trial: Trial) -> None:
        """It goes on, with the map made so far."""
        self._during.append(trial)
        since_s = time.monotonic() + _SETTLED_S

        def goes_on() -> bool:
            said = self._witness.exploration
            return said is not None and said[0] > since_s and said[1].free_m2 > 0.0

        self._witness.wait(goes_on, RECOVERY_S, "an exploration that goes on")
        status = self._status()
        assert status is not None
        if status.free_m2 < _KEPT_SHARE * trial.seen_m2:
            raise ConfigError(
                f"of {trial.seen_m2:.1f} m2 seen before, the map shows {status.free_m2:.1f} m2"
            )
        self._witness.wait(
            lambda: self.is_driving() or self.is_over(), RECOVERY_S, "a robot that drives on"
        )
        trial.next_goal = "reached"

    def finish(self) -> None:
        """See Task."""
        self._witness.wait(self.outcome, EXPLORED_S, "the end of the exploration")
        self._settle()

    def _settle(self) -> None:
        for trial in self._during:
            trial.goal = self.outcome()
        self._during = []

    def _status(self) -> ExplorationStatus | None:
        said = self._witness.exploration
        return None if said is None else said[1]

    def outcome(self) -> str:
        """How it has ended, in words; empty: it has not."""
        status = self._status()
        if status is None or status.state not in ("complete", "failed"):
            return ""
        return "reached" if status.state == "complete" else f"failed: {status.reason}"
