"""What people say of a run, as stored in its labels.json: tags and a note."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError, field_validator

from mazebot.common.config import ConfigError, one_line
from mazebot.common.files.limits import MAX_TEXT_BYTES
from mazebot.common.files.reading import NotReadableError, read_limited, reason
from mazebot.common.messages.documents import Document
from mazebot.common.recordings.run_folder import LABELS, write_atomically

KEEP = "keep"
"""A run with this tag is never pruned."""
TAG_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.:-]{0,39}$"
MOST_TAGS = 50
MOST_NOTE = 10_000

Tag = Annotated[str, Field(pattern=TAG_PATTERN)]


class Labels(Document):
    """Tags and a note of a run."""

    tags: tuple[Tag, ...] = Field(
        (), max_length=MOST_TAGS, description="words of letters, digits and `_.:-`, sorted"
    )
    note: str = Field("", max_length=MOST_NOTE, description="any text")

    @field_validator("tags")
    @classmethod
    def _sorted(cls, tags: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(sorted(set(tags)))


def read_labels(folder: Path) -> Labels:
    """The labels of a run; empty ones if it has none.

    Raises ConfigError with one line where the file cannot be read, or holds no labels.
    """
    path = folder / LABELS
    try:
        return Labels.model_validate_json(read_limited(path, MAX_TEXT_BYTES))
    except FileNotFoundError:
        return Labels()
    except (OSError, NotReadableError) as error:
        raise ConfigError(f"{path}: {reason(error)}") from error
    except ValidationError as error:
        raise ConfigError(f"{path}: {one_line(error):.300}") from error


def write_labels(folder: Path, labels: Labels) -> None:
    """Write the labels of a run; empty ones remove the file.

    Raises ConfigError with one line where the file cannot be written.
    """
    path = folder / LABELS
    try:
        if labels == Labels():
            path.unlink(missing_ok=True)
        else:
            write_atomically(path, [labels.model_dump_json(indent=2).encode(), b"\n"])
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from error


def relabelled(
    labels: Labels, add: tuple[str, ...] = (), remove: tuple[str, ...] = (), note: str | None = None
) -> Labels:
    """The labels after a change; without a `note` the old one stays.

    Raises ConfigError with one line where a tag, or the note, cannot be.
    """
    tags = (set(labels.tags) | set(add)) - set(remove)
    values = {"tags": sorted(tags), "note": labels.note if note is None else note}
    for tag in add:
        if re.fullmatch(TAG_PATTERN, tag) is None:
            expected = (
                "must be letters, digits and _.:- and begin with a letter or digit, 40 at most"
            )
            raise ConfigError(f"tag {tag!r:.60}: {expected}")
    try:
        return Labels.model_validate(values)
    except ValidationError as error:
        raise ConfigError(one_line(error)) from error
