"""Writes XML elements of SDF, with numbers, materials and files in them."""

from __future__ import annotations

from collections.abc import Iterable

from lxml import etree

from mazebot.common.messages.documents import Rgba
from mazebot.worldgen.sdf.model import MAZEBOT_NAMESPACE

SHEET_THICKNESS_M = 0.001
"""Thickness in exports of surfaces without any: rooms' floors, the ceiling, a solid plane.
"""


def sdf_root(version: str) -> etree._Element:
    """`<sdf version="...">`, with the prefix `mazebot` declared."""
    return etree.Element("sdf", nsmap={"mazebot": MAZEBOT_NAMESPACE}, version=version)


def add(
    parent: etree._Element, tag: str, text: str | None = None, **attributes: str
) -> etree._Element:
    """Append a child, and return it."""
    child = etree.SubElement(parent, tag, **attributes)
    child.text = text
    return child


def annotate(element: etree._Element, **attributes: str) -> None:
    """Set `mazebot:` attributes."""
    for key, value in attributes.items():
        element.set(f"{{{MAZEBOT_NAMESPACE}}}{key}", value)


def numbers(values: Iterable[float]) -> str:
    """Numbers with as many digits as needed to read the same values back."""
    # Adding 0.0 turns -0.0 into 0.0.
    return " ".join(repr(float(value) + 0.0).removesuffix(".0") for value in values)


def add_look(visual: etree._Element, ambient: Rgba, diffuse: Rgba, texture: str = "") -> None:
    """Append a matte material; `texture` is the URI of an image."""
    material = add(visual, "material")
    add(material, "ambient", numbers(ambient))
    add(material, "diffuse", numbers(diffuse))
    add(material, "specular", "0 0 0 1")
    metal = add(add(material, "pbr"), "metal")
    if texture:
        add(metal, "albedo_map", texture)
    add(metal, "roughness", "1")
    add(metal, "metalness", "0")


def xml_bytes(root: etree._Element) -> bytes:
    """The XML file, with identical bytes for identical elements."""
    return bytes(etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True))
