"""The queries of the topic table as services of Foxglove, in JSON."""

from __future__ import annotations

import json
from typing import Any

from foxglove import MessageSchema, Schema, Service, ServiceRequest, ServiceSchema
from pydantic import ValidationError

from mazebot.common.client.robot import Robot
from mazebot.common.config import one_line
from mazebot.common.messages.documents import Document
from mazebot.common.messages.topics import QUERIES, Query

ANSWER_TIMEOUT_S = 30.0
_JSON = "json"


def services_of(robot: Robot) -> list[Service]:
    """A service for each query."""
    return [_service(robot, query) for query in QUERIES]


def _service(robot: Robot, query: Query[Any, Any]) -> Service:
    def answer(request: ServiceRequest) -> bytes:
        # Foxglove shows the text of an exception.
        try:
            document = query.request.model_validate_json(request.payload or b"{}")
        except ValidationError as error:
            raise ValueError(f"{query.name}: {one_line(error)}") from None
        reply: Document = robot.ask(query, document, ANSWER_TIMEOUT_S)
        return reply.model_dump_json().encode()

    schema = ServiceSchema(
        query.request.__name__, request=_schema(query.request), response=_schema(query.response)
    )
    return Service(query.name, schema=schema, handler=answer)


def _schema(kind: type[Document]) -> MessageSchema:
    text = json.dumps(kind.model_json_schema()).encode()
    return MessageSchema(
        encoding=_JSON, schema=Schema(name=kind.__name__, encoding="jsonschema", data=text)
    )
