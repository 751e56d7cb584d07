"""The one service loop: configuration, log, bus, signals, liveliness, watchdog, diagnostics."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NoReturn, TypeVar

from services.common import log, wire
from services.common.bus import Bus, BusConfig, BusUnavailableError, open_session, subscribe
from services.common.config import ConfigError, ServiceConfig, fail, load
from services.common.diagnostics import diagnostics
from services.common.messages import ns_from_time
from services.common.node import ClockNode, Inbox, Node, Outbox, Trigger
from services.common.topics import CLOCK, DIAGNOSTICS, PARAMETERS

if TYPE_CHECKING:
    import zenoh

C = TypeVar("C", bound=ServiceConfig)

WATCHDOG_S = 20.0
"""A loop that has not turned for this long will never turn again: the process ends and is started
anew.
"""
SAY_AGAIN_S = 2.0
IDLE_S = 0.01
MAX_LAG_S = 0.1
"""A clock that is later than this gives up catching up: simulation time then runs slower than real
time.
"""
EXIT_WATCHDOG = 70


def main(config_type: type[C], node_type: Callable[[C], Node]) -> NoReturn:
    """Run one service until it is told to stop or its work is done; the process ends with its exit
    code.
    """
    name: str = node_type.name  # type: ignore[attr-defined]
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    try:
        config = load(config_type, name, sys.argv[1:])
        bus_config = load(BusConfig, "bus", [])
        rosout = log.configure()
        node = node_type(config)
    except ConfigError as error:
        fail(str(error))
    code = 0
    try:
        code = _Service(node, bus_config, rosout, stop).run()
    except ConfigError as error:
        code = 2
        sys.stderr.write(f"error: {error}\n")
    finally:
        with contextlib.suppress(ConfigError):
            node.close()
    # Zenoh's threads may outlive a lost router; nothing of ours is left to finish.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


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
        self._wake = threading.Event()
        self._now_ns = 0
        self._last_turn_s = time.monotonic()
        self._said_s = 0.0
        self._said: str | None = None
        self._diagnostics_s = 0.0

    def run(self) -> int:
        threading.Thread(target=self._watch, name="watchdog", daemon=True).start()
        session = self._open()
        if session is None:
            return 0
        inbox = Inbox(self._node, self._wake.set)
        bus = Bus(session, self._node, inbox, self._bus_config.prefix)
        outbox = bus.outbox(self._node)
        self._rosout.outbox = outbox
        clock = None
        if not isinstance(self._node, ClockNode):
            clock = subscribe(session, CLOCK, self._on_clock, self._bus_config.prefix)
        outbox.put(PARAMETERS, self._node.parameters())
        bus.announce()
        self._log.info("connected to %s", self._bus_config.connect)
        try:
            if isinstance(self._node, ClockNode):
                self._run_clock(self._node, inbox, outbox)
            else:
                self._run(inbox, outbox)
        finally:
            self._rosout.outbox = None
            del clock
            bus.close()
        return self._node.exit_code or 0

    def _open(self) -> zenoh.Session | None:
        while not self._stop.is_set():
            self._turn()
            try:
                return open_session(self._bus_config)
            except BusUnavailableError as error:
                self._say(f"the bus: {error}")
        return None

    def _run(self, inbox: Inbox, outbox: Outbox) -> None:
        trigger = Trigger(self._node)
        while not self._stop.is_set() and self._node.exit_code is None:
            self._wake.wait(IDLE_S * 5)
            self._wake.clear()
            if trigger.due(self._now_ns, inbox):
                outbox.now_ns = self._now_ns
                self._node.step(self._now_ns, inbox, outbox)
            self._housekeeping(inbox, outbox)

    def _run_clock(self, node: ClockNode, inbox: Inbox, outbox: Outbox) -> None:
        """Step in pace with the wall clock, at the node's speed."""
        start_s, start_ns, speed = time.monotonic(), 0, node.speed
        running = False
        trigger = Trigger(node)
        while not self._stop.is_set() and node.exit_code is None:
            next_ns = node.next_step_ns()
            if next_ns is None:
                running = False
                self._wake.wait(IDLE_S)
                self._wake.clear()
                if trigger.due(self._now_ns, inbox):
                    node.step(self._now_ns, inbox, outbox)
            else:
                if not running or speed != node.speed or next_ns < start_ns:
                    running, speed = True, node.speed
                    start_s, start_ns = time.monotonic(), next_ns
                if speed > 0.0:
                    due_s = start_s + (next_ns - start_ns) * 1e-9 / speed
                    lag_s = time.monotonic() - due_s
                    if lag_s > MAX_LAG_S:
                        start_s += lag_s
                    elif lag_s < 0.0:
                        time.sleep(-lag_s)
                self._now_ns = next_ns
                outbox.now_ns = next_ns
                node.step(next_ns, inbox, outbox)
            self._housekeeping(inbox, outbox)

    def _housekeeping(self, inbox: Inbox, outbox: Outbox) -> None:
        self._turn()
        self._say(self._node.waiting_for())
        now_s = time.monotonic()
        if now_s - self._diagnostics_s >= 1.0:
            self._diagnostics_s = now_s
            outbox.put(DIAGNOSTICS, diagnostics(self._now_ns, self._node, inbox, outbox))

    def _say(self, waiting_for: str | None) -> None:
        """Tell once what the service waits for, and again every two seconds while it does."""
        now_s = time.monotonic()
        if waiting_for is None:
            if self._said is not None:
                self._log.info("active")
        elif now_s - self._said_s >= SAY_AGAIN_S:
            self._said_s = now_s
            self._log.info("waiting for %s", waiting_for)
        else:
            return
        self._said = waiting_for

    def _on_clock(self, payload: bytes, _: bytes | None) -> None:
        try:
            self._now_ns = ns_from_time(wire.decode(CLOCK, payload).clock)
        except wire.WireError:
            return
        self._wake.set()

    def _turn(self) -> None:
        self._last_turn_s = time.monotonic()

    def _watch(self) -> None:
        while True:
            time.sleep(1.0)
            if time.monotonic() - self._last_turn_s > WATCHDOG_S:
                sys.stderr.write(f"error: {self._node.name}: the loop hangs; ending the process\n")
                sys.stderr.flush()
                os._exit(EXIT_WATCHDOG)
