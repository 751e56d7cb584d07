"""The text of `--help`: options in groups, and nothing cut, however narrow the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_MOST_OF_A_SUMMARY = 1000
_GROUPS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "demo": {
        "World": (
            "--world", "--set", "--arg", "--path", "--worlds-dir", "--map", "--use_aruco",
            "--texture_base",
        ),
        "What the robot does": ("--goal", "--tour", "--slam", "--explore", "--controller"),
        "Settings": ("--seed", "--config", "--params", "--camera", "--renderer"),
        "What is kept and shown": (
            "--out", "--record", "--console", "--console-port", "--router-port", "--json",
        ),
    },
    "plan": {
        "Path": (
            "--start", "--goal", "--planner", "--tolerance", "--radius", "--cost-travel-multiplier",
            "--allow-reverse",
        ),
        "Map": (
            "--map", "--keepout", "--speed", "--inflation-radius", "--cost-scaling-factor",
            "--allow-unknown",
        ),
    },
}  # fmt: skip
"""Of a command with many options: their groups, in the order in which they are shown."""


def write_help(command: Any, context: Any, formatter: Any) -> None:
    """Usage, what the command does, and its arguments and options."""
    command.format_usage(context, formatter)
    command.format_help_text(context, formatter)
    command.format_options(context, formatter)


def write_options(command: Any, context: Any, formatter: Any) -> None:
    """Arguments, then the options by their groups, those without one last."""
    arguments = []
    options: dict[str, tuple[str, str]] = {}
    for param in command.get_params(context):
        record = param.get_help_record(context)
        if record is None:
            continue
        if param.param_type_name == "argument":
            arguments.append(record)
        else:
            options[param.opts[0]] = record
    grouped = {
        title: [options.pop(name) for name in names if name in options]
        for title, names in _GROUPS.get(command.name, {}).items()
    }
    titles = {"Arguments": arguments, **grouped, "Options": list(options.values())}
    for title, records in titles.items():
        if records:
            with formatter.section(title):
                formatter.write_dl(records)


def write_commands(group: Any, context: Any, formatter: Any) -> None:
    """The commands of a group, each with its first sentence."""
    commands = [(name, group.get_command(context, name)) for name in group.list_commands(context)]
    rows = [
        (name, command.get_short_help_str(_MOST_OF_A_SUMMARY))
        for name, command in commands
        if command is not None and not command.hidden
    ]
    if rows:
        with formatter.section("Commands"):
            formatter.write_dl(rows)
