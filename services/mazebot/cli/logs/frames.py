"""Where a bag's transforms have its lidars and its base."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.cli.logs.log import BASES
from mazebot.cli.logs.stamps import Told
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import Array, inverse_matrix
from mazebot.common.messages.scan import Mount

_LEVEL_COS = 0.94
"""Of 20 degrees: a lidar that is tilted by more does not see what is around it."""
MOVES_M, MOVES_RAD = 0.02, math.radians(1.0)
"""A frame that moves by less is fixed."""


def last_part(frame: str) -> str:
    """A frame's name without the robot's prefix: base_scan of robot1/base_scan."""
    return frame.rpartition("/")[2]


class Motion(NamedTuple):
    """How a frame moves in its parent."""

    times_ns: NDArray[np.int64]
    """(n,), in any order."""
    parent_from_child: Array
    """(n, 4, 4)"""

    def at(self, times_ns: NDArray[np.int64]) -> Array:
        """(m, 4, 4) at (m,) times: between two, in a straight line; outside, as at the nearest."""
        order = np.argsort(self.times_ns, kind="stable")
        own_ns, matrices = self.times_ns[order], self.parent_from_child[order]
        after = np.clip(np.searchsorted(own_ns, times_ns, side="right"), 1, len(own_ns) - 1)
        between_ns = np.maximum(own_ns[after] - own_ns[after - 1], 1)
        share = np.clip((times_ns - own_ns[after - 1]) / between_ns, 0.0, 1.0)[:, None, None]
        found = matrices[after - 1] * (1.0 - share) + matrices[after] * share
        left, _, right = np.linalg.svd(found[:, :3, :3])
        found[:, :3, :3] = left @ right
        return np.asarray(found)


class FixedFrames:
    """Frames that do not move in others, or as arms and pan units do: each is where it was first,
    unless it is asked for at a time.
    """

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Array]] = {}
        self._moves: dict[str, list[Told]] = {}
        """Of the frames that are not of `fix`: all that differ from those before and after."""
        self._settled: frozenset[str] = frozenset()

    def settle(self) -> None:
        """Replace none of the present transforms any more."""
        self._settled = frozenset(self._parents)

    def fix(self, child: str, parent: str, parent_from_child: Array) -> None:
        """A rigid (4, 4) transform; a newer one replaces it."""
        if child not in self._settled:
            self._parents[child] = parent, parent_from_child
            self._moves.pop(child, None)

    def fix_first(self, child: str, parent: str, parent_from_child: Told) -> None:
        """The same, unless there is one already: then it has moved."""
        if child not in self._parents:
            self._parents[child] = parent, parent_from_child.says
            self._moves[child] = []
        moves = self._moves.get(child)
        if moves is None or child in self._settled or self._parents[child][0] != parent:
            return
        if len(moves) > 1 and all(
            np.array_equal(one.says, parent_from_child.says) for one in moves[-2:]
        ):
            moves.pop()
        moves.append(parent_from_child)

    def moving(self, frame: str, base: str) -> dict[str, Sequence[Told]]:
        """Of the frames from this one up to a base: those that move in their parents, and how.
        None where the base is not above.
        """
        above = self.above(frame)
        if base not in above:
            return {}
        there = {child: self._moves.get(child, []) for child in above[: above.index(base)]}
        return {child: moves for child, moves in there.items() if _is_moving(moves)}

    def mounts_at(
        self,
        frame: str,
        base: str,
        times_ns: NDArray[np.int64],
        motions: Mapping[str, Motion],
    ) -> list[Mount | None]:
        """The same as `mount_of` at (n,) times, where frames on the way to the base above move so;
        None at those when it is neither level nor upside down.

        Raises ConfigError with a phrase where it never is.
        """
        base_from_frame = np.broadcast_to(np.eye(4), (len(times_ns), 4, 4))
        for child in self.above(frame):
            if child == base:
                break
            motion, fixed = motions.get(child), self._parents[child][1]
            base_from_frame = (motion.at(times_ns) if motion else fixed) @ base_from_frame
        are_level = np.abs(base_from_frame[:, 2, 2]) >= _LEVEL_COS
        if not are_level.any():
            _level_mount(frame, base_from_frame[0])
        return [
            Mount.of(matrix) if is_level else None
            for matrix, is_level in zip(base_from_frame, are_level, strict=True)
        ]

    def above(self, frame: str) -> list[str]:
        """A frame and those that it is fixed in, the nearest first."""
        return [name for name, _ in self._above(frame)]

    def base_of(self, frame: str) -> str | None:
        """The base that a frame is fixed to: base_footprint, or base_link where that is in no
        base_footprint; None: neither.
        """
        above = self.above(frame)
        named = [[one for one in above if last_part(one) == base] for base in BASES]
        return next((ones[-1] for ones in named if ones), None)

    def transform(self, target: str, source: str) -> Array | None:
        """The rigid (4, 4) target_from_source; None where no transforms lead there."""
        above_target = dict(self._above(target))
        for common, common_from_source in self._above(source):
            if common in above_target:
                return inverse_matrix(above_target[common]) @ common_from_source
        return None

    def mount_of(self, frame: str, base: str) -> Mount | None:
        """How a lidar of this frame is mounted on a base; None where no transforms lead there.

        Raises ConfigError with a phrase where it is neither level nor upside down.
        """
        base_from_frame = self.transform(base, frame)
        if base_from_frame is None:
            return None
        return _level_mount(frame, base_from_frame)

    def _above(self, frame: str) -> Iterator[tuple[str, Array]]:
        """A frame and those that it is fixed in, the nearest first, each with the (4, 4) transform
        from the frame to it.
        """
        passed, above_from_frame = {frame}, np.eye(4)
        yield frame, above_from_frame
        while frame in self._parents:
            frame, parent_from_child = self._parents[frame]
            if frame in passed:
                return
            passed.add(frame)
            above_from_frame = parent_from_child @ above_from_frame
            yield frame, above_from_frame


def _level_mount(frame: str, base_from_frame: Array) -> Mount:
    upright = float(base_from_frame[2, 2])
    if abs(upright) < _LEVEL_COS:
        tilt_deg = float(np.degrees(np.arccos(np.clip(upright, -1.0, 1.0))))
        raise ConfigError(
            f"lidar {frame!r:.60} is tilted by {tilt_deg:.0f} degrees: must be level, or "
            "upside down"
        )
    return Mount.of(base_from_frame)


def _is_moving(moves: Sequence[Told]) -> bool:
    if len(moves) < 2:
        return False
    matrices = np.array([one.says for one in moves])
    moved = matrices - matrices[0]
    turned = np.linalg.norm(moved[:, :3, :3], axis=(1, 2)) / math.sqrt(2.0)
    return bool(
        (np.linalg.norm(moved[:, :3, 3], axis=1) > MOVES_M).any() or (turned > MOVES_RAD).any()
    )
