"""`mazebot keys`: the keys with which services and people sign in at a stack's router."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mazebot.cli.parsing.command import App
from mazebot.cli.parsing.options import Json, print_json

if TYPE_CHECKING:
    from mazebot.common.access.key_store import KeyStore

app = App(help="Make, list and take back the keys of a stack: see mazebot up --keys.")

KeysDir = Annotated[
    Path, typer.Option("--keys", metavar="FOLDER", help="folder of the keys [default: ./keys]")
]
DEFAULT = Path("keys")
_Name = Annotated[str, typer.Argument(metavar="NAME", help="of whoever has the key")]


@app.command()
def make(folder: KeysDir = DEFAULT) -> None:
    """Make the keys that are missing: one for each service, and one for each role of people."""
    made = _store(folder).complete()
    _say(f"{len(made)} keys made in {folder}" if made else f"{folder}: no key is missing")


@app.command("list")
def list_keys(folder: KeysDir = DEFAULT, as_json: Json = False) -> None:
    """List the keys: name, role, and what the role may do."""
    from mazebot.cli.recordings.printing import print_table  # noqa: PLC0415
    from mazebot.common.access.grants import about  # noqa: PLC0415

    keys = _store(folder).read()
    if as_json:
        print_json([{"name": key.name, "role": key.role} for key in keys.values()])
    elif not keys:
        _say(f"{folder}: there are no keys: make them with `mazebot keys make`")
    else:
        rows = [(key.name, key.role, about(key.role)) for key in keys.values()]
        print_table(("name", "role", "may"), rows)


@app.command()
def add(
    name: _Name,
    role: Annotated[
        str,
        typer.Option(
            help="operator, viewer, grader, autonomy or robot: see mazebot security matrix"
        ),
    ] = "viewer",
    folder: KeysDir = DEFAULT,
) -> None:
    """Make a key for a person, in a file to hand over to them."""
    path = _store(folder).add(name, role)
    _say(f"{path}: {name} signs in with it as {role}: MAZEBOT_BUS_KEY_FILE")


@app.command()
def revoke(name: _Name, folder: KeysDir = DEFAULT) -> None:
    """Remove a person's key: a stack that runs refuses it from then on."""
    _store(folder).revoke(name)
    _say(f"{name} has no key any more")


@app.command()
def rotate(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]...", help="whose key is replaced [default: everyone's]"),
    ] = None,
    folder: KeysDir = DEFAULT,
) -> None:
    """Replace keys by new ones; the old ones are refused from then on."""
    replaced = _store(folder).rotate(names or ())
    _say(f"{len(replaced)} key{'' if len(replaced) == 1 else 's'} replaced in {folder}")


def _store(folder: Path) -> KeyStore:
    from mazebot.common.access.key_store import KeyStore  # noqa: PLC0415 - loads all tables

    return KeyStore(folder)


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
