"""`mazebot replay RUN`: publishes a recorded run on the bus, with its clock."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import zenoh

from mazebot.cli.parsing.options import print_json
from mazebot.cli.replay.comparison import Comparison
from mazebot.cli.replay.in_process import NOT_COMPARED
from mazebot.cli.replay.progress import shown
from mazebot.cli.replay.reading.recording import Recording
from mazebot.cli.replay.reading.replayed import CLOCK_SERVICE, Replayed, between, in_time
from mazebot.cli.replay.seats import FIRST_TURN, Feed
from mazebot.cli.replay.sender import MATCH_S, Listener, Sender, wait_until
from mazebot.cli.replay.through_service import print_comparison, summary_of
from mazebot.cli.replay.turns_on_bus import TurnsOnBus
from mazebot.cli.topics.topic import named_topic
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import alive
from mazebot.common.bus.pace import Pace
from mazebot.common.bus.session import BusUnavailableError, join
from mazebot.common.config import ConfigError
from mazebot.common.messages.keys import Keys
from mazebot.common.messages.topics import CLOCK, EDGE, SERVICES, Delivery
from mazebot.common.settings.load import load
from mazebot.common.stop_signals import INTERRUPTED

_SLEEP_S = 0.05
_FIRST_STEP_NS = 50_000_000
"""Simulation time within which every service has stepped that does so periodically."""
_FIRST_STEP_S = 5.0
_LAST_S = 1.0
"""Wall time within which the answers to the last messages come."""


@dataclass(frozen=True)
class Choice:
    """Which messages are published."""

    only: frozenset[str] = frozenset()
    """Topics; empty: all."""
    without: tuple[str, ...] = ()
    """Services whose messages are left out."""

    @classmethod
    def of(cls, only: Sequence[str], without: Sequence[str]) -> Choice:
        """From the user's words. Raises ConfigError where one is none of the table."""
        topics = {named_topic(name).name for some in only for name in some.split(",")}
        services = tuple(dict.fromkeys(name for some in without for name in some.split(",")))
        for service in services:
            if service == CLOCK_SERVICE:
                raise ConfigError(
                    f"--without: {service}: must be another service: the clock of this one "
                    "is replayed"
                )
            if service not in (*SERVICES, EDGE):
                known = ", ".join(name for name in (*SERVICES, EDGE) if name != CLOCK_SERVICE)
                raise ConfigError(f"--without: {service!r:.60}: must be one of {known}")
        return cls(frozenset(topics), services)

    @property
    def real(self) -> list[str]:
        """The services whose place running ones take."""
        return [service for service in self.without if service != EDGE]

    def check(self, compare: bool, lockstep: bool) -> None:
        """Raises ConfigError where an option needs a service that takes part."""
        for option, given in (("--compare", compare), ("--lockstep", lockstep)):
            if given and not self.real:
                raise ConfigError(f"{option}: must be given with --without")

    def wants(self, message: Replayed) -> bool:
        """Whether a message is published."""
        if message.service in self.without:
            return False
        topic = message.topic
        return not self.only or topic.name in self.only or topic is CLOCK


def publish_recording(
    recording: Recording,
    endpoint: str,
    choice: Choice,
    span_ns: tuple[int, int],
    speed: float,
    loop: bool,
    lockstep: bool,
    compare: bool,
    as_json: bool,
) -> int:
    """Publish a recording; return the exit code: with `compare` 1 if the services left out, which
    run on the bus, do something otherwise.

    Raises ConfigError where no router responds, a simulation runs there already, or a service that
    is replayed.
    """
    real = choice.real
    try:
        pace = "lockstep" if lockstep else "real_time"
        config = load(BusConfig, "bus", [], {"connect": endpoint, "pace": pace})
        session, _ = join(config)
    except BusUnavailableError as error:
        hint = "start one with `docker compose up router`, or python -m mazebot.router"
        raise ConfigError(f"replay: {error}: {hint}") from error
    comparison = Comparison()
    player = _Player(session, config.keys, recording, choice, real, comparison)
    code = 0
    try:
        with contextlib.closing(player):
            player.prepare(lockstep)
            _say(f"replaying {recording.name} on {endpoint} (Ctrl-C to stop)", as_json)
            while True:
                player.play(span_ns, speed, lockstep)
                if not loop:
                    break
    except KeyboardInterrupt:
        _say("interrupted", as_json)
        code = INTERRUPTED
    finally:
        session.close()  # type: ignore[no-untyped-call]
    for line in recording.lines_of_unfit():
        _say(line, as_json)
    _say(f"published {player.sent} messages", as_json)
    if not compare:
        return code
    if as_json:
        print_json({"recording": recording.name, "services": real, **summary_of(comparison)})
    else:
        print_comparison(comparison)
        if not lockstep and not comparison.is_same:
            _say(
                "in real time, messages arrive up to a step earlier or later; see --lockstep", False
            )
    return code or (0 if comparison.is_same else 1)


def _say(line: str, on_error: bool) -> None:
    """Print a line; where standard output is JSON, on standard error."""
    stream = sys.stderr if on_error else sys.stdout
    stream.write(line + "\n")
    stream.flush()


class _Player:
    """One replay on the bus."""

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        recording: Recording,
        choice: Choice,
        real: list[str],
        comparison: Comparison,
    ) -> None:
        self._session, self._keys = session, keys
        self._recording = recording
        self._choice = choice
        self._real = real
        self._comparison = comparison
        self._replayed = [
            service
            for service in SERVICES
            if service not in real and (service in recording.services or service == CLOCK_SERVICE)
        ]
        self._listener = Listener(session, real, keys)
        self._turns: TurnsOnBus | None = None
        self.sent = 0

    def prepare(self, lockstep: bool) -> None:
        """Wait for the services that take the place of recorded ones.

        Raises ConfigError where a service runs that is replayed.
        """
        running = alive(self._session, self._keys)
        if CLOCK_SERVICE in running:
            raise ConfigError(
                "replay: a simulation, or another replay, is running on this router: stop "
                "it first, or "
                "name another router (--connect)"
            )
        for service in self._replayed:
            if service in running:
                raise ConfigError(
                    f"replay: {service} is running on this router, and is in the recording: "
                    "stop it, or "
                    f"leave out its messages (--without {service})"
                )
        if lockstep:
            self._turns = TurnsOnBus(self._session, self._real, self._keys)
        reported: list[str] = []
        while missing := self._missing():
            if missing != reported:
                how = " in lockstep (MAZEBOT_BUS_PACE=lockstep)" if lockstep else ""
                _say(f"waiting for {', '.join(missing)}{how}", True)
                reported = missing
            time.sleep(_SLEEP_S)

    def _missing(self) -> list[str]:
        if self._turns is not None:
            return self._turns.missing()
        if not self._real:
            return []
        running = alive(self._session, self._keys)
        return [service for service in self._real if service not in running]

    def play(self, span_ns: tuple[int, int], speed: float, lockstep: bool) -> None:
        """Publish all messages once."""
        sender = Sender(self._session, self._replayed, lockstep, self._keys)
        self._listener.own.update(sender.sources.values())
        self._listener.newest_ns.clear()
        self._listener.counts.clear()
        messages = between(in_time(self._recording.read()), *span_ns)
        wanted = (one for one in messages if self._choice.wants(one) or self._keeps(one))
        feed = Feed(wanted, span_ns[0])
        try:
            with shown(*span_ns) as show:

                def watch(now_ns: int) -> None:
                    show(now_ns)
                    self._listener.hand_to(self._comparison)

                if self._turns is not None:
                    self._turns.play(feed, sender, speed, self._keep, watch, self._is_missing)
                else:
                    self._play_by_the_clock(feed, sender, speed, watch)
            if self._real:
                self._wait_for_last()
                self._comparison.end()
        finally:
            self.sent += sender.sent
            sender.close()

    def _keeps(self, message: Replayed) -> bool:
        return message.service in self._real and message.topic.name not in NOT_COMPARED

    def _keep(self, message: Replayed) -> None:
        if self._keeps(message) and not message.is_repeated:
            self._comparison.take_recorded(message.topic, message.time_ns, message.data)

    def _play_by_the_clock(
        self, feed: Feed, sender: Sender, speed: float, watch: Callable[[int], object]
    ) -> None:
        """Publish each message when it is due by the wall clock."""
        wait_until(lambda: sender.matched(self._real), MATCH_S)
        self._publish(sorted(feed.until(feed.start_ns), key=_at_the_start), sender)
        pace, settled = Pace(), not self._real
        while (next_ns := feed.next_ns) is not None:
            if not settled and feed.last_ns >= feed.start_ns + _FIRST_STEP_NS:
                # In its first step a service takes in the world, which may take it long.
                settled = True
                wait_until(lambda: self._have_stepped(feed.start_ns), _FIRST_STEP_S)
            wait_s = pace.wait_s(time.monotonic(), next_ns, speed)
            if wait_s > 0.0:
                time.sleep(min(wait_s, _SLEEP_S))
                continue
            self._publish(sorted(feed.until(next_ns), key=_in_turn), sender)
            watch(next_ns)

    def _have_stepped(self, start_ns: int) -> bool:
        """Whether each service has sent something in a step after the first instant."""
        stepped = [time_ns > start_ns for time_ns in list(self._listener.newest_ns.values())]
        return stepped.count(True) >= len(self._real)

    def _publish(self, messages: list[Replayed], sender: Sender) -> None:
        for message in messages:
            if message.service in self._real:
                self._keep(message)
            else:
                sender.send(message)

    def _wait_for_last(self) -> None:
        """Take in what the services have sent so far."""
        sent = self._turns.sent() if self._turns is not None else {}

        def all_received() -> bool:
            self._listener.hand_to(self._comparison)
            received = self._listener.counts
            return bool(sent) and all(
                received.get(topic, 0) >= count
                for topic, count in sent.items()
                if topic not in NOT_COMPARED
            )

        wait_until(all_received, MATCH_S if sent else _LAST_S)

    def _is_missing(self, time_ns: int) -> bool:
        """Whether the services lack a message of a time."""
        self._wait_for_last()
        return self._comparison.missing_at(time_ns)

    def close(self) -> None:
        """Hear no more."""
        self._listener.close()


def _at_the_start(message: Replayed) -> tuple[bool, int]:
    return message.topic.delivery is not Delivery.LATCHED, FIRST_TURN.get(message.service, 1)


def _in_turn(message: Replayed) -> tuple[bool, int]:
    """The order within an instant: that of the services, and the clock after all else."""
    service = message.service
    place = SERVICES.index(service) if service in SERVICES else len(SERVICES)
    return message.topic is CLOCK, place
