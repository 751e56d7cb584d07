"""Prints docs/schemas/<name>.schema.json from the documents that a run writes."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from types import MappingProxyType

from mazebot.common.messages.documents import Document
from mazebot.common.recordings.labels import Labels
from mazebot.common.recordings.series import RunSeries
from mazebot.common.recordings.summary import RunSummary

SCHEMAS: Mapping[str, type[Document]] = MappingProxyType(
    {"summary": RunSummary, "series": RunSeries, "labels": Labels}
)
"""The document of each file of a run, by the file's name without `.json`."""


def schema_text(name: str) -> str:
    """The JSON schema of a run's file."""
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(dialect | SCHEMAS[name].model_json_schema(), indent=2) + "\n"


if __name__ == "__main__":
    sys.stdout.write(schema_text(sys.argv[1]))
