"""Marker detection against the truth: recall, wrong ids and pose error by range and angle."""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table

from mazebot.bench.parts.blank_pictures import blank_pictures
from mazebot.bench.parts.perception_views import TrueMarker, View, Viewer
from mazebot.common.maths.frames import pose_matrix
from mazebot.common.messages.documents import MarkerEntity
from mazebot.perception.config import PerceptionConfig
from mazebot.perception.find import Found, MarkerFinder
from mazebot.perception.pose import Camera
from mazebot.physics.camera.camera import Intrinsics

WORLDS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("sim_house_markers", ()),
    ("sim_house_rooms", ()),
    ("maze", ("maze.cell_m=1.5", "marker_cover={share: 0.9}")),
    ("maze_rooms", ("maze.cell_m=1.5", "marker_cover={share: 0.9}")),
)
RANGES_M = (0.6, 1.0, 2.0, 3.0, 4.0)
ANGLES_DEG = (0.0, 20.0, 40.0, 60.0)
BINS = tuple(
    ((near, far), (math.radians(straight), math.radians(oblique)))
    for near, far in pairwise(RANGES_M)
    for straight, oblique in pairwise(ANGLES_DEG)
)
VIEW_SHARE = 12
"""Pictures without markers for each one with markers, which is judged in each condition."""
KNOWN_WORLD = "sim_house_markers"
"""Its ids are those that could be used wrongly in pictures without markers."""
WRONG_PLACE = 0.2
"""Share of the range beyond which a marker's position is taken for a wrong detection."""

Grey = NDArray[np.uint8]
Figures = dict[str, Any]


def _dim(grey: Grey, generator: np.random.Generator) -> Grey:
    return _bytes(0.15 * grey + 20.0 + generator.normal(0.0, 1.5, grey.shape))


def _shaded(grey: Grey, generator: np.random.Generator) -> Grey:
    light = np.linspace(0.1, 1.0, grey.shape[1])
    return _bytes(grey * light + generator.normal(0.0, 1.5, grey.shape))


def _noisy(grey: Grey, generator: np.random.Generator) -> Grey:
    return _bytes(grey + generator.normal(0.0, 10.0, grey.shape))


def _moving(grey: Grey, _: np.random.Generator) -> Grey:
    return np.asarray(cv2.filter2D(grey, -1, np.full((1, 5), 0.2, np.float32)), np.uint8)


CONDITIONS: dict[str, Callable[[Grey, np.random.Generator], Grey]] = {
    "as rendered": lambda grey, _: grey,
    "noise of 10 grey levels": _noisy,
    "contrast of 38 grey levels": _dim,
    "shaded to a tenth": _shaded,
    "motion blur of 5 px": _moving,
}


@dataclass(frozen=True)
class _Row:
    """One marker in view, and what was found of it."""

    truth: TrueMarker
    found: bool
    position_error: float = math.nan
    """As a share of the range."""
    turn_error_rad: float = math.nan


def perception_figures(pictures: int, seed: int) -> Figures:
    """Measure detection on pictures without markers, and on a twelfth as many with markers.

    Args:
        pictures: number of pictures without markers.
        seed: of the poses and pictures.

    Returns:
        JSON values: `recall` and `position_error_p95` (share of the range) of the pictures as
        rendered, `bins` by range and angle, `conditions` by name, `wrong_ids`, and `detect_ms`, the
        processor time for a picture (median and 90th percentile).
    """
    rows, wrong_places, taken_ms = _measure_views(max(pictures // VIEW_SHARE, 1), seed)
    blank = _measure_blank(pictures, seed)
    plain = rows["as rendered"]
    return {
        "pictures_with_markers": max(pictures // VIEW_SHARE, 1),
        "pictures_without_markers": pictures,
        **_summary(plain),
        "bins": _bins(plain),
        "conditions": {name: _summary(some) for name, some in rows.items()},
        "wrong_ids": {**blank, "in_pictures_with_markers": wrong_places},
        "detect_ms": {
            name: [round(float(p), 2) for p in np.percentile(some, (50, 90))]
            for name, some in taken_ms.items()
            if some
        },
    }


def _measure_views(
    count: int, seed: int
) -> tuple[dict[str, list[_Row]], int, dict[str, list[float]]]:
    """Rows by condition, how often a marker was found where there is none, and times in ms."""
    generator = np.random.default_rng(seed)
    rows: dict[str, list[_Row]] = {name: [] for name in CONDITIONS}
    taken_ms: dict[str, list[float]] = {name: [] for name in CONDITIONS}
    wrong = 0
    for number, (world, overrides) in enumerate(WORLDS):
        with closing(Viewer(world, overrides)) as viewer:
            finder = _finder(viewer.markers)
            camera = camera_of(viewer.intrinsics)
            for index in range(number, count, len(WORLDS)):
                # Far and oblique views as often as others, where the world has them.
                # Few pictures have all ranges and angles as well: 5 and 12 share no factor.
                wanted = BINS[(5 * (index // len(WORLDS)) + 3 * number) % len(BINS)]
                pose = viewer.pose_before_a_marker(generator, *wanted)
                view = viewer.look(pose or viewer.random_pose(generator))
                grey = np.asarray(cv2.cvtColor(view.rgb, cv2.COLOR_RGB2GRAY), np.uint8)
                for name, change in CONDITIONS.items():
                    changed = change(grey, generator)
                    finder.forget_picture()
                    start_s = time.thread_time()
                    found = finder.find(changed, camera, viewer.base_from_optical).found
                    taken_ms[name].append((time.thread_time() - start_s) * 1e3)
                    some, strange = _evaluate(view, found)
                    rows[name] += some
                    wrong += strange
    return rows, wrong, taken_ms


def _evaluate(view: View, found: Sequence[Found]) -> tuple[list[_Row], int]:
    """A row for each marker in view, and the number of detections that are none of these."""
    wrong = sum(one.marker_id not in view.partly for one in found)
    by_id = {one.marker_id: one for one in found}
    rows = []
    for truth in view.in_view:
        one = by_id.get(truth.marker.marker_id)
        if one is None:
            rows.append(_Row(truth, False))
            continue
        pose = one.solutions[0].camera_from_marker
        off_m = float(np.linalg.norm(pose[:3, 3] - truth.camera_from_marker[:3, 3]))
        cosine = float(pose[:3, 2] @ truth.camera_from_marker[:3, 2])
        turn_rad = math.acos(min(max(cosine, -1.0), 1.0))
        rows.append(_Row(truth, True, off_m / truth.range_m, turn_rad))
        wrong += off_m > WRONG_PLACE * truth.range_m
    return rows, wrong


def _measure_blank(count: int, seed: int) -> Figures:
    """What is found where there is nothing."""
    with closing(Viewer(KNOWN_WORLD)) as viewer:
        finder, floor_from_camera = _finder(viewer.markers), viewer.base_from_optical
        camera = camera_of(viewer.intrinsics)
    used: Counter[str] = Counter()
    unknown: Counter[str] = Counter()
    misplaced: Counter[str] = Counter()
    shown: Counter[str] = Counter()
    taken_ms = []
    for kind, grey in blank_pictures(count, np.random.default_rng((seed, 1))):
        start_s = time.thread_time()
        findings = finder.find(grey, camera, floor_from_camera)
        taken_ms.append((time.thread_time() - start_s) * 1e3)
        shown[kind] += 1
        used[kind] += len(findings.found)
        unknown[kind] += len(findings.unknown)
        misplaced[kind] += len(findings.misplaced)
    return {
        "used": used.total(),
        "unknown_to_the_world": unknown.total(),
        "misplaced": misplaced.total(),
        "by_kind": {
            kind: {
                "pictures": number,
                "used": used[kind],
                "unknown_to_the_world": unknown[kind],
                "misplaced": misplaced[kind],
            }
            for kind, number in shown.items()
        },
        "detect_ms": [round(float(p), 2) for p in np.percentile(taken_ms or [0.0], (50, 90))],
    }


def camera_of(intrinsics: Intrinsics) -> Camera:
    """A simulated camera's intrinsics as perception takes them."""
    of = intrinsics
    matrix = np.array([[of.fx, 0.0, of.cx], [0.0, of.fy, of.cy], [0.0, 0.0, 1.0]])
    return Camera(matrix, np.zeros(5))


def _finder(markers: Sequence[MarkerEntity]) -> MarkerFinder:
    finder = MarkerFinder(PerceptionConfig())
    for one in markers:
        finder.register(one.dictionary, one.marker_id, one.marker_size_m, pose_matrix(one))
    return finder


def _summary(rows: Sequence[_Row]) -> Figures:
    whole = [row for row in rows if row.truth.whole_panel]
    cut = [row for row in rows if not row.truth.whole_panel]
    found = [row for row in rows if row.found]
    return {
        "markers_in_view": len(whole),
        "recall": _recall(whole),
        "quiet_zone_cut_off": len(cut),
        "recall_quiet_zone_cut_off": _recall(cut),
        "position_error_p50": _percentile([row.position_error for row in found], 50),
        "position_error_p95": _percentile([row.position_error for row in found], 95),
        "normal_error_p95_deg": _percentile(
            [math.degrees(row.turn_error_rad) for row in found], 95
        ),
    }


def _bins(rows: Sequence[_Row]) -> list[Figures]:
    def inside(row: _Row, ranges_m: tuple[float, float], angles_rad: tuple[float, float]) -> bool:
        far_enough = ranges_m[0] <= row.truth.range_m < ranges_m[1]
        return far_enough and angles_rad[0] <= row.truth.angle_rad < angles_rad[1]

    return [
        {
            "range_m": list(ranges_m),
            "angle_deg": [round(math.degrees(angle)) for angle in angles_rad],
            **_summary([row for row in rows if inside(row, ranges_m, angles_rad)]),
        }
        for ranges_m, angles_rad in BINS
    ]


def _recall(rows: Sequence[_Row]) -> float | None:
    return sum(row.found for row in rows) / len(rows) if rows else None


def _percentile(values: Sequence[float], percent: float) -> float | None:
    return float(np.percentile(values, percent)) if values else None


def _bytes(picture: NDArray[np.float64]) -> Grey:
    return np.asarray(np.clip(np.rint(picture), 0, 255), np.uint8)


def perception_tables(figures: Figures) -> list[Table]:
    """The figures for people."""
    columns = ("in view", "recall", "cut off", "recall", "position p50", "p95", "normal p95")
    bins = Table("range", "angle", *columns, box=box.SIMPLE_HEAD, title="markers, as rendered")
    for one in figures["bins"]:
        near, far = one["range_m"]
        straight, oblique = one["angle_deg"]
        bins.add_row(f"{near:g} to {far:g} m", f"{straight:g} to {oblique:g} deg", *_cells(one))
    bins.add_row("all", "", *_cells(figures))
    conditions = Table("condition", *columns, "ms p50", "p90", box=box.SIMPLE_HEAD)
    for name, one in figures["conditions"].items():
        taken = (f"{ms:.1f}" for ms in figures["detect_ms"][name])
        conditions.add_row(name, *_cells(one), *taken)
    wrong = figures["wrong_ids"]
    blank = Table("images without markers", "number", "wrong ids used", "unknown", "misplaced",
                  box=box.SIMPLE_HEAD)  # fmt: skip
    for kind, one in wrong["by_kind"].items():
        blank.add_row(kind, *(str(value) for value in one.values()))
    both = " and ".join(f"{ms:.1f}" for ms in wrong["detect_ms"])
    blank.caption = f"{both} ms of processor time per image, median and p90"
    total = (
        figures["pictures_without_markers"],
        *(wrong[key] for key in ("used", "unknown_to_the_world", "misplaced")),
    )
    blank.add_row("all", *(str(value) for value in total))
    blank.add_row("wrong in images with markers", "", str(wrong["in_pictures_with_markers"]))
    return [bins, conditions, blank]


def _cells(one: Figures) -> list[str]:
    return [
        str(one["markers_in_view"]),
        _share(one["recall"], 1),
        str(one["quiet_zone_cut_off"]),
        _share(one["recall_quiet_zone_cut_off"], 1),
        _share(one["position_error_p50"], 3),
        _share(one["position_error_p95"], 3),
        "-" if one["normal_error_p95_deg"] is None else f"{one['normal_error_p95_deg']:.2f} deg",
    ]


def _share(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{100.0 * value:.{digits}f} %"


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=int, default=10_000, help="without markers")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="file to write")
    given = parser.parse_args(arguments)
    figures = perception_figures(given.pictures, given.seed)
    console = Console()
    if not console.is_terminal:
        console.width = 120
    for table in perception_tables(figures):
        console.print(table)
    if given.json is not None:
        given.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
