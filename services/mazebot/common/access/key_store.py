"""A folder of keys: one file for each identity."""

from __future__ import annotations

import contextlib
import os
import secrets
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mazebot.common.access.grants import PEOPLE, ROLES, ROUTER
from mazebot.common.config import ConfigError
from mazebot.common.files.key_file import (
    HANDED_OUT,
    NAME,
    SUFFIX,
    Key,
    KeyFileError,
    file_of,
    read_key,
    text_of,
)
from mazebot.common.messages.topics import SERVICES

if TYPE_CHECKING:
    from mazebot.common.access.certificates import Authority

_PASSWORD_BYTES = 32
_READABLE = 0o644
AUTHORITY = "authority.pem"
"""The file of whoever signs the certificates of a folder of keys, if they have any."""


class KeyStore:
    """A folder of keys, of which each is readable by its owner alone."""

    def __init__(self, folder: Path) -> None:
        """The folder is made with its first key. Raises ConfigError where it is none."""
        if folder.exists() and not folder.is_dir():
            raise ConfigError(f"{folder}: must be a folder of keys")
        self.folder = folder

    def path_of(self, name: str) -> Path:
        """The file of an identity, whether it is there or not."""
        return file_of(self.folder, name)

    def read(self) -> dict[str, Key]:
        """All keys by their names.

        Raises ConfigError where a file is no key, has another name than its key or an unknown role.
        """
        found: dict[str, Key] = {}
        for path in sorted(self.folder.glob(f"*{SUFFIX}")):
            try:
                key = read_key(path)
            except KeyFileError as error:
                raise ConfigError(str(error)) from error
            if key.name != path.name.removesuffix(SUFFIX):
                raise ConfigError(f"{path}: name: {key.name}: must be the file's")
            if key.role not in ROLES:
                raise ConfigError(f"{path}: role: {key.role}: must be one of {', '.join(ROLES)}")
            if key.role not in PEOPLE and key.role != key.name:
                raise ConfigError(
                    f"{path}: role: {key.role}: must be one of {', '.join(PEOPLE)}: a service has "
                    "one key"
                )
            found[key.name] = key
        return found

    def changed_ns(self) -> dict[str, int]:
        """The time of the last change of each file, in nanoseconds, by its name."""
        found = {}
        for path in self.folder.glob(f"*{SUFFIX}"):
            # It may be removed meanwhile.
            with contextlib.suppress(OSError):
                found[path.name] = path.stat().st_mtime_ns
        return found

    def complete(self, hosts: Sequence[str] | None = None) -> list[str]:
        """Make the keys of the services, and one for each role of people, that are missing; return
        their names.

        Args:
            hosts: names and addresses by which the router is reached, where it is to speak TLS:
                every key gets a certificate, and those that end soon a new one.

        Raises ConfigError.
        """
        if hosts is not None and not self._authority_path.exists():
            from mazebot.common.access.certificates import Authority  # noqa: PLC0415

            _write({self._authority_path: Authority.new().text})
        there = self.read()
        missing = [name for name in (ROUTER, *SERVICES, *PEOPLE) if name not in there]
        self._make((name, name) for name in missing)
        renewed = [] if hosts is None else self._renew(hosts)
        return [*missing, *(name for name in renewed if name not in missing)]

    def _renew(self, hosts: Sequence[str]) -> list[str]:
        """Give a new certificate to each key that has none which lasts."""
        authority = self._authority()
        assert authority is not None
        renewed = {}
        for name, key in self.read().items():
            its_hosts = hosts if name == ROUTER else ()
            if not authority.still_holds(key.certificate, its_hosts):
                certificate = authority.issue(name, its_hosts)
                renewed[name] = text_of(key._replace(certificate=certificate))
        _write({self.path_of(name): text for name, text in renewed.items()})
        return list(renewed)

    @property
    def _authority_path(self) -> Path:
        return self.folder / AUTHORITY

    def _authority(self) -> Authority | None:
        """Who signs the certificates, where there are any. Raises ConfigError."""
        path = self._authority_path
        if not path.exists():
            return None
        from mazebot.common.access.certificates import Authority  # noqa: PLC0415 - loads slowly

        try:
            return Authority.of_text(path.read_text(encoding="ascii"))
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror}") from error
        except ValueError as error:
            raise ConfigError(
                f"{path}: must be the authority that the router made: remove it, and the router "
                "makes a new one, and new certificates"
            ) from error

    def add(self, name: str, role: str) -> Path:
        """Make a key for a person. Raises ConfigError where the name is taken, or is none."""
        if NAME.fullmatch(name) is None:
            raise ConfigError(
                f"name: {name!r:.60}: must be 1 to 32 lower-case letters, digits, - and _, the "
                "first one a letter"
            )
        if role not in PEOPLE:
            raise ConfigError(f"role: {role!r:.60}: must be one of {', '.join(PEOPLE)}")
        if name in ROLES and name != role:
            raise ConfigError(f"name: {name}: must not be the name of a service or another role")
        if name in self.read():
            raise ConfigError(f"name: {name}: has a key already: `mazebot keys rotate {name}`")
        self._make([(name, role)])
        return self.path_of(name)

    def revoke(self, name: str) -> None:
        """Remove a person's key. Raises ConfigError where there is none, or it is a service's."""
        if self._there(name).role not in PEOPLE:
            raise ConfigError(
                f"name: {name}: a service needs its key: `mazebot keys rotate {name}`"
            )
        self.path_of(name).unlink()

    def rotate(self, names: Iterable[str]) -> list[str]:
        """Replace keys by new ones, without names all; return their names.

        Raises ConfigError, before any is replaced, where one is missing or cannot be written.
        """
        keys = [self._there(name) for name in names] or list(self.read().values())
        self._make((key.name, key.role) for key in keys)
        return [key.name for key in keys]

    def hand_out(self, folder: Path) -> list[str]:
        """Write each key that is new or has changed into `folder/NAME/own.key`, where there is such
        a folder, and remove those that were revoked; return the names of both.

        A service finds its key there without seeing those of the others: each folder is one that
        only the service can reach, so that the file in it is readable by everyone.

        Raises ConfigError.
        """
        keys, changed = self.read(), []
        for own in sorted(path for path in folder.iterdir() if path.is_dir()):
            path = own / HANDED_OUT
            key = keys.get(own.name)
            text = None if key is None else text_of(key)
            if (path.read_text(encoding="utf-8") if path.exists() else None) == text:
                continue
            if text is None:
                path.unlink()
            else:
                _write({path: text}, _READABLE)
            changed.append(own.name)
        return changed

    def _there(self, name: str) -> Key:
        keys = self.read()
        if name not in keys:
            some = ", ".join(keys) or "none; make them with `mazebot keys make`"
            raise ConfigError(f"name: {name!r:.60}: has no key in {self.folder}: there are {some}")
        return keys[name]

    def _make(self, wanted: Iterable[tuple[str, str]]) -> None:
        """Write a new key for each name and role, or, where one cannot be, none."""
        authority = self._authority()
        texts = {}
        for name, role in wanted:
            # The router's has the names by which it is reached, which it alone knows.
            certificate = authority.issue(name) if authority and name != ROUTER else None
            key = Key(name, role, secrets.token_urlsafe(_PASSWORD_BYTES), certificate)
            texts[self.path_of(name)] = text_of(key)
        _write(texts)


def _write(texts: Mapping[Path, str], mode: int = 0o600) -> None:
    """Write files. Raises ConfigError, before any is replaced, where one cannot be written."""
    with contextlib.ExitStack() as rest:
        made = {path: rest.enter_context(_beside(path, text, mode)) for path, text in texts.items()}
        for path, new in made.items():
            with _told(path):
                new.replace(path)


@contextlib.contextmanager
def _beside(path: Path, text: str, mode: int) -> Iterator[Path]:
    """A new file to take a path's place; removed at the end where it has not.

    Raises ConfigError.
    """
    with _told(path):
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        # Readable by its owner alone from the first moment, and never half written.
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".new")
    new = Path(name)
    try:
        with _told(path), os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            os.fchmod(handle, mode)
        yield new
    finally:
        new.unlink(missing_ok=True)


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """Raises an OSError as ConfigError."""
    try:
        yield
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from error
