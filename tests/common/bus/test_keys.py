"""Keys and tokens, as rmw_zenoh documents them; tests/ros2 lets others read them."""

from __future__ import annotations

import pytest

from mazebot.common.bus.config import BusConfig
from mazebot.common.config import ConfigError
from mazebot.common.messages import messages as msg
from mazebot.common.messages.cdr import encode
from mazebot.common.messages.keys import PUBLISHER, SUBSCRIBER, Keys, gid_of
from mazebot.common.messages.topics import (
    CMD_VEL,
    GOAL_POSE,
    MAP,
    PAUSE_GOAL,
    SCAN,
    TOPICS,
    WORLD,
)
from mazebot.common.messages.type_hash import hash_of
from mazebot.common.messages.wire import decode, of_own_type
from mazebot.common.settings.load import load

SCAN_KEY = f"scan/sensor_msgs::msg::dds_::LaserScan_/{hash_of('sensor_msgs/msg/LaserScan')}"
STRING = hash_of("std_msgs/msg/String")
WAYS = [Keys(), Keys(domain_id=5, prefix="lab/bot1/"), Keys("plain"), Keys("plain", 0, "bot1/")]


def test_keys_of_topics() -> None:
    assert Keys().of_topic(SCAN) == f"0/{SCAN_KEY}"
    assert Keys(domain_id=5, prefix="bot1/").of_topic(SCAN) == f"5/bot1/{SCAN_KEY}"
    hash_ = hash_of("mazebot_msgs/msg/World")
    assert Keys().of_topic(WORLD) == f"0/world/mazebot_msgs::msg::dds_::World_/{hash_}"
    assert Keys("plain", 5, "bot1/").of_topic(SCAN) == "bot1/scan"


def test_keys_of_queries_and_of_what_only_mazebot_knows_are_apart_by_domain() -> None:
    assert Keys(domain_id=5, prefix="bot1/").of_query(PAUSE_GOAL) == "5/bot1/navigation/pause"
    assert Keys(domain_id=5).own("mazebot/alive/x") == "5/mazebot/alive/x"
    assert Keys("plain", 5, "bot1/").of_query(PAUSE_GOAL) == "bot1/navigation/pause"


@pytest.mark.parametrize("keys", WAYS)
def test_a_key_leads_back_to_its_topic(keys: Keys) -> None:
    for topic in TOPICS:
        assert keys.topic_of(keys.of_topic(topic)) is topic
    assert keys.topic_of(keys.of_topic(CMD_VEL, msg.Twist.__msgtype__)) is CMD_VEL
    assert keys.topic_of(keys.of_query(PAUSE_GOAL)) is None


@pytest.mark.parametrize(
    "key",
    [
        f"1/{SCAN_KEY}", f"0/bot1/{SCAN_KEY}", f"0/{SCAN_KEY}0", "scan", "0/scan", "",
        f"0/scan/std_msgs::msg::dds_::String_/{STRING}",
    ],
)  # fmt: skip
def test_a_key_of_something_else_is_none_of_a_topic(key: str) -> None:
    assert Keys().topic_of(key) is None


def test_tokens_of_a_node_and_its_endpoints() -> None:
    keys = Keys(domain_id=2)
    assert keys.node_token("ab12", 3, "physics") == "@ros2_lv/2/ab12/3/3/NN/%/%/physics"
    scan = keys.endpoint_token("ab12", 3, 4, "physics", PUBLISHER, SCAN)
    place, _, type_and_hash = SCAN_KEY.partition("/")
    assert scan == f"@ros2_lv/2/ab12/3/4/MP/%/%/physics/%{place}/{type_and_hash}/2::,1:,:,:,,"
    named = Keys(prefix="lab/bot1/")
    assert named.node_token("ab12", 3, "physics").endswith("/NN/%/%lab%bot1/physics")
    token = named.endpoint_token("ab12", 3, 4, "physics", SUBSCRIBER, MAP)
    assert "/MS/%/%lab%bot1/physics/%lab%bot1%map/nav_msgs::msg::dds_::OccupancyGrid_/" in token
    assert token.endswith("/:1:,1:,:,:,,")
    assert keys.endpoint_token("a", 0, 1, "n", SUBSCRIBER, GOAL_POSE).endswith("/::,100:,:,:,,")


@pytest.mark.parametrize("keys", [Keys(), Keys(domain_id=5, prefix="lab/bot1/")])
@pytest.mark.parametrize("more", ["", "/cpu:buffers"])
def test_a_token_is_read_with_or_without_what_newer_versions_add(keys: Keys, more: str) -> None:
    for topic in TOPICS:
        token = keys.endpoint_token("ab12", 3, 4, "physics", PUBLISHER, topic) + more
        endpoint = keys.endpoint(token)
        assert endpoint is not None
        assert keys.topic_with(endpoint) is topic
        assert endpoint.misfit(topic) == ""
        assert endpoint.gid == gid_of(token)


@pytest.mark.parametrize(
    "token",
    [
        "@ros2_lv/0/ab12/3/3/NN/%/%/physics",
        "@ros2_lv/1/a/0/1/MP/%/%/n/%scan/sensor_msgs::msg::dds_::LaserScan_/RIHS01_0/::,:,:,:,,",
        "@ros2_lv/0/a/0/1/XX/%/%/n/%scan/sensor_msgs::msg::dds_::LaserScan_/RIHS01_0/::,:,:,:,,",
        "mazebot/alive/physics/ab12",
    ],
)
def test_other_tokens_are_none_of_a_publisher_here(token: str) -> None:
    assert Keys().endpoint(token) is None


def test_a_publisher_of_another_type_is_told_with_both() -> None:
    token = Keys().endpoint_token("a", 0, 1, "teleop", PUBLISHER, CMD_VEL, msg.Twist.__msgtype__)
    endpoint = Keys().endpoint(token)
    assert endpoint is not None
    assert endpoint.misfit(CMD_VEL) == ""
    assert endpoint.misfit(SCAN) == "geometry_msgs/msg/Twist: must be sensor_msgs/msg/LaserScan"
    hash_ = hash_of("geometry_msgs/msg/Twist")
    older = Keys().endpoint(token.replace(hash_, "TypeHashNotSupported"))
    assert older is not None
    reason = f"geometry_msgs/msg/Twist with the hash TypeHashNotSupported: must be {hash_}"
    assert older.misfit(CMD_VEL) == reason


def test_the_identity_of_an_endpoint() -> None:
    # XXH3 of 128 bits of the empty text, as its authors publish it.
    assert gid_of("") == bytes.fromhex("99aa06d3014798d86001c324468d497f")[::-1].hex()


def test_a_twist_is_taken_where_a_stamped_one_is() -> None:
    twist = msg.Twist(msg.Vector3(0.1, 0.0, 0.0), msg.Vector3(0.0, 0.0, -0.5))
    data = bytes(encode(msg.Twist.__msgtype__, twist))
    taken = decode(CMD_VEL, of_own_type(CMD_VEL, data))
    assert (taken.header, taken.twist) == (msg.header(0, ""), twist)
    stamped = msg.TwistStamped(msg.header(5, "base_footprint"), twist)
    whole = bytes(encode(msg.TwistStamped.__msgtype__, stamped))
    assert of_own_type(CMD_VEL, whole) == whole


@pytest.mark.parametrize(
    ("prefix", "namespace"),
    [("", ""), ("/", ""), ("bot1", "bot1/"), ("/bot1/", "bot1/"), ("lab/bot1", "lab/bot1/")],
)
def test_a_prefix_is_a_namespace_however_it_is_written(prefix: str, namespace: str) -> None:
    assert BusConfig(prefix=prefix).keys == Keys(prefix=namespace)


def test_the_domain_of_ros_2_holds_where_no_setting_names_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert load(BusConfig, "bus", []).keys.domain_id == 7
    monkeypatch.setenv("MAZEBOT_BUS_DOMAIN_ID", "8")
    assert load(BusConfig, "bus", []).keys.domain_id == 8


@pytest.mark.parametrize(
    ("variable", "value", "reason"),
    [
        ("MAZEBOT_BUS_PREFIX", "1bot", "prefix: must be a ROS namespace"),
        ("MAZEBOT_BUS_WIRE", "dds", "wire: must be 'rmw_zenoh' or 'plain'"),
        ("ROS_DOMAIN_ID", "233", "domain_id: must be less than or equal to 232"),
        ("ROS_DOMAIN_ID", "x", "from ROS_DOMAIN_ID"),
    ],
)
def test_a_wrong_setting_is_one_line(
    variable: str, value: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(variable, value)
    with pytest.raises(ConfigError, match=reason) as caught:
        load(BusConfig, "bus", [])
    assert "\n" not in str(caught.value)
    assert value in str(caught.value)


def test_a_service_has_a_key_and_a_token_of_its_type() -> None:
    keys = Keys(domain_id=4, prefix="bot1/")
    name, kind, digest = "/map_server/load_map", "nav2_msgs/srv/LoadMap", "RIHS01_ab"
    assert keys.typed(name, kind, digest) == (
        "4/bot1/map_server/load_map/nav2_msgs::srv::dds_::LoadMap_/RIHS01_ab"
    )
    token = keys.typed_token("a1", 2, 3, "worldgen", "SS", name, kind, digest, "::,10:,:,:,,")
    assert token == (
        "@ros2_lv/4/a1/2/3/SS/%/%bot1/worldgen/%bot1%map_server%load_map/"
        "nav2_msgs::srv::dds_::LoadMap_/RIHS01_ab/::,10:,:,:,,"
    )
    found = keys.endpoint(token)
    assert found is not None
    assert (found.kind, found.node, found.name) == ("SS", "/bot1/worldgen", "/bot1" + name)
    assert (found.type_name, found.type_hash) == (kind, digest)
