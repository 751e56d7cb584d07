"""What a scenario is, and the row of figures of each of its trials."""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mazebot.common.config import merged
from mazebot.common.maths.frames import Array

Settings = dict[str, dict[str, Any]]
"""Sections of a settings file"""


@dataclass(frozen=True)
class Options:
    """What holds for all scenarios of a run of the benchmark."""

    camera: bool = True
    """Whether scenarios that use the camera may; else they are run by lidar alone."""
    settings: Path | None = None
    """A settings file for all services."""

    def with_settings(self, more: Settings) -> Options:
        """The same with more settings, which win over those of the file."""
        text = "" if self.settings is None else self.settings.read_text(encoding="utf-8")
        given: dict[str, Any] = yaml.safe_load(text or "{}")
        both = merged(given, more)
        path = scratch_folder() / f"settings_{zlib.crc32(repr(both).encode()):08x}.yaml"
        path.write_text(yaml.safe_dump(both), encoding="utf-8")
        return Options(self.camera, path)


@functools.cache
def scratch_folder() -> Path:
    """A folder for worlds and settings, removed at the end of the process."""
    folder = Path(tempfile.mkdtemp(prefix="mazebot-bench-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@dataclass
class Row:
    """One trial. All figures are of the ground truth; None where there was nothing to measure."""

    scenario: str
    world: str
    seed: int
    trial: int
    success: bool = False
    """The verdict by the scenario's own rule; for most: `reached` without a contact of the robot's
    making."""
    reached: bool = False
    """Navigation reported success, and the true pose was within 0.25 m and 0.25 rad of the goal."""
    error_code: int | None = None
    error_msg: str = ""
    time_s: float = 0.0
    driven_m: float = 0.0
    shortest_m: float | None = None
    spl: float | None = None
    contacts_robot: int = 0
    """Episodes in which the robot moved toward the thing faster than 0.02 m/s."""
    contacts_other: int = 0
    min_clearance_m: float | None = None
    clearance_p05_m: float | None = None
    jerk_m_s3: float | None = None
    jerk_rad_s3: float | None = None
    irregularity_rad_m: float | None = None
    recoveries: int = 0
    localisation_mean_m: float | None = None
    localisation_p95_m: float | None = None
    localisation_mean_deg: float | None = None
    localisation_p95_deg: float | None = None
    consistency: float | None = None
    """Share of the claimed poses whose 95 % ellipse holds the true pose."""
    alarms: int = 0
    """Times that localisation gave up a pose that had been right for a while."""
    barn: float = 0.0
    barn_own_speed: float = 0.0
    goal_error_m: float | None = None
    extra: dict[str, Any] = field(default_factory=dict)
    """What only this scenario measures."""
    skipped: str = ""
    """Why it was not run."""
    way: Array = field(default_factory=lambda: np.empty((0, 2)), repr=False)
    """(n, 2) true places at 10 Hz, for the plots; not in the JSON."""
    touches: Array = field(default_factory=lambda: np.empty((0, 2)), repr=False)
    """(n, 2) places of contacts, for the plots"""
    scene: tuple[Array, ...] = field(default=(), repr=False)
    """Outlines of what stood in the world, for the plots; of a run's first trial only"""
    errors_m: Array = field(default_factory=lambda: np.empty(0), repr=False)
    errors_rad: Array = field(default_factory=lambda: np.empty(0), repr=False)


RunSeed = Callable[[str, int, Options], list[Row]]
"""Runs one seed of the scenario of this name: one row for each trial."""


@dataclass(frozen=True)
class Scenario:
    """A kind of trial, and how many seeds of it are run."""

    name: str
    about: str
    run: RunSeed
    seeds: int
    """In a full run"""
    few: int
    """In the default run; 0: not part of it"""
    required: str = ""
    """What a full run has to show"""


def skipped(scenario: str, seed: int, why: str) -> list[Row]:
    """The row of a scenario that cannot be run."""
    return [Row(scenario, "", seed, 0, skipped=why)]
