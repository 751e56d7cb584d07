"""Collects the findings of an import while it reads."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from lxml import etree

from mazebot.worldgen.sdf.model import Ignored, ImportReport, Included, Renamed, SdfError

MAX_ERRORS = 1000


@dataclass(frozen=True, eq=False)
class Source:
    """A file that was read."""

    file: Path
    """Resolved."""
    shown: str
    """As displayed."""
    expanded: bool
    """Whether it was expanded by xacro: lines are those of the expanded text."""
    root: etree._Element
    version: tuple[int, int]
    """Of the SDF specification."""


class Place(NamedTuple):
    """An element of a file."""

    source: Source
    element: etree._Element

    def at(self, element: etree._Element) -> Place:
        """Another element of the same file."""
        return Place(self.source, element)

    def __str__(self) -> str:
        line = f"{self.source.shown}:{self.element.sourceline}"
        path = path_of(self.element)
        return f"{line}{' (expanded)' if self.source.expanded else ''}: {path}"


def path_of(element: etree._Element) -> str:
    """Tags and names from the root's child to the element: `world default/model box`."""
    parts: list[str] = []
    for one in (element, *element.iterancestors()):
        if one.getparent() is None and parts:
            break
        name = " ".join((one.get("name") or "").split())
        tag = local_name(one.tag)
        parts.append(f"{tag} {name[:80]}" if name else tag)
    return "/".join(reversed(parts))


def local_name(tag: object) -> str:
    """A tag without its namespace."""
    return str(tag).rpartition("}")[2]


class Findings:
    """Errors, ignored and renamed elements, counts and files."""

    def __init__(self) -> None:
        self._errors: dict[tuple[str, str, str], SdfError] = {}
        self._missing: dict[tuple[str, str, str], SdfError] = {}
        self._unsolid: dict[str, None] = {}
        self._ignored: dict[tuple[str, str, bool], tuple[str, int]] = {}
        self._includes: list[Included] = []
        self._renamed: list[Renamed] = []
        self._materials: dict[str, None] = {}
        self.models = 0
        self.links = 0
        self._counts: dict[str, dict[str, int]] = {"collision": {}, "visual": {}}

    def error(self, kind: str, where: Place | str, message: str) -> None:
        """Record an error. Beyond MAX_ERRORS further ones are dropped."""
        _add(self._errors, kind, where, message)

    def missing(self, kind: str, where: Place | str, message: str) -> None:
        """Record a picture or mesh that a visual has to do without."""
        _add(self._missing, kind, where, message)

    def no_collision(self, link: str) -> None:
        """Record a link with visuals and no collision."""
        self._unsolid[link] = None

    def ignore(self, what: str, where: Place, solid: bool = False) -> None:
        """Record something not simulated, and whether something solid is missing or another for
        that. The same in one file is reported once, with its count.
        """
        key = (" ".join(what.split())[:200], where.source.shown, solid)
        first, count = self._ignored.get(key) or (str(where), 0)
        self._ignored[key] = first, count + 1

    def include(self, uri: str, name: str, file: str) -> None:
        """Record an included file."""
        self._includes.append(Included(uri=uri, name=name, file=file))

    def rename(self, kind: str, name: str, new_name: str, where: Place) -> None:
        """Record that an element was renamed."""
        self._renamed.append(
            Renamed(kind=kind, name=name[:200], new_name=new_name[:200], where=str(where))
        )

    def material(self, words: str) -> None:
        """Record the material of a visual."""
        self._materials[words] = None

    def shape(self, role: str, kind: str) -> None:
        """Record a collision or a visual, whether or not it can be simulated."""
        counts = self._counts[role]
        counts[kind] = counts.get(kind, 0) + 1

    def report(self, world: str) -> ImportReport:
        """The report of all findings."""
        return ImportReport(
            world=world,
            models=self.models,
            links=self.links,
            collisions=dict(sorted(self._counts["collision"].items())),
            visuals=dict(sorted(self._counts["visual"].items())),
            materials=tuple(self._materials),
            includes=tuple(self._includes),
            renamed=tuple(self._renamed),
            ignored=tuple(
                Ignored(
                    what=what, where=first + (f" (and {n - 1} more)" if n > 1 else ""), solid=solid
                )
                for (what, _, solid), (first, n) in self._ignored.items()
            ),
            errors=tuple(self._errors.values()),
            missing=tuple(self._missing.values()),
            unsolid=tuple(self._unsolid),
        )


def _add(
    found: dict[tuple[str, str, str], SdfError], kind: str, where: Place | str, message: str
) -> None:
    if len(found) < MAX_ERRORS:
        one = SdfError(kind=kind, where=str(where), message=" ".join(message.split())[:500])
        found[one.kind, one.where, one.message] = one
