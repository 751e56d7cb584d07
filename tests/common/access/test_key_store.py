"""A folder of keys: what is made, and what is refused."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

import pytest

from mazebot.common.access.grants import PEOPLE, ROUTER
from mazebot.common.access.key_store import KeyStore
from mazebot.common.config import ConfigError
from mazebot.common.files.key_file import (
    HANDED_OUT,
    Certificate,
    KeyFileError,
    operators_key,
    operators_key_here,
    read_key,
)
from mazebot.common.messages.topics import SERVICES


@pytest.fixture
def store(tmp_path: Path) -> KeyStore:
    store = KeyStore(tmp_path / "keys")
    store.complete()
    return store


def test_each_service_and_each_role_of_people_gets_a_key_of_its_own(store: KeyStore) -> None:
    keys = store.read()
    assert keys.keys() == {ROUTER, *SERVICES, *PEOPLE}
    assert len({key.password for key in keys.values()}) == len(keys)
    assert all(len(key.password) >= 40 for key in keys.values())
    for path in store.folder.iterdir():
        assert path.stat().st_mode & 0o077 == 0
    assert store.folder.stat().st_mode & 0o077 == 0


def test_only_what_is_missing_is_made(store: KeyStore) -> None:
    before = store.read()
    store.path_of("physics").unlink()
    assert store.complete() == ["physics"]
    after = store.read()
    assert {name for name in after if after[name] != before[name]} == {"physics"}


def test_keys_of_people_come_and_go(store: KeyStore) -> None:
    path = store.add("anna", "viewer")
    assert read_key(path).role == "viewer"
    first = store.read()
    assert store.rotate(["anna", "physics"]) == ["anna", "physics"]
    second = store.read()
    changed = {name for name in first if first[name] != second[name]}
    assert changed == {"anna", "physics"}
    store.revoke("anna")
    assert "anna" not in store.read()
    assert store.rotate([]) == sorted(store.read())
    assert not list(store.folder.glob(".*"))


def test_where_one_cannot_be_written_no_key_is_replaced_and_nothing_is_left(
    store: KeyStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, files = store.read(), sorted(store.folder.iterdir())
    made, there = [], tempfile.mkstemp

    def third_is_read_only(**where: Any) -> tuple[int, str]:
        handle, name = there(**where)
        made.append(name)
        if len(made) == 3:
            os.close(handle)
            handle = os.open(name, os.O_RDONLY)
        return handle, name

    monkeypatch.setattr("tempfile.mkstemp", third_is_read_only)
    with pytest.raises(ConfigError, match=f"{sorted(before)[2]}.key: Bad file descriptor"):
        store.rotate([])
    assert store.read() == before
    assert sorted(store.folder.iterdir()) == files


@pytest.mark.parametrize(
    ("name", "role", "text"),
    [
        ("Anna", "viewer", "name: 'Anna': must be 1 to 32"),
        ("", "viewer", "name: ''"),
        ("a/../b", "viewer", "name: 'a/../b'"),
        ("a:b", "viewer", "name: 'a:b'"),
        ("a" * 33, "viewer", "must be 1 to 32"),
        ("anna", "physics", "role: 'physics': must be one of operator, viewer, grader"),
        ("physics", "viewer", "name: physics: must not be the name of a service"),
        ("grader", "operator", "name: grader: must not be the name of a service or another role"),
        ("viewer", "viewer", "name: viewer: has a key already: `mazebot keys rotate viewer`"),
    ],
)
def test_a_key_that_must_not_be_made_is_not(
    store: KeyStore, name: str, role: str, text: str
) -> None:
    before = sorted(store.folder.iterdir())
    with pytest.raises(ConfigError) as refused:
        store.add(name, role)
    assert text in str(refused.value)
    assert sorted(store.folder.iterdir()) == before


def test_what_has_no_key_cannot_lose_or_change_it(store: KeyStore) -> None:
    before = store.read()
    with pytest.raises(ConfigError, match=r"name: 'bob': has no key in .*: there are autonomy, "):
        store.revoke("bob")
    with pytest.raises(ConfigError, match="name: 'bob': has no key"):
        store.rotate(["physics", "bob"])
    with pytest.raises(ConfigError, match="name: physics: a service needs its key"):
        store.revoke("physics")
    assert store.read() == before


RIGHT = {"name": "anna", "role": "viewer", "password": "x" * 43}


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "must be a key"),
        (b"\x00\xff\xfe", "must be a key"),
        (b"[1, 2]", "name: must be a key"),
        (b"[" * 4000, "must be a key"),
        (b" " * 20_000 + json.dumps(RIGHT).encode(), "must be a key"),
        (json.dumps(RIGHT | {"name": "An\nna"}).encode(), "name: must be a key"),
        (json.dumps(RIGHT | {"password": 7}).encode(), "password: must be a key"),
        (json.dumps(RIGHT | {"password": "a\nroot:b"}).encode(), "password: must be a key"),
        (json.dumps({"name": "anna", "role": "viewer"}).encode(), "password: must be a key"),
        (json.dumps(RIGHT | {"role": "root"}).encode(), "role: root: must be one of router, "),
        (json.dumps(RIGHT | {"name": "bob"}).encode(), "name: bob: must be the file's"),
        (json.dumps(RIGHT | {"certificate": 7}).encode(), "certificate: must be one that"),
        (
            json.dumps(RIGHT | {"certificate": dict.fromkeys(Certificate._fields, "x")}).encode(),
            "certificate: must be one that `mazebot keys` made",
        ),
        (
            json.dumps(RIGHT | {"role": "physics"}).encode(),
            "role: physics: must be one of operator, viewer, grader",
        ),
    ],
    ids=range(14),
)
def test_a_file_that_is_no_key_is_named(store: KeyStore, content: bytes, text: str) -> None:
    store.path_of("anna").write_bytes(content)
    with pytest.raises(ConfigError) as refused:
        store.read()
    assert text in str(refused.value)
    assert str(store.path_of("anna")) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_folder_or_a_device_is_no_key(tmp_path: Path) -> None:
    (tmp_path / "a.key").mkdir()
    (tmp_path / "b.key").symlink_to("/dev/zero")
    for name in ("a", "b", "c"):
        with pytest.raises(KeyFileError):
            read_key(tmp_path / f"{name}.key")


def test_where_no_keys_can_be_made_a_line_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"file/.*: Not a directory"):
        KeyStore(tmp_path / "file" / "keys").complete()


def test_tools_find_the_operators_key_of_a_stack_of_this_user(
    store: KeyStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    stack = tmp_path / "mazebot" / "7500"
    stack.mkdir(parents=True)
    assert operators_key("tcp/127.0.0.1:7500") is None
    (stack / "keys").symlink_to(store.folder)
    for host in ("127.0.0.1", "localhost", "[::1]"):
        found = operators_key(f"tcp/{host}:7500")
        assert found is not None
        assert read_key(found).role == "operator"
    assert operators_key("tcp/127.0.0.1:7501") is None
    # A password is not sent to other machines.
    assert operators_key("tcp/192.0.2.1:7500") is None


def test_tools_find_the_operators_key_that_containers_have_left_in_the_clone(
    store: KeyStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(store.folder.parent)
    found = operators_key_here("tcp/127.0.0.1:7447")
    assert found is not None
    assert read_key(found).role == "operator"
    assert operators_key_here("tcp/192.0.2.1:7447") is None
    monkeypatch.chdir(store.folder)
    assert operators_key_here("tcp/127.0.0.1:7447") is None


def test_each_service_is_handed_its_own_key_where_it_has_a_folder(
    store: KeyStore, tmp_path: Path
) -> None:
    handout = tmp_path / "handout"
    for name in ("physics", "operator", "stranger"):
        (handout / name).mkdir(parents=True)
    assert store.hand_out(handout) == ["operator", "physics"]
    handed = handout / "physics" / HANDED_OUT
    assert read_key(handed) == store.read()["physics"]
    # Whoever reaches the folder reads it, whatever the user of its container.
    assert handed.stat().st_mode & 0o777 == 0o644
    assert {path.name for path in handout.iterdir()} == {"physics", "operator", "stranger"}
    assert not any((handout / "stranger").iterdir())

    assert store.hand_out(handout) == []
    store.rotate(["physics"])
    assert store.hand_out(handout) == ["physics"]
    assert read_key(handed) == store.read()["physics"]
    store.revoke("operator")
    assert store.hand_out(handout) == ["operator"]
    assert not (handout / "operator" / HANDED_OUT).exists()
