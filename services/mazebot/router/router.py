"""The Zenoh router, to which every service connects."""

from __future__ import annotations

import json
import logging
import os
import socket
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import zenoh

from mazebot.common.bus.liveliness import alive_key
from mazebot.common.bus.session import close_links_at_once
from mazebot.common.config import ConfigError
from mazebot.common.files.key_file import TLS, in_base64
from mazebot.common.messages.keys import DEFAULT_KEYS, Keys, types_of
from mazebot.common.messages.topics import TOPICS
from mazebot.common.messages.wire import MAX_MESSAGE_BYTES, most_bytes
from mazebot.router.config import RouterConfig

SETTINGS_FILE = Path(__file__).with_name("router.json5")
_ATTACHMENT_BYTES = 1024
"""More than any has; Zenoh counts it in."""
OWN_HOSTS = "localhost", "127.0.0.1", "::1"
RECEIVING_THREADS = 8
"""Each thread forwards the messages of one connection; Zenoh's default of two is soon blocked by
slow readers.
"""


class Router:
    """An open router; it works in its own threads until it is closed."""

    def __init__(self, config: RouterConfig, keys: Keys = DEFAULT_KEYS) -> None:
        """Open it, and declare its liveliness token. Port 0 means any free one.

        Raises ConfigError where it cannot listen, or a key is wrong.
        """
        # Read when the first session of a process is opened.
        os.environ["ZENOH_RUNTIME"] = f"(rx: (worker_threads: {RECEIVING_THREADS}))"
        self._config, self._keys = config, keys
        self.endpoint = _with_port(config.listen)
        """What it listens on."""
        encrypts = config.listen.startswith(TLS)
        hosts = [*OWN_HOSTS, *config.tls_hosts] if encrypts else None
        self._lock = (
            None if config.keys_dir is None else Lock(config.keys_dir, config.handout_dir, hosts)
        )
        self._session, self._token = self._opened()

    def _opened(self) -> tuple[zenoh.Session, zenoh.LivelinessToken]:
        settings = zenoh.Config.from_file(SETTINGS_FILE)
        settings.insert_json5("listen/endpoints", json.dumps([self.endpoint]))
        settings.insert_json5("listen/exit_on_failure", "true")
        settings.insert_json5("low_pass_filter", json.dumps(size_limits(self._keys)))
        with tempfile.NamedTemporaryFile("w", encoding="utf-8") as users:
            # Read while it opens.
            if self._lock is not None:
                self._lock.set_in(settings, users, self._config, self._keys)
            session = self._open(settings)
        close_links_at_once(session)
        key = alive_key("router", str(session.zid()), self._keys)
        return session, session.liveliness().declare_token(key)

    def _open(self, settings: zenoh.Config) -> zenoh.Session:
        try:
            return zenoh.open(settings)
        except zenoh.ZError as error:
            reason = "address in use" if "Address already in use" in str(error) else "cannot listen"
            raise ConfigError(f"router: listen: {self._config.listen}: {reason}") from error

    @property
    def session(self) -> zenoh.Session:
        """The router's own session, for what runs in its process."""
        return self._session

    def take_new_keys(self) -> None:
        """Where the keys in its folder have changed, close every connection and let in those who
        have one of the new keys. Where one of them is wrong, all stays as it was.
        """
        if self._lock is None or not self._lock.has_changed():
            return
        log = logging.getLogger("router")
        try:
            self._lock.read()
        except ConfigError as error:
            log.error("the keys stay as they were: %s", error)
            return
        log.info("the keys have changed: everyone signs in again")
        self.close()
        self._session, self._token = self._opened()

    def close(self) -> None:
        """Close every connection."""
        self._token.undeclare()  # type: ignore[no-untyped-call]
        self._session.close()  # type: ignore[no-untyped-call]


def size_limits(keys: Keys) -> list[dict[str, Any]]:
    """Zenoh's `low_pass_filter`: what every reader would refuse for its size is not passed on."""
    by_bytes: dict[int, list[str]] = {}
    for topic in TOPICS:
        for name in types_of(topic):
            by_bytes.setdefault(most_bytes(name), []).append(keys.of_topic(topic, name))
    return [
        {
            "id": f"at most {most} bytes",
            "flows": ["ingress"],
            "messages": ["put"],
            # On the plain wire, the types of a topic have one key.
            "key_exprs": list(dict.fromkeys(found)),
            "size_limit": most + _ATTACHMENT_BYTES,
        }
        for most, found in by_bytes.items()
        if most < MAX_MESSAGE_BYTES
    ]


class Lock:
    """The keys of a folder, and the rules that go with them."""

    def __init__(
        self, folder: Path, handout: Path | None = None, hosts: Sequence[str] | None = None
    ) -> None:
        """Make the keys that are missing, and hand them out: see KeyStore.complete and hand_out.

        Raises ConfigError.
        """
        # It loads all tables, which takes long.
        from mazebot.common.access.key_store import KeyStore  # noqa: PLC0415

        self._store = KeyStore(folder)
        self._handout = handout
        self._hosts = hosts
        self._changed_ns: dict[str, int] = {}
        self.read()

    def read(self) -> None:
        """Read the keys again. Raises ConfigError, and keeps those from before."""
        # First, so that a wrong key is told once.
        self._changed_ns = self._store.changed_ns()
        made = self._store.complete(self._hosts)
        if made:
            logging.getLogger("router").info("made %d keys in %s", len(made), self._store.folder)
            self._changed_ns = self._store.changed_ns()
        self._there = self._store.read()
        if self._handout is not None:
            self._store.hand_out(self._handout)

    def has_changed(self) -> bool:
        """Whether keys have come, gone or changed since they were last read."""
        return self._store.changed_ns() != self._changed_ns

    def set_in(
        self, settings: zenoh.Config, users: IO[str], config: RouterConfig, keys: Keys
    ) -> None:
        """Let in only those who have a key, each with the rules of its role.

        Args:
            settings: of the router.
            users: an empty file, which is read when it opens.
            config: of the router.
            keys: of the bus.
        """
        from mazebot.common.access.grants import ROUTER  # noqa: PLC0415 - they load all tables
        from mazebot.common.access.rules import access_control  # noqa: PLC0415

        users.writelines(f"{key.name}:{key.password}\n" for key in self._there.values())
        users.flush()
        own = self._there[ROUTER]
        login = {"user": own.name, "password": own.password, "dictionary_file": users.name}
        settings.insert_json5("transport/auth/usrpwd", json.dumps(login))
        if self._hosts is not None and own.certificate is not None:
            tls = {
                "root_ca_certificate_base64": in_base64(own.certificate.authority),
                "listen_certificate_base64": in_base64(own.certificate.certificate),
                "listen_private_key_base64": in_base64(own.certificate.private_key),
                "enable_mtls": True,
            }
            settings.insert_json5("transport/link/tls", json.dumps(tls))
        rules = access_control(
            {key.name: key.role for key in self._there.values()},
            keys,
            operator_sees_truth=config.ground_truth_for == "operator",
        )
        settings.insert_json5("access_control", json.dumps(rules))


def _with_port(listen: str) -> str:
    """The endpoint with a free port in place of port 0: Zenoh does not tell which one it takes."""
    protocol, _, address = listen.partition("/")
    host, _, port = address.rpartition(":")
    if protocol not in ("tcp", "tls") or port != "0":
        return listen
    with socket.socket() as probe:
        probe.bind(("", 0))
        return f"{protocol}/{host}:{probe.getsockname()[1]}"
