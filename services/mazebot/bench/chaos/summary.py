"""What a sequence of faults comes to, by fault."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from statistics import median
from typing import NamedTuple

from mazebot.bench.chaos.faults import STOP_S, Fault
from mazebot.bench.chaos.trial import Trial


class Row(NamedTuple):
    """All trials of one fault."""

    fault: str
    times: int
    recovered: int
    contacts: int
    stop_s: float | None
    """The longest."""
    stop_m: float | None
    back_s: float | None
    """By the median, as the machine may be busy in one of them."""
    promised_s: float | None
    drives_s: float | None
    reached: int
    """Of the goals during which it happened."""

    def cells(self) -> tuple[str, ...]:
        """Of the table."""
        figures = (self.stop_s, self.stop_m, self.back_s, self.promised_s, self.drives_s)
        return (
            self.fault, str(self.times), str(self.recovered), str(self.contacts),
            *("" if one is None else f"{one:.2f}" for one in figures), str(self.reached),
        )  # fmt: skip


def rows_of(faults: Sequence[Fault], trials: Sequence[Trial]) -> list[Row]:
    """One row a fault, in the order of the faults."""
    rows = []
    for fault in faults:
        own = [trial for trial in trials if trial.fault == fault.name]
        if own:
            rows.append(
                Row(
                    fault.name,
                    len(own),
                    sum(trial.recovered for trial in own),
                    sum(trial.contacts for trial in own),
                    _most(trial.stop_s for trial in own),
                    _most(trial.stop_m for trial in own),
                    _middle(trial.back_s for trial in own),
                    fault.back_s,
                    _middle(trial.drives_s for trial in own),
                    sum(trial.goal == "reached" for trial in own),
                )
            )
    return rows


def met(row: Row) -> list[str]:
    """The promises that were not kept, in words."""
    failures = []
    if row.recovered < row.times:
        failures.append(f"{row.fault}: recovered {row.recovered} of {row.times}")
    if row.contacts:
        failures.append(f"{row.fault}: {row.contacts} contacts")
    if row.fault == "kill-navigation" and row.stop_s is not None and row.stop_s > STOP_S:
        failures.append(f"{row.fault}: at rest after {row.stop_s:.2f} s, not {STOP_S:g} s")
    if row.promised_s is not None and row.back_s is not None and row.back_s > row.promised_s:
        failures.append(f"{row.fault}: back after {row.back_s:.2f} s, not {row.promised_s:g} s")
    return failures


def _most(values: Iterable[float | None]) -> float | None:
    return max((one for one in values if one is not None), default=None)


def _middle(values: Iterable[float | None]) -> float | None:
    known = [one for one in values if one is not None]
    return median(known) if known else None
