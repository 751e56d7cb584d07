"""Reads a material from an OGRE script: the colours and the texture of its first pass."""

from __future__ import annotations

import re
from dataclasses import dataclass

from mazebot.common.messages.documents import Rgba
from mazebot.worldgen.sdf.reading import values

MAX_SCRIPT_BYTES = 1024 * 1024

_TOKEN = re.compile(r'"[^"\n]*"|[{}\n]|[^\s{}"]+')
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)


@dataclass(frozen=True)
class ScriptMaterial:
    """The properties of a material that are simulated."""

    ambient: Rgba | None
    diffuse: Rgba | None
    picture: str
    """File name of its first texture; empty: none."""


def material_in(script: str, name: str) -> ScriptMaterial | None:
    """The material of that name; None if the script has none.

    Format: OGRE manual, "Material Scripts". A material's parent (`material a : b`) is not followed.
    """
    lines = _lines(script)
    for index, line in enumerate(lines):
        if len(line) >= 2 and line[0] == "material" and line[1].strip('"') == name:
            return _read(lines[index + 1 :])
    return None


def _lines(script: str) -> list[list[str]]:
    """The words of each line; a brace is a line of its own."""
    lines: list[list[str]] = [[]]
    for token in _TOKEN.findall(_COMMENT.sub(" ", script)):
        if token == "\n":
            lines.append([])
        elif token in "{}":
            lines += [[token], []]
        else:
            lines[-1].append(token)
    return [line for line in lines if line]


def _read(lines: list[list[str]]) -> ScriptMaterial:
    depth = 0
    colours: dict[str, Rgba] = {}
    picture = ""
    for line in lines:
        if line[0] == "{":
            depth += 1
        elif line[0] == "}":
            depth -= 1
            if depth <= 0:
                break
        elif line[0] in ("ambient", "diffuse"):
            try:
                colours.setdefault(line[0], values.colour(" ".join(line[1:5])))
            except ValueError:
                continue
        elif line[0] == "texture" and len(line) > 1 and not picture:
            picture = line[1].strip('"')
    return ScriptMaterial(colours.get("ambient"), colours.get("diffuse"), picture)
