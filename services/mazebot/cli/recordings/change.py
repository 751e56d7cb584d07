"""`mazebot recordings report|export|prune|repair|tag`."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import typer

from mazebot.cli.parsing.options import print_json
from mazebot.cli.parsing.outputs import refuse_inputs
from mazebot.cli.recordings.printing import info_row, print_table, size_text
from mazebot.common.config import ConfigError
from mazebot.common.recordings.catalog import RecordingInfo, find_run, list_recordings
from mazebot.common.recordings.labels import read_labels, relabelled, write_labels
from mazebot.common.recordings.mcap.mcap_records import McapError
from mazebot.common.recordings.mcap.mcap_scan import scan
from mazebot.common.recordings.retention import Kept, delete_rest, delete_run, to_delete
from mazebot.common.recordings.run_folder import LOCK, MESSAGES, parts_of


def make_reports(directory: Path, names: Sequence[str], as_json: bool) -> None:
    """Write report.html and thumbnail.png of runs, and print their paths.

    Raises ConfigError where one is no run, or a file cannot be written.
    """
    from mazebot.common.recordings.report.report import write_report  # noqa: PLC0415

    runs = [find_run("recordings report", directory, name) for name in names]
    files = [str(file) for run in runs for file in write_report(run.path)]
    if as_json:
        print_json({"files": files})
    else:
        sys.stdout.write("".join(f"{file}\n" for file in files))


def export_table(runs: Sequence[RecordingInfo], out: Path, goals: bool, as_json: bool) -> None:
    """Write one table of runs, or of their goals.

    Raises ConfigError where its name has no known suffix, or it cannot be written.
    """
    from mazebot.common.recordings.export import SUFFIXES, rows_of, write_table  # noqa: PLC0415

    if out.suffix not in SUFFIXES:
        raise ConfigError(f"--out: {out}: must end in {', '.join(SUFFIXES)}")
    rows = rows_of(runs, "goals" if goals else "runs")
    refuse_inputs("--out", (out,))
    write_table(out, rows)
    if as_json:
        print_json({"file": str(out), "rows": len(rows)})
    else:
        sys.stdout.write(f"{out}: {len(rows)} {'goals' if goals else 'runs'}\n")


def prune_runs(directory: Path, kept: Kept, dry_run: bool, yes: bool, as_json: bool) -> None:
    """Delete the runs beyond what is to be kept, after asking.

    Raises ConfigError where no limit is given, or there is no terminal for the confirmation.
    """
    if kept.is_all:
        raise ConfigError(
            "recordings prune: --keep-days, --keep-gb or --keep-last: must be given: "
            "otherwise nothing is deleted"
        )
    runs = list_recordings(directory)
    doomed = to_delete(runs, kept, datetime.now())  # noqa: DTZ005 - local, as folders are named
    size_bytes = sum(run.size_bytes for run in doomed)
    if not as_json:
        if not doomed:
            sys.stdout.write(f"nothing to delete: all {len(runs)} runs stay\n")
            return
        print_table(
            ("name", "world", "size MB"),
            [(run.name, run.world, size_text(run.size_bytes)) for run in doomed],
            right=("size MB",),
        )
        size_line = f"{len(doomed)} of {len(runs)} runs, {size_text(size_bytes)} MB"
        sys.stdout.write(f"{'would delete' if dry_run else 'to delete'}: {size_line}\n")
    problems = []
    if not dry_run and doomed:
        if not yes:
            if as_json or not sys.stdin.isatty():
                raise ConfigError(
                    "recordings prune: --yes: must be given if there is no terminal for the "
                    "question"
                )
            typer.confirm("delete them?", abort=True)
        delete_rest(directory)
        for run in doomed:
            try:
                delete_run(run.path)
            except ConfigError as error:
                problems.append(str(error))
    if as_json:
        rows = [info_row(run) for run in doomed]
        print_json({"runs": rows, "bytes": size_bytes, "deleted": not dry_run, "failed": problems})
    if problems:
        raise ConfigError(f"recordings prune: {'; '.join(problems)}")


def repair_runs(directory: Path, name: str | None, as_json: bool) -> None:
    """Repair the runs whose recorders were killed, or one of them.

    Raises ConfigError where it is no such run, or one cannot be repaired.
    """
    from mazebot.recorder.keeping.repair import Repair, leftovers  # noqa: PLC0415

    only = None
    if name is not None:
        run = find_run("recordings repair", directory, name)
        if run.state == "running":
            raise ConfigError(f"recordings repair: {run.path}: is being recorded; stop it first")
        if not (run.path / LOCK).exists() and not _cut_off(run.path):
            how = "is complete" if run.state == "ended" else "is repaired already"
            raise ConfigError(f"recordings repair: {run.path}: {how}: must be a run "
                              "whose recorder was killed, or that is truncated")  # fmt: skip
        # As a killed recorder leaves it.
        (run.path / LOCK).touch()
        directory, only = run.path.parent, run.path
    found = [folder for folder in leftovers(directory) if only in (None, folder)]
    if not as_json:
        logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    repair = Repair(directory, only)
    repair.repair_all()
    left = leftovers(directory)
    given_up = {file.parent for file in repair.unreadable}
    whole = [str(folder) for folder in found if folder not in left and folder not in given_up]
    waiting = [str(folder) for folder in found if folder in left]
    failed = [str(folder) for folder in found if folder in left or folder in given_up]
    if as_json:
        print_json({"repaired": whole, "failed": failed})
    elif not found:
        sys.stdout.write(f"nothing to repair in {directory}\n")
    else:
        sys.stdout.write("".join(f"{folder}: repaired\n" for folder in whole))
    problems = [f"{', '.join(waiting)}: no space, or in use"] if waiting else []
    if repair.unreadable:
        problems.append(f"{', '.join(map(str, repair.unreadable))}: cannot be read, left as it is")
    if problems:
        raise ConfigError(f"recordings repair: {'; '.join(problems)}")


def _cut_off(folder: Path) -> bool:
    """Whether a file of a run's messages lacks its end, as when copying it was broken off."""
    try:
        return not all(scan(part).is_whole for part in parts_of(folder, MESSAGES))
    except (McapError, OSError):
        return True


def tag_run(
    directory: Path,
    name: str,
    add: Sequence[str],
    remove: Sequence[str],
    note: str | None,
    as_json: bool,
) -> None:
    """Change the tags and the note of a run, and print them.

    Raises ConfigError where there is no such run, or a tag cannot be one.
    """
    folder = find_run("recordings tag", directory, name).path
    labels = read_labels(folder)
    if add or remove or note is not None:
        try:
            labels = relabelled(labels, tuple(add), tuple(remove), note)
        except ConfigError as error:
            raise ConfigError(f"recordings tag: {error}") from error
        write_labels(folder, labels)
    if as_json:
        print_json({"name": folder.name} | labels.model_dump(mode="json"))
        return
    tags = " ".join(labels.tags) or "none"
    sys.stdout.write(f"tags: {tags}\n" + (f"note: {labels.note}\n" if labels.note else ""))
