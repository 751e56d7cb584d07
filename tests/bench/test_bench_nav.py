"""The navigation benchmark: its metrics on motions worked out by hand, and that it runs."""

import json
import math
import re
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
import pytest
import shapely
import yaml

from mazebot.bench.navigation import __main__ as bench_nav
from mazebot.bench.navigation import metrics, runner
from mazebot.bench.navigation.courses.bench_worlds import BenchWorld, narrow_maze, two_rooms
from mazebot.bench.navigation.courses.course import Course, rectangle
from mazebot.bench.navigation.courses.moving import UNPREDICTED, places_in
from mazebot.bench.navigation.courses.scenarios import BY_NAME, GROUPS, SCENARIOS
from mazebot.bench.navigation.measure import Leg, alarm_count
from mazebot.bench.navigation.plots import overview, ways
from mazebot.bench.navigation.report import ratio_table, read_summaries, row_as_json, summary
from mazebot.bench.navigation.robot_outline import robot_parts
from mazebot.bench.navigation.scenario import Options, Row, Scenario
from mazebot.bench.navigation.surroundings import FAR_M, Post, PutThing, Surroundings
from mazebot.common.config import ConfigError
from mazebot.common.files.root import ROOT
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.robot.waffle import MAX_LINEAR_M_S

TIMES_S = np.arange(0.0, 10.0, 1.0 / 30.0)


def claims_at(poses: Array, sigma_m: float, sigma_rad: float) -> Array:
    """Claims ten times a second of these poses, with independent errors."""
    covariance = np.diag([sigma_m**2, sigma_m**2, sigma_rad**2]).ravel()
    times_s = np.arange(len(poses)) * 0.1
    return np.column_stack([times_s, poses, np.tile(covariance, (len(poses), 1))])


def standing(x_m: float, y_m: float, yaw_rad: float) -> Array:
    """True rows of a robot that stands for ten seconds."""
    pose = np.tile([x_m, y_m, yaw_rad, 0.0, 0.0], (len(TIMES_S), 1))
    return np.column_stack([TIMES_S, pose])


def test_a_circle_is_as_irregular_as_it_is_tight_and_has_no_jerk() -> None:
    radius_m, speed = 0.5, 0.2
    yaws = np.array([(one + math.pi) % (2.0 * math.pi) - math.pi for one in TIMES_S * 0.4])
    places = radius_m * np.stack([np.sin(TIMES_S * 0.4), 1.0 - np.cos(TIMES_S * 0.4)], 1)
    length_m = metrics.driven_m(places)
    assert length_m == pytest.approx(speed * TIMES_S[-1], rel=1e-3)
    assert metrics.irregularity(yaws, length_m) == pytest.approx(1.0 / radius_m, rel=1e-3)
    assert metrics.jerk(TIMES_S, np.full(len(TIMES_S), speed)) == pytest.approx(0.0, abs=1e-9)


def test_the_jerk_of_a_growing_acceleration_is_its_growth() -> None:
    assert metrics.jerk(TIMES_S, 0.5 * 0.3 * TIMES_S**2) == pytest.approx(0.3, rel=0.02)
    assert metrics.jerk(TIMES_S[:5], TIMES_S[:5]) is None


def test_jitter_at_rest_is_no_distance() -> None:
    shaking = np.stack([0.0005 * (-1.0) ** np.arange(100), np.zeros(100)], 1)
    assert metrics.driven_m(shaking) == 0.0
    assert metrics.irregularity(np.zeros(100), 0.0) is None


def test_path_length_weighs_success() -> None:
    assert metrics.spl(True, 4.0, 3.0) == pytest.approx(0.75)
    assert metrics.spl(True, 2.9, 3.0) == 1.0
    assert metrics.spl(False, 3.0, 3.0) == 0.0
    assert metrics.spl(True, 3.0, None) is None


def test_barn_s_score_is_the_published_one_and_bounded_by_the_robot_s_speed() -> None:
    optimal_s = 10.0 / MAX_LINEAR_M_S
    best = metrics.barn_score(True, optimal_s, 10.0, metrics.BARN_SPEED_M_S)
    assert best == pytest.approx(MAX_LINEAR_M_S / metrics.BARN_SPEED_M_S)
    assert best <= 0.23 + 1e-9
    assert metrics.barn_score(True, optimal_s, 10.0, MAX_LINEAR_M_S) == 0.5
    assert metrics.barn_score(True, 1e6, 10.0, metrics.BARN_SPEED_M_S) == 0.125
    assert metrics.barn_score(False, optimal_s, 10.0, MAX_LINEAR_M_S) == 0.0


def test_contacts_within_a_second_are_one() -> None:
    assert metrics.episodes([]) == 0
    assert metrics.episodes([5.0, 1.0, 1.5, 2.4, 3.5]) == 3


@pytest.mark.parametrize(
    ("off", "inside"),
    [((0.0, 0.0, 0.0), True), ((0.027, 0.0, 0.0), True), ((0.029, 0.0, 0.0), False),
     ((0.0, 0.0, 0.027), True), ((0.02, 0.02, 0.0), False), ((0.0, 0.0, 2.0 * math.pi), True)],
)  # fmt: skip
def test_a_claim_is_consistent_inside_the_95_percent_ellipse(
    off: tuple[float, float, float], inside: bool
) -> None:
    # Along one axis the ellipse ends at sqrt(7.815) = 2.80 standard deviations.
    truth = standing(1.0, 2.0, 3.1)
    claims = claims_at(np.tile(np.array([1.0, 2.0, 3.1]) + off, (50, 1)), 0.01, 0.01)
    found = metrics.localisation_errors(claims, truth)
    assert found.inside.all() if inside else not found.inside.any()
    assert found.metres == pytest.approx(math.hypot(off[0], off[1]))


def test_a_claim_without_a_covariance_is_not_consistent() -> None:
    truth = standing(0.0, 0.0, 0.0)
    assert not metrics.localisation_errors(
        claims_at(np.zeros((5, 3)), 0.0, 0.0), truth
    ).inside.any()


def test_claims_are_compared_with_the_truth_of_their_own_time() -> None:
    truth = np.column_stack([TIMES_S, 0.4 * TIMES_S, np.zeros((len(TIMES_S), 4))])
    poses = np.column_stack([0.4 * np.arange(90) * 0.1, np.zeros((90, 2))])
    assert metrics.localisation_errors(claims_at(poses, 0.01, 0.01), truth).metres.max() < 1e-9


def test_the_robot_is_as_wide_as_its_wheels_and_as_long_as_its_hull() -> None:
    corners = np.concatenate(robot_parts())
    assert corners.min(0) == pytest.approx([-0.1965, -0.153], abs=1e-4)
    assert corners.max(0) == pytest.approx([0.0685, 0.153], abs=1e-4)


def test_clearance_is_that_of_the_outline_and_of_the_time() -> None:
    around = Surroundings(two_rooms().load())
    # The middle wall's face is at x = -0.075, the hull's front 0.0685 m before the axle.
    poses = np.array([[-0.3, 1.2, 0.0], [-0.3, 1.2, math.pi]])
    clearance_m = around.clearance_m(np.zeros(2), poses)
    assert clearance_m == pytest.approx([0.225 - 0.0685, 0.225 - 0.1965], abs=1e-3)
    around.put.append(PutThing("box", rectangle(SE2(-2.0, 0.0, 0.0), (0.2, 0.2)), 5.0, 6.0))
    near = np.tile([-2.2, 0.0, 0.0], (3, 1))
    before, during, after = around.clearance_m(np.array([4.0, 5.5, 6.0]), near)
    assert during == pytest.approx(0.1 - 0.0685, abs=1e-3)
    assert before == after > 1.0


def test_a_post_is_where_it_was_at_the_time() -> None:
    around = Surroundings(BenchWorld("original").load())
    around.posts["post"] = Post("post", 0.1, [0.0, 10.0], [(0.0, 0.0), (1.0, 0.0)])
    pose = np.array([[0.2, 0.0, 0.0]])
    assert around.distance_to_m("post", 6.0, pose)[0] == pytest.approx(0.3 - 0.0685, abs=2e-3)
    assert around.distance_to_m("post", 2.0, pose)[0] == 0.0
    assert around.clearance_m(np.array([6.0]), pose)[0] < FAR_M


def test_who_moved_into_whom() -> None:
    options = Options(camera=False)
    with Course("test", two_rooms(), 0, options) as course:
        course.session.command(0.3, 0.0, for_s=3.0)
        course.put_box("box", course.pose @ SE2(0.35, 0.0, 0.0), (0.2, 0.5))
        course.session.command(0.3, 0.0, for_s=2.0)
        course.run_for(0.5)
        assert course.witness.contacts
        assert course.witness.contacts[0].body == "box"
        assert all(one.by_robot for one in course.witness.contacts)
    stays = options.with_settings({"navigation": {"giving_way": {"enabled": False}}})
    with Course("test", two_rooms(), 0, stays) as course:
        at = course.pose
        course.put_box("box", at @ SE2(-0.35, 0.0, 0.0), (0.1, 0.5))
        assert course.put_post("post", (at.x_m + 0.8, 0.0), [(at.x_m - 0.05, 0.0)], 0.3, False, 0.1)
        course.run_for(3.5)
        assert course.witness.contacts
        assert course.witness.contacts[0].body == "post"
        assert {one.body for one in course.witness.contacts} == {"post", "box"}
        assert not any(one.by_robot for one in course.witness.contacts), "it stands, and is pushed"


def test_places_named_in_a_text_are_found() -> None:
    assert places_in("no way past (1.20, -0.5) and (3,4): code 208 (2 tries)") == [
        (1.2, -0.5), (3.0, 4.0),
    ]  # fmt: skip
    assert places_in("blocked") == []


def rows_of(successes: int, trials: int = 4) -> list[Row]:
    """Trials of which some succeeded."""
    return [
        Row("tours", "w", seed, 0, success=seed < successes, reached=True, spl=0.9, time_s=10.0,
            driven_m=5.0, contacts_robot=int(seed >= successes), consistency=0.5,
            errors_m=np.full(10, 0.02), errors_rad=np.full(10, 0.01),
            way=np.array([[0.0, 0.0], [1.0, 0.5]]), scene=(np.array([[0, 0], [1, 0], [1, 1.0]]),),
            extra={"found_s": 2.0 + seed, "word": "x", "opens": True})
        for seed in range(trials)
    ]  # fmt: skip


def test_a_summary_counts_pools_and_keeps_what_only_one_scenario_measures() -> None:
    found = summary(rows_of(3))
    assert (found["trials"], found["successes"], found["contacts_robot"]) == (4, 3, 1)
    assert found["contacts_per_km"] == 50.0
    assert found["localisation_p95_m"] == 0.02
    assert found["consistency"] == 0.5
    assert (found["found_s_median"], found["found_s_count"]) == (3.5, 4)
    assert "opens_median" not in found
    assert summary([Row("docking", "", 0, 0, skipped="no dock")]) == {
        "trials": 0, "skipped": "no dock",
    }  # fmt: skip


def test_ratios_to_another_run(tmp_path: Path) -> None:
    old, new = {"tours": summary(rows_of(2))}, {"tours": summary(rows_of(4))}
    path = tmp_path / "old.json"
    path.write_text(json.dumps({"scenarios": old}))
    made = ratio_table(new, read_summaries(path))
    cells = [next(iter(column.cells)) for column in made.columns]
    assert cells[:4] == ["tours", "2/4 -> 4/4", "1.00", "0.00"]


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"scenarios": 3}'])
def test_a_baseline_that_is_none_is_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "old.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"--baseline: .*old\.json: must be the JSON of a run"):
        read_summaries(path)
    with pytest.raises(ConfigError, match=r"--baseline: .*No such file"):
        read_summaries(tmp_path / "none.json")


def test_a_row_is_json(tmp_path: Path) -> None:
    (row, *_) = rows_of(1)
    row.min_clearance_m = math.inf
    told = json.loads(json.dumps(row_as_json(row), allow_nan=False))
    assert told["seed"] == 0
    assert told["min_clearance_m"] is None
    assert "way" not in told


def test_pictures_show_the_ways() -> None:
    picture = ways("tours", rows_of(2))
    assert picture is not None
    colours = {colour for _, colour in picture.getcolors(100_000) or []}
    assert {(31, 119, 180), (214, 39, 40), (150, 150, 150)} <= colours
    assert ways("docking", [Row("docking", "", 0, 0, skipped="no dock")]) is None
    share = overview({"a": summary(rows_of(2)), "b": summary(rows_of(4))})
    blue = np.all(np.asarray(share) == (31, 119, 180), axis=2).sum(axis=1)
    assert sorted(set(blue.tolist())) == [0, 201, 401]


def test_every_scenario_is_named_once_and_every_group_holds_scenarios() -> None:
    assert {name for names in GROUPS.values() for name in names} <= set(BY_NAME)
    assert not set(GROUPS) & set(BY_NAME)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--scenario", "tourz"], "error: --scenario: 'tourz': must be one of tours, kidnap"),
        (["--seeds", "0"], "error: --seeds: must be 1 to 10000 (got 0)"),
        (["--baseline", "none.json"], "error: --baseline: none.json: No such file"),
    ],
)
def test_wrong_arguments_are_one_line(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        bench_nav.main(arguments)
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith(said)
    assert error.count("\n") == 1


def test_a_trial_that_breaks_off_is_a_failure_and_the_others_go_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def run(name: str, seed: int, options: Options) -> list[Row]:
        if seed == 1:
            raise ValueError("no\nroom")
        return rows_of(1, 1)

    monkeypatch.setitem(BY_NAME, "mazes", Scenario("mazes", "", run, 2, 2))
    out = tmp_path / "out.json"
    assert bench_nav.main(["--scenario", "mazes", "--jobs", "1", "--json", str(out)]) == 0
    report = json.loads(out.read_text())
    assert (report["scenarios"]["mazes"]["trials"], report["scenarios"]["mazes"]["successes"]) == (
        2, 1,
    )  # fmt: skip
    assert report["trials"][1]["error_msg"] == "trial failed: ValueError: no room"
    assert re.search(r"mazes seed 1: 0/1 \S+ s trial failed", capsys.readouterr().out)


def test_a_seed_is_the_same_trial_again() -> None:
    first, again = (runner.run_unit(runner.Unit("box_removed", 1), Options()).rows for _ in "ab")
    assert [row_as_json(row) for row in first] == [row_as_json(row) for row in again]
    assert first[0].extra["marked"]
    assert 0.0 < first[0].extra["cleared_s"] < 5.0


def test_a_drive_is_measured() -> None:
    with Course("test", narrow_maze(0.85, 0, 2, 2), 0, Options()) as course:
        goal = course.loaded.world.locations[0].se2()
        row = course.drive(goal)
    assert row.success, row
    assert row.shortest_m is not None
    assert row.driven_m >= 0.95 * row.shortest_m
    assert row.spl == pytest.approx(min(row.shortest_m / row.driven_m, 1.0))
    assert row.min_clearance_m is not None
    assert 0.02 < row.min_clearance_m < 0.3
    assert len(row.errors_m) > 20
    assert row.localisation_p95_m is not None
    assert row.localisation_p95_m < 0.1
    assert shapely.LineString(row.way).length == pytest.approx(row.driven_m, rel=0.05)


def test_a_narrow_maze_has_corridors_of_that_width() -> None:
    world = narrow_maze(0.5, 3).load().world
    assert {wall.thickness_m for wall in world.walls} == {0.15}
    around = Surroundings(narrow_maze(0.5, 3).load())
    assert around.point_clearance_m(0.0, 0.0) == pytest.approx(0.25, abs=1e-6)


@pytest.mark.slow
def test_two_processes_find_what_one_finds() -> None:
    units = [runner.Unit("box_removed", seed) for seed in (1, 2)]
    found = [
        sorted((unit, json.dumps([row_as_json(row) for row in ran.rows]))
               for unit, ran in runner.run_units(units, Options(), jobs))
        for jobs in (1, 2)
    ]  # fmt: skip
    assert found[0] == found[1]


def test_a_killed_process_is_a_failure_and_not_the_end() -> None:
    done: Future[runner.Ran] = Future()
    done.set_exception(BrokenProcessPool("gone"))
    ran = runner.result_of(done, runner.Unit("mazes", 3))
    assert (ran.rows[0].seed, ran.rows[0].success) == (3, False)
    assert ran.rows[0].error_msg == "its process was killed"


class Told:
    """What a witness has heard of localisation."""

    def __init__(self, claims: Array, statuses: list[tuple[float, bool, bool]]) -> None:
        self.claims, self.statuses = claims.tolist(), statuses


@pytest.mark.parametrize(
    ("claimed", "alarms"),
    [((1.0, 2.0, 0.5), 1), ((1.4, 2.0, 0.5), 0), ((1.0, 2.0, 2.0), 0), ((1.1, 2.1, 0.6), 1)],
)
def test_a_right_pose_that_is_given_up_is_a_false_alarm(
    claimed: tuple[float, float, float], alarms: int
) -> None:
    truth = standing(1.0, 2.0, 0.5)
    claims = claims_at(np.tile(claimed, (50, 1)), 0.1, 0.1)
    told = Told(claims, [(0.5, True, True), (3.0, False, False), (4.0, False, False)])
    leg = Leg(0.0, 9.0, SE2(1.0, 2.0, 0.5), SE2(0.0, 0.0, 0.0), None)
    assert alarm_count(leg, truth, told) == alarms
    assert alarm_count(leg._replace(end_s=2.0), truth, told) == 0
    # The claim at that moment is already of the search for another pose.
    told.claims[29][1] += 2.0
    assert alarm_count(leg, truth, told) == alarms
    # A pose that was wrong a moment ago is given up with good reason.
    told.claims[25][1] += 2.0
    assert alarm_count(leg, truth, told) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["docking", "kidnap_lidar", "door_closed_15s", "corridor_30x2"])
def test_a_scenario_is_mastered(name: str) -> None:
    rows = runner.run_unit(runner.Unit(name, 1), Options()).rows
    assert all(row.success for row in rows), rows


def test_settings_of_a_scenario_win_over_those_of_the_user(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        "navigation: {controller_server: {controller: mppi, mppi: {batch_size: 500}}}\nseed: 3\n"
    )
    made = Options(settings=path).with_settings(UNPREDICTED)
    assert made.settings is not None
    assert yaml.safe_load(made.settings.read_text()) == {
        "seed": 3,
        "navigation": {
            "controller_server": {
                "controller": "mppi",
                "mppi": {"batch_size": 500, "prediction": False},
            }
        },
    }


def test_the_page_lists_every_scenario_as_it_is() -> None:
    text = (ROOT / "docs" / "bench-nav.md").read_text()
    for one in SCENARIOS:
        row = f"| `{one.name}` | {one.about} | {one.few or '-'} | {one.seeds} | {one.required} |"
        assert row in text, f"docs/bench-nav.md lacks: {row}"
