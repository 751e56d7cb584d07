"""`--help` of every command, in a terminal of 80 columns."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import typer

from mazebot.cli.app import app
from tests.cli.test_app import mazebot


def commands(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command and group, with the words that call it."""
    yield words, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from commands(inner, (*words, name))


COMMANDS = dict(commands(typer.main.get_command(app)))


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_nothing_is_cut_in_80_columns(words: tuple[str, ...]) -> None:
    shown = mazebot(*words, "--help", COLUMNS="80").stdout
    assert all(len(line) <= 80 for line in shown.splitlines())
    assert "…" not in shown
    unwrapped = "".join(shown.split())
    for param in COMMANDS[words].params:
        for name in (*param.opts, *param.secondary_opts) if param.opts[0].startswith("-") else ():
            assert name in shown
        text = getattr(param, "help", None)
        assert "".join((text or "").split()) in unwrapped
    for name in getattr(COMMANDS[words], "commands", {}):
        assert name in shown


def test_the_options_of_a_demo_are_in_groups_with_their_defaults() -> None:
    shown = mazebot("demo", "--help", COLUMNS="80").stdout
    titles = [line for line in shown.splitlines() if line.endswith(":") and line[0] != " "]
    assert titles == [
        "World:", "What the robot does:", "Settings:", "What is kept and shown:", "Options:",
    ]  # fmt: skip
    assert "[default: enhanced]" in " ".join(shown.split())
