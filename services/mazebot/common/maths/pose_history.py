"""The poses of one frame in another over time."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import (
    Array,
    quaternion_from_rotation,
    rigid_matrix,
)

_NEW_RUN_NS = 1_000_000_000


class PoseHistory:
    """The newest poses `a_from_b`, at least `depth` of them, interpolated between their stamps."""

    def __init__(self, depth: int) -> None:
        self._depth = depth
        self._stamps_ns: list[int] = []
        self._poses: list[Array] = []

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest pose; None before the first."""
        return self._stamps_ns[-1] if self._stamps_ns else None

    def clear(self) -> None:
        """Forget every pose."""
        self._stamps_ns.clear()
        self._poses.clear()

    def add(self, stamp_ns: int, a_from_b: Array) -> bool:
        """Add a rigid (4, 4) pose; False where it is not newer than the newest one.

        A pose older by more than a second means that the simulation was reset: the history is
        cleared.
        """
        newest_ns = self.newest_ns
        if newest_ns is not None and stamp_ns <= newest_ns:
            if stamp_ns > newest_ns - _NEW_RUN_NS:
                return False
            self.clear()
        if len(self._stamps_ns) >= 2 * self._depth:
            del self._stamps_ns[: self._depth], self._poses[: self._depth]
        self._stamps_ns.append(stamp_ns)
        self._poses.append(a_from_b)
        return True

    def at(self, stamp_ns: int, hold_ns: int = 0) -> Array | None:
        """The (4, 4) pose at a stamp, linear between the two poses around it.

        Up to `hold_ns` before the oldest or after the newest pose, that pose; beyond that, None.
        """
        if not self._stamps_ns:
            return None
        after = bisect_left(self._stamps_ns, stamp_ns)
        if after == len(self._stamps_ns):
            return self._poses[-1] if stamp_ns - self._stamps_ns[-1] <= hold_ns else None
        if self._stamps_ns[after] == stamp_ns:
            return self._poses[after]
        if after == 0:
            return self._poses[0] if self._stamps_ns[0] - stamp_ns <= hold_ns else None
        t0, t1 = self._stamps_ns[after - 1], self._stamps_ns[after]
        return _between(self._poses[after - 1], self._poses[after], (stamp_ns - t0) / (t1 - t0))


def _between(first: Array, second: Array, fraction: float) -> Array:
    """The pose interpolated between two close ones."""
    q0 = np.array(quaternion_from_rotation(first[:3, :3]))
    q1 = np.array(quaternion_from_rotation(second[:3, :3]))
    if float(portable.product(q0, q1)) < 0.0:
        q1 = -q1
    q = (1.0 - fraction) * q0 + fraction * q1
    q /= portable.lengths(q)
    position = (1.0 - fraction) * first[:3, 3] + fraction * second[:3, 3]
    return rigid_matrix(*position.tolist(), *q.tolist())
