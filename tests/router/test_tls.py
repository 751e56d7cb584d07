"""A router that encrypts lets in whoever shows a certificate of its folder of keys."""

from __future__ import annotations

import datetime
import json
import queue
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from mazebot.bench.parts.loopback_router import free_port, running_router
from mazebot.common.access import certificates
from mazebot.common.access.certificates import Authority
from mazebot.common.access.grants import OPERATOR, ROUTER
from mazebot.common.access.key_store import AUTHORITY, KeyStore
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.session import BusUnavailableError, open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.config import ConfigError
from mazebot.common.files.key_file import TLS, in_base64, read_key, text_of
from mazebot.common.messages.topics import CMD_VEL
from mazebot.router.config import RouterConfig

HOSTS = "localhost", "127.0.0.1"


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> KeyStore:
    return KeyStore(tmp_path_factory.mktemp("tls") / "keys")


@pytest.fixture(scope="module")
def endpoint(keys: KeyStore) -> Iterator[str]:
    with running_router(keys_dir=keys.folder, encrypts=True) as endpoint:
        yield endpoint


@pytest.fixture
def store(tmp_path: Path) -> KeyStore:
    store = KeyStore(tmp_path / "keys")
    store.complete(HOSTS)
    return store


def refusal(endpoint: str, key_file: Path | None) -> str:
    with pytest.raises(BusUnavailableError) as refused:
        open_session(BusConfig(connect=endpoint, key_file=key_file), 1.0)
    return str(refused.value)


def test_who_has_a_certificate_is_let_in_and_heard(endpoint: str, keys: KeyStore) -> None:
    assert endpoint.startswith(TLS)
    operator, physics = (
        open_session(BusConfig(connect=endpoint, key_file=keys.path_of(name)), 10.0)
        for name in (OPERATOR, "physics")
    )
    heard: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    subscription = subscribe(physics, CMD_VEL, lambda data, _: heard.put(data))
    publisher = publish(operator, CMD_VEL, lossless=True)
    publisher.put(b"twist")
    while not heard.qsize():
        publisher.put(b"twist")
    assert heard.get(timeout=10.0) == b"twist"
    del subscription
    for session in (operator, physics):
        session.close()  # type: ignore[no-untyped-call]


def test_nobody_else_is(
    endpoint: str, keys: KeyStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "asks for a key" in refusal(endpoint, None)
    in_the_open = refusal(endpoint.replace(TLS, "tcp/"), keys.path_of(OPERATOR))
    assert f"or encrypts: MAZEBOT_BUS_CONNECT={TLS}" in in_the_open
    key = read_key(keys.path_of(OPERATOR))
    other = tmp_path / "other.key"
    other.write_text(text_of(key._replace(certificate=None)))
    assert f"asks for a certificate, which the key {other} has not" in refusal(endpoint, other)
    # The right password, and a certificate of somebody else's authority.
    other.write_text(text_of(key._replace(certificate=Authority.new().issue(OPERATOR))))
    assert f"refuses the key {other}" in refusal(endpoint, other)
    monkeypatch.setattr(certificates, "LASTS", datetime.timedelta(minutes=30))
    authority = Authority.of_text((keys.folder / AUTHORITY).read_text())
    other.write_text(text_of(key._replace(certificate=authority.issue(OPERATOR))))
    assert f"refuses the key {other}" in refusal(endpoint, other)
    # The right certificate without the password.
    other.write_text(text_of(key._replace(password="x" * 43)))
    assert f"refuses the key {other}" in refusal(endpoint, other)


@pytest.mark.parametrize("name", [ROUTER, OPERATOR])
def test_nobody_stands_in_for_the_router(keys: KeyStore, endpoint: str, name: str) -> None:
    """A server with the certificate of a person, who has one of the same authority."""
    shown, asks = (read_key(keys.path_of(one)).certificate for one in (name, ROUTER))
    assert shown is not None
    assert asks is not None
    settings = zenoh.Config()
    false = f"{TLS}127.0.0.1:{free_port()}"
    users = keys.folder.parent / "users"
    login = read_key(keys.path_of(OPERATOR))
    users.write_text(f"{login.name}:{login.password}\n")
    for field, value in {
        "mode": "router",
        "listen/endpoints": [false],
        "scouting/multicast/enabled": False,
        "transport/auth/usrpwd": {
            "user": login.name, "password": login.password, "dictionary_file": str(users)
        },
        "transport/link/tls": {
            "root_ca_certificate_base64": in_base64(asks.authority),
            "listen_certificate_base64": in_base64(shown.certificate),
            "listen_private_key_base64": in_base64(shown.private_key),
            "enable_mtls": True,
        },
    }.items():  # fmt: skip
        settings.insert_json5(field, json.dumps(value))
    router = zenoh.open(settings)
    if name == ROUTER:
        config = BusConfig(connect=false, key_file=keys.path_of(OPERATOR))
        open_session(config, 10.0).close()  # type: ignore[no-untyped-call]
    else:
        assert "refuses the key" in refusal(false, keys.path_of(OPERATOR))
    router.close()  # type: ignore[no-untyped-call]


def test_certificates_are_made_once_and_renewed_in_time(
    store: KeyStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = store.read()
    assert all(key.certificate for key in first.values())
    assert len({key.certificate for key in first.values()}) == len(first)
    for path in store.folder.iterdir():
        assert path.stat().st_mode & 0o077 == 0
    assert store.complete(HOSTS) == []
    assert store.read() == first
    # The router got another name.
    assert store.complete((*HOSTS, "lab.example")) == [ROUTER]
    assert store.complete(()) == []
    monkeypatch.setattr(certificates, "RENEWED_BEFORE", certificates.LASTS)
    assert set(store.complete(HOSTS)) == first.keys()
    assert {name: key.password for name, key in store.read().items()} == {
        name: key.password for name, key in first.items()
    }


def test_new_keys_of_such_a_folder_have_certificates(store: KeyStore) -> None:
    assert read_key(store.add("anna", "viewer")).certificate is not None
    store.rotate(["anna", "physics", ROUTER])
    keys = store.read()
    assert keys["anna"].certificate is not None
    assert keys["physics"].certificate is not None
    # It alone knows by which names it is reached.
    assert keys[ROUTER].certificate is None
    assert store.complete(HOSTS) == [ROUTER]


@pytest.mark.parametrize("text", ["", "no authority", "-----BEGIN CERTIFICATE-----\nAAAA\n"])
def test_a_broken_authority_is_told(store: KeyStore, text: str) -> None:
    before = store.read()
    (store.folder / AUTHORITY).write_text(text)
    with pytest.raises(ConfigError, match=r"authority.pem: must be the authority that the router"):
        store.complete(HOSTS)
    assert store.read() == before


def test_hosts_have_names_and_addresses() -> None:
    hosts = ("robot", "robot.local", "my_router-2", "10.0.0.5", "fe80::1", "4.example")
    assert RouterConfig(tls_hosts=hosts).tls_hosts == hosts


def test_a_router_that_encrypts_needs_keys() -> None:
    with pytest.raises(ValueError, match=r"listen: tls/.*: with tls/, keys_dir must be a folder"):
        RouterConfig(listen="tls/127.0.0.1:7447")
