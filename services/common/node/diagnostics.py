"""What every service says of itself on /diagnostics."""

from __future__ import annotations

from dataclasses import dataclass

from services.common.node import messages as msg
from services.common.node.node import ClockNode, Inbox, Node, Outbox
from services.common.node.topics import Topic, owned_by

WAITING_KEY = "waiting_for"
REJECTED_KEY = "rejected "
LOST_KEY = "lost "
RATE_KEY = "rate_hz "
REAL_TIME_FACTOR_KEY = "real_time_factor"

ENOUGH = 0.9
"""Share of a nominal rate below which it is not kept."""
_PERIODS = 20
"""Of a topic over which its rate is taken, so that one message more or less is within ENOUGH."""
_LEAST_WINDOW_NS = 1_000_000_000

_OK, _WARN = 0, 1

Nominal = float | Topic[object] | None


@dataclass
class _Window:
    """From when a topic's messages are counted, and what its rate was before."""

    start_ns: int
    sent: int
    nominal: Nominal
    source_sent: int
    """Messages on the topic whose rate is the nominal one, where that is a topic's."""
    rate_hz: float | None = None
    kept: bool = True


class SelfReport:
    """Tells the state of one node: what it waits for, what it rejected by topic and reason, what
    never came, and how often it puts out what is periodic, per second of simulation.

    Rates are taken from counts and simulation time: where a run repeats, they repeat.
    """

    def __init__(self, node: Node, inbox: Inbox, outbox: Outbox) -> None:
        self._node = node
        self._inbox = inbox
        self._outbox = outbox
        self._periodic = [topic for topic in owned_by(node.name) if topic.rate_hz is not None]
        self._windows: dict[str, _Window] = {}
        self._paced: tuple[int, float, int] | None = None

    def report(self, now_ns: int, wall_s: float | None = None) -> msg.DiagnosticArray:
        """The message for /diagnostics. `wall_s` is a steady clock's time, for the real time factor
        of the node that makes time pass; without it none is told.
        """
        node = self._node
        waiting = node.waiting_for()
        values = [msg.KeyValue(key=WAITING_KEY, value=waiting or "")]
        faults = self._faults()
        rates, slow = self._rates(now_ns)
        paces, behind = self._pace(now_ns, wall_s)
        slow += behind
        trouble = f"slow: {', '.join(slow)}" if slow else "active"
        status = msg.DiagnosticStatus(
            level=_WARN if waiting or faults or slow else _OK,
            name=node.name,
            message=f"waiting for {waiting}" if waiting else trouble,
            hardware_id="",
            values=[*values, *faults, *rates, *paces],
        )
        return msg.DiagnosticArray(header=msg.header(now_ns, ""), status=[status])

    def _faults(self) -> list[msg.KeyValue]:
        values = []
        for topic, counts in self._inbox.counts.items():
            for reason, count in counts.rejected.items():
                key = f"{REJECTED_KEY}{topic}: {reason}"
                values.append(msg.KeyValue(key=key, value=str(count)))
            if counts.lost:
                values.append(msg.KeyValue(key=f"{LOST_KEY}{topic}", value=str(counts.lost)))
        for (topic, reason), count in self._outbox.rejected.items():
            key = f"{REJECTED_KEY}{topic}: own, {reason}"
            values.append(msg.KeyValue(key=key, value=str(count)))
        return values

    def _rates(self, now_ns: int) -> tuple[list[msg.KeyValue], list[str]]:
        """The rate of each periodic topic as far as it is known, and the topics that are slow."""
        values, slow = [], []
        nominal_rates = self._node.nominal_rates_hz()
        for topic in self._periodic:
            window = self._measured(topic, now_ns, nominal_rates.get(topic.name))
            if window is None or window.rate_hz is None:
                continue
            values.append(
                msg.KeyValue(key=f"{RATE_KEY}{topic.name}", value=f"{window.rate_hz:.2f}")
            )
            if not window.kept:
                slow.append(f"{topic.name} at {window.rate_hz:.2f} Hz")
        return values, slow

    def _measured(self, topic: Topic[object], now_ns: int, nominal: Nominal) -> _Window | None:
        """The window of a topic, brought up to now; None before its first message."""
        sent = self._outbox.sent(topic)
        if not sent:
            return None
        source_sent = 0
        if isinstance(nominal, Topic):
            source_sent = self._inbox.counts[nominal.name].sent
        window = self._windows.get(topic.name)
        if window is None or now_ns < window.start_ns or nominal != window.nominal:
            # What was promised only in part of a window was not kept in all of it.
            window = _Window(now_ns, sent, nominal, source_sent)
            self._windows[topic.name] = window
        elapsed_ns = now_ns - window.start_ns
        rate_hz = nominal if isinstance(nominal, float) else topic.rate_hz or 1.0
        if elapsed_ns >= max(_LEAST_WINDOW_NS, _PERIODS * 1e9 / rate_hz):
            expected = elapsed_ns * 1e-9 * rate_hz
            if isinstance(nominal, Topic):
                expected = float(source_sent - window.source_sent)
            count = sent - window.sent
            window = _Window(
                now_ns, sent, nominal, source_sent, count * 1e9 / elapsed_ns,
                nominal is None or count >= ENOUGH * expected,
            )  # fmt: skip
            self._windows[topic.name] = window
        return window

    def _pace(self, now_ns: int, wall_s: float | None) -> tuple[list[msg.KeyValue], list[str]]:
        """The real time factor since the last report, and what to say where time is behind."""
        if wall_s is None or not isinstance(self._node, ClockNode):
            return [], []
        before, self._paced = self._paced, (now_ns, wall_s, self._node.interventions)
        if self._node.paused or self._node.waiting_for():
            self._paced = None
        if before is None or self._paced is None or now_ns <= before[0] or wall_s <= before[1]:
            return [], []
        if self._node.interventions != before[2]:
            # Time passed in another way for a part of what has gone by.
            return [], []
        factor = (now_ns - before[0]) * 1e-9 / (wall_s - before[1])
        value = msg.KeyValue(key=REAL_TIME_FACTOR_KEY, value=f"{factor:.3f}")
        late = 0.0 < factor < ENOUGH * self._node.speed
        return [value], [f"{REAL_TIME_FACTOR_KEY} {factor:.2f}"] if late else []
