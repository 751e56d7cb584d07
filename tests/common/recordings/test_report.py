"""The report and the thumbnail of a run."""

from __future__ import annotations

import json
import re
import shutil
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from mazebot.common.config import ConfigError
from mazebot.common.files.version import mazebot_version
from mazebot.common.recordings.labels import Labels, write_labels
from mazebot.common.recordings.report.plots import Line, plot, ticks
from mazebot.common.recordings.report.report import write_report
from mazebot.common.recordings.report.thumbnail import thumbnail_png
from mazebot.common.recordings.run_folder import RunFolder
from mazebot.common.recordings.series import (
    CostRows,
    RunSeries,
    SeriesEvent,
    SeriesGoal,
    read_series,
)
from mazebot.common.recordings.summary import RunSummary
from tests.common.recordings.made_run import listed_run, made_run

VOID = {"meta", "link", "br", "img", "input"}


class Page(HTMLParser):
    """Collects elements, and checks that they are nested properly."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self._open: list[str] = []
        self.feed(text)
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def named(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_run(tmp_path_factory.mktemp("runs") / "<run>")


@pytest.fixture
def run(real: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(real, tmp_path / "<run>"))


def report_of(run: Path) -> str:
    write_report(run)
    return (run / "report.html").read_text()


def series_of(run: Path) -> RunSeries:
    series = read_series(run)
    assert series is not None
    return series


def change_series(run: Path, **fields: object) -> None:
    series = series_of(run).model_copy(update=fields)
    (run / "series.json").write_text(series.model_dump_json())


def test_a_report_tells_what_there_was(run: Path) -> None:
    text = report_of(run)
    for words in (
        "&lt;run&gt;", "0 of 1 goals reached", "world room", "seed 7", "no (105)",
        "corner: error 105: no progress", "Localisation error", "Heading error", "Speed",
        "marker 60 first seen", "navigation.controller_server.controller", "mppi",
        "regulated_pure_pursuit",
        "python", "pybullet", "processor", "/ground_truth/odom", "navigation: not finite: 2",
    ):  # fmt: skip
        assert words in text, words
    row = f'<th scope="row">mazebot</th><td><code>{mazebot_version()}</code></td>'
    assert row in text


def test_it_needs_nothing_but_itself(run: Path) -> None:
    page = Page(report_of(run))
    assert page.named("script") == []
    assert page.named("link") == []
    for tag, attributes in page.elements:
        assert "style" not in attributes, tag
        assert not any(name.startswith("on") for name in attributes), tag
        for name in ("src", "href"):
            value = attributes.get(name)
            assert value is None or value.startswith("data:image/png;base64,")
    assert "http" not in re.sub(r"\s+", " ", report_of(run))


def test_pictures_are_told_in_words(run: Path) -> None:
    text = report_of(run)
    page = Page(text)
    assert page.named("html") == [{"lang": "en"}]
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    for picture in page.named("svg"):
        if picture.get("aria-hidden") != "true":
            assert picture["role"] == "img"
            assert picture["aria-labelledby"] in ids
    for section in page.named("section"):
        assert section["aria-labelledby"] in ids
    assert "1 markers and 0 contacts" in text
    assert all("scope" in cell for cell in page.named("th"))


def test_every_drawing_is_well_formed(run: Path) -> None:
    drawings = re.findall(r"<svg.*?</svg>", report_of(run), re.DOTALL)
    assert len(drawings) > 8
    for drawing in drawings:
        for path in ET.fromstring(drawing).iter("path"):
            assert re.fullmatch(r"[MLZhvmlH0-9. -]*", path.get("d", "?")), drawing[:200]


def test_text_from_outside_is_never_markup(run: Path) -> None:
    evil = "<script>alert(1)</script>"
    write_labels(run, Labels(note=evil))
    event = SeriesEvent(time_s=1.0, kind="log", level="error", text=evil)
    goal = SeriesGoal(name=evil, reached=True)
    change_series(run, events=(event,), goals=(goal,), world=evil)
    text = report_of(run)
    assert "<script" not in text
    assert text.count("&lt;script&gt;") >= 2


def test_costs_and_contacts_are_drawn(run: Path) -> None:
    costs = CostRows(time_s=(1.0, 2.0), step_time_p99_ms=(3.0, 4.5), missed_periods=(0.0, 7.0))
    contact = SeriesEvent(time_s=1.0, kind="contact", text="base_link touches Wall", x_m=1, y_m=1)
    text = report_of(run)
    assert "do not report their step times" in text
    change_series(run, costs={"navigation": costs}, events=(contact,))
    text = report_of(run)
    assert "Step time, 99th percentile" in text
    assert '<td class="number">4.5</td><td class="number">4.5</td><td class="number">7</td>' in text
    assert 'class="contact"' in text
    assert "1 contacts" in text


def test_a_map_that_the_robot_made_is_shown_with_its_figures(run: Path) -> None:
    change_series(run, slam=True)
    summary = json.loads((run / "summary.json").read_text())
    step = {"time_s": 1.0, "driven_m": 0.1, "coverage_share": 0.5}
    summary["mapping"] = {"coverage_share": 0.75, "exploration": "complete", "coverage": [step]}
    (run / "summary.json").write_text(json.dumps(summary))
    assert "floor mapped" in report_of(run)
    assert "exploration complete" in report_of(run)
    assert "data:image/png" not in report_of(run)
    (run / "map").mkdir()
    pixels = np.full((20, 40), 254, np.uint8)
    pixels[:3] = 0
    cv2.imwrite(str(run / "map" / "map.pgm"), pixels)
    (run / "map" / "map.yaml").write_text(
        "image: map.pgm\nresolution: 0.05\norigin: [-1.0, -0.5, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    assert "data:image/png;base64," in report_of(run)
    (run / "map" / "map.yaml").write_text("{bad")
    assert "data:image/png" not in report_of(run)


@pytest.mark.parametrize("missing", ["series.json", "summary.json", "config.yaml"])
def test_what_is_missing_is_said(run: Path, missing: str) -> None:
    (run / missing).unlink()
    # As long as one file shows that it is a run.
    (run / "run.rrd").touch()
    text = report_of(run)
    assert (f"There is no {missing}" in text) is (missing != "config.yaml")
    assert (run / "thumbnail.png").is_file() is (missing != "series.json")


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("series.json", "{bad"),
        ("series.json", '{"format": 2}'),
        ("summary.json", '{"world": 3}'),
        ("config.yaml", "{bad: ["),
        ("labels.json", "3"),
    ],
)
def test_what_cannot_be_read_is_said(run: Path, file: str, text: str) -> None:
    (run / file).write_text(text)
    report = report_of(run)
    Page(report)
    assert f"{file}" in report or "cannot be read" in report


def test_a_run_that_goes_on_has_a_report(run: Path) -> None:
    lock = RunFolder(run)
    assert "This run has not ended" in report_of(run)
    lock.let_go()
    assert "This run was interrupted" in report_of(run)


def test_no_run_has_no_report(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="contains no run"):
        write_report(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_run_of_which_nothing_is_known_has_a_report(tmp_path: Path) -> None:
    Page(report_of(listed_run(tmp_path, "run", {})))


def test_a_summary_keeps_to_its_document(run: Path) -> None:
    RunSummary.model_validate_json((run / "summary.json").read_bytes())


def test_a_thumbnail_shows_walls_path_and_goal(run: Path) -> None:
    report_of(run)
    data = np.frombuffer((run / "thumbnail.png").read_bytes(), np.uint8)
    picture = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), int)
    assert picture.shape == (240, 320, 3)
    blue, green, red = picture.transpose(2, 0, 1)
    assert ((blue > red + 60) & (blue > 120)).sum() > 50  # path
    assert ((red > 150) & (green < 90)).sum() > 50  # a goal that was missed
    assert (picture.sum(axis=2) < 300).sum() > 2_000  # walls
    assert picture[120, 160].min() > 200  # free floor inside them


def test_a_run_without_a_step_has_a_thumbnail() -> None:
    start = {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0}
    empty = RunSeries.model_validate({"world": "a", "world_hash": "b", "start": start})
    assert thumbnail_png(empty).startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.0, 1.0, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]),
        (0.0, 83.0, [0.0, 20.0, 40.0, 60.0, 80.0]),
        (-100.0, 100.0, [-100.0, -50.0, 0.0, 50.0, 100.0]),
        (0.0, 0.031, [0.0, 0.01, 0.02, 0.03]),
    ],
)
def test_ticks_are_round(low: float, high: float, expected: list[float]) -> None:
    assert ticks(low, high, 4) == pytest.approx(expected)


def test_a_line_has_a_gap_where_nothing_was_measured() -> None:
    times_s = [0.1 * number for number in range(50)] + [60.0 + 0.1 * n for n in range(50)]
    drawn = plot("a", "A", "m", [Line("a", times_s, [1.0] * 100)], 70.0)
    assert drawn is not None
    assert drawn.lines[0].path.count("M") == 2
    assert plot("a", "A", "m", [Line("a", [], [])], 70.0) is None
    one = plot("a", "A", "m", [Line("a", [1.0], [0.0])], 0.0)
    assert one is not None
    assert one.lines[0].path.endswith("h0.1")
