"""What keeps ROS 2 from joining a stack, told by `mazebot doctor --ros`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pytest
from typer.testing import CliRunner

from mazebot.bench.parts.loopback_router import free_port, running_router
from mazebot.cli.app import app
from mazebot.cli.doctor import Diagnosis, diagnose, doctor
from mazebot.common.bus.bus import Bus
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import open_session
from mazebot.common.config import ServiceConfig
from mazebot.common.files.key_file import Key
from mazebot.common.messages.keys import RELIABLE_QOS, Keys, Kind
from mazebot.common.messages.topics import SERVICES
from mazebot.common.messages.type_hash import hash_of
from mazebot.common.node.node import Inbox, Node, Outbox
from mazebot.common.ros.interfaces import interfaces

RIGHT = {"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}
SPIN = "nav2_msgs/action/Spin_SendGoal"


def stack(keys: Keys) -> list[str]:
    """The tokens of a stack's nodes, and of two of its publishers."""
    nodes = [keys.node_token("a1", i, name) for i, name in enumerate(SERVICES)]
    return [
        *nodes, end(keys, "/cmd_vel", "geometry_msgs/msg/TwistStamped", "navigation"),
        end(keys, "/scan", "sensor_msgs/msg/LaserScan", "physics"),
    ]  # fmt: skip


def end(keys: Keys, name: str, kind: str, node: str, what: Kind = "MP", digest: str = "") -> str:
    return keys.typed_token(
        "b2", 0, 1, node, what, name, kind, digest or hash_of(kind), RELIABLE_QOS
    )


def of(tokens: list[str], environment: Mapping[str, str] = RIGHT, **bus: Any) -> Diagnosis:
    return diagnose(BusConfig.model_validate(bus), environment, tokens)


@pytest.mark.parametrize("bus", [{}, {"domain_id": 4, "prefix": "bot1"}])
def test_a_stack_in_order_has_nothing_wrong(bus: dict[str, Any]) -> None:
    config = BusConfig.model_validate(bus)
    keys = config.keys
    events = "/parameter_events", "rcl_interfaces/msg/ParameterEvent"
    others = [end(keys, *events, "rviz"), end(keys, *events, "navigation")]
    others += [keys.node_token("c3", 0, "rviz"), end(keys, "/goal_pose", POSE, "rviz"),
              end(keys, "/cmd_vel", "geometry_msgs/msg/Twist", "teleop")]  # fmt: skip
    environment = {**RIGHT, "ROS_DOMAIN_ID": str(config.domain_id)}
    found = of([*stack(keys), *others], environment, **bus)
    assert not found.wrong
    assert found.found.endswith(f"{len(SERVICES)} nodes of Mazebot, 1 of others")
    assert found.exports == {
        "RMW_IMPLEMENTATION": "rmw_zenoh_cpp",
        "ZENOH_CONFIG_OVERRIDE": 'connect/endpoints=["tcp/127.0.0.1:7447"]',
        "ROS_DOMAIN_ID": str(config.domain_id),
    }


def test_where_the_router_asks_for_a_key_ros_2_signs_in_with_it_as_a_client() -> None:
    key = Key("operator", "operator", "x" * 43)
    keyless = {**RIGHT, "ZENOH_CONFIG_OVERRIDE": 'connect/endpoints=["tcp/127.0.0.1:7447"]'}
    found = diagnose(BusConfig(), keyless, stack(HERE), key)
    override = found.exports["ZENOH_CONFIG_OVERRIDE"]
    for part in ('mode="client"', 'usrpwd/user="operator"', f'usrpwd/password="{"x" * 43}"'):
        assert part in override
    assert any("transport/auth/usrpwd/user" in line for line in found.wrong)
    assert not diagnose(BusConfig(), found.exports, stack(HERE), key).wrong


POSE = "geometry_msgs/msg/PoseStamped"
HERE = Keys()


@pytest.mark.parametrize(
    ("tokens", "text"),
    [
        ([], "no node of Mazebot in domain 0"),
        (stack(Keys(domain_id=7)), "must be ROS_DOMAIN_ID=7"),
        (
            stack(Keys(prefix="bot1/")),
            "in namespace /, but in namespace /bot1: must be MAZEBOT_BUS_PREFIX=bot1",
        ),
        (
            [*stack(HERE), Keys(domain_id=7).node_token("c", 0, "rviz")],
            "/rviz: in domain 7: must be in 0",
        ),
        ([*stack(HERE), *stack(HERE)], "/physics is there 2 times"),
        (
            [*stack(HERE), end(HERE, "/cmd_vel", "std_msgs/msg/String", "joy")],
            "/cmd_vel of /joy is heard by nobody: std_msgs/msg/String: must be geometry_msgs/msg/",
        ),
        (
            [*stack(HERE), end(HERE, "/scan", "sensor_msgs/msg/LaserScan", "n", "MS", "RIHS01_0")],
            "/scan of /n hears nothing: sensor_msgs/msg/LaserScan with the hash RIHS01_0",
        ),
        (
            [*stack(HERE), end(HERE, "/scan", "sensor_msgs/msg/LaserScan", "gazebo")],
            "/scan has several publishers: /physics, /gazebo: must be one",
        ),
        (
            [
                *stack(HERE),
                *(end(HERE, "/cmd_vel", "geometry_msgs/msg/Twist", node) for node in ("a", "b")),
            ],
            "/cmd_vel has several publishers: /navigation, /a, /b",
        ),
        (
            [
                *stack(HERE),
                end(
                    HERE, "/spin/_action/send_goal", SPIN, "bt", "SC",
                    interfaces("kilted").hash_of(SPIN),
                ),
            ],
            "that of jazzy: must be bus.distro=kilted",
        ),
        (
            [
                *stack(HERE),
                end(HERE, "/spawn_entity", "gazebo_msgs/srv/SpawnEntity", "n", "SC", "RIHS01_0"),
            ],
            "must be simulation_interfaces/srv/SpawnEntity",
        ),
    ],
)  # fmt: skip
def test_what_is_wrong_in_the_graph_is_told(tokens: list[str], text: str) -> None:
    wrong = of(tokens).wrong
    assert any(text in each for each in wrong), wrong
    assert all("\n" not in each for each in wrong)


def test_a_stack_in_another_namespace_is_none_of_others() -> None:
    tokens = [*stack(HERE), HERE.node_token("c3", 0, "rviz")]
    found = of(tokens, prefix="nobody")
    assert found.wrong == [
        "no node of Mazebot in namespace /nobody, but in namespace /: must be MAZEBOT_BUS_PREFIX=''"
    ]
    assert found.found.endswith(f"0 nodes of Mazebot, {len(SERVICES)} of Mazebot in /, 1 of others")


@pytest.mark.parametrize("form", ["kilted", "lyrical"])
def test_clients_of_either_version_of_simulation_interfaces_fit(form: str) -> None:
    kind = "simulation_interfaces/srv/SpawnEntity"
    client = end(HERE, "/spawn_entity", kind, "n", "SC", interfaces(form).hash_of(kind))
    assert not of([*stack(HERE), client]).wrong


@pytest.mark.parametrize(
    ("environment", "text"),
    [
        ({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}, "rmw_fastrtps_cpp: must be rmw_zenoh_cpp"),
        ({"ROS_DISTRO": "jazzy"}, "RMW_IMPLEMENTATION: not set"),
        ({**RIGHT, "ROS_DISTRO": "humble"}, "ROS_DISTRO: humble: must be jazzy or newer"),
        ({**RIGHT, "ROS_DISTRO": "kilted"}, "MAZEBOT_BUS_DISTRO=kilted"),
        ({**RIGHT, "ROS_DISTRO": "jazzy"}, "ZENOH_CONFIG_OVERRIDE: not set"),
        (
            {**RIGHT, "ZENOH_CONFIG_OVERRIDE": 'connect/endpoints=["tcp/127.0.0.1:74470"]'},
            'must have connect/endpoints=["tcp/127.0.0.1:7447"]',
        ),
        ({**RIGHT, "ROS_DOMAIN_ID": "5"}, "ROS_DOMAIN_ID: 5: must be 0"),
    ],
)
def test_what_is_wrong_in_the_shell_is_told(environment: dict[str, str], text: str) -> None:
    wrong = of(stack(HERE), environment).wrong
    assert any(text in each for each in wrong), wrong


def test_without_a_router_the_command_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    config = BusConfig(connect=f"tcp/127.0.0.1:{free_port()}")
    assert doctor(config, RIGHT, as_json=False) == 1
    assert f"no Zenoh router at {config.connect}: start a stack" in capsys.readouterr().out


def test_the_plain_wire_is_none_of_ros() -> None:
    assert "must be rmw_zenoh" in of(stack(HERE), wire="plain").wrong[0]


@pytest.fixture
def endpoint() -> Iterator[str]:
    with running_router() as address:
        yield address


def test_the_command_tells_the_exports_of_a_running_stack(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("ROS_DISTRO", "ROS_DOMAIN_ID", "ZENOH_CONFIG_OVERRIDE", "RMW_IMPLEMENTATION"):
        monkeypatch.delenv(name, raising=False)

    class Physics(Node):
        name = "physics"
        _config = ServiceConfig()

        def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
            pass

    command = ["doctor", "--ros", "--connect", endpoint]
    nobody = CliRunner().invoke(app, command)
    assert nobody.exit_code == 1
    assert "wrong: no node of Mazebot in domain 0" in nobody.output
    node = Physics()
    bus = Bus(open_session(BusConfig(connect=endpoint), timeout_s=5.0), node, Inbox(node))
    try:
        result = CliRunner().invoke(app, command)
    finally:
        bus.close()
    assert result.exit_code == 0, result.output
    assert f"export ZENOH_CONFIG_OVERRIDE='connect/endpoints=[\"{endpoint}\"]'" in result.output
    assert "1 nodes of Mazebot, 0 of others\nnothing is wrong" in result.output
