"""Prints docs/recordings.md from the documents that a run writes."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import Any

from services.cli.pages.mcap_section import MCAP_ROW, MCAP_SECTION
from services.common.recordings.digests import HEAD, ROW, ROW_FIELDS
from services.common.recordings.run_folder import CONFIG, DIGESTS, LOCK, RECORDING, SUMMARY
from services.recorder.judging.summary import RunSummary
from services.recorder.keeping.map_folder import MAP_FOLDER, MAP_NAME, MARKERS, POSE_GRAPH_FILE

_HEAD = """# Recordings: what a run leaves

Generated from `services/recorder/` by `make generate`; do not edit.

Each run gets its own folder, `recordings/<local time>_<world>/` or the one given with `--out`:

| file | what |
| --- | --- |
"""

_FILES = (
    (
        RECORDING,
        "all messages, drawn: a [Rerun](https://rerun.io) recording on the timeline `sim_time`, "
        "simulation time; entities are named like the topics",
    ),
    MCAP_ROW,
    (SUMMARY, "the run in numbers, compared with the ground truth; its fields are listed below"),
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
)

_VIEWER = f"""
`{SUMMARY}` is rewritten every 5 s during the run, and at its end. Without recording
(`--no-record`) only `{SUMMARY}`, `{CONFIG}` and `{MAP_FOLDER}` are written. While its recorder is
alive, the folder also contains a locked file `{LOCK}`.

`mazebot recordings list` lists the runs, `mazebot recordings view` shows one in the browser.

## In the viewer

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

_DIGESTS = f"""
## digests.bin

One line of JSON (`head`: "{HEAD}", and the lists `topics` and `services`), and then {ROW.itemsize}
bytes per message, little-endian, in the order in which the recorder processed them.

| field | type | what |
| --- | --- | --- |
"""


def recordings_page() -> str:
    """Return the text of the page."""
    schema: dict[str, Any] = RunSummary.model_json_schema()
    definitions: dict[str, Any] = schema["$defs"]
    files = [f"| `{name}` | {about} |\n" for name, about in _FILES]
    tabs = [f"| {name} | {about} |\n" for name, about in _TABS]
    parts = [_HEAD, *files, _VIEWER, *tabs, _FIELDS, *_section("The run", schema)]
    for name in _in_use(schema, definitions):
        parts += _section(_title(name), definitions[name])
    rows = (f"| `{name}` | `{kind}` | {about} |\n" for name, kind, about in ROW_FIELDS)
    return "".join([*parts, MCAP_SECTION, _DIGESTS, *rows])


def _section(title: str, schema: dict[str, Any]) -> Iterator[str]:
    about = " ".join(schema.get("description", "").split())
    yield f"\n### {title}\n\n{about}\n\n| field | value | what |\n| --- | --- | --- |\n"
    for name, field in schema["properties"].items():
        what = " ".join(field["description"].split()).replace("|", "\\|")
        yield f"| `{name}` | {_kind(field)} | {what} |\n"


def _in_use(schema: dict[str, Any], definitions: dict[str, Any]) -> list[str]:
    """Names of the definitions, in the order of their first reference."""
    found: dict[str, None] = {}
    for field in schema["properties"].values():
        for name in _references(field):
            found |= dict.fromkeys([name, *_in_use(definitions[name], definitions)])
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
    if "$ref" in field:
        title = _title(field["$ref"].rpartition("/")[2])
        return f"[{title.lower()}](#{title.lower().replace(' ', '-')})"
    if "anyOf" in field:
        return " or ".join(map(_kind, field["anyOf"]))
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
            return "whole number"
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
