"""Navigation's settings: Nav2's tree, by flags, variables and files."""

from pathlib import Path

import pytest

from mazebot.common.config import ConfigError, changed_defaults
from mazebot.common.settings.load import load
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.control.mppi.critic_params import MPPIParams
from mazebot.navigation.robot.controller_server import ControllerServerParams


def loaded(*arguments: str) -> NavigationConfig:
    return load(NavigationConfig, "navigation", arguments)


def refused(*arguments: str) -> str:
    with pytest.raises(ConfigError) as caught:
        loaded(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    "flag",
    [
        "--max-linear-vel=0.2",
        "--controller-server.max-linear-vel=0.2",
        "--controller_server.max_linear_vel=0.2",
    ],
)
def test_a_setting_is_given_by_its_last_name_or_in_full(flag: str) -> None:
    assert loaded(flag).controller_server.max_linear_vel == 0.2
    assert loaded("--controller", "regulated_pure_pursuit").controller_server.controller


def test_a_part_of_the_name_that_is_unique_is_enough() -> None:
    config = loaded("--mppi.batch-size", "500", "--CostCritic.cost-weight=2")
    mppi = config.controller_server.mppi
    assert (mppi.batch_size, mppi.CostCritic.cost_weight) == (500, 2.0)


def test_a_variable_is_named_as_its_flag(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAZEBOT_NAVIGATION_YAW_GOAL_TOLERANCE", "0.1")
    monkeypatch.setenv("MAZEBOT_NAVIGATION_CONTROLLER_SERVER__MPPI__COSTCRITIC__COST_WEIGHT", "2")
    monkeypatch.setenv("MAZEBOT_NAVIGATION_LOCAL_COSTMAP", '{"width": 4, "height": 5}')
    config = loaded("--local-costmap.height=6")
    server = config.controller_server
    assert server.general_goal_checker.yaw_goal_tolerance == 0.1
    assert server.mppi.CostCritic.cost_weight == 2.0
    assert (config.local_costmap.width, config.local_costmap.height) == (4.0, 6.0)


def test_a_name_of_several_settings_is_refused_with_all_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said = refused("--inflation-radius", "0.5")
    assert said.startswith("--inflation-radius: ambiguous: must be ")
    assert "--global-costmap.inflation-layer.inflation-radius or " in said
    monkeypatch.setenv("MAZEBOT_NAVIGATION_WIDTH", "4")
    monkeypatch.setenv("MAZEBOT_NAVIGATION_FOOTPRINT_PADDING", "0.1")
    said = refused()
    assert said.startswith("MAZEBOT_NAVIGATION_FOOTPRINT_PADDING: ambiguous: must be ")
    assert "MAZEBOT_NAVIGATION_LOCAL_COSTMAP__FOOTPRINT_PADDING" in said


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("desired_linear_vel", "controller_server.max_linear_vel"),
        ("max_planning_iterations", "planner_server.GridBased.max_iterations"),
        ("inflation_radius", "local_costmap.inflation_layer.inflation_radius"),
        ("obstacle_max_range", "global_costmap.obstacle_layer.scan.obstacle_max_range"),
        ("obstacle_static_margin", "global_costmap.obstacle_layer.static_margin"),
        ("xy_goal_tolerance", "controller_server.general_goal_checker.xy_goal_tolerance"),
        ("mppi", "controller_server.mppi"),
        ("keepout_mask", "keepout_filter_mask_server.yaml_filename"),
        ("speed_mask_type", "speed_costmap_filter_info_server.type"),
        ("local_costmap_size", "local_costmap"),
    ],
)
def test_a_name_without_its_section_is_refused_with_its_place(
    tmp_path: Path, name: str, place: str
) -> None:
    file = tmp_path / "settings.yaml"
    file.write_text(f"navigation: {{{name}: 1}}\n")
    said = refused("--config", str(file))
    assert said.startswith(f"{file}: navigation.{name}: 1: unknown field; did you mean ")
    assert place in said


def test_where_a_wrong_value_of_a_section_is_from_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "settings.yaml"
    file.write_text("navigation: {controller_server: {max_linear_vel: -1}}\n")
    told = "controller_server.max_linear_vel: must be greater than 0 (got "
    assert refused("--config", str(file)) == f"navigation: {told}-1 from {file})"
    monkeypatch.setenv("MAZEBOT_NAVIGATION_MAX_LINEAR_VEL", "-2")
    name = "MAZEBOT_NAVIGATION_MAX_LINEAR_VEL"
    assert refused("--config", str(file)) == f"navigation: {told}'-2' from {name})"
    assert f"{told}'-3' from --controller-server.max-linear-vel" in refused(
        "--controller-server.max-linear-vel", "-3"
    )
    file.write_text("navigation: {controller_server: 3}\n")
    assert "navigation.controller_server: 3: must be a mapping" in refused("--config", str(file))


def test_what_was_changed_is_named_by_its_place() -> None:
    config = NavigationConfig(
        controller_server=ControllerServerParams(max_linear_vel=0.2, mppi=MPPIParams(gamma=0.1))
    )
    assert changed_defaults(config) == {
        "controller_server.max_linear_vel": 0.46,
        "controller_server.mppi.gamma": 0.015,
    }
