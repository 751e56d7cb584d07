"""Why a router lets a key not do something."""

from __future__ import annotations

from mazebot.common.access.grants import ROLES, Verb, grants_of
from mazebot.common.access.rules import decide
from mazebot.common.files.key_file import Key
from mazebot.common.messages.keys import Keys


def denial(key: Key, verb: Verb, name: str, expression: str, keys: Keys) -> str:
    """One line, or an empty text where the key lets its owner do it.

    Args:
        key: with which a session has signed in.
        verb: what it tries to do.
        name: of the topic or query.
        expression: its key.
        keys: of the stack.
    """
    if key.role not in ROLES or decide(grants_of(key.role, keys), verb, expression).is_granted:
        return ""
    return (
        f"{name}: {key.name} may not {verb.text} it, as {key.role}: see mazebot security explain "
        f"{key.role} {name}"
    )
