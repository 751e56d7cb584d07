"""Where a bag's transforms have a lidar."""

from __future__ import annotations

import numpy as np

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import Array
from mazebot.common.messages.scan import Mount

BASES = ("base_footprint", "base_link")
_MOST_LINKS = 16
_LEVEL_COS = 0.94
"""Of 20 degrees: a lidar that is tilted by more does not see what is around it."""


def last_part(frame: str) -> str:
    """A frame's name without the robot's prefix: base_scan of robot1/base_scan."""
    return frame.rpartition("/")[2]


class FixedFrames:
    """Frames that do not move in others."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Array]] = {}

    def fix(self, child: str, parent: str, parent_from_child: Array) -> None:
        """A rigid (4, 4) transform; a newer one replaces it."""
        self._parents[child] = parent, parent_from_child

    def fix_first(self, child: str, parent: str, parent_from_child: Array) -> None:
        """The same, unless there is one already."""
        self._parents.setdefault(child, (parent, parent_from_child))

    def mount_of(self, frame: str) -> Mount | None:
        """How a lidar of this frame is mounted on base_footprint, or on base_link where that is in
        no other frame; None where no transforms lead there.

        Raises ConfigError with a phrase where it is neither level nor upside down.
        """
        base_from_frame, lidar = np.eye(4), frame
        for _ in range(_MOST_LINKS):
            name = last_part(frame)
            if name == BASES[0] or (name == BASES[1] and frame not in self._parents):
                break
            if frame not in self._parents:
                return None
            frame, parent_from_frame = self._parents[frame]
            base_from_frame = parent_from_frame @ base_from_frame
        else:
            return None
        upright = float(base_from_frame[2, 2])
        if abs(upright) < _LEVEL_COS:
            tilt_deg = float(np.degrees(np.arccos(np.clip(upright, -1.0, 1.0))))
            raise ConfigError(
                f"lidar {lidar!r:.60} is tilted by {tilt_deg:.0f} degrees: must be level, or "
                "upside down"
            )
        return Mount.of(base_from_frame)
