"""ENDPOINT NAME SERVICE [VALUES]: pyzeros calls a service of common ROS packages with the values of
the request as JSON, by field, and prints the response as JSON. Messages in lists name their class
by `_type`.
"""

from __future__ import annotations

import asyncio
import dataclasses
import json
import sys
from typing import Any

import numpy as np
import pyzeros
import zenoh
from ros2_pyterfaces.cyclone import all_srvs
from sessions import opened


def plain(value: Any) -> Any:
    """A message as JSON values."""
    if dataclasses.is_dataclass(value):
        return {one.name: plain(getattr(value, one.name)) for one in dataclasses.fields(value)}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(one) for one in value]
    return value.item() if isinstance(value, np.generic) else value


def filled(message: Any, values: dict[str, Any]) -> Any:
    """A message with values."""
    for name, value in values.items():
        now = getattr(message, name)
        if dataclasses.is_dataclass(now):
            filled(now, value)
        elif value and isinstance(value[0] if isinstance(value, list) else None, dict):
            made = [filled(getattr(all_srvs, one.pop("_type"))(), one) for one in value]
            setattr(message, name, made)
        else:
            setattr(message, name, value)
    return message


class Uncancelled:
    """A querier of the Zenoh of Jazzy, which cannot cancel a query as pyzeros asks it to."""

    def __init__(self, querier: Any) -> None:
        self._querier = querier

    def get(self, handler: Any, **options: Any) -> Any:
        """Send the request."""
        del options["cancellation_token"]
        return self._querier.get(handler, **options)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._querier, name)


class Token:
    """What it would cancel the query by."""

    def cancel(self) -> None:
        """Nothing: the process ends."""


setattr(zenoh, "CancellationToken", Token)  # noqa: B010 - there is none to replace


async def call(kind: Any, name: str, values: dict[str, Any]) -> Any:
    """The response."""
    client = pyzeros.Client(kind, name)
    await asyncio.wait_for(client.wait_for_service(), 20.0)
    client.zenoh_cli = Uncancelled(client.zenoh_cli)
    return await asyncio.wait_for(client.call_async(filled(kind.Request(), values)), 20.0)


if __name__ == "__main__":
    endpoint, name, service, *rest = sys.argv[1:]
    with pyzeros.auto_context(node="caller", zenoh_session=opened(endpoint, "peer")):
        values = json.loads(rest[0]) if rest else {}
        answer = asyncio.run(call(getattr(all_srvs, service), name, values))
    sys.stdout.write(json.dumps(plain(answer)))
