"""Converts a URDF robot to an equivalent SDF model, element by element, keeping line numbers."""

from __future__ import annotations

from collections.abc import Iterator

from lxml import etree

from mazebot.worldgen.sdf.reading.findings import local_name

VERSION = "1.9"
_WEIGHTLESS_KG = "1e-6"
"""Of a link without an inertial, or of mass 0, if others have one: negligible."""
_ATTRIBUTES = {
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "sphere": ("radius",),
}


def sdf_of(robot: etree._Element) -> etree._Element:
    """The root <sdf> with one model.

    A child link's pose is relative to its parent's, by its joint. A robot without any mass, or of
    mass 0 as PyBullet has it, is static, and so is one whose root is the link `world`. Elements
    without a meaning here (transmissions, extensions) are kept as they are, to be listed by the
    reader.
    """
    root = _like(robot, "sdf", version=VERSION)
    model = _add(root, robot, "model", name=robot.get("name") or "")
    links = [one for one in robot if _tag(one) == "link"]
    joints = [one for one in robot if _tag(one) == "joint"]
    looks = {one.get("name"): one for one in robot if _tag(one) == "material"}
    has_mass = any(link.find("inertial") is not None and not _is_massless(link) for link in links)
    if not has_mass:
        _add(model, robot, "static").text = "true"
    joint_to = {_end(joint, "child"): joint for joint in joints}
    for link in links:
        if link.get("name") == "world":
            continue
        converted = _add(model, link, "link", name=link.get("name"))
        joint = joint_to.get(link.get("name") or "")
        if joint is not None:
            pose = _pose(converted, joint)
            parent = _end(joint, "parent")
            if parent != "world":
                pose.set("relative_to", parent)
        _inertial(converted, link, has_mass)
        for role in ("visual", "collision"):
            # Names of shapes are optional in URDF; in SDF they are required and unique.
            taken: set[str] = set()
            for number, shape in enumerate(link.findall(role)):
                name = shape.get("name") or role
                name = f"{name}_{number}" if name in taken else name
                taken.add(name)
                _shape(converted, shape, role, name, looks)
        _keep(converted, link, ("inertial", "visual", "collision"))
    for joint, name in _named(joints, links):
        _joint(model, joint, name)
    _keep(model, robot, ("link", "joint", "material"))
    return root


def _named(
    joints: list[etree._Element], links: list[etree._Element]
) -> Iterator[tuple[etree._Element, str | None]]:
    """Joints with their names: that of a link gets `_joint` added, since in SDF it is taken."""
    of_links = {link.get("name") for link in links}
    taken = of_links | {joint.get("name") for joint in joints}
    for joint in joints:
        name = joint.get("name")
        if name in of_links:
            while name in taken:
                name = f"{name}_joint"
            taken.add(name)
        yield joint, name


def _joint(model: etree._Element, joint: etree._Element, name: str | None) -> None:
    converted = _add(model, joint, "joint", name=name, type=joint.get("type"))
    for role in ("parent", "child"):
        end = joint.find(role)
        if end is not None:
            _add(converted, end, role).text = end.get("link")


def _inertial(link: etree._Element, urdf: etree._Element, has_mass: bool) -> None:
    inertial = urdf.find("inertial")
    if inertial is None and not has_mass:
        return
    at = urdf if inertial is None else inertial
    converted = _add(link, at, "inertial")
    mass = None if inertial is None else inertial.find("mass")
    text: str | None = "" if mass is None else mass.get("value")
    if inertial is None or (has_mass and _is_massless(urdf)):
        text = _WEIGHTLESS_KG
    _add(converted, at if mass is None else mass, "mass").text = text


def _is_massless(link: etree._Element) -> bool:
    """Whether a link has a mass of 0."""
    mass = link.find("inertial/mass")
    try:
        return mass is not None and float(mass.get("value") or "") == 0.0
    except ValueError:
        return False


def _shape(
    link: etree._Element,
    urdf: etree._Element,
    role: str,
    name: str,
    looks: dict[str | None, etree._Element],
) -> None:
    converted = _add(link, urdf, role, name=name)
    _pose(converted, urdf)
    geometry = urdf.find("geometry")
    if geometry is not None:
        kinds = _add(converted, geometry, "geometry")
        for one in geometry:
            _geometry(kinds, one)
    material = urdf.find("material")
    if material is not None:
        if not len(material):
            material = looks.get(material.get("name"), material)
        _material(converted, material)


def _geometry(geometry: etree._Element, urdf: etree._Element) -> None:
    kind = _tag(urdf)
    shape = _add(geometry, urdf, kind)
    if kind == "mesh":
        _add(shape, urdf, "uri").text = urdf.get("filename")
        if urdf.get("scale") is not None:
            _add(shape, urdf, "scale").text = urdf.get("scale")
    for attribute in _ATTRIBUTES.get(kind, ()):
        if urdf.get(attribute) is not None:
            _add(shape, urdf, attribute).text = urdf.get(attribute)


def _material(visual: etree._Element, urdf: etree._Element) -> None:
    colour, texture = urdf.find("color"), urdf.find("texture")
    if colour is None and texture is None:
        return
    material = _add(visual, urdf, "material")
    if colour is not None:
        for look in ("ambient", "diffuse"):
            _add(material, colour, look).text = colour.get("rgba")
    if texture is not None:
        metal = _add(_add(material, texture, "pbr"), texture, "metal")
        _add(metal, texture, "albedo_map").text = texture.get("filename")


def _pose(element: etree._Element, urdf: etree._Element) -> etree._Element:
    """Add the <origin> of an element as its <pose>."""
    origin = urdf.find("origin")
    at = urdf if origin is None else origin
    pose = _add(element, at, "pose")
    pose.text = f"{at.get('xyz') or '0 0 0'} {at.get('rpy') or '0 0 0'}"
    return pose


def _keep(converted: etree._Element, urdf: etree._Element, read: tuple[str, ...]) -> None:
    """Add the elements that are not read."""
    for one in urdf:
        if _tag(one) not in read:
            _add(converted, one, _tag(one), name=one.get("name"))


def _end(joint: etree._Element, role: str) -> str:
    end = joint.find(role)
    return "" if end is None else end.get("link") or ""


def _tag(element: etree._Element) -> str:
    return local_name(element.tag)


def _like(urdf: etree._Element, tag: str, **attributes: str | None) -> etree._Element:
    return _marked(etree.Element(tag), urdf, attributes)


def _add(
    parent: etree._Element, urdf: etree._Element, tag: str, **attributes: str | None
) -> etree._Element:
    return _marked(etree.SubElement(parent, tag), urdf, attributes)


def _marked(
    element: etree._Element, urdf: etree._Element, attributes: dict[str, str | None]
) -> etree._Element:
    for name, value in attributes.items():
        if value is not None:
            element.set(name, value)
    element.sourceline = urdf.sourceline
    return element
