"""Which actions of a tree run: one of each kind, as Nav2's action servers have it."""

from __future__ import annotations

from typing import Protocol


class RunningAction(Protocol):
    """An action that may be ended from outside its node."""

    def cancel(self) -> None:
        """End it: a node of the tree has canceled it."""
        ...

    def preempt(self) -> None:
        """End it: another one of its kind has begun."""
        ...


class RunningActions:
    """The actions that run, by the names of their kinds, such as `FollowPath`."""

    def __init__(self) -> None:
        self._running: dict[str, RunningAction] = {}

    def begin(self, kind: str, action: RunningAction) -> None:
        """Let an action run in place of the one of its kind that runs."""
        before = self._running.get(kind)
        self._running[kind] = action
        if before is not None and before is not action:
            before.preempt()

    def end(self, kind: str, action: RunningAction) -> bool:
        """Forget an action that has ended; whether it still ran."""
        runs = self._running.get(kind) is action
        if runs:
            del self._running[kind]
        return runs

    def cancel(self, kind: str) -> None:
        """Cancel what runs of a kind, if anything does."""
        action = self._running.pop(kind, None)
        if action is not None:
            action.cancel()
