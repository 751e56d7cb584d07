"""Resolves URIs to files, and checks that these may be read.

Files are read from the folder of the requested file, from the roots, and from the `models` folders
beside and above that file; nowhere else, and not through links that lead elsewhere.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import unquote

from mazebot.common.files.root import ROOT

SHIPPED = ROOT / "models"
_GAZEBOS_OWN = ("ground_plane", "sun")
"""Gazebo's own models that are shipped."""
_GAZEBOS_OWNER = "openrobotics"
"""Owner of these on Fuel"""
MAX_PARENTS = 4
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*):")
_HINT = "put its folder on the path (`--path DIR` or GZ_SIM_RESOURCE_PATH)"
_FUEL_MODEL = re.compile(
    r"//(?P<host>[^/]+)/(?:\d+\.\d+/)?(?P<owner>[^/]+)/(?:fuel/)?models/(?P<name>[^/]+)"
    r"(?:/(?P<version>\d+|tip))?(?:/files/(?P<inner>.+?))?/?$"
)
_PACKAGE_NAME = re.compile(rb"<name>\s*([\w.-]+)\s*</name>")


class LocateError(Exception):
    """No file is found: the specification's kind of error, and a sentence."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class Locator:
    """Finds files by URI."""

    def __init__(self, file: Path, roots: Sequence[Path]) -> None:
        folder = file.parent
        parents = [folder, *list(folder.parents)[:MAX_PARENTS]]
        self._packages = [p for p in parents if (p / "package.xml").is_file()]
        implied = [folder]
        implied += [p / "models" for p in parents if (p / "models").is_dir()]
        if (folder / "model.config").is_file():
            implied.append(folder.parent)
        self._given = [*roots, *implied]
        # Gazebo provides a sun and a ground plane; a user's own model takes precedence.
        self._roots = [*self._given, SHIPPED]
        self._areas = [_resolved(p) for p in (*self._roots, *self._packages)]

    def model(self, uri: str, folder: Path) -> Path:
        """The file or folder of an <include> in a file of `folder`. Raises LocateError."""
        return self._found(uri, folder, folders=True)

    def file(self, uri: str, folder: Path) -> Path:
        """The file of a URI in a file of `folder`. Raises LocateError."""
        return self._found(uri, folder, folders=False)

    def package(self, name: str) -> Path | None:
        """The folder of a package, as `$(find name)` means it."""
        if "/" in name or name in ("", ".", ".."):
            return None
        found = dict.fromkeys(self._package_folders(name))
        return next((p for p in found if self.may_read(p)), None)

    def may_read(self, path: Path) -> bool:
        """Whether a path, with all links resolved, is where files may be read."""
        try:
            resolved = path.resolve()
        except (OSError, RuntimeError, ValueError):
            return False
        return any(resolved.is_relative_to(area) for area in self._areas)

    def _found(self, uri: str, folder: Path, folders: bool) -> Path:
        shown = uri if len(uri) <= 100 else uri[:97] + "..."
        if not uri or len(uri) > 1000 or not uri.isprintable():
            raise LocateError("URI_INVALID", f"`{shown!a}` must be a URI")
        found: list[Path] = []
        refused = False
        candidates = dict.fromkeys(self._candidates(uri, folder))
        for path in candidates:
            try:
                if not (path.is_file() or (folders and path.is_dir())):
                    continue
            except (OSError, ValueError):
                continue
            if self.may_read(path):
                found.append(path.resolve())
            else:
                refused = True
        different = list(dict.fromkeys(found))
        if len(different) > 1 and uri.startswith("package:"):
            raise LocateError("URI_LOOKUP", f"`{shown}` is in {len(different)} folders of the path")
        if different:
            return different[0]
        if refused:
            raise LocateError(
                "URI_INVALID", f"`{shown}` lies outside the file's folder and the path: {_HINT}"
            )
        raise LocateError("URI_LOOKUP", f"`{shown}` does not exist: {_HINT}")

    def _candidates(self, uri: str, folder: Path) -> Iterator[Path]:
        scheme = _SCHEME.match(uri)
        if scheme is None:
            yield from self._plain(uri, folder)
            return
        name = scheme.group(1).lower()
        rest = uri[scheme.end() :]
        if name in ("http", "https", "fuel", "ign", "gz"):
            fetched = list(self._fetched(rest))
            if not fetched:
                raise LocateError(
                    "URI_INVALID",
                    f"`{uri[:100]}` is remote, and nothing is downloaded: download it, and {_HINT}",
                )
            yield from fetched
            return
        if name not in ("model", "package", "file") or not rest.startswith("//"):
            raise LocateError(
                "URI_INVALID", f"`{uri[:100]}` must begin with model://, package:// or file://"
            )
        rest = rest[2:]
        if not rest:
            raise LocateError("URI_INVALID", f"`{uri[:100]}` must name a file")
        if name == "file":
            # Some worlds contain `file://model://...`, which Gazebo accepts.
            inner_scheme = _SCHEME.match(rest)
            if inner_scheme is not None and inner_scheme.group(1).lower() in ("model", "package"):
                yield from self._candidates(rest, folder)
            else:
                yield from self._plain(rest, folder)
            return
        first, _, inner = rest.lstrip("/").partition("/")
        if name == "package":
            for package in self._package_folders(first):
                yield package / inner if inner else package
            return
        for root in self._roots:
            yield root / first / inner if inner else root / first
        yield from _shipped(unquote(first), inner)
        # A root may be the model's own folder, and a model may refer to itself by name.
        for root in (folder, *folder.parents[:MAX_PARENTS], *self._roots):
            if root.name == first:
                yield root / inner if inner else root

    def _fetched(self, uri: str) -> Iterator[Path]:
        """Locations of a Fuel model in the roots: in a folder of its name, as written on Fuel or as
        a file name (`ground_plane`), or in the layout of Gazebo's cache
        (`HOST/OWNER/models/NAME/VERSION`, in lower case).
        """
        model = _FUEL_MODEL.search(unquote(uri))
        if model is None or ".." in model.groups():
            return
        small = model["name"].lower()
        for root in self._given:
            for name in dict.fromkeys((model["name"], small, small.replace(" ", "_"))):
                if (root / name).is_dir():
                    yield root / name / (model["inner"] or "")
            kept = root / model["host"] / model["owner"].lower() / "models" / small
            for version in _versions(kept, model["version"]):
                yield version / (model["inner"] or "")
        if model["owner"].lower() == _GAZEBOS_OWNER:
            yield from _shipped(model["name"], model["inner"] or "")

    def _plain(self, path: str, folder: Path) -> Iterator[Path]:
        if path.startswith("/"):
            yield Path(path)
            return
        yield folder / path
        for root in self._roots:
            yield root / path

    def _package_folders(self, name: str) -> Iterator[Path]:
        for root in (*self._roots, *self._packages):
            if root.name == name or _package_name(root) == name:
                yield root
        for root in self._roots:
            if (root / name).is_dir():
                yield root / name


def _shipped(name: str, inner: str) -> Iterator[Path]:
    """Shipped copies of Gazebo's own models, for any spelling of the name (`Ground Plane`)."""
    folder = name.strip().lower().replace(" ", "_")
    if folder in _GAZEBOS_OWN:
        yield SHIPPED / folder / inner


def _versions(folder: Path, wanted: str | None) -> list[Path]:
    """Folders of a cached model's versions: the wanted one, else all, the newest first."""
    try:
        numbered = [one for one in folder.iterdir() if re.fullmatch(r"\d{1,9}", one.name, re.ASCII)]
    except (OSError, ValueError):
        return []
    if wanted is not None and wanted != "tip":
        return [one for one in numbered if one.name == wanted]
    return sorted(numbered, key=lambda one: int(one.name), reverse=True)


def _package_name(folder: Path) -> str:
    """The name in a folder's package.xml; empty if there is none."""
    try:
        with (folder / "package.xml").open("rb") as file:
            match = _PACKAGE_NAME.search(file.read(65536))
    except OSError:
        return ""
    return match.group(1).decode("ascii", "replace") if match else ""


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError):
        return path.absolute()
