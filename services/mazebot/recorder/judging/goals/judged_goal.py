"""A goal that has ended, with its report."""

from __future__ import annotations

from dataclasses import dataclass

from mazebot.common.messages.documents import GoalReport

_NONE_SET: set[str] = set()
"""Shared: otherwise pydantic would keep the set of field names for each report."""


@dataclass(slots=True)
class JudgedGoal:
    """A goal that has ended, and the errors and contacts on the way. Small: a run may have
    thousands.
    """

    start_ns: int
    end_ns: int
    verdict: GoalReport
    """The last report."""
    errors: int = 0
    error_sum_m: float = 0.0
    contacts: int = 0
    _is_current: bool = False
    """Whether the verdict includes all errors and contacts."""

    def see_error(self, stamp_ns: int, error_m: float) -> None:
        """Count an estimate's error, if it was made on the way."""
        if self.start_ns <= stamp_ns <= self.end_ns:
            self.errors += 1
            self.error_sum_m += error_m
            self._is_current = False

    def see_contact(self, stamp_ns: int) -> None:
        """Count a contact, if it was on the way."""
        if self.start_ns <= stamp_ns <= self.end_ns:
            self.contacts += 1
            self._is_current = False

    def report(self) -> GoalReport:
        """The report with all errors and contacts so far."""
        if not self._is_current:
            mean_m = self.error_sum_m / self.errors if self.errors else None
            seen = {"localisation_error_m": mean_m, "contacts": self.contacts}
            self.verdict = GoalReport.model_construct(_NONE_SET, **dict(self.verdict) | seen)
            self._is_current = True
        return self.verdict
