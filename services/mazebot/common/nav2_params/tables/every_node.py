"""Parameters that every node of Nav2 has."""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import namespace

EVERY_NODE = namespace(
    "every_node",
    """
use_sim_time bool false * =- !true
introspection_mode string disabled {disabled,metadata,contents} =- !disabled
enable_stamped_cmd_vel bool true * =- !true|false
- bond_heartbeat_period # bringup monitors the nodes
- allow_parameter_qos_overrides # QoS is defined in the table of topics
- autostart_node # bringup starts the nodes
- start_type_description_service
""",
)

PREFIXES = ("qos_overrides.", "diagnostic_updater.")
"""Beginnings of names that ROS 2 itself reads."""
