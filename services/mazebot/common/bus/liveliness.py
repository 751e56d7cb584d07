"""Which services are alive, by their liveliness tokens."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any, cast

import zenoh

ALIVE_PREFIX = "mazebot/alive/"


def alive_key(service: str, source: str, prefix: str = "") -> str:
    """The key of a service's liveliness token, which names the service and its message source."""
    return f"{prefix}{ALIVE_PREFIX}{service}/{source}"


def service_and_source(key: object) -> tuple[str, str]:
    """The service and the source at the end of a token's or a seat's key."""
    service, _, source = str(key).rpartition("/")
    return service.rsplit("/", 1)[-1], source


def watch_tokens(
    session: zenoh.Session, keys: str, on_change: Callable[[str, str, bool], None]
) -> Any:
    """Call `on_change` with the service and source of each liveliness token, and whether it is
    present: now, and on every change.
    """

    def on_token(sample: zenoh.Sample) -> None:
        on_change(*service_and_source(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

    return session.liveliness().declare_subscriber(
        keys, cast("Any", zenoh.handlers.Callback(on_token, indirect=False)), history=True
    )


def alive(
    session: zenoh.Session, prefix: str = "", timeout_s: float = 1.0
) -> Mapping[str, frozenset[str]]:
    """The services with a liveliness token, the router among them, each with the message sources
    of its processes.
    """
    found: dict[str, set[str]] = defaultdict(set)
    for reply in session.liveliness().get(alive_key("*", "*", prefix), timeout=timeout_s):
        if reply.ok is not None:
            service, source = service_and_source(reply.ok.key_expr)
            found[service].add(source)
    return {service: frozenset(sources) for service, sources in found.items()}


def watch_sources(
    session: zenoh.Session, on_change: Callable[[str, bool], None], prefix: str = ""
) -> Any:
    """Call `on_change` with the source of each service and whether it is present: now, and on every
    change. Keep a reference to the returned object. It runs on Zenoh's thread: it must only store.
    """
    return watch_tokens(
        session,
        alive_key("*", "*", prefix),
        lambda _, source, is_there: on_change(source, is_there),
    )
