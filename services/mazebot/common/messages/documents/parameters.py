"""The configuration of a running service."""

from __future__ import annotations

from pydantic import Field, JsonValue

from mazebot.common.messages.documents.document import Document


class Parameters(Document):
    """The configuration of a running service."""

    service: str
    values: dict[str, JsonValue]
    defaults: dict[str, JsonValue] = Field(
        default_factory=dict, description="the defaults of those that have another value"
    )
