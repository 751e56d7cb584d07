"""What is carried, and the settings that say so."""

from __future__ import annotations

from pathlib import Path

import pytest

from mazebot.common.bus.config import BusConfig
from mazebot.common.config import ConfigError
from mazebot.common.settings.load import load
from mazebot.ros2_bridge.config import Ros2BridgeConfig, is_allowed


def test_by_default_nodes_of_ros_hear_everything_and_command_as_users_do() -> None:
    config = Ros2BridgeConfig()
    assert is_allowed("/scan", config.to_ros)
    assert {"/cmd_vel", "/goal_pose", "/initialpose"} <= set(config.from_ros)
    assert not {"/scan", "/odom", "/tf", "/clock", "/world", "/map"} & set(config.from_ros)


@pytest.mark.parametrize(
    ("name", "patterns", "allowed"),
    [
        ("/scan", ("/scan",), True),
        ("/scan", ("/sca",), False),
        ("/camera/color/image_raw", ("/camera/*",), True),
        ("/navigate_to_pose/_action/feedback", ("/navigate_to_pose",), True),
        ("/navigate_to_pose/_action/send_goal", ("/spin", "/wait"), False),
        ("/tf", (), False),
    ],
)
def test_a_pattern_stands_for_names(name: str, patterns: tuple[str, ...], allowed: bool) -> None:
    assert is_allowed(name, patterns) is allowed


def test_the_environment_lists_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAZEBOT_ROS2_BRIDGE_FROM_ROS", "/cmd_vel, /tf")
    assert load(Ros2BridgeConfig, "ros2_bridge", []).from_ros == ("/cmd_vel", "/tf")
    monkeypatch.setenv("MAZEBOT_ROS2_BRIDGE_DISCOVERY", "everywhere")
    with pytest.raises(ConfigError, match="must be 'localhost' or 'subnet'"):
        load(Ros2BridgeConfig, "ros2_bridge", [])


def test_no_other_service_reads_a_setting_of_the_bridge(tmp_path: Path) -> None:
    file = tmp_path / "settings.yaml"
    file.write_text("ros2_bridge: {to_ros: [/scan]}\n")
    assert load(BusConfig, "bus", ["--config", str(file)]) == BusConfig()
    assert load(Ros2BridgeConfig, "ros2_bridge", ["--config", str(file)]).to_ros == ("/scan",)
