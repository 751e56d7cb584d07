"""Our hashes beside those of ROS 2's own generator."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.document_types import PACKAGE
from mazebot.common.messages.topics import TOPICS
from mazebot.common.messages.type_hash import definitions_of, hash_of, messages_of, type_hash
from mazebot.common.recordings.mcap.mcap_channels import definition_of
from mazebot.common.ros.definitions import DISTROS
from mazebot.common.ros.interfaces import interfaces
from mazebot.common.ros.own_services import own_definitions
from tests.ros2.environment import FOLDER, output_of

pytestmark = pytest.mark.ros2

SEEN = (
    ("jazzy", "nav2_msgs/action/NavigateToPose_SendGoal", "a4fcb3be"),
    ("jazzy", "nav2_msgs/action/NavigateToPose_GetResult", "c4079203"),
    ("jazzy", "nav2_msgs/action/NavigateToPose_FeedbackMessage", "9d1f6fa2"),
    ("lyrical", "nav2_msgs/action/NavigateToPose_FeedbackMessage", "2c1b4ec1"),
    ("jazzy", "nav2_msgs/action/Spin_SendGoal", "a8637277"),
    ("kilted", "nav2_msgs/action/Spin_SendGoal", "63ad359d"),
    ("jazzy", "nav2_msgs/action/FollowWaypoints_GetResult", "feb0bffe"),
    ("kilted", "nav2_msgs/action/FollowWaypoints_GetResult", "7bc8b2d1"),
    ("jazzy", "nav2_msgs/srv/ClearEntireCostmap", "553f54f9"),
    ("lyrical", "nav2_msgs/srv/ClearEntireCostmap", "f6d3228c"),
    ("jazzy", "nav2_msgs/srv/LoadMap", "eb875de5"),
    ("kilted", "simulation_interfaces/msg/EntityFilters", "8e7b12e8ea062f14"),
    ("kilted", "simulation_interfaces/msg/Result", "cf43a306adff3337"),
    ("lyrical", "simulation_interfaces/srv/SpawnEntity", "66860313e11009fa"),
    ("lyrical", "simulation_interfaces/srv/LoadWorld", "87d0ded1bfddb40a"),
    ("lyrical", "simulation_interfaces/srv/GetAvailableWorlds", "ce5589b5523f2732"),
    ("lyrical", "simulation_interfaces/srv/GetNamedPoses", "c3d12ab920115bfd"),
    ("lyrical", "simulation_interfaces/srv/GetSpawnables", "3e25fd827d8bcbd9"),
    ("lyrical", "simulation_interfaces/srv/GetEntityBounds", "17be8d36231178a5"),
    ("lyrical", "simulation_interfaces/msg/EntityInfo", "3b9a2e7fa00f9a59"),
)

PACKAGES = Path(__file__).parents[2] / "ros2"
TYPES = sorted({wire.type_name(topic) for topic in TOPICS})


def write(folder: Path, name: str, text: str) -> None:
    package, kind, short = name.split("/")
    file = folder / package / kind / f"{short}.{kind}"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)


@pytest.mark.parametrize("store", [Stores.ROS2_JAZZY, Stores.ROS2_KILTED, Stores.ROS2_LYRICAL])
def test_of_every_topic_in_each_distribution(store: Stores, tmp_path: Path) -> None:
    types = get_typestore(store)
    for kind, text in msg.OTHER_MESSAGES.items():
        types.register(get_types_from_msg(text, kind.__msgtype__))
    for name in (one for one in TYPES if one.startswith(PACKAGE)):
        types.register(get_types_from_msg(definition_of(name), name))
    definitions = {
        name: text for kind in TYPES for name, text in definitions_of(kind, types).items()
    }
    for name, text in definitions.items():
        file = tmp_path / f"{name}.msg"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    official = json.loads(output_of("official_hashes", str(tmp_path)))
    assert {name: type_hash(name, definitions) for name in definitions} == official
    assert {name: hash_of(name) for name in TYPES} == {name: official[name] for name in TYPES}


def test_of_the_package_that_people_build(tmp_path: Path) -> None:
    shutil.copytree(PACKAGES / PACKAGE, tmp_path / PACKAGE)
    for name in ("service_msgs/msg/ServiceEventInfo", "builtin_interfaces/msg/Time"):
        write(tmp_path, name, interfaces().definitions_of(name)[name])
    official = json.loads(output_of("official_hashes", str(tmp_path)))
    for file in (*PACKAGES.glob("*/msg/*.msg"), *PACKAGES.glob("*/srv/*.srv")):
        assert "/".join((*file.parts[-3:-1], file.stem)) in official
    topics = [name for name in TYPES if name.startswith(PACKAGE)]
    assert {name: hash_of(name) for name in topics} == {name: official[name] for name in topics}
    assert len(topics) > 20
    services = list(own_definitions())
    ours = {name: interfaces().hash_of(name) for name in services}
    assert ours == {name: official[name] for name in services}


def test_of_messages_services_and_actions_as_published() -> None:
    definitions: dict[str, str] = {}
    official: dict[str, str] = {}
    for file in FOLDER.glob("share/*/*/*"):
        name = f"{file.parts[-3]}/{file.parts[-2]}/{file.stem}"
        if file.suffix in (".msg", ".srv", ".action"):
            definitions[name] = file.read_text()
        elif file.suffix == ".json" and file.parts[-2] in ("msg", "srv", "action"):
            official[name] = json.loads(file.read_text())["type_hashes"][0]["hash_string"]
    # Those of IDL files alone have no such text.
    ours = {name: type_hash(name, definitions) for name in definitions}
    assert ours == {name: official[name] for name in definitions}
    assert {name.split("/")[1] for name in ours} == {"msg", "srv", "action"}
    assert len(ours) > 150


@pytest.mark.parametrize("distro", DISTROS)
def test_of_every_service_and_action_in_each_distribution(distro: str, tmp_path: Path) -> None:
    types = interfaces(distro)
    texts = dict(DISTROS[distro])
    for name in DISTROS[distro]:
        for part in messages_of(name, DISTROS[distro][name]):
            for each, text in types.definitions_of(part).items():
                if "/msg/" in each:
                    texts.setdefault(each, text)
    for name, text in texts.items():
        write(tmp_path, name, text)
    official = json.loads(output_of("official_hashes", str(tmp_path)))
    assert {name: types.hash_of(name) for name in official} == official
    assert {*DISTROS[distro]} <= {*official}
    assert "nav2_msgs/action/Spin_SendGoal" in official


def test_of_what_was_seen_elsewhere() -> None:
    """Of types that were built with their own packages: those of Nav2's branches, and of
    simulation_interfaces as others generated it.
    """
    for distro, name, start in SEEN:
        assert interfaces(distro).hash_of(name).startswith(f"RIHS01_{start}"), (distro, name)
