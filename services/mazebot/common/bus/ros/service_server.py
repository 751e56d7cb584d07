"""ROS 2's services of one node on the wire of rmw_zenoh: a queryable and a token each."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from typing import Any, cast

import zenoh

from mazebot.common.bus.attachment import pack_ros_attachment, unpack_ros_attachment
from mazebot.common.bus.liveliness import GraphNode
from mazebot.common.messages import wire
from mazebot.common.messages.keys import RELIABLE_QOS, SERVICE, Keys
from mazebot.common.messages.topics import Query
from mazebot.common.node.node import Inbox, Node
from mazebot.common.ros.call import Response, Service
from mazebot.common.ros.interfaces import Interfaces, served_as

_ANOTHER_S = 20.0
"""For the reply of another service: it may have a large file to read."""
Respond = Callable[[Response], None]
Refuse = Callable[[str, str], None]
"""Gets a short reason, by which refusals are counted, and its detail."""


def declare_service(
    session: zenoh.Session,
    keys: Keys,
    graph: GraphNode,
    name: str,
    types: Interfaces,
    type_name: str,
    handle: Callable[[Any, Respond, Refuse], None],
    refused: Callable[[str], None],
) -> zenoh.Queryable[None]:
    """Declare a service; keep a reference to the returned object.

    `handle` gets each valid request, and calls one of the two functions once: now or later, on any
    thread. It runs on Zenoh's thread. `refused` gets the short reason of each request that was not
    answered; its sender gets an error, as rmw_zenoh's clients expect.
    """
    type_hash = types.hash_of(type_name)

    def on_query(query: zenoh.Query) -> None:
        def refuse(reason: str, detail: str = "") -> None:
            refused(reason)
            # The client, or the session, may be gone.
            with contextlib.suppress(zenoh.ZError), query:
                query.reply_err(f"{name}: {reason}{detail and f': {detail}'}")

        try:
            request, sequence, gid = _request(types, type_name, query)
        except wire.WireError as error:
            refuse(error.reason, str(error).partition(": ")[2])
            return

        def respond(response: Response) -> None:
            try:
                payload = types.encode(f"{type_name}_Response", response)
            except wire.WireError as error:
                refuse(error.reason, str(error))
                return
            with contextlib.suppress(zenoh.ZError), query:
                query.reply(
                    query.key_expr,
                    payload,
                    encoding=zenoh.Encoding.APPLICATION_CDR,
                    attachment=pack_ros_attachment(sequence, time.time_ns(), gid),
                )

        handle(request, respond, refuse)

    queryable = session.declare_queryable(
        keys.typed(name, type_name, type_hash),
        cast("Any", zenoh.handlers.Callback(on_query, indirect=False)),
        complete=True,
    )
    # A client that finds the token may call at once, and would get no reply from one not yet there.
    graph.has(SERVICE, name, type_name, type_hash, RELIABLE_QOS)
    return queryable


def _request(types: Interfaces, type_name: str, query: zenoh.Query) -> tuple[Any, int, bytes]:
    """The request, and the number and sender by which it is answered. Raises WireError where it is
    none.
    """
    if query.attachment is None:
        raise wire.WireError("no attachment")
    try:
        sequence, gid = unpack_ros_attachment(query.attachment.to_bytes())
    except ValueError as error:
        raise wire.WireError(str(error)) from error
    data = query.payload.to_bytes() if query.payload is not None else b""
    return types.decode(f"{type_name}_Request", data), sequence, gid


class ServiceServer:
    """The services of one node, answered by its queries."""

    def __init__(
        self,
        session: zenoh.Session,
        node: Node,
        inbox: Inbox,
        keys: Keys,
        graph: GraphNode,
        services: list[Service],
    ) -> None:
        """Declare them."""
        self._session, self._node, self._inbox, self._keys = session, node, inbox, keys
        self._log = logging.getLogger(node.name)
        self._kept = [
            declare_service(
                session, keys, graph, service.name, types, service.type, self._handler(service),
                lambda reason, name=service.name: inbox.refuse(name, reason),  # type: ignore[misc]
            )
            for service in services
            for types in served_as(service.type, keys.distro)
        ]  # fmt: skip

    def _handler(self, service: Service) -> Callable[[Any, Respond, Refuse], None]:
        def handle(request: Any, respond: Respond, refuse: Refuse) -> None:
            steps = service.handle(request, self._node)

            def go_on(reply: Any) -> None:
                try:
                    query, document = steps.send(reply)
                except StopIteration as end:
                    respond(cast("Response", end.value))
                except ValueError as error:
                    refuse("invalid request", " ".join(str(error).split()))
                except Exception:
                    # It may run within the node's step, which must go on.
                    self._log.exception("%s", service.name)
                    refuse("internal error", "see the log of the service")
                else:
                    if query.owner != self._node.name:
                        self._ask_another(query, document, go_on, refuse)
                    elif not self._inbox.ask(query, document, go_on):
                        refuse("too many pending requests", "")

            go_on(None)

        return handle

    def _ask_another(
        self, query: Query[Any, Any], document: Any, go_on: Callable[[Any], None], refuse: Refuse
    ) -> None:
        """Ask a query of another service; it answers on a thread of Zenoh's."""
        replies: list[bytes] = []

        def take(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                replies.append(reply.ok.payload.to_bytes())

        def end() -> None:
            if not replies:
                refuse("no reply", f"{query.owner} is not running, or too busy")
                return
            try:
                answered = wire.decode_json(query.response, replies[0])
            except wire.WireError as error:
                refuse(f"reply of {query.owner}", str(error))
            else:
                go_on(answered)

        try:
            self._session.get(
                self._keys.of_query(query),
                cast("Any", zenoh.handlers.Callback(take, drop=end, indirect=True)),
                payload=wire.encode_json(document),
                timeout=_ANOTHER_S,
            )
        except zenoh.ZError as error:
            refuse("no reply", f"{query.owner}: {error}")
