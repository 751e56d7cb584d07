"""Reads the <pose> of an element."""

from __future__ import annotations

import numpy as np
from lxml import etree

from mazebot.worldgen.sdf.reading import values
from mazebot.worldgen.sdf.reading.findings import Findings, Place
from mazebot.worldgen.sdf.reading.frame_graph import Pose
from mazebot.worldgen.sdf.reading.vocabulary import list_unread


def reference_in(place: Place, attribute: str, findings: Findings) -> str:
    """The name of a frame in an attribute; empty if there is none, or none is allowed."""
    name = place.element.get(attribute) or ""
    if name != "__root__":
        return name
    findings.error(
        "ATTRIBUTE_INVALID", place, f"{attribute} must not be `__root__`, which is reserved"
    )
    return ""


def pose_of(place: Place, findings: Findings) -> Pose:
    """The <pose> of an element; the identity if there is none, or it is invalid."""
    element: etree._Element | None = place.element.find("pose")
    if element is None:
        return still(place)
    at = place.at(element)
    list_unread(at, findings)
    reference = reference_in(at, "relative_to", findings)
    if element.get("frame") is not None:
        if place.source.version < (1, 7):
            reference = reference or element.get("frame") or ""
        else:
            findings.ignore("attribute frame of pose", at)
    degrees = False
    if element.get("degrees") is not None:
        try:
            degrees = values.truth(element.get("degrees"))
        except ValueError as error:
            findings.error("ATTRIBUTE_INVALID", at, f"degrees {error}")
    rotation = element.get("rotation_format") or "euler_rpy"
    if rotation not in ("euler_rpy", "quat_xyzw") or (degrees and rotation == "quat_xyzw"):
        findings.error(
            "ATTRIBUTE_INVALID",
            at,
            f"rotation_format `{rotation[:40]}` must be euler_rpy, or quat_xyzw without degrees",
        )
        return Pose(np.eye(4), reference, at)
    try:
        matrix = values.pose(element.text, degrees, rotation == "quat_xyzw")
    except ValueError as error:
        findings.error("ELEMENT_INVALID", at, f"<pose> {error}")
        matrix = np.eye(4)
    return Pose(matrix, reference, at)


def still(place: Place) -> Pose:
    """The identity."""
    return Pose(np.eye(4), "", place)
