"""Folders of runs, made by a real recorder from a run made by hand."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path
from typing import Any

from mazebot.common.messages import documents as doc
from mazebot.common.messages import topics as table
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.node import RecorderNode
from tests.recorder.synthetic import Bench, driving, opening, room


def made_run(folder: Path, seconds: float = 3.0, world: str = "room", **config: Any) -> Path:
    """A run of a robot that drives a circle and misses its goal; without a recording."""
    settings: dict[str, Any] = {"record": False, "out_dir": folder} | config
    node = RecorderNode(RecorderConfig.model_validate(settings), local_time=_when)
    bench = Bench(node)
    the_room = room(world)
    bench.say(opening(the_room))
    values = {"seed": 7, "controller_server": {"controller": "mppi"}}
    defaults = {"controller_server.controller": "regulated_pure_pursuit"}
    said = doc.Parameters(service="navigation", values=values, defaults=defaults)
    bench.say([(0, table.PARAMETERS, said)])
    bench.say(driving(the_room, seconds))
    bench.node.close()
    return folder


def _when() -> datetime:
    return datetime(2026, 11, 21, 12, 0, 0)  # noqa: DTZ001 - local


def listed_run(folder: Path, name: str, summary: object = None, **files: str) -> Path:
    """A folder with a summary and other files, whatever they hold."""
    run = folder / name
    run.mkdir(parents=True)
    if summary is not None:
        (run / "summary.json").write_text(json.dumps(summary))
    for file, text in files.items():
        (run / file.replace("_json", ".json")).write_text(text)
    return run
