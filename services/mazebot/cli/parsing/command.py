"""Argument parsing and usage errors of all commands."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import typer
from pydantic import ValidationError
from typer.core import TyperCommand, TyperGroup

from mazebot.cli.parsing.help_text import write_commands, write_help, write_options
from mazebot.cli.parsing.poses import POSE_OPTIONS, are_numbers
from mazebot.common.config import ConfigError, must

_POSE_WORDS = 3
F = TypeVar("F", bound=Callable[..., Any])

# typer does not export click's UsageError.
UsageMistake: type[Exception] = typer.BadParameter.__mro__[1]


class Command(TyperCommand):
    """A command that accepts negative numbers as arguments, and refuses empty texts."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Move the arguments behind `--`, so that none is parsed as an option; then parse.

        Raises ConfigError where an option or an argument is an empty text, or an option that has
        one value is given again.
        """
        if ctx.resilient_parsing:
            # Incomplete arguments, for shell completion.
            return super().parse_args(ctx, args)
        named = {
            name: param
            for param in self.get_params(ctx)
            if param.param_type_name == "option"
            for name in (*param.opts, *param.secondary_opts)
        }
        takes = {
            name: 0 if getattr(param, "is_flag", False) else param.nargs
            for name, param in named.items()
        }
        seen: set[str | None] = set()
        options: list[str] = []
        arguments: list[str] = []
        waiting = list(reversed(args))
        while waiting:
            word = waiting.pop()
            if word == "--":
                arguments += reversed(waiting)
                break
            if word not in takes and (not word.startswith("-") or are_numbers(word)):
                arguments.append(word)
                continue
            name, equals, value = word.partition("=")
            count = 0 if equals else takes.get(word, 0)
            values = [waiting.pop() for _ in range(count) if waiting]
            if word in POSE_OPTIONS and values:
                # As many words as belong to the pose are one value.
                while waiting and _goes_on(values, waiting[-1], takes):
                    values.append(waiting.pop())
                values = [" ".join(values)]
            if len(values) < count:
                many = f"{count} values" if count > 1 else "a value"
                given = f"{' '.join(values)!r}: " if values else ""
                raise ConfigError(f"{word}: {given}must be followed by {many}")
            if "" in values or (equals and name in takes and not value):
                raise ConfigError(f"{name}: '': must not be empty")
            if takes.get(name) and not getattr(named[name], "multiple", False):
                if named[name].name in seen:
                    raise ConfigError(f"{name}: {' '.join(values) or value}: must be given once")
                seen.add(named[name].name)
            options += [word, *values]
        if "" in arguments:
            raise ConfigError(f"{ctx.command_path}: '': an argument must not be empty")
        return super().parse_args(ctx, [*options, *(["--", *arguments] if arguments else [])])

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """See `help_text`."""
        write_help(self, ctx, formatter)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """See `help_text`."""
        write_options(self, ctx, formatter)


class Group(TyperGroup):
    """A group of commands, with help as a Command has it."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """See `help_text`."""
        write_help(self, ctx, formatter)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """See `help_text`."""
        write_options(self, ctx, formatter)
        write_commands(self, ctx, formatter)


class App(typer.Typer):
    """A group of commands that prints its help if no command is given."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(invoke_without_command=True, cls=Group, **settings)
        self.callback()(overview)

    def command(  # type: ignore[override]
        self, name: str | None = None, *, cls: type[TyperCommand] = Command, **settings: Any
    ) -> Callable[[F], F]:
        """As typer's, with `Command` as the default class."""
        return super().command(name, cls=cls, **settings)


def overview(context: typer.Context) -> None:
    """Print the help of a group."""
    if context.invoked_subcommand is None:
        sys.stdout.write(context.get_help() + "\n")


def _goes_on(pose: Sequence[str], word: str, takes: Mapping[str, int]) -> bool:
    """Whether a word belongs to the pose that the words before it have begun."""
    is_whole = len(pose) == _POSE_WORDS or "," in pose[0]
    return not is_whole and word not in takes and (not word.startswith("-") or are_numbers(word))


def in_one_line(error: Exception) -> str:
    """The text of a UsageMistake: the option or argument, its value, and what is allowed."""
    mistake: Any = error
    param, context = getattr(mistake, "param", None), mistake.ctx
    if param is not None and isinstance(error.__cause__, ValidationError):
        first = error.__cause__.errors()[0]
        text = must(first["msg"])
        choices = text.partition(" is not one of ")[2].rstrip(".")
        text = f"must be one of {choices}" if choices else text
        is_option = param.param_type_name == "option"
        name = param.opts[0] if is_option else param.metavar or param.human_readable_name
        return f"{name.strip('[]')}: {first['input']!r:.80}: {text}"
    text = str(mistake.format_message()).rstrip(".")
    if context is None:
        return text
    commands = getattr(context.command, "commands", {})
    if "No such command" in text and "Did you mean" not in text:
        return f"{text}: must be one of {', '.join(commands)}"
    if "No such option" in text and "Possible" not in text:
        return f"{text}: see `{context.command_path} --help`"
    if "Did you mean" in text or "Possible" in text:
        return text
    return f"{text}. {' '.join(context.get_usage().split())}"
