"""The <state> of a world that Gazebo Classic saved: where its models were then, and how large."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np

from mazebot.common.maths.frames import Array
from mazebot.worldgen.sdf.reading import values
from mazebot.worldgen.sdf.reading.findings import Findings, Place
from mazebot.worldgen.sdf.reading.frame_graph import Item, Pose, inverse
from mazebot.worldgen.sdf.reading.poses import pose_of

_NOT_APPLIED = ("insertions", "deletions")


def apply_state(world: Item, lights: Sequence[Place], findings: Findings) -> None:
    """Put models, their links and the world's own lights where the first <state> has them, and
    give models its scales.

    Gazebo Classic does so when it loads the file. All poses of a <state> are in the world. The
    state of something that the world does not have is left out, as there.
    """
    state = world.place.element.find("state")
    if state is None:
        return
    at = world.place.at(state)
    for tag in _NOT_APPLIED:
        element = state.find(tag)
        if element is not None and len(element):
            findings.ignore(f"{tag} of state", at.at(element), solid=True)
    _place_models(at, world, np.eye(4), findings)
    by_name = {place.element.get("name"): place.element for place in lights}
    for element in state.findall("light"):
        pose, light = element.find("pose"), by_name.get(element.get("name"))
        if pose is None or light is None:
            continue
        for before in light.findall("pose"):
            light.remove(before)
        light.append(copy.deepcopy(pose))


def _place_models(at: Place, scope: Item, world_from_scope: Array, findings: Findings) -> None:
    """Place the models of a <state>, or of a model's part of it, in their scope."""
    for element in at.element.findall("model"):
        item = scope.items.get(element.get("name") or "")
        if item is None or item.kind != "model":
            continue
        here = at.at(element)
        _scale(here, item, findings)
        world_from_model = _placed(here, item, world_from_scope, findings)
        if world_from_model is None:
            continue
        for link in element.findall("link"):
            found = item.items.get(link.get("name") or "")
            if found is not None and found.kind == "link":
                _placed(here.at(link), found, world_from_model, findings)
        _place_models(here, item, world_from_model, findings)


def _placed(at: Place, item: Item, world_from_scope: Array, findings: Findings) -> Array | None:
    """Place an element in its scope; its pose in the world, None if the state has none."""
    if at.element.find("pose") is None:
        return None
    pose = pose_of(at, findings)
    item.pose = Pose(inverse(world_from_scope) @ pose.matrix, "", pose.place)
    # The pose of a state is that of the model itself.
    item.placement_frame = ""
    return pose.matrix


def _scale(at: Place, item: Item, findings: Findings) -> None:
    element = at.element.find("scale")
    if element is None or not (element.text or "").strip():
        return
    try:
        x, y, z = values.positives(element.text, 3)
    except ValueError as error:
        findings.error("ELEMENT_INVALID", at.at(element), f"<scale> {error}")
    else:
        item.scale = x, y, z
