"""The time of a bag's messages: that of their stamps, from 0."""

from __future__ import annotations

import functools
import statistics
import struct
from collections.abc import Callable, Sequence
from typing import Any, cast

from rosbags.interfaces import Nodetype

from mazebot.common.messages import messages as msg

_NEAR_NS = 5_000_000_000
_AHEAD_NS = 1_000_000_000
_SET_BACK_NS = 500_000_000
"""A clock that goes back by more was set back: a simulation that was reset."""
_SECOND_NS = 1_000_000_000
_TIME, _HEADER = "builtin_interfaces/msg/Time", "std_msgs/msg/Header"
_STAMP = struct.Struct("<iI")
_PREAMBLE_BYTES = 4


def stamp_of(type_name: str, data: bytes) -> int | None:
    """The stamp in ns of a message in little-endian CDR that begins with a header; None: it has
    none, or that is 0.
    """
    fields = msg.TYPESTORE.fielddefs[type_name][1]
    if not fields or fields[0][1] != (Nodetype.NAME, _HEADER) or data[1:2] != b"\x01":
        return None
    if len(data) < _PREAMBLE_BYTES + _STAMP.size:
        return None
    seconds, nanoseconds = _STAMP.unpack_from(data, _PREAMBLE_BYTES)
    return int(seconds * _SECOND_NS + nanoseconds) or None


class BagTime:
    """Time by the clock that stamps the messages.

    That is the bag's /clock where it has one, as from a simulator. Otherwise the clock of the
    machine that recorded it is taken to be ahead of the stamps by what it was ahead of the freshest
    of them, so that no message comes before its own time.
    """

    def __init__(
        self,
        logged: Sequence[tuple[int, int]],
        first_clock_ns: int | None,
        moves_ns: Sequence[int] = (),
    ) -> None:
        """`logged` are the times of logging and the stamps of the bag's first messages, in ns;
        `moves_ns`, by how much later the former are than the files say where the recorder's clock
        was set back, which may have been that of the stamps, too.
        """
        self._moves_ns = (0, *moves_ns)
        self._log_ns = 0
        self._clock_ns = first_clock_ns
        self._moved_ns = self._moved_before_ns = 0
        """By what the clock and the stamps go on after it was set back, and until then."""
        self.set_back = 0
        """How often the clock was set back so far."""
        self._lag_ns = 0
        delays = [log_ns - stamp_ns for log_ns, stamp_ns in logged]
        if delays:
            middle = statistics.median_low(delays)
            self._lag_ns = min(delay for delay in delays if abs(delay - middle) <= _NEAR_NS)
        self._begun_ns: int | None = None
        self._now_ns = 0

    def take_clock(self, clock_ns: int) -> None:
        """A message of the bag's clock. Where that was set back, time goes on from there."""
        if self._clock_ns is not None and clock_ns < self._clock_ns - _SET_BACK_NS:
            self._moved_before_ns = self._moved_ns
            self._moved_ns += self._clock_ns - clock_ns
            self.set_back += 1
        self._clock_ns = clock_ns

    def begin(self, log_ns: int) -> None:
        """The first message was logged then: time is 0 at the whole second before."""
        first_ns = log_ns - self._lag_ns if self._clock_ns is None else self._clock_ns
        self._begun_ns = first_ns // _SECOND_NS * _SECOND_NS

    def at(self, log_ns: int, stamp_ns: int | None) -> int:
        """The time of a message in ns, by the time of logging and its stamp; it never goes back."""
        assert self._begun_ns is not None
        self._log_ns = log_ns
        if self._clock_ns is None:
            now_ns = log_ns - self._lag_ns
        else:
            now_ns = self._clock_ns
            if stamp_ns is not None and now_ns < stamp_ns <= now_ns + _AHEAD_NS:
                # Simulators send their clock less often than their sensors' data.
                now_ns = stamp_ns
            now_ns += self._moved_ns
        self._now_ns = max(self._now_ns, now_ns - self._begun_ns)
        return self._now_ns

    def shift(self, message: Any, type_name: str) -> None:
        """Let the stamps in a message count from 0; those of before are 0."""
        _shift(message, type_name, self._from_begin)

    def _from_begin(self, stamp_ns: int) -> int:
        assert self._begun_ns is not None
        moved_ns = self._moved_ns
        if self._clock_ns is None:
            due_ns = self._log_ns - self._lag_ns
            moved_ns = min(self._moves_ns, key=lambda one: abs(stamp_ns + one - due_ns))
        elif stamp_ns > self._clock_ns + _AHEAD_NS:
            # From before the clock was set back.
            moved_ns = self._moved_before_ns
        return max(stamp_ns + moved_ns - self._begun_ns, 0)


def _shift(message: Any, type_name: str, shifted_ns: Callable[[int], int]) -> None:
    for name, kind, inner in _stamped(type_name):
        value = getattr(message, name)
        if inner == _TIME and kind == Nodetype.NAME:
            stamp_ns = msg.ns_from_time(value)
            if stamp_ns:
                setattr(message, name, msg.time_from_ns(shifted_ns(stamp_ns)))
        elif kind == Nodetype.NAME:
            _shift(value, inner, shifted_ns)
        else:
            for one in value:
                _shift(one, inner, shifted_ns)


@functools.cache
def _stamped(type_name: str) -> tuple[tuple[str, Nodetype, str], ...]:
    """The fields of a type in which there is a stamp: name, kind, and type of it or its items."""
    found = []
    for name, (kind, what) in msg.TYPESTORE.fielddefs[type_name][1]:
        is_list = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
        item_kind, item = cast("tuple[Nodetype, Any]", what[0] if is_list else (kind, what))
        if item_kind != Nodetype.NAME:
            continue
        inner = str(item)
        if (name == "stamp" and inner == _TIME) or (inner != _TIME and _stamped(inner)):
            found.append((name, kind, inner))
    return tuple(found)
