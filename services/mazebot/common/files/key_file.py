"""The key of an identity: a file with its name and password. It imports little, as `health` needs
it.
"""

from __future__ import annotations

import base64
import json
import os
import re
import stat
import tempfile
from pathlib import Path
from typing import NamedTuple

NAME = re.compile(r"[a-z][a-z0-9_-]{0,31}")
"""Of an identity, and of a role."""
_PASSWORD = re.compile(r"[A-Za-z0-9_-]{20,128}")
_FORMS = {"name": NAME, "role": NAME, "password": _PASSWORD}
SUFFIX = ".key"
HANDED_OUT = "own.key"
"""The file in which an identity finds its key in a folder of its own."""
_LONGEST = 16_384
"""Bytes of a key file: far above what it holds."""
KEYS = "keys"
"""The folder with the keys in a stack's folder, while it runs with keys."""
_PEM = re.compile(r"(-----BEGIN [A-Z ]+-----\n[A-Za-z0-9+/=\n]+-----END [A-Z ]+-----\n)+")
TLS = "tls/"
"""How an endpoint begins whose router asks for a certificate, and encrypts."""
_LOOPBACK = re.compile(r"(tcp|tls)/(127\.0\.0\.1|localhost|\[::1\]):(?P<port>\d+)")


class KeyFileError(ValueError):
    """A file that is no key; the text is one line."""


class Certificate(NamedTuple):
    """With which an identity shows that it is who it says it is: PEM."""

    authority: str
    """The certificate of whoever has signed it, and those of all others."""
    certificate: str
    private_key: str


class Key(NamedTuple):
    """An identity with its password, and its certificate, if there is one."""

    name: str
    role: str
    password: str
    certificate: Certificate | None = None


def file_of(folder: Path, name: str) -> Path:
    """The file of an identity in a folder of keys, whether it is there or not."""
    return folder / f"{name}{SUFFIX}"


def read_key(path: Path) -> Key:
    """The key in a file. Raises KeyFileError."""
    try:
        with path.open("rb") as file:
            content = json.loads(file.read(_LONGEST))
    except OSError as error:
        raise KeyFileError(f"{path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise KeyFileError(f"{path}: must be a key that `mazebot keys` made") from error
    for field, form in _FORMS.items():
        value = content.get(field) if isinstance(content, dict) else None
        if not isinstance(value, str) or form.fullmatch(value) is None:
            raise KeyFileError(f"{path}: {field}: must be a key that `mazebot keys` made")
    name, role, password = (content[field] for field in _FORMS)
    return Key(name, role, password, _certificate_in(content, path))


def _certificate_in(content: dict[str, object], path: Path) -> Certificate | None:
    found = content.get("certificate")
    if found is None:
        return None
    values = [
        found.get(field) if isinstance(found, dict) else None for field in Certificate._fields
    ]
    texts = [one for one in values if isinstance(one, str) and _PEM.fullmatch(one)]
    if len(texts) != len(values):
        raise KeyFileError(f"{path}: certificate: must be one that `mazebot keys` made")
    return Certificate(*texts)


def text_of(key: Key) -> str:
    """What `read_key` reads."""
    content = key._asdict()
    content["certificate"] = key.certificate and key.certificate._asdict()
    return json.dumps({field: value for field, value in content.items() if value is not None})


def sign_in(key: Key, endpoint: str) -> dict[str, dict[str, str | bool]]:
    """The settings of a Zenoh session that signs in with a key at an endpoint."""
    settings: dict[str, dict[str, str | bool]] = {
        "transport/auth/usrpwd": {"user": key.name, "password": key.password}
    }
    if endpoint.startswith(TLS) and key.certificate is not None:
        settings["transport/link/tls"] = {
            "root_ca_certificate_base64": in_base64(key.certificate.authority),
            "connect_certificate_base64": in_base64(key.certificate.certificate),
            "connect_private_key_base64": in_base64(key.certificate.private_key),
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }
    return settings


def in_base64(text: str) -> str:
    """As Zenoh's settings have what else would be a file."""
    return base64.b64encode(text.encode()).decode()


def stacks_folder() -> Path:
    """The folder of new stacks of this user, whether it is there or not."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and os.access(runtime, os.W_OK):
        return Path(runtime) / "mazebot"
    return _in_temporary(tempfile.gettempdir())


def stacks_folders() -> list[Path]:
    """The folders with stacks of this user that are there, that of new ones first: another shell
    of the user may have another environment. Those that others may write are left out.
    """
    runtime = Path("/run/user") / str(os.getuid()) / "mazebot"
    usual = (runtime, _in_temporary(tempfile.gettempdir()), _in_temporary("/tmp"))
    return [folder for folder in dict.fromkeys((stacks_folder(), *usual)) if is_own(folder)]


def _in_temporary(folder: str) -> Path:
    return Path(folder) / f"mazebot-{os.getuid()}"


def is_own(folder: Path) -> bool:
    """Whether it is a folder of this user that nobody else may write."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    own = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
    return own and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def operators_key(endpoint: str) -> Path | None:
    """The operator's key of this user's stack whose router listens at an endpoint; None: there is
    no such stack, or it has no keys.
    """
    found = _LOOPBACK.fullmatch(endpoint)
    if found is None:
        return None
    keys = [folder / found["port"] / KEYS for folder in stacks_folders()]
    files = [path for path in (file_of(one, "operator") for one in keys) if path.exists()]
    # A stack that was killed leaves its own.
    return max(files, key=lambda path: path.parent.lstat().st_mtime, default=None)


def operators_key_here(endpoint: str) -> Path | None:
    """The operator's key in ./keys, where the containers of a clone leave it for whoever works
    there, if it may be for the router at an endpoint: another machine does not get to see it.
    """
    path = file_of(Path(KEYS), "operator")
    return path if _LOOPBACK.fullmatch(endpoint) and os.access(path, os.R_OK) else None
