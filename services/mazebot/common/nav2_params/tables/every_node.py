"""Parameters that every node of Nav2 has."""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import namespace

EVERY_NODE = namespace(
    "every_node",
    """
use_sim_time bool false * =- !true
bond_heartbeat_period double 0.25 * =- # bringup monitors the nodes
introspection_mode string disabled {disabled,metadata,contents} =- !disabled
enable_stamped_cmd_vel bool true * =- !true|false
allow_parameter_qos_overrides bool true * =- # QoS is defined in the table of topics
autostart_node bool false * =- # bringup starts the nodes
start_type_description_service bool true * =-
""",
)

PREFIXES = ("qos_overrides.", "diagnostic_updater.")
"""Beginnings of names that ROS 2 itself reads."""
