"""The one service loop: configuration, log, bus, signals, liveliness, watchdog, diagnostics."""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NoReturn, TypeVar

from mazebot.common.bus.bus import Bus
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.handover import Handover
from mazebot.common.bus.lockstep import (
    HeldInbox,
    Lockstep,
    LockstepError,
    Participant,
    Turn,
    TurnEnd,
)
from mazebot.common.bus.pace import Pace
from mazebot.common.bus.seats import SeatOnBus, give_turn, watch_seats
from mazebot.common.bus.session import BusUnavailableError, key_of, open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.config import ConfigError, ServiceConfig, fail
from mazebot.common.files.key_file import Key
from mazebot.common.garbage import settled
from mazebot.common.messages import wire
from mazebot.common.messages.messages import ns_from_time
from mazebot.common.messages.topics import CLOCK, DIAGNOSTICS, PARAMETERS
from mazebot.common.node import log
from mazebot.common.node.diagnostics import SelfReport
from mazebot.common.node.node import ClockNode, Envelope, Inbox, Node, Outbox, Trigger
from mazebot.common.resident import give_back_freed
from mazebot.common.settings.load import load
from mazebot.common.stop_signals import on_stop

if TYPE_CHECKING:
    import zenoh

C = TypeVar("C", bound=ServiceConfig)

WATCHDOG_PERIOD_S = 1.0
WATCHDOG_TICKS = 20
"""After this many watchdog periods without an iteration the loop counts as hung: the process exits
and is restarted.
"""
LOG_AGAIN_S = 2.0
IDLE_S = 0.01
RETRY_S = 0.1
"""Between two looks for the router, as Zenoh itself makes: a key that is not there yet is found
missing at once.
"""
RESTING_NS = 33_000_000
"""Permitted delay of steps while nothing moves and no message arrives: each wake-up costs as much
as several steps.
"""
LOOK_S = 0.25
"""Period at which a service checks that its messages reach the readers that are alive."""
MUTE_S = 0.5
"""Time without a matching reader after which it reopens its session."""
LOST_S = 2.0
"""The same where there was no router either."""
MAX_MUTE_S = 60.0
"""Maximum of that time, which grows while reopening does not help."""
ENDING_S = 1.0
EXIT_WATCHDOG = 70
EXIT_OUT_OF_STEP = 75


def main(config_type: type[C], node_type: Callable[[C], Node]) -> NoReturn:
    """Run one service until it receives a stop signal or its work is done; the process exits with
    its exit code.
    """
    name: str = node_type.name  # type: ignore[attr-defined]
    stop = threading.Event()
    on_stop(lambda *_: stop.set())
    rosout = log.configure()
    try:
        config = load(config_type, name, sys.argv[1:])
        bus_config = load(BusConfig, "bus", [])
        node = node_type(config)
        node.prepare()
    except ConfigError as error:
        fail(str(error))
    # A collection of the objects made at startup takes as long as a control period.
    settled()
    code = 0
    try:
        code = _Service(node, bus_config, rosout, stop).run()
    except LockstepError as error:
        code = EXIT_OUT_OF_STEP
        sys.stderr.write(f"error: {error}\n")
    except ConfigError as error:
        code = 2
        sys.stderr.write(f"error: {error}\n{error.details}".rstrip() + "\n")
    finally:
        with contextlib.suppress(ConfigError):
            node.close()
    # Zenoh's threads may hang after the router is lost; there is nothing left to finish here.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


class Watchdog:
    """Detects a hung loop. It counts its own ticks, so that time in which the process is paused or
    the machine asleep does not count.
    """

    def __init__(self, patience_ticks: int = WATCHDOG_TICKS) -> None:
        self._patience_ticks = patience_ticks
        self._ticks = 0

    def feed(self) -> None:
        """The loop has completed an iteration."""
        self._ticks = 0

    def tick(self) -> bool:
        """One more period is over; return whether the loop has timed out."""
        self._ticks += 1
        return self._ticks > self._patience_ticks


class _Service:
    """One node on the bus."""

    def __init__(
        self, node: Node, bus_config: BusConfig, rosout: log.RosoutHandler, stop: threading.Event
    ) -> None:
        self._node = node
        self._bus_config = bus_config
        self._rosout = rosout
        self._stop = stop
        self._log = logging.getLogger(node.name)
        self._key: Key | None = None
        self._wake = threading.Event()
        self._now_ns = 0
        self._watchdog = Watchdog()
        self._handover: Handover | None = None
        self._trigger: Trigger | None = None
        self._logged_s = 0.0
        self._logged: str | None = ""
        """What it was said to wait for last; None: active; empty: neither was said yet."""
        self._diagnostics_s = 0.0
        self._report: SelfReport | None = None

    def run(self) -> int:
        threading.Thread(target=self._watch, name="watchdog", daemon=True).start()
        session = self._open()
        if session is None:
            return 0
        run = self._run_in_lockstep if self._bus_config.lockstep else self._run_by_the_clock
        run(session)
        return self._node.exit_code or 0

    def _open(self) -> zenoh.Session | None:
        while not self._stop.is_set():
            self._turn()
            try:
                self._key = key_of(self._bus_config)
                return open_session(self._bus_config)
            except BusUnavailableError as error:
                self._log_waiting(f"the bus: {error}")
                self._stop.wait(RETRY_S)
        return None

    def _begin(self, bus: Bus, outbox: Outbox) -> None:
        if isinstance(self._node, ClockNode):
            self._node.speed = self._bus_config.speed
        outbox.put(PARAMETERS, self._node.parameters())
        bus.announce()
        self._log.info("connected to %s", self._bus_config.connect)
        self._logged = ""

    def _still_wanted(self) -> bool:
        """Whether no stop signal was received; called whenever the service waits."""
        self._turn()
        return not self._stop.is_set()

    def _working(self) -> bool:
        """Whether to continue; called once per loop iteration."""
        return self._still_wanted() and self._node.exit_code is None

    def _rest(self, seconds: float) -> None:
        """Wait until woken, at most for this time."""
        self._wake.wait(seconds)
        self._wake.clear()

    def _run_by_the_clock(self, session: zenoh.Session) -> None:
        keys = self._bus_config.keys
        inbox = Inbox(self._node, self._wake.set)
        bus = Bus(session, self._node, inbox, keys)
        outbox = bus.outbox(self._node)
        self._report = SelfReport(self._node, inbox, outbox)
        self._rosout.outbox = outbox
        bus.watch_sources()
        if not isinstance(self._node, ClockNode):
            bus.keep(
                lambda session: subscribe(session, CLOCK, self._on_clock, keys, graph=bus.graph)
            )
        self._begin(bus, outbox)
        inbox.is_handed_over = False
        self._handover = Handover(bus, inbox, keys)
        self._handover.ask()
        done = threading.Event()
        threading.Thread(
            target=self._keep_matched, args=(bus, done), name="keep_matched", daemon=True
        ).start()
        try:
            if isinstance(self._node, ClockNode):
                self._make_time_pass(self._node, inbox, outbox)
            else:
                self._follow_time(inbox, outbox)
        finally:
            done.set()
            self._rosout.outbox = None
            bus.close()

    def _keep_matched(self, bus: Bus, done: threading.Event) -> None:
        """Reopen the session if messages reach no reader: after some reconnects Zenoh believes that
        a publisher has no reader, and only a new session makes it check again; and a router whose
        network was gone for seconds may refuse a session for ever that it takes for connected
        (MAX_LINKS). Reopen it as well
        where it has another key now: Zenoh would go on to sign in with the one from before.
        """
        wait_s, mute_s = MUTE_S, 0.0
        while not done.wait(LOOK_S):
            with contextlib.suppress(BusUnavailableError):
                key = key_of(self._bus_config)
                if key != self._key:
                    # Until the router knows the key as well, it is refused.
                    bus.move_to(open_session(self._bus_config))
                    self._key = key
                    self._log.info("session reopened: signed in with a new key")
                    continue
            if not bus.is_mute():
                wait_s, mute_s = MUTE_S, 0.0
                continue
            mute_s += LOOK_S
            if mute_s < wait_s:
                continue
            try:
                bus.move_to(open_session(self._bus_config))
                self._log.warning("session reopened: what was published reached nobody")
            except BusUnavailableError:
                # Without a router Zenoh goes on trying, too.
                wait_s, mute_s = max(wait_s, LOST_S), 0.0
                continue
            # If the fault is on the other side, this does not help: retry less often.
            wait_s, mute_s = min(wait_s * 4.0, MAX_MUTE_S), 0.0

    def _follow_time(self, inbox: Inbox, outbox: Outbox) -> None:
        self._trigger = trigger = Trigger(self._node)
        while self._working():
            self._rest(IDLE_S * 5)
            if trigger.due(self._now_ns, inbox):
                now_ns = outbox.now_ns = self._now_ns
                begun_s = time.perf_counter()
                self._node.step(now_ns, inbox, outbox)
                if self._report is not None:
                    self._report.stepped(now_ns, time.perf_counter() - begun_s)
            self._housekeeping(inbox, outbox)

    def _make_time_pass(self, node: ClockNode, inbox: Inbox, outbox: Outbox) -> None:
        """Step in pace with the wall clock, at the node's speed."""
        trigger, pace = Trigger(node), Pace()
        while self._working():
            next_ns = node.next_step_ns()
            if next_ns is None:
                pace.rest()
                wait_s = IDLE_S
            else:
                wait_s = pace.wait_s(time.monotonic(), next_ns, node.speed)
            if next_ns is None or wait_s > 0.0:
                if next_ns is not None and node.resting:
                    later_ns = next_ns + RESTING_NS
                    self._rest(pace.wait_s(time.monotonic(), later_ns, node.speed))
                else:
                    self._rest(min(wait_s, IDLE_S))
                if trigger.due(self._now_ns, inbox):
                    outbox.now_ns = self._now_ns
                    node.step(self._now_ns, inbox, outbox)
                    self._now_ns = node.now_ns
            else:
                outbox.now_ns = next_ns
                node.step(next_ns, inbox, outbox)
                self._now_ns = node.now_ns
            self._housekeeping(inbox, outbox)

    def _housekeeping(self, inbox: Inbox, outbox: Outbox) -> None:
        self._log_waiting(self._node.waiting_for())
        now_s = time.monotonic()
        if now_s - self._diagnostics_s >= 1.0:
            self._diagnostics_s = now_s
            if self._report is not None:
                outbox.put(DIAGNOSTICS, self._report.report(self._now_ns, now_s))
            if inbox.forget_strangers() or inbox.took_large:
                inbox.took_large = False
                give_back_freed()

    def _run_in_lockstep(self, session: zenoh.Session) -> None:
        """Logs outside of a turn go to the console only: they are not part of the run."""
        inbox = HeldInbox(self._node, self._wake.set, self._still_wanted)
        bus = Bus(session, self._node, inbox, self._bus_config.keys, lossless=True)
        outbox = bus.outbox(self._node)
        self._begin(bus, outbox)
        try:
            if isinstance(self._node, ClockNode):
                self._give_turns(self._node, session, bus, inbox, outbox)
            else:
                self._take_turns(session, bus, inbox, outbox)
        finally:
            bus.close()

    def _take_turns(
        self, session: zenoh.Session, bus: Bus, inbox: HeldInbox, outbox: Outbox
    ) -> None:
        turns: queue.SimpleQueue[tuple[bytes, Callable[[bytes], None]]] = queue.SimpleQueue()

        def on_turn(turn: bytes, respond: Callable[[bytes], None]) -> None:
            turns.put((turn, respond))
            self._wake.set()

        seat = SeatOnBus(session, bus, on_turn, self._bus_config.keys)
        participant = Participant(self._node, inbox, outbox, bus.matched, self._rosout)
        called = False
        while self._working():
            self._rest(IDLE_S * 5)
            while not turns.empty():
                data, respond = turns.get()
                try:
                    turn = Turn.model_validate_json(data)
                except ValueError:
                    self._log.warning("turn rejected: not a valid lockstep turn")
                    continue
                end = participant.take(turn)
                if end.error and self._stop.is_set():
                    # Leave without a reply: the error is only that waiting was interrupted.
                    return
                called = end.woken
                respond(end.model_dump_json().encode())
                self._turn()
            if not called and inbox.wakes():
                called = True
                seat.call()
            self._log_waiting(
                self._node.waiting_for() if participant.seated else "its first turn in lockstep"
            )

    def _give_turns(
        self,
        node: ClockNode,
        session: zenoh.Session,
        bus: Bus,
        inbox: HeldInbox,
        outbox: Outbox,
    ) -> None:
        keys, timeout_s = self._bus_config.keys, self._bus_config.lockstep_timeout_s
        notes: queue.SimpleQueue[tuple[str, str, bool | None]] = queue.SimpleQueue()

        def note(service: str, source: str, there: bool | None = None) -> None:
            notes.put((service, source, there))
            self._wake.set()

        def ask(service: str, source: str, turn: Turn) -> TurnEnd | None:
            data = turn.model_dump_json().encode()
            end = give_turn(session, service, source, data, timeout_s, keys, self._still_wanted)
            try:
                return None if end is None else TurnEnd.model_validate_json(end)
            except ValueError:
                return None

        lockstep = Lockstep(
            node, inbox, outbox, bus.source, ask, bus.matched, timeout_s, self._rosout
        )
        watch = watch_seats(session, note, note, keys)
        pace = Pace()
        try:
            while self._working():
                while not notes.empty():
                    lockstep.note(*notes.get())
                next_ns = node.next_step_ns() if lockstep.gathered else None
                if next_ns is None:
                    pace.rest()
                    wait_s = 0.0
                else:
                    # Without bringup's tour, run in real time.
                    speed = node.speed or (1.0 if "bringup" in lockstep.missing() else 0.0)
                    wait_s = pace.wait_s(time.monotonic(), next_ns, speed)
                moved = lockstep.turn(advance=wait_s == 0.0)
                if not moved:
                    self._rest(min(wait_s or IDLE_S, IDLE_S))
                awaited = [] if lockstep.gathered else lockstep.awaited()
                self._log_waiting(
                    f"lockstep with {', '.join(awaited)}" if awaited else node.waiting_for()
                )
        except LockstepError:
            # When all services are stopped together, some end sooner.
            if not self._stop.wait(ENDING_S):
                raise
        finally:
            del watch

    def _log_waiting(self, waiting_for: str | None) -> None:
        """Log what the service waits for, and again every two seconds while it waits."""
        now_s = time.monotonic()
        if waiting_for is None:
            if self._logged is not None:
                self._log.info("active")
        elif not self._logged or now_s - self._logged_s >= LOG_AGAIN_S:
            self._logged_s = now_s
            self._log.info("waiting for %s", waiting_for)
            if self._handover is not None:
                # The message may have been lost, or a service that keeps it may be back only now.
                self._handover.ask(of_the_living=True)
        else:
            return
        self._logged = waiting_for

    def _on_clock(self, payload: bytes, _: Envelope) -> None:
        try:
            self._now_ns = ns_from_time(wire.decode(CLOCK, payload).clock)
        except wire.WireError:
            return
        if self._trigger is not None and self._trigger.is_time(self._now_ns):
            self._wake.set()

    def _turn(self) -> None:
        self._watchdog.feed()

    def _watch(self) -> None:
        while True:
            time.sleep(WATCHDOG_PERIOD_S)
            if self._watchdog.tick():
                sys.stderr.write(f"error: {self._node.name}: the main loop is hung; exiting\n")
                sys.stderr.flush()
                os._exit(EXIT_WATCHDOG)
