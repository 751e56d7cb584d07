"""What forms and scripts send."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from urllib.parse import parse_qs

from starlette.exceptions import HTTPException
from starlette.requests import Request


async def fields_of(request: Request, known: Sequence[str]) -> Mapping[str, str]:
    """The fields of a form, or of a JSON object, which may have only the `known` ones.

    Raises HTTPException.
    """
    body = await request.body()
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    try:
        if kind == "application/json":
            content = json.loads(body)
            if not isinstance(content, dict):
                raise HTTPException(422, "the body must be a JSON object")
            _check_known(content, known)
            return {name: _text(value) for name, value in content.items()}
        if kind == "application/x-www-form-urlencoded":
            found = parse_qs(body.decode(), keep_blank_values=True, max_num_fields=20)
            return {name: values[-1] for name, values in found.items()}
    except (ValueError, RecursionError):
        raise HTTPException(400, "the body does not match its content type") from None
    raise HTTPException(415, "the body must be a form or JSON")


def _check_known(names: Iterable[str], known: Sequence[str]) -> None:
    unknown = ", ".join(f"{name!r:.80}" for name in names if name not in known)
    if unknown:
        allowed = " and ".join(f"`{name}`" for name in known)
        raise HTTPException(400, f"unknown field {unknown:.300}: allowed: {allowed}")


def _text(value: object) -> str:
    """A field as text; the words of a list are joined."""
    if isinstance(value, list):
        return " ".join(str(one) for one in value)
    return str(value)
