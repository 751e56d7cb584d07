"""Sections for several nodes, such as `/**`, give each node of Nav2 what it has a parameter for."""

import pytest
from pydantic import BaseModel

from mazebot.common.config import ConfigError
from mazebot.common.nav2_params.loader import load_nav2_params
from mazebot.common.nav2_params.report import Report, report
from mazebot.localization.config import LocalizationConfig
from mazebot.navigation.config import NavigationConfig
from tests.common.nav2_params.files import config_of, row_of

BOTH: dict[str, type[BaseModel]] = {
    "navigation": NavigationConfig,
    "localization": LocalizationConfig,
}


def told(text: str) -> Report:
    return report(load_nav2_params(text, "my.yaml"), BOTH)


def most_particles(found: Report) -> int:
    values = found.settings.get("localization", {})
    return LocalizationConfig.model_validate(values).max_particles


def test_each_node_takes_what_it_has_of_plugins_and_old_names_too() -> None:
    found = told(
        "/**:\n  ros__parameters:\n    use_sim_time: true\n    max_particles: 600\n"
        "    velocity_timeout: 0.3\n    robot_base_frame: base_link\n"
        "    FollowPath: {plugin: 'nav2_mppi_controller/MPPIController', vx_max: 0.2,"
        " prune_distance: 1.2}\n    inflation_layer.inflation_radius: 0.5\n    no_such: 1\n"
    )
    config = config_of(found)
    assert most_particles(found) == 600
    assert config.velocity_smoother.velocity_timeout == 0.3
    assert config.controller_server.mppi.vx_max == 0.2
    assert config.controller_server.path_handler.prune_distance == 1.2
    costmaps = config.local_costmap, config.global_costmap
    assert [one.inflation_layer.inflation_radius for one in costmaps] == [0.5, 0.5]
    row = row_of(found, "max_particles")
    assert (row.node, row.status, row.setting) == ("/**", "used", "localization.max_particles")
    assert row.note == "of amcl"
    unknown = [row.parameter for row in found.rows if row.status == "unknown"]
    assert unknown == ["no_such"]


AMCL = "amcl: {ros__parameters: {max_particles: 700}}\n"
ALL = "/**: {ros__parameters: {max_particles: 600}}\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (ALL + AMCL, 700),
        # As in ROS 2 the last in the file counts, not the one that names the node.
        (AMCL + ALL, 600),
        (ALL + "/*: {ros__parameters: {max_particles: 800}}\n", 800),
        ("/robot1/**: {ros__parameters: {max_particles: 800}}\n", 800),
        ("/**/amcl: {ros__parameters: {max_particles: 800}}\n", 800),
        ("robot1: {'*': {ros__parameters: {max_particles: 800}}}\n", 800),
        # Of the nodes in a namespace that is a node's own.
        ("/local_costmap/**: {ros__parameters: {max_particles: 800}}\n", 2000),
    ],
)
def test_of_sections_that_match_a_node_the_last_counts(text: str, expected: int) -> None:
    assert most_particles(told(text)) == expected


def test_what_does_not_count_names_the_line_that_does() -> None:
    lost, taken = told(AMCL + ALL).rows
    assert (lost.node, lost.status, taken.status) == ("amcl", "unsupported", "used")
    assert lost.note.startswith("amcl has 600 of /** in line 2: the last section of the file that")


def test_costmaps_are_two_names_deep() -> None:
    one = "/*: {ros__parameters: {inflation_layer: {inflation_radius: 0.5}}}\n"
    local = "/local_costmap/*: {ros__parameters: {inflation_layer: {inflation_radius: 0.4}}}\n"
    config = config_of(told(one + local))
    assert config.local_costmap.inflation_layer.inflation_radius == 0.4
    assert config.global_costmap == NavigationConfig().global_costmap


def test_a_wrong_value_is_refused_with_its_line() -> None:
    with pytest.raises(ConfigError, match=r"my\.yaml:1: /\*\*\.max_particles: 'x': must be an int"):
        told("/**: {ros__parameters: {max_particles: x}}")
