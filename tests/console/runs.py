"""Folders of runs as a recorder leaves them, without a recorder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mazebot.common.recordings.run_folder import SERIES, SUMMARY

WORLDS = ("sim_house", "maze", "office")


def summary(number: int = 0, **changes: Any) -> dict[str, Any]:
    """What the summary of a run says, different for each number."""
    error_m = 0.01 + 0.001 * (number % 50)
    goals = [
        {
            "name": f"location{goal + 1}",
            "reached": number % 7 != 0 or goal < 2,
            "time_s": 10.0,
            "path_length_m": 3.0,
            "goal_error_m": 0.02,
            "recoveries": 0,
            "error_msg": "" if number % 7 else "no way",
        }
        for goal in range(3)
    ]
    return {
        "world": WORLDS[number % len(WORLDS)],
        "world_hash": "00aa",
        "seed": number,
        "sim_time_s": 60.0 + number % 30,
        "real_time_factor": 5.0,
        "goals": goals,
        "goals_sent": 3,
        "goals_reached": sum(bool(goal["reached"]) for goal in goals),
        "contacts": {"count": 0, "list": []},
        "localisation_error_m": {"mean": error_m, "p95": 2.0 * error_m, "max": 3.0 * error_m},
        "distance_m": 20.0,
        "mapping": None,
        "changed_settings": {
            "navigation.global_costmap.inflation_layer.inflation_radius": {
                "value": 0.4,
                "default": 0.55,
            }
        }
        if number % 3 == 0
        else {},
        **changes,
    }


def series(**changes: Any) -> dict[str, Any]:
    """What the series of a run says: a way along x, with an event in its middle."""
    time_s = [0.1 * step for step in range(100)]
    zeros = [0.0] * len(time_s)
    motion = {"time_s": time_s, "x_m": time_s, "y_m": zeros, "yaw_rad": zeros}
    return {
        "world": "sim_house",
        "world_hash": "00aa",
        "sim_time_s": 10.0,
        "truth": {**motion, "speed_m_s": [1.0] * len(time_s), "yaw_rate_rad_s": zeros},
        "estimate": {**motion, "error_m": [0.01] * len(time_s), "error_rad": zeros},
        "start": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0},
        "events": [
            {"time_s": 5.0, "kind": "goal", "text": "location1: reached", "x_m": 5.0, "y_m": 0.0}
        ],
        "solid": [[[-1.0, -1.0], [11.0, -1.0], [11.0, 1.0], [-1.0, 1.0]]],
        **changes,
    }


def make_run(
    recordings: Path, name: str, said: Mapping[str, Any] | None = None, with_series: bool = False
) -> Path:
    """A run that has ended."""
    folder = recordings / name
    folder.mkdir(parents=True)
    (folder / SUMMARY).write_text(json.dumps(summary() if said is None else said))
    (folder / "run.rrd").write_bytes(b"RRF2" + bytes(range(256)) * 8)
    if with_series:
        (folder / SERIES).write_text(json.dumps(series()))
    return folder


def make_many(recordings: Path, count: int) -> None:
    """Runs of different worlds and results; of each only its summary."""
    for number in range(count):
        day, hour, minute = number // 1440 + 1, number // 60 % 24, number % 60
        said = summary(number)
        name = f"2026-01-{day:02d}_{hour:02d}-{minute:02d}-00_{said['world']}"
        make_run(recordings, name, said)
