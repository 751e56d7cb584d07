"""Where a bag's transforms have its lidars and its base."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mazebot.cli.logs.log import BASES
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import Array, inverse_matrix
from mazebot.common.messages.scan import Mount

_LEVEL_COS = 0.94
"""Of 20 degrees: a lidar that is tilted by more does not see what is around it."""


def last_part(frame: str) -> str:
    """A frame's name without the robot's prefix: base_scan of robot1/base_scan."""
    return frame.rpartition("/")[2]


class FixedFrames:
    """Frames that do not move in others."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Array]] = {}
        self._settled: frozenset[str] = frozenset()

    def settle(self) -> None:
        """Replace none of the present transforms any more."""
        self._settled = frozenset(self._parents)

    def fix(self, child: str, parent: str, parent_from_child: Array) -> None:
        """A rigid (4, 4) transform; a newer one replaces it."""
        if child not in self._settled:
            self._parents[child] = parent, parent_from_child

    def fix_first(self, child: str, parent: str, parent_from_child: Array) -> None:
        """The same, unless there is one already."""
        self._parents.setdefault(child, (parent, parent_from_child))

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
        upright = float(base_from_frame[2, 2])
        if abs(upright) < _LEVEL_COS:
            tilt_deg = float(np.degrees(np.arccos(np.clip(upright, -1.0, 1.0))))
            raise ConfigError(
                f"lidar {frame!r:.60} is tilted by {tilt_deg:.0f} degrees: must be level, or "
                "upside down"
            )
        return Mount.of(base_from_frame)

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
