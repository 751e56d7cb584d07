"""Colours, (r, g, b) of 0 to 255, with the same meaning in every drawing."""

from __future__ import annotations

TRUTH = (46, 204, 113)
ESTIMATE = (255, 140, 0)
PLAN = (52, 152, 255)
SCAN = (255, 60, 60)
MARKER = (255, 0, 200)
NAME = (255, 240, 120)
ROOM, LOCATION = (225, 225, 225), (130, 205, 255)
PARTICLE = (255, 200, 60)
SECOND = (150, 150, 150)
GOOD, BAD = (46, 204, 113), (231, 76, 60)

STATES: dict[str, tuple[int, int, int]] = {
    "active": GOOD,
    "controlling": GOOD,
    "planning": PLAN,
    "recovering": ESTIMATE,
    "idle": (120, 120, 120),
    "waiting": (120, 120, 120),
    "localized": TRUTH,
    "searching": ESTIMATE,
    "lost": BAD,
    "do_nothing": (120, 120, 120),
    "approach": ESTIMATE,
    "slowdown": ESTIMATE,
    "limit": ESTIMATE,
    "stop": BAD,
    "uninitialized": (120, 120, 120),
    "rejecting": BAD,
    "exploring": GOOD,
    "returning": PLAN,
    "complete": TRUTH,
    "paused": (120, 120, 120),
    "failed": BAD,
}
"""Colours of the states of services and of navigation."""
