"""The seats of services whose messages are replayed, around the recorded clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping

from mazebot.cli.replay.reading.replayed import CLOCK_SERVICE, Replayed
from mazebot.common.config import ServiceConfig
from mazebot.common.messages.topics import SERVICES
from mazebot.common.node.executive import Round, Seat
from mazebot.common.node.node import ClockNode, Inbox, Outbox
from mazebot.physics.config import STEPS_PER_SECOND, time_of_step_ns

START_TURNS = 3
"""Turns before time advances."""
OUTSIDE = ""
"""Whoever is no service."""
FIRST_TURN = {
    "worldgen": 2, "spawner": 2, "recorder": 2, CLOCK_SERVICE: START_TURNS, OUTSIDE: START_TURNS,
}  # fmt: skip
"""Before time advances, a world is asked for, then described and furnished, then built. All other
services have taken a step before that, and nobody commands before.
"""


class Feed:
    """Hands out the messages in time."""

    def __init__(self, messages: Iterator[Replayed], start_ns: int) -> None:
        self._messages = messages
        self._next = next(messages, None)
        self.start_ns = start_ns
        self.turns = 0
        """How many turns have begun."""
        self.last_ns = start_ns
        """The time of the last message handed out."""

    @property
    def next_ns(self) -> int | None:
        """The time of the next message; None: there is no more."""
        return None if self._next is None else self._next.time_ns

    def until(self, now_ns: int) -> Iterator[Replayed]:
        """The messages up to a time."""
        while self._next is not None and self._next.time_ns <= now_ns:
            message = self._next
            self.last_ns = message.time_ns
            self._next = next(self._messages, None)
            yield message


class ReplayedSeat:
    """Sends what a service has sent, at the time at which it did."""

    def __init__(self, name: str, feed: Feed, send: Callable[[Replayed], None]) -> None:
        self.name = name
        self.exit_code: int | None = None
        self.waiting: deque[Replayed] = deque()
        self._feed = feed
        self._send = send
        self._first_turn = FIRST_TURN.get(name, 1)

    def due(self, now_ns: int) -> bool:
        """See Seat."""
        if not self.waiting or self._feed.turns < self._first_turn:
            return False
        return self.waiting[0].time_ns <= now_ns

    def step(self, now_ns: int) -> None:
        """See Seat."""
        while self.waiting and self.waiting[0].time_ns <= now_ns:
            self._send(self.waiting.popleft())


class ReplayedClock(ClockNode):
    """Advances to the time of each message, and to each step of the simulation between them."""

    name = CLOCK_SERVICE
    _config = ServiceConfig()

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self.now_ns = feed.start_ns

    def next_step_ns(self) -> int | None:
        """See ClockNode. None before the services have begun, and after the last message."""
        if self._feed.turns <= START_TURNS:
            return None
        next_ns = self._feed.last_ns if self._feed.next_ns is None else self._feed.next_ns
        if next_ns <= self.now_ns:
            return None
        step = self.now_ns * STEPS_PER_SECOND // 1_000_000_000
        while (step_ns := time_of_step_ns(step)) <= self.now_ns:
            step += 1
        return min(next_ns, step_ns)

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Its seat sends what physics has sent."""


class ReplayedClockSeat(ReplayedSeat):
    """The seat of the recorded clock."""

    def __init__(self, clock: ReplayedClock, feed: Feed, send: Callable[[Replayed], None]) -> None:
        super().__init__(clock.name, feed, send)
        self._clock = clock

    def step(self, now_ns: int) -> None:
        """See Seat."""
        self._clock.now_ns = now_ns
        if self._feed.turns >= START_TURNS:
            super().step(now_ns)


class ReplayRound:
    """Turns of some real services, and of the recorded ones around them."""

    def __init__(
        self,
        feed: Feed,
        real: Mapping[str, Seat],
        send: Callable[[Replayed], None],
        keep: Callable[[Replayed], None],
        clock: ClockNode | None = None,
    ) -> None:
        """`real` are the seats of the real services, by name. `send` gets the messages of all
        others when it is their turn, `keep` those that were recorded of the real ones. `clock` is
        the node that makes time pass, if that is real.
        """
        self.feed = feed
        self._real = real
        self._keep = keep
        self._clock = ReplayedClock(feed) if clock is None else clock
        self._seats = {
            name: ReplayedSeat(name, feed, send) for name in SERVICES if name not in real
        }
        if isinstance(self._clock, ReplayedClock):
            self._seats[CLOCK_SERVICE] = ReplayedClockSeat(self._clock, feed, send)
        self._outside = ReplayedSeat(OUTSIDE, feed, send)
        """Of those that are no service: their messages are taken between two turns."""
        self._round = Round(self._clock)
        self._round.now_ns = feed.start_ns
        for seat in (*real.values(), *self._seats.values()):
            self._round.join(seat)

    @property
    def now_ns(self) -> int:
        """Simulation time."""
        return self._round.now_ns

    @property
    def ended(self) -> bool:
        """Whether the last message has had its turn."""
        return self.feed.next_ns is None and self.feed.turns > START_TURNS

    @property
    def next_ns(self) -> int | None:
        """To when the next turn advances; None: time stands still."""
        self.feed.turns += 1
        next_ns = self._clock.next_step_ns()
        self.feed.turns -= 1
        return next_ns

    def turn(self) -> bool:
        """Advance by one step, and give each seat that is due its turn; whether any stepped."""
        self.feed.turns += 1
        next_ns = self._clock.next_step_ns()
        for message in self.feed.until(self._round.now_ns if next_ns is None else next_ns):
            if message.service in self._real:
                self._keep(message)
            else:
                self._seats.get(message.service, self._outside).waiting.append(message)
        moved = self._round.turn()
        if self._outside.due(self._round.now_ns):
            self._outside.step(self._round.now_ns)
        return moved or self.feed.turns <= START_TURNS
