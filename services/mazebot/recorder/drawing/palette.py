"""Colours, (r, g, b) of 0 to 255, with the same meaning in every drawing."""

from __future__ import annotations

import colorsys
import zlib

from mazebot.common.messages.topics import SERVICES

TRUTH = (46, 204, 113)
ESTIMATE = (255, 140, 0)
PLAN = (52, 152, 255)
SCAN = (255, 60, 60)
DEPTH_SCAN = (255, 120, 200)
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
    "held": ESTIMATE,
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

TREE_STATES: dict[str, tuple[int, int, int]] = {
    "no action": (70, 70, 70),
    "ComputePathToPose": PLAN,
    "ComputePathThroughPoses": PLAN,
    "FollowPath": GOOD,
    "ClearEntireCostmap": (241, 196, 15),
    "Spin": ESTIMATE,
    "Wait": ESTIMATE,
    "BackUp": ESTIMATE,
    "DriveOnHeading": ESTIMATE,
}
"""Colours of what a behaviour tree does; others get one from the viewer."""


def of_name(name: str) -> tuple[int, int, int]:
    """A light colour that a name always gets, for what has no colour of its own: those of the
    services differ as much as possible.
    """
    known = name in SERVICES
    hue = SERVICES.index(name) / len(SERVICES) if known else zlib.crc32(name.encode()) % 360 / 360.0
    red, green, blue = colorsys.hls_to_rgb(hue, 0.62, 0.75)
    return round(255 * red), round(255 * green), round(255 * blue)
