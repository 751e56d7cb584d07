"""A replay in lockstep: the services on the bus and the recorded ones take turns."""

from __future__ import annotations

import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import zenoh

from mazebot.cli.replay.reading.replayed import Replayed
from mazebot.cli.replay.seats import Feed, ReplayRound
from mazebot.cli.replay.sender import MATCH_S, Sender, wait_until
from mazebot.common.bus.lockstep import Ledger, LockstepError, RemoteSeat, Turn, TurnEnd
from mazebot.common.bus.pace import Pace
from mazebot.common.bus.seats import give_turn, watch_seats
from mazebot.common.config import ConfigError
from mazebot.common.messages.keys import Keys
from mazebot.common.messages.topics import SERVICES

TIMEOUT_S = 10.0
"""Wall time within which a service must end its turn."""


@contextmanager
def _in_one_line() -> Iterator[None]:
    try:
        yield
    except LockstepError as error:
        raise ConfigError(f"replay: {error}") from error


class TurnsOnBus:
    """Gives the turns to the services that take the place of recorded ones."""

    def __init__(self, session: zenoh.Session, services: Sequence[str], keys: Keys) -> None:
        self._session, self._keys = session, keys
        self._services = sorted(services, key=SERVICES.index)
        self._present: dict[str, str] = {}
        self._seats: dict[str, RemoteSeat] = {}
        self._executive = uuid.uuid4().hex
        self._before: dict[str, dict[str, int]] = {}
        self._sent: dict[str, dict[str, int]] = {}
        self._watch = watch_seats(session, self._on_seat, self._on_wake, keys)

    def _on_seat(self, service: str, source: str, is_there: bool) -> None:
        if is_there:
            self._present[service] = source
        elif self._present.get(service) == source:
            del self._present[service]

    def _on_wake(self, service: str, source: str) -> None:
        seat = self._seats.get(service)
        if seat is not None and seat.source == source:
            seat.woken = True

    def missing(self) -> list[str]:
        """The services that are not there, or not in lockstep."""
        return [service for service in self._services if service not in self._present]

    def sent(self) -> dict[str, int]:
        """Messages sent by the services in this replay so far, by topic."""
        counts: Counter[str] = Counter()
        for service, sent in self._sent.items():
            counts.update(sent)
            counts.subtract(self._before.get(service, {}))
        return dict(counts)

    @_in_one_line()
    def play(
        self,
        feed: Feed,
        sender: Sender,
        speed: float,
        keep: Callable[[Replayed], None],
        watch: Callable[[int], object],
        missing_at: Callable[[int], bool],
    ) -> None:
        """Replay all messages. Raises ConfigError where a service breaks the lockstep."""
        ledger = Ledger()
        self._sent.clear()
        self._before.clear()
        ledger.sources.update(sender.sources)
        self._seats = {
            name: RemoteSeat(
                name, self._present[name], self._executive, ledger, self._ask, TIMEOUT_S
            )
            for name in self._services
        }
        # All publishers and readers have to match before the first message is sent.
        seats = list(self._seats.values())

        def all_matched() -> bool:
            # Each is asked, so that each takes in what the others have.
            known = [seat.take_in(feed.start_ns) for seat in seats]
            return all(known) and sender.matched(self._services)

        if not wait_until(all_matched, MATCH_S):
            raise ConfigError("replay: lockstep: the router does not connect the services")

        def send(message: Replayed) -> None:
            sequence = sender.send(message)
            ledger.add(message.service, {message.topic.name: sequence + 1})

        turns, pace = ReplayRound(feed, self._seats, send, keep), Pace()
        while not turns.ended:
            next_ns = turns.next_ns
            if next_ns is not None:
                wait_s = pace.wait_s(time.monotonic(), next_ns, speed)
                if wait_s > 0.0:
                    time.sleep(wait_s)
            turns.turn()
            watch(turns.now_ns)
        if missing_at(feed.last_ns):
            # At the end of a run in one process each service takes one more step.
            for seat in seats:
                seat.step(feed.last_ns)

    def _ask(self, service: str, source: str, turn: Turn) -> TurnEnd | None:
        data = turn.model_dump_json().encode()
        reply = give_turn(self._session, service, source, data, TIMEOUT_S, self._keys)
        try:
            end = None if reply is None else TurnEnd.model_validate_json(reply)
        except ValueError:
            return None
        if end is not None:
            self._before.setdefault(service, end.sent)
            self._sent[service] = end.sent
        return end
