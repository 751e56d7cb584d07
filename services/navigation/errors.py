"""The exception that planning and control raise when they fail."""

from __future__ import annotations

from services.common.error_codes import ErrorCode


class NavigationError(Exception):
    """A failure with its code; the one-line message names the value and what would be valid."""

    def __init__(self, code: ErrorCode, message: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
