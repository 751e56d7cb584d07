"""What forms and scripts send."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar
from urllib.parse import parse_qs

from pydantic import BaseModel, ConfigDict, ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import Request

from mazebot.common.config import one_line


class Fields(BaseModel):
    """The base of what may be sent to an address: fields that are texts or lists of words, as in
    JSON; what is of another type is an error.
    """

    model_config = ConfigDict(frozen=True, strict=True)


F = TypeVar("F", bound=Fields)


async def fields_of(request: Request, kind: type[F]) -> F:
    """The fields of a form, where the words of a list have spaces or commas between them, or of a
    JSON object.

    Raises HTTPException.
    """
    body = await request.body()
    media = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    try:
        if media == "application/json":
            content = json.loads(body)
            if not isinstance(content, dict):
                raise HTTPException(422, "the body must be a JSON object")
        elif media == "application/x-www-form-urlencoded":
            found = parse_qs(body.decode(), keep_blank_values=True, max_num_fields=20)
            content = _of_form(found, kind)
        else:
            raise HTTPException(415, "the body must be a form or JSON")
    except (ValueError, RecursionError):
        raise HTTPException(400, "the body does not match its content type") from None
    _check_known(content, list(kind.model_fields))
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        raise HTTPException(422, f"{one_line(error):.300}") from None


def _of_form(found: Mapping[str, Sequence[str]], kind: type[Fields]) -> dict[str, object]:
    """The values of a form as those of JSON."""
    texts = {name for name, field in kind.model_fields.items() if field.annotation is str}
    return {
        name: values[-1] if name in texts else " ".join(values).replace(",", " ").split()
        for name, values in found.items()
    }


def _check_known(names: Iterable[str], known: Sequence[str]) -> None:
    unknown = ", ".join(f"{name!r:.80}" for name in names if name not in known)
    if unknown:
        allowed = " and ".join(f"`{name}`" for name in known)
        raise HTTPException(400, f"unknown field {unknown:.300}: allowed: {allowed}")
