"""The models that can be spawned by their names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mazebot.common.config import ConfigError
from mazebot.common.messages.action_documents import GetModelsReply
from mazebot.worldgen.models.model_entity import model_names, named_model, read_model
from mazebot.worldgen.models.model_reading import entity_in

MOST_MODELS = 100
MOST_BYTES = 50_000_000
"""Read for one answer: whoever asks waits no longer than some seconds."""

_Version = tuple[tuple[str, int, int], ...]
"""Names, sizes and times of the files of a model's folder."""


class SpawnableModels:
    """Those in some folders, and those that are shipped. Each is read once for each version of its
    files: that there is a folder does not say that its model can be spawned.
    """

    def __init__(self, roots: Sequence[Path]) -> None:
        self._roots = roots
        self._known: dict[str, tuple[_Version, bool]] = {}

    def answer(self) -> GetModelsReply:
        """Their names, sorted; an error while reading them takes longer."""
        names = model_names(self._roots)
        read = read_bytes = 0
        known: dict[str, tuple[_Version, bool]] = {}
        for number, name in enumerate(names):
            folder = named_model(name, self._roots)
            version = _version(folder)
            before = self._known.get(name)
            if before is None or before[0] != version:
                if read >= MOST_MODELS or read_bytes >= MOST_BYTES:
                    self._known |= known
                    done = f"{number} of {len(names)} models are read"
                    return GetModelsReply(error=f"{done}: ask again for all of them")
                before = version, self._can_be_spawned(folder)
                read += 1
                read_bytes += sum(size for _, size, _ in version)
            known[name] = before
        self._known = known
        return GetModelsReply(names=tuple(name for name, (_, good) in known.items() if good))

    def _can_be_spawned(self, folder: Path) -> bool:
        try:
            entity_in(read_model(folder, self._roots))
        except ConfigError:
            return False
        return True


def _version(folder: Path) -> _Version:
    found = []
    for path in sorted(folder.rglob("*")):
        try:
            facts = path.stat()
        except OSError:
            continue
        found.append((str(path.relative_to(folder)), facts.st_size, facts.st_mtime_ns))
    return tuple(found)
