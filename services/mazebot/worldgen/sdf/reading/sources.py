"""The files of an import: located, expanded, checked and limited, each read once."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from lxml import etree

from mazebot.worldgen.sdf.files.expansion import StoppedError, expanded, needs_expansion
from mazebot.worldgen.sdf.files.locate import LocateError, Locator
from mazebot.worldgen.sdf.files.xml_text import MAX_FILE_BYTES, UnreadableError, bytes_of, tree_of
from mazebot.worldgen.sdf.reading.findings import Source, local_name
from mazebot.worldgen.sdf.reading.urdf import sdf_of

FIRST_VERSION, LAST_VERSION = (1, 4), (1, 12)
MAX_ELEMENTS = 150_000
"""Elements and attributes in all files together, counted for each inclusion."""
MAX_ATTRIBUTES = 256
"""Of one element: each lookup searches all of them."""
MAX_INCLUDES = 3000
MAX_EXPANSIONS = 16
"""Of xacro files: each starts a process."""

_VERSION = re.compile(r"(\d{1,3})\.(\d{1,3})(\.\d{1,3})?", re.ASCII)


class SourceError(Exception):
    """A file cannot be used: the specification's kind of error, and a sentence."""

    def __init__(self, kind: str, message: str, line: int = 0) -> None:
        super().__init__(message)
        self.kind = kind
        self.line = line


class Sources:
    """Opens files by path or URI."""

    def __init__(self, asked: Path, roots: Sequence[Path], arguments: Mapping[str, str]) -> None:
        self._arguments = dict(arguments)
        try:
            file = asked.resolve()
        except (OSError, RuntimeError, ValueError):
            file = asked.absolute()
        self._file = file / "model.sdf" if _is_folder(file) else file
        self._asked = file
        self._roots = list(roots)
        self.locator = Locator(self._file, self._roots)
        self._opened: dict[Path, tuple[Source, int] | SourceError] = {}
        self._located: dict[tuple[str, Path], Path | SourceError] = {}
        self._bytes = 0
        self._elements = 0
        self._includes = 0
        self._expansions = 0

    def first(self) -> Source:
        """The requested file, or the newest one of the folder. Raises SourceError."""
        if _is_folder(self._asked):
            return self._open(self._newest(self._asked))
        return self._open(self._asked)

    def included(self, uri: str, folder: Path) -> Source:
        """The file of an <include> in a file of `folder`. Raises SourceError."""
        self._includes += 1
        if self._includes > MAX_INCLUDES:
            raise SourceError("URI_INVALID", f"more than {MAX_INCLUDES} <include>s")
        key = uri, folder
        if key not in self._located:
            self._located[key] = self._locate(uri, folder)
        found = self._located[key]
        if isinstance(found, SourceError):
            raise found
        return self._open(found)

    def _locate(self, uri: str, folder: Path) -> Path | SourceError:
        try:
            path = self.locator.model(uri, folder)
            return self._newest(path) if path.is_dir() else path
        except LocateError as error:
            return SourceError(error.kind, str(error))
        except SourceError as error:
            return error

    def shown(self, path: Path) -> str:
        """A path as displayed: relative to the file's folder, or to a root."""
        if path.is_relative_to(self._file.parent):
            return str(path.relative_to(self._file.parent))
        for root in self._roots:
            resolved = root.resolve()
            if path.is_relative_to(resolved):
                return str(path.relative_to(resolved.parent))
        return str(path)

    def _open(self, path: Path) -> Source:
        if path not in self._opened:
            try:
                source = self._read(path)
                self._opened[path] = source, _size(source)
            except SourceError as error:
                self._opened[path] = error
        found = self._opened[path]
        if isinstance(found, SourceError):
            raise found
        source, elements = found
        self._elements += elements
        if self._elements > MAX_ELEMENTS:
            raise SourceError(
                "FILE_READ", f"more than {MAX_ELEMENTS} elements and attributes in all files"
            )
        return source

    def _read(self, path: Path) -> Source:
        shown = self.shown(path)
        through_xacro = False
        try:
            data = bytes_of(path)
            self._bytes += len(data)
            if self._bytes > MAX_FILE_BYTES:
                raise UnreadableError(f"makes it more than {MAX_FILE_BYTES} bytes in all")
            if needs_expansion(path, data):
                through_xacro = True
                data = self._expanded(path)
            root = tree_of(data)
        except UnreadableError as error:
            raise SourceError("FILE_READ", f"{shown} {error}", error.line) from None
        if local_name(root.tag) == "robot":
            root = sdf_of(root)
        return Source(path, shown, through_xacro, root, _version(root, shown))

    def _expanded(self, path: Path) -> bytes:
        self._expansions += 1
        if self._expansions > MAX_EXPANSIONS:
            raise UnreadableError("is not expanded: too many xacro files, or one of them timed out")
        try:
            return expanded(path, self._roots, self._file, self._arguments)
        except StoppedError:
            self._expansions = MAX_EXPANSIONS
            raise

    def _newest(self, folder: Path) -> Path:
        """The file of a model's folder for the newest version of the specification."""
        shown = self.shown(folder)
        config = folder / "model.config"
        if not config.is_file():
            raise SourceError("URI_LOOKUP", f"{shown} must have a model.config")
        if not self.locator.may_read(config):
            raise SourceError("URI_INVALID", f"{shown}/model.config is outside the path")
        try:
            root = tree_of(bytes_of(config))
        except UnreadableError as error:
            raise SourceError("FILE_READ", f"{shown}/model.config {error}") from None
        best: tuple[tuple[int, int], Path] | None = None
        for element in root.findall("sdf"):
            match = _VERSION.fullmatch((element.get("version") or "1.4").strip())
            name = (element.text or "").strip()
            if match is None or not name or "\0" in name:
                continue
            version = int(match.group(1)), int(match.group(2))
            if version <= LAST_VERSION and (best is None or version > best[0]):
                best = version, folder / name
        urdf = (root.findtext("urdf") or "").strip()
        if best is None and urdf and "\0" not in urdf:
            best = FIRST_VERSION, folder / urdf
        if best is None:
            raise SourceError("ELEMENT_MISSING", f"{shown}/model.config must name an <sdf> file")
        if not best[1].is_file():
            raise SourceError(
                "URI_LOOKUP",
                f"{shown}/model.config names {best[1].name[:100]}, which does not exist",
            )
        if not self.locator.may_read(best[1]):
            raise SourceError("URI_INVALID", f"{shown}: the model's file is outside the path")
        return best[1].resolve()


def _size(source: Source) -> int:
    """Number of elements and attributes. Raises SourceError."""
    count = 0
    for element in source.root.iter():
        attributes = len(element.attrib)
        if attributes > MAX_ATTRIBUTES:
            raise SourceError(
                "FILE_READ",
                f"{source.shown}: <{local_name(element.tag)[:60]}> has {attributes} attributes, "
                f"must have at most {MAX_ATTRIBUTES}",
                element.sourceline or 0,
            )
        count += 1 + attributes
    return count


def _version(root: etree._Element, shown: str) -> tuple[int, int]:
    if local_name(root.tag) != "sdf":
        raise SourceError(
            "ELEMENT_MISSING",
            f"{shown} must have the root <sdf> or <robot>, has <{local_name(root.tag)[:60]}>",
            root.sourceline or 0,
        )
    text = root.get("version")
    if text is None:
        raise SourceError(
            "ATTRIBUTE_MISSING", f"{shown}: <sdf> must have a version", root.sourceline or 0
        )
    match = _VERSION.fullmatch(text.strip())
    version = (int(match.group(1)), int(match.group(2))) if match else (0, 0)
    if not FIRST_VERSION <= version <= LAST_VERSION:
        raise SourceError(
            "ATTRIBUTE_INVALID",
            f"{shown}: version `{text[:20]}` of <sdf> must be 1.4 to 1.12",
            root.sourceline or 0,
        )
    return version


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False
