"""`mazebot params`, and the layer that a parameter file of Nav2 is among the settings."""

import json
from pathlib import Path

import pytest
import yaml
from pydantic import Field

from mazebot.common.config import ConfigError, Params, ServiceConfig, merged
from mazebot.common.settings.load import load, read_nav2_params, read_settings
from mazebot.embedded.demo import DemoOptions, bringup_config
from tests.cli.test_app import assert_one_line, mazebot
from tests.common.nav2_files import shipped


class GoalChecker(Params):
    xy_goal_tolerance: float = Field(0.06, gt=0)
    yaw_goal_tolerance: float = Field(0.06, gt=0)


class ControllerServer(Params):
    general_goal_checker: GoalChecker = GoalChecker()
    failure_tolerance: float = Field(0.3, ge=0)


class NavigationConfig(ServiceConfig):
    controller_server: ControllerServer = ControllerServer()


CHECKER = {"plugin": "nav2_controller::SimpleGoalChecker", "xy_goal_tolerance": 0.1}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "nav2_params.yaml"
    values = {
        "goal_checker": CHECKER | {"yaw_goal_tolerance": 0.2},
        "failure_tolerance": 0.5,
        "frobnicate": 1,
    }
    path.write_text(yaml.safe_dump({"controller_server": {"ros__parameters": values}}))
    return path


def test_the_report_names_every_parameter_and_counts_them(file: Path) -> None:
    done = mazebot("params", str(file))
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[-1] == f"{file}: 5 parameters: 4 used, 0 mapped, 0 unsupported, 1 unknown"
    (tolerance,) = [line for line in lines if "goal_checker.xy_goal_tolerance" in line]
    assert tolerance.split()[0] == "7"
    assert "-> navigation" in tolerance
    assert any("frobnicate" in line and "ignores it" in line for line in lines)


def test_json_holds_rows_counts_and_settings(tmp_path: Path) -> None:
    path = tmp_path / "nav2_params.yaml"
    path.write_text(shipped("lyrical"))
    done = mazebot("params", str(path), "--json")
    told = json.loads(done.stdout)
    assert told["parameters"] == len(told["rows"]) == sum(told["counts"].values())
    assert told["counts"]["unknown"] == 1
    (row,) = [row for row in told["rows"] if row["status"] == "unknown"]
    assert row["parameter"] == "controller.simulation_step"
    assert {"node", "value", "setting", "note", "line", "now"} <= set(row)


def test_an_infinite_value_is_json(tmp_path: Path) -> None:
    path = tmp_path / "nav2_params.yaml"
    path.write_text(
        "controller_server: {ros__parameters: {PathHandler: {plugin: "
        "'nav2_controller::FeasiblePathHandler', max_robot_pose_search_dist: .inf}}}\n"
    )
    told = json.loads(mazebot("params", str(path), "--json").stdout)
    assert told["rows"][1]["value"] == "inf"


def test_settings_are_a_file_for_config(file: Path, tmp_path: Path) -> None:
    done = mazebot("params", str(file), "--settings")
    out = tmp_path / "settings.yaml"
    out.write_text(done.stdout)
    read = read_settings(out, {})
    assert read["navigation"]
    assert read["navigation"] == yaml.safe_load(done.stdout)["navigation"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("amcl: {ros__parameters: {sigma_hit: 0}}", [":1: amcl.sigma_hit: 0: must be greater"]),
        ("amcl: [", ["not YAML"]),
        (None, ["nav2_params.yaml: No such file"]),
    ],
)
def test_a_bad_file_is_one_line(tmp_path: Path, text: str | None, words: list[str]) -> None:
    path = tmp_path / "nav2_params.yaml"
    if text is not None:
        path.write_text(text)
    assert_one_line(mazebot("params", str(path)), *words)
    assert_one_line(mazebot("demo", "--params", str(path)), *words)


def test_json_and_settings_exclude_each_other(file: Path) -> None:
    assert_one_line(mazebot("params", str(file), "--json", "--settings"), "--settings")


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    assert_one_line(mazebot("params", str(tmp_path)), "must be a file of Nav2's parameters")


def test_flags_environment_and_settings_win_over_the_file_of_nav2(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def loaded(*arguments: str) -> tuple[float, float, float]:
        server = load(NavigationConfig, "navigation", arguments).controller_server
        checker = server.general_goal_checker
        return checker.xy_goal_tolerance, checker.yaw_goal_tolerance, server.failure_tolerance

    named = ("--params", str(file))
    assert loaded() == (0.06, 0.06, 0.3)
    assert loaded(*named) == (0.1, 0.2, 0.5)
    settings = tmp_path / "settings.yaml"
    checker = "general_goal_checker: {xy_goal_tolerance: 0.3}"
    settings.write_text(f"navigation: {{controller_server: {{{checker}}}}}\n")
    assert loaded(*named, "--config", str(settings)) == (0.3, 0.2, 0.5)
    monkeypatch.setenv("MAZEBOT_PARAMS", str(file))
    monkeypatch.setenv("MAZEBOT_NAVIGATION_YAW_GOAL_TOLERANCE", "0.4")
    assert loaded() == (0.1, 0.4, 0.5)
    assert loaded("--xy-goal-tolerance", "0.7") == (0.7, 0.4, 0.5)
    monkeypatch.setenv("MAZEBOT_NAVIGATION_CONTROLLER_SERVER__FAILURE_TOLERANCE", "0.6")
    whole = "--controller-server.general-goal-checker.yaw-goal-tolerance"
    assert loaded(f"{whole}=0.8") == (0.1, 0.8, 0.6)


def test_a_mapping_of_the_settings_does_not_hide_the_rest_of_the_file_of_nav2() -> None:
    below = {"a": {"x": 1, "y": 2}, "b": 3}
    assert merged(below, {"a": {"y": 5}, "c": 6}) == {
        "a": {"x": 1, "y": 5}, "b": 3, "c": 6,
    }  # fmt: skip


def test_a_value_that_a_service_refuses_is_said_with_its_file(file: Path) -> None:
    class Narrow(NavigationConfig):
        """The settings contradict each other, which no single field shows."""

        def model_post_init(self, _: object) -> None:
            checker = self.controller_server.general_goal_checker
            if checker.xy_goal_tolerance < checker.yaw_goal_tolerance:
                raise ValueError("the tolerances contradict")

    with pytest.raises(ConfigError, match="contradict"):
        load(Narrow, "navigation", ["--params", str(file)])


def test_the_file_is_read_once_for_all_services(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert read_nav2_params(file) is read_nav2_params(file)
    file.write_text(file.read_text().replace("0.5", "0.6"))
    assert read_nav2_params(file).tree["controller_server"]["failure_tolerance"] == 0.6


def test_a_run_in_one_process_checks_the_file(tmp_path: Path) -> None:
    bad = tmp_path / "nav2_params.yaml"
    bad.write_text("amcl: {ros__parameters: {max_beams: x}}")
    with pytest.raises(ConfigError, match=r"amcl\.max_beams: .x.: must be an integer"):
        bringup_config(DemoOptions(params=bad))
