"""How the markers of the world are drawn by their state: not seen yet, seen, detected now."""

from __future__ import annotations

import numpy as np
import rerun as rr

from mazebot.common.maths.frames import MAP_FRAME, rotation_from_quaternion
from mazebot.common.messages import messages as msg
from mazebot.recorder.drawing import palette
from mazebot.recorder.drawing.canvas import Canvas

PATH = "aruco/markers"
_BEFORE_M = 0.1
"""How far in front of its panel a marker's state is drawn, to be seen from above."""
_COLORS = {
    "not seen": palette.SECOND,
    "seen": palette.ESTIMATE,
    "detected": palette.GOOD,
}


def note_detections(canvas: Canvas, detections: msg.Detection3DArray) -> None:
    """Remember which markers are in view, and log each the first time. The time must be
    set.
    """
    ids = {detection.id.rpartition(":")[2] for detection in detections.detections}
    for marker_id in sorted(ids - canvas.markers_seen):
        canvas.event("marker", f"marker {marker_id} seen for the first time")
    canvas.markers_seen |= ids
    canvas.markers_in_view = ids
    draw_marker_states(canvas)


def draw_marker_states(canvas: Canvas) -> None:
    """A point in front of every marker, in the colour of its state. The time must be set."""
    markers = canvas.entities.markers if canvas.entities is not None else ()
    states = [
        "detected"
        if str(marker.marker_id) in canvas.markers_in_view
        else "seen"
        if str(marker.marker_id) in canvas.markers_seen
        else "not seen"
        for marker in markers
    ]
    places = [(marker.position_m, marker.orientation_xyzw) for marker in markers]
    if not canvas.changed(PATH, (states, places)):
        return
    points = [
        np.array(position) + _BEFORE_M * rotation_from_quaternion(*xyzw)[:, 2]
        for position, xyzw in places
    ]
    canvas.frame(PATH, MAP_FRAME, lambda: rr.Points3D.from_fields(radii=0.06, show_labels=True))
    canvas.recording.log(
        PATH,
        rr.Points3D(
            np.array(points, np.float32).reshape(-1, 3),
            colors=[_COLORS[state] for state in states],
            labels=[
                f"{marker.marker_id} {state}" for marker, state in zip(markers, states, strict=True)
            ],
        ),
    )
