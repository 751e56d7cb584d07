"""The status that every service publishes on /diagnostics."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import Topic, owned_by
from mazebot.common.node.node import ClockNode, Inbox, Node, Outbox

WAITING_KEY = "waiting_for"
REJECTED_KEY = "rejected "
LOST_KEY = "lost "
RATE_KEY = "rate_hz "
REAL_TIME_FACTOR_KEY = "real_time_factor"
STEP_TIME_KEY = "step_time_p99_ms"
MISSED_KEY = "missed_periods"
FIGURE_KEYS = frozenset(
    {
        *(REAL_TIME_FACTOR_KEY, STEP_TIME_KEY, MISSED_KEY, "state", "controller", "quality"),
        *("particles", "keyframes", "markers", "loops", "loops rejected"),
        *("seen", "frontiers", "driven"),
    }
)
"""Keys of values that change all the time."""

ENOUGH = 0.9
"""A rate below this share of the nominal rate counts as slow."""
_PERIODS = 20
"""Periods of a topic over which its rate is measured: one message more or less is within ENOUGH."""
_LEAST_WINDOW_NS = 1_000_000_000
_STEPS = 1000
"""Steps over which the step time is measured: 50 s of a controller at 20 Hz."""

_OK, _WARN = 0, 1

Nominal = float | Topic[object] | None


@dataclass
class _Window:
    """The start of the counting window of a topic, and its rate in the window before."""

    start_ns: int
    sent: int
    nominal: Nominal
    source_sent: int
    """Messages on the topic that `nominal` refers to, where it is a topic."""
    rate_hz: float | None = None
    kept: bool = True


class SelfReport:
    """Reports the state of one node: what it waits for, rejected messages by topic and reason, lost
    messages, the rate of its periodic topics per second of simulation time, and its own facts.

    Rates are computed from counts and simulation time: a repeated run gives the same rates.
    """

    def __init__(self, node: Node, inbox: Inbox, outbox: Outbox) -> None:
        self._node = node
        self._inbox = inbox
        self._outbox = outbox
        self._periodic = [topic for topic in owned_by(node.name) if topic.rate_hz is not None]
        self._windows: dict[str, _Window] = {}
        self._paced: tuple[int, float, int] | None = None
        self._step_times_s: deque[float] = deque(maxlen=_STEPS)
        self._stepped_ns: int | None = None
        self._missed = 0

    def stepped(self, now_ns: int, took_s: float) -> None:
        """The node has stepped at `now_ns`, in `took_s` of wall time: a step that takes too long,
        or comes too late, misses periods.
        """
        self._step_times_s.append(took_s)
        period_ns, last_ns = self._node.period_ns, self._stepped_ns
        if period_ns is not None and last_ns is not None and now_ns > last_ns:
            self._missed += max(0, now_ns // period_ns - last_ns // period_ns - 1)
        self._stepped_ns = now_ns

    def report(self, now_ns: int, wall_s: float | None = None) -> msg.DiagnosticArray:
        """The message for /diagnostics. `wall_s` is a steady clock's time, for the real time factor
        of the clock node; without it no factor is reported.
        """
        node = self._node
        waiting = node.waiting_for()
        values = [msg.KeyValue(key=WAITING_KEY, value=waiting or "")]
        faults = self._faults()
        rates, slow = self._rates(now_ns)
        paces, behind = self._pace(now_ns, wall_s)
        slow += behind
        paces += self._steps()
        facts = [msg.KeyValue(key=key, value=value) for key, value in node.facts().items()]
        slowness = f"slow: {', '.join(slow)}" if slow else ""
        warning = node.warning()
        trouble = "; ".join(filter(None, (warning, slowness)))
        status = msg.DiagnosticStatus(
            level=_WARN if waiting or faults or trouble else _OK,
            name=node.name,
            message=f"waiting for {waiting}" if waiting else trouble or "active",
            hardware_id="",
            values=[*values, *faults, *rates, *paces, *facts],
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
        """The current window of a topic; None before its first message."""
        sent = self._outbox.sent(topic)
        if not sent:
            return None
        source_sent = 0
        if isinstance(nominal, Topic):
            source_sent = self._inbox.counts[nominal.name].sent
        window = self._windows.get(topic.name)
        if window is None or now_ns < window.start_ns or nominal != window.nominal:
            # The nominal rate changed within the window: it does not apply to all of it.
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

    def _steps(self) -> list[msg.KeyValue]:
        """How long the newest steps took, and the periods missed since the start."""
        times_s = sorted(self._step_times_s)
        if not times_s:
            return []
        p99_ms = 1e3 * times_s[min(int(0.99 * len(times_s)), len(times_s) - 1)]
        return [
            msg.KeyValue(key=STEP_TIME_KEY, value=f"{p99_ms:.1f}"),
            msg.KeyValue(key=MISSED_KEY, value=str(self._missed)),
        ]

    def _pace(self, now_ns: int, wall_s: float | None) -> tuple[list[msg.KeyValue], list[str]]:
        """The real time factor since the last report, and a warning where it is too low."""
        if wall_s is None or not isinstance(self._node, ClockNode):
            return [], []
        before, self._paced = self._paced, (now_ns, wall_s, self._node.interventions)
        if self._node.paused or self._node.waiting_for():
            self._paced = None
        if before is None or self._paced is None or now_ns <= before[0] or wall_s <= before[1]:
            return [], []
        if self._node.interventions != before[2]:
            # The user paused, reset or changed the speed within the interval.
            return [], []
        factor = (now_ns - before[0]) * 1e-9 / (wall_s - before[1])
        value = msg.KeyValue(key=REAL_TIME_FACTOR_KEY, value=f"{factor:.3f}")
        late = 0.0 < factor < ENOUGH * self._node.speed
        return [value], [f"{REAL_TIME_FACTOR_KEY} {factor:.2f}"] if late else []
