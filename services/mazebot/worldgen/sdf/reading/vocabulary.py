"""The allowed children of each SDFormat element: those that are read, and those not simulated."""

from __future__ import annotations

import re

from mazebot.worldgen.sdf.model import MAZEBOT_NAMESPACE
from mazebot.worldgen.sdf.reading.findings import Findings, Place, local_name


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_ONCE: dict[str, frozenset[str]] = {
    "sdf": _words("world model include light"),
    "world": _words("scene state"),
    "model": _words("pose static"),
    "include": _words("uri name pose static placement_frame"),
    "link": _words("pose inertial"),
    "inertial": _words("mass density"),
    "collision": _words("pose geometry density"),
    "visual": _words("pose geometry material"),
    "material": _words("ambient diffuse script pbr"),
    "script": _words("name"),
    "pbr": _words("metal specular"),
    "metal": _words("albedo_map"),
    "specular": _words("albedo_map"),
    "geometry": _words(
        "box cylinder cone sphere capsule ellipsoid plane mesh empty image heightmap"
    ),
    "box": _words("size"),
    "cylinder": _words("radius length"),
    "cone": _words("radius length"),
    "capsule": _words("radius length"),
    "sphere": _words("radius"),
    "ellipsoid": _words("radii"),
    "plane": _words("normal size"),
    "polyline": _words("height"),
    "mesh": _words("uri scale submesh"),
    "submesh": _words("name center"),
    "joint": _words("parent child pose axis axis2"),
    "frame": _words("pose"),
    "light": _words("pose diffuse direction attenuation light_on"),
    "attenuation": _words("range constant linear quadratic"),
    "scene": _words("ambient background"),
}
"""Elements of which only the first is read."""

_REPEATED: dict[str, frozenset[str]] = {
    "world": _words("model include light frame joint"),
    "model": _words("model include link frame joint"),
    "link": _words("collision visual light"),
    "geometry": _words("polyline"),
    "polyline": _words("point"),
    "script": _words("uri"),
}

_NOT_SIMULATED: dict[str, frozenset[str]] = {
    "sdf": _words("actor"),
    "world": _words(
        "actor atmosphere audio gravity gui magnetic_field physics plugin population road "
        "spherical_coordinates wind"
    ),
    "model": _words("allow_auto_disable enable_wind gripper plugin self_collide"),
    "include": _words("plugin"),
    "link": _words(
        "audio_sink audio_source battery enable_wind gravity kinematic must_be_base_link "
        "particle_emitter plugin projector self_collide sensor velocity_decay"
    ),
    "inertial": _words("auto_inertia_params fluid_added_mass inertia pose"),
    "collision": _words("auto_inertia_params laser_retro max_contacts surface"),
    "visual": _words("cast_shadows laser_retro meta plugin transparency visibility_flags"),
    "material": _words(
        "double_sided emissive lighting render_order shader shininess specular texture"
    ),
    "metal": _words(
        "ambient_occlusion_map emissive_map environment_map light_map metalness metalness_map "
        "normal_map roughness roughness_map"
    ),
    "specular": _words(
        "ambient_occlusion_map emissive_map environment_map glossiness glossiness_map light_map "
        "normal_map specular_map"
    ),
    "mesh": _words("convex_decomposition"),
    "joint": _words(
        "gearbox_ratio gearbox_reference_body physics plugin screw_thread_pitch sensor thread_pitch"
    ),
    "light": _words("cast_shadows intensity plugin specular spot visualize"),
    "scene": _words("cast_shadows fog grid origin_visual shadows sky"),
}

_SOLID = _words("population")
"""Of those not simulated: what can be hit in Gazebo."""

_ATTRIBUTES: dict[str, frozenset[str]] = {
    "sdf": _words("version"),
    "world": _words("name"),
    "model": _words("name canonical_link placement_frame"),
    "include": _words("merge"),
    "link": _words("name"),
    "inertial": _words("auto"),
    "collision": _words("name"),
    "visual": _words("name"),
    "joint": _words("name type"),
    "frame": _words("name attached_to"),
    "light": _words("name type"),
    "pose": _words("relative_to frame degrees rotation_format"),
}

_DRIVE = re.compile("diffdrive|skidsteer|planarmove|ackermann|mecanumdrive|tricycledrive")
"""Letters in the names of Gazebo's plugins, of any generation, that drive a robot."""

NAMESPACES = (f"{{{MAZEBOT_NAMESPACE}}}", "mazebot:")
"""Prefixes of our own names, with a declared XML prefix and without."""


def own_attributes(place: Place) -> dict[str, str]:
    """An element's attributes in our own namespace, by local name."""
    found = {}
    for name, value in place.element.attrib.items():
        text = str(name)
        for start in NAMESPACES:
            if text.startswith(start):
                found[text.removeprefix(start)] = str(value)
    return found


def own_texts(place: Place) -> dict[str, str]:
    """The texts within <mazebot:world>, by name."""
    found = {}
    for element in place.element:
        if str(element.tag) not in [f"{start}world" for start in NAMESPACES]:
            continue
        for child in element:
            name = local_name(child.tag).removeprefix("mazebot:")
            found[name] = (child.text or "").strip()
    return found


def list_unread(place: Place, findings: Findings) -> None:
    """Report everything in an element that the reader does not read, except its children's."""
    element = place.element
    tag = local_name(element.tag)
    attributes = _ATTRIBUTES.get(tag, frozenset())
    for key in element.attrib:
        name = str(key)
        if name in attributes or name.startswith(NAMESPACES):
            continue
        findings.ignore(f"attribute {local_name(name)} of {tag}", place)
    once, repeated = _ONCE.get(tag, frozenset()), _REPEATED.get(tag, frozenset())
    not_simulated = _NOT_SIMULATED.get(tag, frozenset())
    seen = set()
    if tag in _ONCE and len(element):
        texts = [element.text, *(child.tail for child in element)]
        for text in texts[tag == "script" :]:
            if text and text.strip():
                findings.ignore(f"text `{text.strip()[:40]}` in {tag}", place)
    for child in element:
        name = str(child.tag)
        if name in repeated:
            continue
        if name in once:
            if name in seen:
                findings.ignore(f"second <{name}>", place.at(child))
            seen.add(name)
        elif name.startswith(NAMESPACES):
            if local_name(name).removeprefix("mazebot:") != "world" or tag != "world":
                findings.ignore(f"element {_prefixed(place.at(child))}", place.at(child))
        elif name.startswith("{") or ":" in name:
            findings.ignore(f"element {_prefixed(place.at(child))}", place.at(child))
        elif name in not_simulated:
            findings.ignore(described(place.at(child)), place.at(child), solid=name in _SOLID)
        else:
            findings.ignore(f"unknown element <{name}> in {tag}", place.at(child))


def described(place: Place) -> str:
    """A short description of an element: `plugin gz-sim-physics-system`."""
    element = place.element
    tag = local_name(element.tag)
    if tag == "plugin":
        return f"plugin {element.get('filename') or element.get('name') or ''}".strip()
    words = [tag]
    if element.get("name"):
        words.append(str(element.get("name")))
    if element.get("type"):
        words.append(f"({element.get('type')})")
    return " ".join(words)


def drive_of(model: Place) -> str:
    """The plugin in an element that drives a robot on the floor; empty if there is none."""
    for plugin in model.element.findall("plugin"):
        names = f"{plugin.get('filename') or ''} {plugin.get('name') or ''}"
        if _DRIVE.search(re.sub("[^a-z]", "", names.lower())):
            return described(model.at(plugin))
    return ""


def _prefixed(place: Place) -> str:
    prefix = place.element.prefix
    name = local_name(place.element.tag)
    return f"{prefix}:{name}" if prefix else name
