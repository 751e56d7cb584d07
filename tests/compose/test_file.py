"""docker-compose.yaml as it is written; needs no Docker."""

from __future__ import annotations

import posixpath
import re
from typing import Any

import pytest
import yaml

from mazebot.common.files.root import ROOT
from mazebot.common.messages.topics import SERVICES

FILE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yaml").read_text())
STANZAS: dict[str, Any] = FILE["services"]
NAMES = ["router", *(service for service in SERVICES if service != "bringup")]
MAPPERS = {"mapping", "explorer"}
BRIDGE = "ros2-bridge"
CONTAINERS = [name for name in STANZAS if name != "nothing-named"]
OURS = [name for name in CONTAINERS if name != BRIDGE]
"""Those of Mazebot's own image."""
PROFILES = {"original", "enhanced", "slam", "slam-enhanced"}
SIMULATORS = {"simulator": "original", "simulator-enhanced": "enhanced"}
"""Each with the profile of the demo in the same world."""
NAVIGATION = "navigation-only"
SIMULATION = {"worldgen", "physics", "spawner", "perception"}
WRITERS = {"router", "recorder", "console"}
"""They write into folders of the clone, as its owner."""
DEMOS = {
    "original": "demo-world",
    "enhanced": "demo-world-enhanced",
    "slam": "slam-world",
    "slam-enhanced": "slam-world-enhanced",
}


def gate_of(demo: str) -> str:
    """The stanza that fails instead of a demo while another world runs."""
    return f"{demo}-refused.another-world-runs.docker-compose-down-ends-it"


@pytest.mark.parametrize("name", NAMES)
def test_each_service_has_a_stanza_that_runs_it_in_its_profiles(name: str) -> None:
    stanza = STANZAS[name]
    assert stanza["command"][:3] == ["python", "-m", f"mazebot.{name}"]
    if name in MAPPERS:
        assert set(stanza["profiles"]) == {"slam", "slam-enhanced"}
    elif name == "localization":
        assert set(stanza["profiles"]) == {"original", "enhanced", NAVIGATION}
    else:
        simulators = set() if name == "navigation" else SIMULATORS.keys()
        others = set() if name in SIMULATION else {NAVIGATION}
        assert set(stanza["profiles"]) == PROFILES | simulators | others
    assert stanza["restart"] == "unless-stopped"
    assert stanza["healthcheck"]["test"][-1] == name


def test_the_console_comes_up_alone_and_writes_as_the_recorder_does() -> None:
    stanza, recorder = STANZAS["console"], STANZAS["recorder"]
    assert stanza["command"][:3] == ["python", "-m", "mazebot.console"]
    assert stanza["profiles"] == ["console"]
    assert stanza["depends_on"] == []
    assert stanza["ports"] == ["127.0.0.1:${MAZEBOT_CONSOLE_PORT:-8080}:8080"]
    for field in ("user", "cap_add", "init", "entrypoint"):
        assert stanza[field] == recorder[field]
    assert stanza["healthcheck"]["test"][-1] == "mazebot.console.health"


def test_each_demo_needs_every_service() -> None:
    for profile, demo in DEMOS.items():
        stanza = STANZAS[demo]
        assert stanza["command"] == ["python", "-m", "mazebot.bringup"]
        assert stanza["profiles"] == [profile]
        assert stanza["restart"] == "no"
        without = {"localization"} if profile.startswith("slam") else MAPPERS
        needed = {*NAMES, gate_of(demo)} - without
        assert set(stanza["depends_on"]) == needed
        slam = stanza["environment"].get("MAZEBOT_BRINGUP_SLAM")
        assert slam == ("True" if profile.startswith("slam") else None)


@pytest.mark.parametrize("name", SIMULATORS)
def test_a_simulator_is_a_world_in_which_nobody_localises_or_drives(name: str) -> None:
    stanza = STANZAS[name]
    demo = STANZAS[DEMOS[SIMULATORS[name]]]
    assert stanza["profiles"] == [name]
    assert stanza["command"] == demo["command"]
    assert stanza["environment"] == demo["environment"] | {"MAZEBOT_BRINGUP_DRIVE": "False"}
    assert set(stanza["depends_on"]) == {"router", "recorder", *SIMULATION, gate_of(name)}
    gate = STANZAS[gate_of(name)]
    assert gate["environment"] == STANZAS[gate_of(DEMOS[SIMULATORS[name]])]["environment"]


def test_navigation_comes_up_alone() -> None:
    stanza = STANZAS[NAVIGATION]
    assert stanza["profiles"] == [NAVIGATION]
    assert set(stanza["depends_on"]) == {"router", "localization", "navigation", "recorder"}


def test_a_demo_asks_for_any_world_with_anything_put_over_it() -> None:
    for name in (*DEMOS.values(), *map(gate_of, DEMOS.values())):
        environment = STANZAS[name]["environment"]
        assert environment["MAZEBOT_BRINGUP_WORLD_NAME"].startswith("${WORLD_NAME:-sim_house")
        assert environment["MAZEBOT_BRINGUP_WORLD_OVERRIDES"] == "${WORLD_SET:-}"


@pytest.mark.parametrize(
    ("worlds_dir", "texture_base", "worlds", "textures"),
    [
        (False, False, "/opt/mazebot/worlds", "/opt/mazebot/worlds/textures"),
        (True, False, "/worlds", "/worlds/textures"),
        (False, True, "/opt/mazebot/worlds", "/textures"),
        (True, True, "/worlds", "/textures"),
    ],
)
def test_worlds_and_textures_are_the_image_s_or_one_s_own(
    worlds_dir: bool, texture_base: bool, worlds: str, textures: str
) -> None:
    environment = STANZAS["worldgen"]["environment"]

    def path(name: str) -> str:
        text = str(environment[f"MAZEBOT_WORLDGEN_{name}"])
        for variable, given in (("WORLDS_DIR", worlds_dir), ("TEXTURE_BASE", texture_base)):
            text = re.sub(rf"\${{{variable}:\+([^}}]*)}}", r"\1" if given else "", text)
        return posixpath.normpath(text)

    assert path("WORLDS_DIR") == worlds
    assert path("TEXTURE_BASE") == textures
    folders = [volume for volume in STANZAS["worldgen"]["volumes"] if isinstance(volume, dict)]
    assert {volume["target"] for volume in folders} == {"/worlds", "/textures", "/maps"}
    assert all(volume["read_only"] for volume in folders)


@pytest.mark.parametrize("name", CONTAINERS)
def test_each_stanza_is_hardened(name: str) -> None:
    stanza = STANZAS[name]
    assert stanza["read_only"] is True
    assert stanza["cap_drop"] == ["ALL"]
    assert stanza["security_opt"] == ["no-new-privileges:true"]
    # Else Docker lets a service swap as much again.
    assert stanza["memswap_limit"] == stanza["mem_limit"]
    assert all(port.startswith("127.0.0.1:") for port in stanza.get("ports", ()))
    assert name in WRITERS or stanza["user"] == "10001:10001"


@pytest.mark.parametrize("name", OURS)
def test_each_stanza_but_the_bridge_is_in_the_stack_s_own_network(name: str) -> None:
    stanza = STANZAS[name]
    assert set(stanza["profiles"]) <= {*PROFILES, *SIMULATORS, NAVIGATION, "console", "tools"}
    assert stanza["image"] == "mazebot"
    assert "network_mode" not in stanza
    assert "edge" not in stanza["networks"] or name in WRITERS


def test_the_bridge_reaches_the_router_s_published_port_alone() -> None:
    stanza = STANZAS[BRIDGE]
    assert stanza["command"] == ["python", "-m", "mazebot.ros2_bridge"]
    assert (stanza["image"], stanza["profiles"]) == ("mazebot-ros2", ["ros2"])
    assert stanza["network_mode"] == "host"
    assert not {"ports", "networks", "depends_on"} & stanza.keys()
    port = STANZAS["router"]["ports"][0].removesuffix(":7447").replace("127.0.0.1:", "")
    assert stanza["environment"]["MAZEBOT_BUS_CONNECT"] == f"tcp/127.0.0.1:{port}"
    lists = {name for name in stanza["environment"] if name.startswith("MAZEBOT_ROS2_BRIDGE_")}
    # And none that would let Fast DDS leave the loopback.
    assert lists == {f"MAZEBOT_ROS2_BRIDGE_{name}" for name in ("TO_ROS", "FROM_ROS", "SERVICES")}
    assert {stanza["environment"][name] for name in lists} == {None}


def test_what_a_person_builds_by_name_builds_the_image_and_nobody_looks_elsewhere() -> None:
    builders = {name for name in OURS if "build" in STANZAS[name]}
    assert builders == {*DEMOS.values(), *SIMULATORS, NAVIGATION, "console"}
    assert all(STANZAS[name]["build"] == FILE["x-build"] for name in builders)
    assert {STANZAS[name]["pull_policy"] for name in OURS} == {"never"}
    # Two builders in one `up` give two images of the same content, and the next `up` starts anew.
    assert not any(builders & set(STANZAS[name]["depends_on"]) for name in OURS)


def test_the_environment_file_enables_every_profile() -> None:
    (line,) = (
        line
        for line in (ROOT / ".env").read_text().splitlines()
        if line.startswith("COMPOSE_PROFILES=")
    )
    used = {profile for stanza in STANZAS.values() for profile in stanza["profiles"]}
    assert set(line.partition("=")[2].split(",")) == used


def test_what_takes_long_of_the_bridge_s_image_is_kept_until_a_definition_changes() -> None:
    stages = re.split(r"^FROM ", (ROOT / "docker/ros2/Dockerfile").read_text(), flags=re.MULTILINE)
    (builds,) = (stage for stage in stages if "packages.py packages" in stage)
    assert "COPY --from=definitions /build/packages" in builds
    assert "services" not in builds
    assert "import mazebot" not in (script := (ROOT / "docker/ros2/packages.py").read_text())
    assert "from mazebot" not in script
