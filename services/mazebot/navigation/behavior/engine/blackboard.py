"""The blackboard: the values that the nodes of a behaviour tree share, by name."""

from __future__ import annotations

from collections.abc import Mapping


class Blackboard:
    """Values by key; the board of a SubTree passes its remapped keys on to the board above.

    A key that begins with `@` is one of the root board, as in BehaviorTree.CPP 4.
    """

    def __init__(
        self,
        above: Blackboard | None = None,
        remapped: Mapping[str, str] | None = None,
        autoremap: bool = False,
    ) -> None:
        """Create a root board, or the board of a SubTree.

        Args:
            above: board of the tree that contains the SubTree; None for the root.
            remapped: keys of the board above, by keys of this one.
            autoremap: pass every key on under its own name; names that begin with `_` stay here.
        """
        self._values: dict[str, object] = {}
        self._times_set: dict[str, int] = {}
        self._own: set[str] = set()
        self._above = above
        self._remapped = dict(remapped or {})
        self._autoremap = autoremap

    @property
    def root(self) -> Blackboard:
        """The board of the main tree."""
        return self if self._above is None else self._above.root

    def get(self, key: str) -> object | None:
        """The value of a key; None where there is none."""
        board, name = self._place(key)
        return board._values.get(name)

    def set(self, key: str, value: object) -> None:
        """Set the value of a key."""
        board, name = self._place(key)
        board._values[name] = value
        board._times_set[name] = board._times_set.get(name, 0) + 1

    def unset(self, key: str) -> None:
        """Remove a key; one that is not there is no error."""
        board, name = self._place(key)
        board._values.pop(name, None)

    def times_set(self, key: str) -> int:
        """How often a key was set, also to the value that it had; 0 where it is not there."""
        board, name = self._place(key)
        return board._times_set.get(name, 0) if name in board._values else 0

    def hold(self, key: str, value: object) -> None:
        """Keep a key on this board, also where keys are passed on under their own names."""
        self._own.add(key)
        self._values[key] = value
        self._times_set[key] = 1

    def __contains__(self, key: str) -> bool:
        board, name = self._place(key)
        return name in board._values

    def _place(self, key: str) -> tuple[Blackboard, str]:
        """The board that holds a key, and its name there."""
        if key.startswith("@"):
            return self.root, key[1:]
        if self._above is None or key in self._own:
            return self, key
        if key in self._remapped:
            return self._above._place(self._remapped[key])
        if self._autoremap and not key.startswith("_"):
            return self._above._place(key)
        return self, key
