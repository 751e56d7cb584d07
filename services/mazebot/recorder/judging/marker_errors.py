"""Which markers were detected in a run, and how far from their true positions."""

from __future__ import annotations

from collections import Counter

import numpy as np

from mazebot.common.maths.frames import BASE_FOOTPRINT_FRAME, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import MarkerEntity
from mazebot.common.messages.messages import ns_from_time
from mazebot.common.node.frame_tree import FrameTree
from mazebot.recorder.judging.error_summary import ErrorSummary
from mazebot.recorder.judging.pending import Pending
from mazebot.recorder.judging.poses.true_poses import TruePoses


class MarkerErrors:
    """Judges each detection by the robot's true pose at its stamp."""

    def __init__(self) -> None:
        self.entities: tuple[MarkerEntity, ...] = ()
        """The markers of the world."""
        self.static = FrameTree()
        """Fixed frames of the robot."""
        self.seen: Counter[str] = Counter()
        """Number of images in which each marker was detected, by its id."""
        self.error_m = ErrorSummary()
        self._detections = Pending[msg.Detection3DArray]()

    def add_static_transforms(self, transforms: msg.TFMessage) -> None:
        """Add fixed frames of the robot."""
        self.static.add(transforms)

    def add(self, detections: msg.Detection3DArray) -> list[str]:
        """Add the markers detected in one image; returns the ids that were not seen before."""
        ids = {d.results[0].hypothesis.class_id for d in detections.detections if d.results}
        new = sorted(ids - self.seen.keys())
        self.seen.update(sorted(ids))
        if detections.detections:
            self._detections.add(ns_from_time(detections.header.stamp), detections)
        return new

    def settle(self, truth: TruePoses, newest_ns: int) -> None:
        """Judge what waits, up to the newest true pose."""
        for stamp_ns, detections in self._detections.take_until(newest_ns):
            map_from_base = truth.map_from_base(stamp_ns)
            if map_from_base is not None:
                found = marker_errors_m(detections, map_from_base, self.static, self.entities)
                for _, error_m in found:
                    self.error_m.add(error_m)

    def seen_of_world(self) -> dict[str, int]:
        """In how many images each marker of the world was detected, by its id."""
        ids = dict.fromkeys(str(entity.marker_id) for entity in self.entities)
        return {marker_id: self.seen[marker_id] for marker_id in ids}


def marker_errors_m(
    detections: msg.Detection3DArray,
    map_from_base: Array,
    static: FrameTree,
    entities: tuple[MarkerEntity, ...],
) -> list[tuple[str, float]]:
    """Id of each marker detected in the camera's frame, and the distance (m) of its best solution
    to the nearest true position of a marker with that id.
    """
    base_from_camera = static.chain(BASE_FOOTPRINT_FRAME, detections.header.frame_id)
    if base_from_camera is None:
        return []
    map_from_camera = map_from_base @ base_from_camera
    errors = []
    for detection in detections.detections:
        true_m = [
            np.array(entity.position_m)
            for entity in entities
            if f"{entity.dictionary}:{entity.marker_id}" == detection.id
        ]
        if detection.results and true_m:
            p = detection.results[0].pose.pose.position
            seen_m = (map_from_camera @ np.array([p.x, p.y, p.z, 1.0]))[:3]
            distance_m = min(float(np.linalg.norm(seen_m - at_m)) for at_m in true_m)
            errors.append((detection.id, distance_m))
    return errors
