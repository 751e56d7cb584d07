"""`mazebot security`: what the keys of a stack let their owners do."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mazebot.cli.access.keys import DEFAULT, KeysDir
from mazebot.cli.parsing.command import App
from mazebot.cli.parsing.options import Json, print_json
from mazebot.common.config import ConfigError

if TYPE_CHECKING:
    from mazebot.common.messages.keys import Keys

app = App(help="Print who may do what on the bus of a stack with keys: see mazebot keys.")

_Truth = Annotated[
    bool,
    typer.Option(
        "--ground-truth-for-grader",
        help="as with MAZEBOT_ROUTER_GROUND_TRUTH_FOR=grader: the operator must not read it",
    ),
]


@app.command()
def matrix(for_grader: _Truth = False, as_json: Json = False) -> None:
    """Print who may publish and read each topic, and ask and answer each service."""
    from mazebot.cli.recordings.printing import print_table  # noqa: PLC0415
    from mazebot.common.access.matrix import in_short  # noqa: PLC0415
    from mazebot.common.access.matrix import matrix as rows_of  # noqa: PLC0415

    rows = list(rows_of(_keys(), operator_sees_truth=not for_grader))
    if as_json:
        print_json(
            [
                {"name": row.name, **{verb.text: roles for verb, roles in row.roles.items()}}
                for row in rows
            ]
        )
        return
    table = [
        (row.name, *(f"{verb.text}: {in_short(roles)}" for verb, roles in row.roles.items()))
        for row in rows
    ]
    print_table(("topic or service", "who sends or asks", "who reads or answers"), table)


@app.command()
def explain(
    user: Annotated[str, typer.Argument(metavar="USER", help="a name with a key, or a role")],
    key: Annotated[
        str, typer.Argument(metavar="KEY", help="a topic or service such as /cmd_vel, or a key "
                            "expression of Zenoh")
    ],
    what: Annotated[
        str,
        typer.Argument(
            metavar="[WHAT]",
            help="put, subscribe, query, answer, ... [default: put and subscribe, or of a service "
            "query and answer]",
        ),
    ] = "",
    for_grader: _Truth = False,
    folder: KeysDir = DEFAULT,
    as_json: Json = False,
) -> None:  # fmt: skip
    """Print whether a user may do something with a topic or service, and which rule decides."""
    from mazebot.common.access.grants import Verb, grants_of  # noqa: PLC0415
    from mazebot.common.access.rules import decide  # noqa: PLC0415

    verbs = {verb.text: verb for verb in Verb}
    if what and what not in verbs:
        raise ConfigError(f"WHAT: {what!r:.40}: must be one of {', '.join(verbs)}")
    role = _role(user, folder)
    grants = grants_of(role, _keys(), operator_sees_truth=not for_grader)
    found = []
    for one, its_verbs in _resolved(key):
        for text in [what] if what else its_verbs:
            try:
                granted, grant = decide(grants, verbs[text], one)
            except ValueError as error:
                raise ConfigError(f"KEY: {error}") from error
            why = "no rule lets them" if grant is None else grant.why
            found.append({"key": one, "what": text, "granted": granted, "why": why})
    if as_json:
        print_json({"user": user, "role": role, "decisions": found})
        return
    who = user if user == role else f"{user}, a {role},"
    for each in found:
        may = "may" if each["granted"] else "may not"
        sys.stdout.write(f"{who} {may} {each['what']} {each['key']}: {each['why']}\n")


def _role(user: str, folder: Path) -> str:
    """The role of a key or, where none has the name, the role of that name. Raises ConfigError."""
    from mazebot.common.access.grants import ROLES  # noqa: PLC0415
    from mazebot.common.access.key_store import KeyStore  # noqa: PLC0415

    keys = KeyStore(folder).read()
    if user in keys:
        return keys[user].role
    if user not in ROLES:
        known = ", ".join(dict.fromkeys((*keys, *ROLES)))
        raise ConfigError(f"USER: {user!r:.40}: has no key in {folder}: must be one of {known}")
    return user


def _resolved(name: str) -> Iterator[tuple[str, list[str]]]:
    """The keys of a topic, query or service, its name also without the leading slash; of an action
    those of its parts; else a key itself. With each goes what one may do with it.

    Raises ConfigError where nothing has a name.
    """
    from mazebot.common.access.matrix import named  # noqa: PLC0415

    of_topic, of_service = ["put", "subscribe"], ["query", "answer"]
    full = f"/{name.removeprefix('/')}"
    parts = [one for one in named(_keys()) if one.name == full]
    parts = parts or [one for one in named(_keys()) if one.name.startswith(f"{full}/_action/")]
    if not parts and name != full:
        yield name, [*of_topic, *of_service]
        return
    if not parts:
        raise ConfigError(
            f"KEY: {name!r:.60}: must be a topic, service or action: see mazebot security matrix"
        )
    for part in parts:
        for key in part.keys:
            yield key, of_topic if part.is_topic else of_service


def _keys() -> Keys:
    """Those of the stack that the environment tells of."""
    from mazebot.common.bus.config import BusConfig  # noqa: PLC0415
    from mazebot.common.settings.load import load  # noqa: PLC0415

    return load(BusConfig, "bus", []).keys
