"""The exception that planning and control raise when they fail."""

from __future__ import annotations

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode


class NavigationError(Exception):
    """A failure with its code; the one-line message names the value and what would be valid."""

    def __init__(
        self,
        code: ErrorCode,
        message: str,
        place_m: tuple[float, float] | None = None,
        nearest_free: SE2 | None = None,
    ) -> None:
        """A failure.

        Args:
            code: Nav2's number.
            message: one line of text.
            place_m: x and y in the map of what is in the way, where that is known.
            nearest_free: the pose nearest to an occupied goal where the robot can be.
        """
        super().__init__(message)
        self.code = code
        self.message = message
        self.place_m = place_m
        self.nearest_free = nearest_free
        self.for_good = False
        """Whether it is no use to wait and try again."""
