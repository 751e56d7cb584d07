"""Markers that hang elsewhere than the map says, by what the scans decide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array
from mazebot.localization.markers.marker_model import MarkerCandidate

_CONTRADICTIONS = 3
"""Of a marker, more than it has confirmed, after which it is not used."""

MarkerKey = tuple[float, ...]
"""The place in the map, which tells markers apart."""


def marker_key(map_from_marker: Array) -> MarkerKey:
    """The key of a marker by its pose in the map, (4, 4)."""
    return tuple(float(value) for value in map_from_marker[:3, 3])


@dataclass
class _Record:
    map_from_seen: Array
    """(4, 4) where the marker was seen when it last contradicted the pose."""
    count: int = 0
    is_misplaced: bool = False


class MarkerTrust:
    """Which markers are not used, because the scans fit the pose that they contradict."""

    def __init__(self) -> None:
        self._records: dict[MarkerKey, _Record] = {}

    @property
    def misplaced(self) -> dict[MarkerKey, Array]:
        """Markers that are not used, and where each was seen: map_from_marker, (4, 4)."""
        return {key: one.map_from_seen for key, one in self._records.items() if one.is_misplaced}

    def is_misplaced(self, key: MarkerKey) -> bool:
        """Whether a marker is not used."""
        return key in self._records and self._records[key].is_misplaced

    def seen_at(self, key: MarkerKey) -> Array | None:
        """(4, 4) where a marker was seen that has contradicted the pose; None: none has."""
        return self._records[key].map_from_seen if key in self._records else None

    def contradicted(
        self,
        key: MarkerKey,
        map_from_base: SE2,
        candidates: Sequence[MarkerCandidate],
        base_from_camera: Array,
    ) -> None:
        """Count a sighting from a pose that contradicts it and that the scans fit."""
        likeliest = max(candidates, key=lambda candidate: candidate[2])
        map_from_seen = portable.product(map_from_base.matrix(), base_from_camera, likeliest[0])
        record = self._records.setdefault(key, _Record(map_from_seen))
        record.map_from_seen = map_from_seen
        record.count = min(record.count + 1, _CONTRADICTIONS)
        record.is_misplaced |= record.count == _CONTRADICTIONS

    def confirmed(self, key: MarkerKey) -> None:
        """Count a sighting that shows the marker where the map says, and not where it was seen."""
        record = self._records[key]
        record.count -= 1
        if record.count <= 0:
            del self._records[key]
