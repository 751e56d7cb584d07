"""The exception by which planning and control tell why they fail."""

from __future__ import annotations

from services.common.error_codes import ErrorCode


class NavigationError(Exception):
    """A failure with its code; its one line names the value and what would be right."""

    def __init__(self, code: ErrorCode, message: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
