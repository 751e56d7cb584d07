"""The configuration of a running service, and its change."""

from __future__ import annotations

from pydantic import Field, JsonValue

from mazebot.common.messages.documents.document import Document


class SetParameters(Document):
    """Requests that parameters of a running service be set: all of them, or none."""

    values: dict[str, JsonValue] = Field(description="by dotted name")


class SetParametersReply(Document):
    """The result of setting parameters."""

    error: str = Field("", description="one line; empty: all are set")


class Parameters(Document):
    """The configuration of a running service."""

    service: str
    values: dict[str, JsonValue]
    defaults: dict[str, JsonValue] = Field(
        default_factory=dict, description="the defaults of those that have another value"
    )
