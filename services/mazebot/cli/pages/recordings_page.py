"""Prints docs/recordings.md from the documents that a run writes."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import Any

from mazebot.cli.pages.mcap_section import MCAP_ROW, MCAP_SECTION
from mazebot.common.messages.documents import Document
from mazebot.common.recordings.comparing.digests import HEAD, ROW, ROW_FIELDS
from mazebot.common.recordings.labels import KEEP, Labels
from mazebot.common.recordings.run_folder import (
    CONFIG,
    DIGESTS,
    LABELS,
    LOCK,
    MESSAGES,
    RECORDING,
    REPORT,
    SERIES,
    SUMMARY,
    THUMBNAIL,
)
from mazebot.common.recordings.series import RunSeries
from mazebot.common.recordings.summary import RunSummary
from mazebot.recorder.keeping.run.map_folder import (
    MAP_FOLDER,
    MAP_NAME,
    MARKERS,
    POSE_GRAPH_FILE,
    SAVED_MAPS,
)

_HEAD = """# Recordings: what a run leaves

Generated from `services/mazebot/recorder/` by `make generate`; do not edit.

Each run gets its own folder, `recordings/<local time>_<world>/` or the one given with `--out`:

| file | what |
| --- | --- |
"""

_FILES = (
    (
        RECORDING,
        "all messages, drawn: a [Rerun](https://rerun.io) recording on the timeline `sim_time`, "
        "simulation time; entities are named like the topics. That of a long run goes on in "
        "`run_2.rrd` and so on, after some ten minutes each: `mazebot recordings view` and the "
        "console show them as one",
    ),
    MCAP_ROW,
    (
        SUMMARY,
        "the run in numbers, compared with the ground truth; its fields are listed below, and in "
        "[summary.schema.json](schemas/summary.schema.json)",
    ),
    (
        SERIES,
        "the run over time, in tables of bounded length, and the plan of its world "
        "([series.schema.json](schemas/series.schema.json)): what the report, the console and the "
        "comparison of runs draw",
    ),
    (
        REPORT,
        "one page without scripts, which needs nothing else: plan with true and estimated path, "
        "goals, errors, speed, costs of each service, events, changed settings, versions and "
        "hardware. It can be printed",
    ),
    (THUMBNAIL, "the plan with the path, goals reached in green and missed in red, 320 x 240"),
    (
        LABELS,
        "tags and a note, if someone has written any "
        "([labels.schema.json](schemas/labels.schema.json))",
    ),
    (
        CONFIG,
        "the requested world, the world that ran and its hash, the seed, and every parameter of "
        "every service",
    ),
    (
        DIGESTS,
        "a hash of each message, by which `mazebot diff` finds the first one in which two runs "
        "differ",
    ),
    (
        MAP_FOLDER,
        f"of a run in which the robot makes the map ([mapping](mapping.md)): `{MAP_NAME}.yaml` and "
        f"`{MAP_NAME}.pgm` for Nav2's map_server, the markers in `{MARKERS}`, and the pose graph "
        f"in `{POSE_GRAPH_FILE}`; each is at most 5 s old at any time of the run",
    ),
    (SAVED_MAPS, "the maps that `/map_saver/save_map` was asked for ([ROS 2](ros2.md#services))"),
)

_VIEWER = f"""
`{SUMMARY}` and `{SERIES}` are rewritten every 5 s during the run, and at its end; `{REPORT}` and
`{THUMBNAIL}` are written at the end. Without recording (`--no-record`) only `{SUMMARY}`,
`{SERIES}`, `{CONFIG}`, `{MAP_FOLDER}` and `{SAVED_MAPS}` are written. While its recorder is
alive, the folder also contains a locked file `{LOCK}`.

A run whose recorder was killed is `interrupted`, and stays so when its files have been repaired: it
counts as failed, and a goal that was under way as not reached. Where the disk
had no room for all messages, or a recorder has died and another went on with the run, `list`,
`info`, `compare`, the report and the console say how many of them `{MESSAGES}` holds.

## Commands

Each takes `--dir` for another folder than `./recordings`, and `--json` where it prints data. A run
is named by its folder or its name, or `latest`.

| command | what it does |
| --- | --- |
"""

_COMMANDS = (
    (
        "list",
        "lists the runs, newest first; `--world`, `--tag`, `--failed`, `--since 7d` choose some, "
        "`--sort error` sorts them. A summary that cannot be read is reported in its row",
    ),
    (
        "info RUN",
        "prints the figures of a run, its changed settings and its files, and what these lack or "
        "have of another run: a copy may be cut or mixed up",
    ),
    ("view RUN", "shows a run in the browser, by default the newest one"),
    (
        "report RUN...",
        f"writes `{REPORT}` and `{THUMBNAIL}` again: of a run without a recording, of one that "
        "is in progress, or of one whose recorder was killed",
    ),
    (
        "compare RUN RUN...",
        "prints the settings that differ, the figures of each run with their differences from the "
        "first one's, and the result of [`mazebot diff`](simulation.md) for their messages; "
        "the exit code is 1 where the files of a run are cut, missing or another run's, as that of "
        "`mazebot diff`",
    ),
    (
        "export --out FILE",
        "writes one table of all runs as Parquet, CSV or JSON: one row per run, nested "
        "names joined by dots (`localisation_error_m.p95`, "
        "`settings.navigation.controller_server.controller`); with `--goals` a row a goal",
    ),
    (
        "prune",
        "deletes the runs beyond `--keep-days`, `--keep-gb` and `--keep-last`, after asking; "
        "`--dry-run` only lists them. A run that is being recorded or is yet to be repaired, or "
        f"with the tag `{KEEP}`, stays. "
        "The recorder does the same by itself with `keep_days` and `keep_gib` "
        "([parameters](parameters.md))",
    ),
    (
        "repair [RUN]",
        "repairs the recordings of killed recorders, as the next recorder would; of a named "
        "run also truncated messages, for example by an interrupted copy",
    ),
    (
        "tag RUN TAG...",
        "adds tags; `--remove TAG` removes one, `--note` sets the note. Without any, prints them",
    ),
)

_IN_THE_VIEWER = """
The names of runs and tags are completed by the shell after `mazebot --install-completion`.

## In the viewer

There is a layout for each purpose: see [the viewer](viewer.md).

| tab | shows |
| --- | --- |
"""

_TABS = (
    (
        "mapping",
        "only where the robot makes the map: the map as it grows, the walls that the lidar can "
        "see in green, the pose graph with its keyframes in blue, its loops in bright green and "
        "its markers as axes, frontiers, and the robot as in Maze; with plots of how much is "
        "mapped, of the frontiers and of the graph",
    ),
    (
        "Maze",
        "the world from above and south. The robot model is at the true pose, an orange outline "
        "at the estimated pose, each with its driven path; costmap, scan, particles, plan and goal",
    ),
    (
        "Map",
        "the world from straight above, as in RViz: x to the right, y up. The occupancy map, "
        "the costmap in RViz's colours, the controller's rollouts, the names of locations and "
        "rooms, the robot as above",
    ),
    ("Behavior tree", "the tree that runs, each node marked with its newest answer"),
    ("Camera, Depth", "the camera's images; detected markers are outlined"),
    ("Events", "events to jump to: goals, contacts, recoveries, new markers, faults"),
    ("Log", "each line of `/rosout` and each change of `/diagnostics`"),
    ("States", "the state of each service, of localisation and of navigation over time"),
    (
        "Results",
        "the table that the tour prints: the finished goals and other actions, the run's errors; "
        "where the robot makes the map, the map's figures",
    ),
    (
        "the plots",
        "the whole run. A line has a gap where nothing was measured: the marker's error has no "
        "value while no marker is detected",
    ),
)

_FIELDS = """
## summary.json

Lengths are in m, angles in rad, times in s, in the frame `map`. A value that was not measured is
`null`, never 0.
"""

_SERIES = """
## series.json

Units and frames as in summary.json. A table has at most 2,000 rows: when it is full, every second
one is left out, and from then on rows are taken half as often.
"""

_LABELS = """
## labels.json
"""

_DIGESTS = f"""
## digests.bin

One line of JSON (`head`: "{HEAD}", and the lists `topics` and `services`), and then {ROW.itemsize}
bytes per message, little-endian, in the order in which the recorder processed them.

| field | type | what |
| --- | --- | --- |
"""


def recordings_page() -> str:
    """Return the text of the page."""
    files = [f"| `{name}` | {about} |\n" for name, about in _FILES]
    commands = [f"| `mazebot recordings {name}` | {about} |\n" for name, about in _COMMANDS]
    tabs = [f"| {name} | {about} |\n" for name, about in _TABS]
    rows = (f"| `{name}` | `{kind}` | {about} |\n" for name, kind, about in ROW_FIELDS)
    documented: set[str] = set()
    return "".join(
        [
            *(_HEAD, *files, _VIEWER, *commands, _IN_THE_VIEWER, *tabs),
            *(_FIELDS, *_document("The run", RunSummary, documented)),
            *(_SERIES, *_document("The run over time", RunSeries, documented)),
            *(_LABELS, *_document("Tags and note", Labels, documented)),
            *(MCAP_SECTION, _DIGESTS, *rows),
        ]
    )


def _document(title: str, model: type[Document], documented: set[str]) -> Iterator[str]:
    """The fields of a document, and of those in it that are not yet documented."""
    schema: dict[str, Any] = model.model_json_schema()
    definitions: dict[str, Any] = schema.get("$defs", {})
    yield from _section(title, schema)
    for name in _in_use(schema, definitions):
        if name not in documented and definitions[name].get("properties"):
            documented.add(name)
            yield from _section(_title(name), definitions[name])


def _section(title: str, schema: dict[str, Any]) -> Iterator[str]:
    about = " ".join(schema.get("description", "").split())
    yield f"\n### {title}\n\n{about}\n\n| field | value | what |\n| --- | --- | --- |\n"
    for name, field in schema["properties"].items():
        what = " ".join(field.get("description", "").split()).replace("|", "\\|")
        yield f"| `{name}` | {_kind(field)} | {what} |\n"


def _in_use(schema: dict[str, Any], definitions: dict[str, Any]) -> list[str]:
    """Names of the definitions, in the order of their first reference."""
    found: dict[str, None] = {}
    for field in schema["properties"].values():
        for name in _references(field):
            # Any JSON value refers to itself.
            inner = definitions[name] if definitions[name].get("properties") else {}
            found |= dict.fromkeys([name, *(_in_use(inner, definitions) if inner else ())])
    return list(found)


def _references(node: object) -> Iterator[str]:
    if isinstance(node, dict):
        if "$ref" in node:
            yield node["$ref"].rpartition("/")[2]
        for value in node.values():
            yield from _references(value)
    elif isinstance(node, list):
        for value in node:
            yield from _references(value)


def _title(name: str) -> str:
    """`ErrorStatistics` as `Error statistics`."""
    words = "".join(f" {letter}" if letter.isupper() else letter for letter in name)
    return words.strip().capitalize()


def _kind(field: dict[str, Any]) -> str:
    """The type of a field, in words."""
    if field.get("$ref", "").endswith("/JsonValue") or not field:
        return "any"
    if "$ref" in field:
        title = _title(field["$ref"].rpartition("/")[2])
        return f"[{title.lower()}](#{title.lower().replace(' ', '-')})"
    if "anyOf" in field:
        return " or ".join(map(_kind, field["anyOf"]))
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return ", ".join(f"`{value}`" for value in field["enum"])
    match field["type"]:
        case "array" if "prefixItems" in field:
            return f"[{len(field['prefixItems'])} x {_one_of(map(_kind, field['prefixItems']))}]"
        case "array":
            return f"list of {_kind(field['items'])}"
        case "object":
            return f"mapping of names to {_kind(field['additionalProperties'])}"
        case "number":
            return "number"
        case "integer":
            return "integer"
        case "boolean":
            return "`true`, `false`"
        case "null":
            return "`null`"
        case _:
            return "text"


def _one_of(kinds: Iterable[str]) -> str:
    return " or ".join(dict.fromkeys(kinds))


if __name__ == "__main__":
    sys.stdout.write(recordings_page())
