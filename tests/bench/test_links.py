"""A proxy on whose links things go wrong."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, suppress

import pytest

from mazebot.bench.chaos.links import Links, Shape, service_behind

PATIENCE_S = 20.0


@pytest.fixture
def links() -> Iterator[Links]:
    """Before a server that says back what it hears."""
    server = socket.create_server(("127.0.0.1", 0))

    def answer(connection: socket.socket) -> None:
        with closing(connection):
            while data := connection.recv(65536):
                connection.sendall(data)

    def serve() -> None:
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            threading.Thread(target=answer, args=(connection,), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    with Links(server.getsockname()[1], 1) as proxy:
        yield proxy
    server.close()


def connected(links: Links) -> socket.socket:
    client = socket.create_connection(("127.0.0.1", links.port), PATIENCE_S)
    client.sendall(b"first")
    assert heard(client, 5) == b"first"
    return client


def heard(client: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = client.recv(count - len(data))
        if not more:
            break
        data += more
    return data


def test_all_bytes_pass_in_order(links: Links) -> None:
    sent = bytes(range(256)) * 20_000
    with closing(connected(links)) as client:
        sender = threading.Thread(target=client.sendall, args=(sent,))
        sender.start()
        assert heard(client, len(sent)) == sent
        sender.join(PATIENCE_S)


def await_slow(client: socket.socket, sent: bytes, least_s: float) -> None:
    """Say something until it comes back no sooner than after a time."""
    end_s, took_s = time.monotonic() + PATIENCE_S, 0.0
    while took_s < least_s:
        assert time.monotonic() < end_s, f"after {took_s:.3f} s, not {least_s:g} s"
        begun_s = time.monotonic()
        client.sendall(sent)
        assert heard(client, len(sent)) == sent
        took_s = time.monotonic() - begun_s


def test_a_delay_is_kept_both_ways(links: Links) -> None:
    with closing(connected(links)) as client:
        links.shape("", Shape(delay_s=0.2))
        await_slow(client, b"a", 0.4)


def test_a_rate_is_kept(links: Links) -> None:
    with closing(connected(links)) as client:
        links.shape("", Shape(rate_bytes_s=100_000.0))
        await_slow(client, b"x" * 50_000, 0.5)


def test_of_a_link_that_is_not_open_all_is_lost_and_it_breaks_at_the_end(links: Links) -> None:
    with closing(connected(links)) as client, closing(connected(links)) as silent:
        links.shape("", Shape(is_open=False))
        client.settimeout(0.3)
        for _ in range(100):
            client.sendall(b"lost")
            try:
                # Said before the proxy knew.
                assert client.recv(100)
            except TimeoutError:
                break
        links.clear("")
        client.settimeout(PATIENCE_S)
        with suppress(ConnectionResetError):
            assert client.recv(1) == b""
        # On the other nothing was lost.
        silent.sendall(b"still")
        assert heard(silent, 5) == b"still"


def test_whose_connection_it_is_is_told_by_its_module(links: Links) -> None:
    with closing(connected(links)) as client:
        # This is no service.
        assert service_behind(client.getsockname()[1]) == ""
        assert links.services() == {""}
    assert service_behind(1) == ""
