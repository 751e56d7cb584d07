"""The commands `mazebot recordings ...`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mazebot.cli.parsing.command import App
from mazebot.cli.parsing.completion import run_names, tag_names, world_names
from mazebot.cli.parsing.options import Json
from mazebot.cli.recordings.selection import SortKey, chosen_runs, folder_of
from mazebot.recorder.config import LayoutName

app = App(help="List, view, compare, export and clean up the recordings of runs.")

RecordingsDir = Annotated[
    Path | None, typer.Option("--dir", help="folder of recordings [default: ./recordings]")
]
RunName = Annotated[
    str,
    typer.Argument(
        metavar="RUN", help="its folder, its name, or `latest`", autocompletion=run_names
    ),
]
_World = Annotated[
    str | None,
    typer.Option(
        help="of this world, or of those whose names contain this", autocompletion=world_names
    ),
]
_Tags = Annotated[
    list[str] | None, typer.Option("--tag", help="with this tag", autocompletion=tag_names)
]
_Failed = Annotated[bool, typer.Option("--failed", help="where a goal was not reached")]
_Since = Annotated[
    str | None, typer.Option(help="started since 2026-11-20, 2026-11-20T14:30, 7d, 12h or 90min")
]


@app.command("list")
def list_runs(
    directory: RecordingsDir = None,
    world: _World = None,
    tag: _Tags = None,
    failed: _Failed = False,
    since: _Since = None,
    sort: Annotated[SortKey, typer.Option(help="sort by this")] = "started",
    reverse: Annotated[bool, typer.Option("--reverse", help="reverse the order")] = False,
    as_json: Json = False,
) -> None:
    """List the runs, newest first."""
    from mazebot.cli.recordings.tell import print_runs  # noqa: PLC0415

    folder = folder_of(directory)
    runs = chosen_runs(folder, world, tag or (), failed, since, sort, reverse)
    print_runs(folder, runs, as_json)


@app.command()
def info(name: RunName, directory: RecordingsDir = None, as_json: Json = False) -> None:
    """Print the information about a run: figures, changed settings, files."""
    from mazebot.cli.recordings.tell import print_run  # noqa: PLC0415

    print_run(folder_of(directory), name, as_json)


@app.command()
def view(
    name: Annotated[
        str,
        typer.Argument(
            metavar="[RUN]", help="its folder, its name, or `latest` [default: latest]",
            autocompletion=run_names,
        ),
    ] = "",
    directory: RecordingsDir = None,
    port: Annotated[int, typer.Option(min=1, max=65534, help="port of the web viewer")] = 9090,
    open_browser: Annotated[
        bool, typer.Option("--open", help="open it in a browser, if this machine has one")
    ] = False,
    layout: Annotated[
        LayoutName | None, typer.Option(help="what to show [default: that of the run]")
    ] = None,
) -> None:  # fmt: skip
    """Serve a run (by default the newest one) to a browser."""
    from mazebot.cli.recordings.view import view_run  # noqa: PLC0415

    view_run(folder_of(directory), name, port, open_browser, layout)


@app.command()
def compress(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[RUN...]", help="only these [default: all that have no videos yet]",
            autocompletion=run_names,
        ),
    ] = None,
    directory: RecordingsDir = None,
    as_json: Json = False,
) -> None:  # fmt: skip
    """Compress the images of runs to videos."""
    from mazebot.cli.recordings.compress import compress_runs  # noqa: PLC0415

    raise typer.Exit(compress_runs(folder_of(directory), names or [], as_json))


@app.command()
def report(
    names: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN...", help="its folder, its name, or `latest`", autocompletion=run_names
        ),
    ],
    directory: RecordingsDir = None,
    as_json: Json = False,
) -> None:
    """Write report.html and thumbnail.png of runs again, also of running and killed ones."""
    from mazebot.cli.recordings.change import make_reports  # noqa: PLC0415

    make_reports(folder_of(directory), names, as_json)


@app.command()
def compare(
    names: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN RUN...", help="the others are compared with the first",
            autocompletion=run_names,
        ),
    ],
    directory: RecordingsDir = None,
    messages: Annotated[
        bool, typer.Option("--messages/--no-messages", help="report where their messages differ")
    ] = True,
    as_json: Json = False,
) -> None:  # fmt: skip
    """Compare runs: the settings that differ, the figures, and the messages as `mazebot diff`.

    The exit code is 1 where the files of a run are cut, missing or another run's.
    """
    from mazebot.cli.recordings.tell import print_comparison  # noqa: PLC0415

    raise typer.Exit(print_comparison(folder_of(directory), names, messages, as_json))


@app.command()
def export(
    out: Annotated[Path, typer.Option(help="a file *.parquet, *.csv or *.json")],
    directory: RecordingsDir = None,
    goals: Annotated[
        bool, typer.Option("--goals", help="one row per goal instead of per run")
    ] = False,
    world: _World = None,
    tag: _Tags = None,
    failed: _Failed = False,
    since: _Since = None,
    as_json: Json = False,
) -> None:
    """Write one table of all runs, one row per run: figures, versions and changed settings."""
    from mazebot.cli.recordings.change import export_table  # noqa: PLC0415

    runs = chosen_runs(folder_of(directory), world, tag or (), failed, since)
    export_table(runs, out, goals, as_json)


@app.command()
def prune(
    directory: RecordingsDir = None,
    keep_days: Annotated[
        float | None, typer.Option(min=0.0, help="delete runs that started longer ago")
    ] = None,
    keep_gb: Annotated[
        float | None,
        typer.Option(min=0.0, help="delete the oldest until the total size is at most this, GiB"),
    ] = None,
    keep_last: Annotated[
        int | None,
        typer.Option(
            min=0, help="keep this number of newest runs in any case; alone: delete all others"
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="only list what would be deleted")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="do not ask for confirmation")] = False,
    as_json: Json = False,
) -> None:
    """Delete old runs; never one with the tag `keep`, nor one that is still being recorded."""
    from mazebot.cli.recordings.change import prune_runs  # noqa: PLC0415
    from mazebot.common.recordings.retention import Kept  # noqa: PLC0415

    kept = Kept(days=keep_days, gib=keep_gb, last=keep_last)
    prune_runs(folder_of(directory), kept, dry_run, yes, as_json)


@app.command()
def repair(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="RUN", help="only this one [default: all of the folder]",
            autocompletion=run_names,
        ),
    ] = None,
    directory: RecordingsDir = None,
    as_json: Json = False,
) -> None:  # fmt: skip
    """Repair the recordings of killed recorders, as the next recorder would."""
    from mazebot.cli.recordings.change import repair_runs  # noqa: PLC0415

    repair_runs(folder_of(directory), name, as_json)


@app.command()
def tag(
    name: RunName,
    tags: Annotated[
        list[str] | None,
        typer.Argument(metavar="[TAG...]", help="tags to add", autocompletion=tag_names),
    ] = None,
    remove: Annotated[
        list[str] | None, typer.Option(help="a tag to remove", autocompletion=tag_names)
    ] = None,
    note: Annotated[
        str | None, typer.Option(help="the note; `-` removes it")
    ] = None,
    directory: RecordingsDir = None,
    as_json: Json = False,
) -> None:  # fmt: skip
    """Add tags to a run, remove some, set its note; without any: print them."""
    from mazebot.cli.recordings.change import tag_run  # noqa: PLC0415

    text = "" if note == "-" else note
    tag_run(folder_of(directory), name, tags or (), remove or (), text, as_json)
