"""The router of containers asks for keys, and each container has its own."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from mazebot.common.access.grants import OPERATOR, ROUTER
from mazebot.common.access.key_store import KeyStore
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.session import BusUnavailableError, open_session
from mazebot.common.files.key_file import HANDED_OUT
from mazebot.common.files.root import ROOT
from mazebot.common.messages.topics import SERVICES
from tests.cli.test_app import mazebot
from tests.compose.checks import is_active
from tests.compose.stack import DEMOS, OPEN, Stack, stack_of, wait_until
from tests.console.live.running import Page

FILE, OPENED = (
    yaml.safe_load((ROOT / name).read_text()) for name in OPEN["COMPOSE_FILE"].split(":")
)
STANZAS = {name: one for name, one in FILE["services"].items() if name != "nothing-named"}
IDENTITIES = {*SERVICES, OPERATOR}
HUMAN = "console", "mazebot", "navigation-only", "ros2-bridge"
DEMO = DEMOS["original"]


def keys_of(stanza: dict[str, Any]) -> set[str]:
    """The volumes of keys that a container sees."""
    volumes = (volume for volume in stanza["volumes"] if isinstance(volume, str))
    return {volume for volume in volumes if volume.startswith(("key-", "./keys"))}


def test_each_container_signs_in_and_sees_no_key_but_its_own() -> None:
    for name, stanza in STANZAS.items():
        if name == ROUTER:
            continue
        assert stanza["environment"]["MAZEBOT_BUS_KEY_FILE"] == f"/keys/{HANDED_OUT}"
        identity = name if name in SERVICES else OPERATOR if name in HUMAN else "bringup"
        of_foxglove = {"key-operator:/operator:ro"} if name == "recorder" else set()
        assert keys_of(stanza) == {f"key-{identity}:/keys:ro"} | of_foxglove


def test_the_router_alone_hands_them_out() -> None:
    handed = {f"key-{name}:/handout/{name}" for name in (ROUTER, *IDENTITIES)}
    assert keys_of(STANZAS[ROUTER]) == handed | {"./keys:/keys"}
    assert FILE["volumes"].keys() == {f"key-{name}" for name in (ROUTER, *IDENTITIES)}
    for field in ("user", "cap_add", "init"):
        assert STANZAS[ROUTER][field] == STANZAS["recorder"][field]


def test_an_open_router_is_asked_without_a_key_by_everyone() -> None:
    assert OPENED["services"].keys() == STANZAS.keys()
    for name, stanza in OPENED["services"].items():
        named = {key for key in STANZAS[name]["environment"] if re.search("KEY|HANDOUT", key)}
        assert stanza["environment"] == dict.fromkeys(named, "")


@pytest.fixture(scope="module")
def stack(person: int, image: str) -> Iterator[Stack]:
    with stack_of(person) as stack:
        for stanza in (DEMO, "console"):
            started = stack.compose("up", "--detach", stanza)
            assert started.returncode == 0, started.stdout
        wait_until(lambda: is_active(stack, DEMO), 60.0, "both lines")
        yield stack


def opens(stack: Stack, name: str | None) -> bool:
    """Whether the router lets somebody in with the key of that name, or with none."""
    key_file = None if name is None else KeyStore(stack.folder / "keys").path_of(name)
    try:
        session = open_session(BusConfig(connect=stack.endpoint, key_file=key_file), 5.0)
    except BusUnavailableError:
        return False
    session.close()  # type: ignore[no-untyped-call]
    return True


def says(stack: Stack, service: str, text: str) -> bool:
    """Whether a service has said something."""
    return text in stack.logs(service)


@pytest.mark.compose
def test_nobody_gets_in_without_a_key_and_the_owner_of_the_clone_has_one(
    stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(stack.folder))
    assert not opens(stack, None)
    assert opens(stack, OPERATOR)
    keys = stack.folder / "keys"
    assert {path.stat().st_uid for path in (keys, *keys.iterdir())} == {stack.uid}
    monkeypatch.chdir(stack.folder)
    goal = ("goal", "-1.678", "-1.178", "--timeout", "0.5", "--connect", stack.endpoint)
    assert mazebot(*goal).stdout.startswith("driving to")
    monkeypatch.setenv("MAZEBOT_BUS_KEY_FILE", "keys/viewer.key")
    refused = mazebot(*goal)
    assert refused.returncode != 0
    assert refused.stdout == ""
    assert "viewer" in refused.stderr


@pytest.mark.compose
def test_a_person_without_python_has_the_command_line_in_a_container(stack: Stack) -> None:
    goal = ("goal", "-1.678", "-1.178", "--timeout", "0.5")
    sent = stack.compose("run", "--rm", "-T", "mazebot", *goal)
    assert "driving to" in sent.stdout
    told = stack.compose("run", "--rm", "-T", "mazebot", "topic", "echo", "/scan", "--once")
    assert told.returncode == 0, told.stdout
    assert "range_max" in told.stdout
    said = stack.inside("navigation", "import os; print(os.access('/keys/own.key', os.W_OK))")
    assert said == "False"


@pytest.mark.compose
def test_a_container_reads_its_own_key_alone(stack: Stack) -> None:
    code = "import json; print(json.load(open('/keys/own.key'))['name'])"
    for service in ("physics", "navigation", "recorder"):
        assert stack.inside(service, code) == service
        assert stack.inside(service, "import os; print(os.listdir('/keys'))") == "['own.key']"
    assert stack.inside("physics", "import os; print(os.path.exists('/handout'))") == "False"


@pytest.mark.compose
def test_the_console_commands_as_the_operator(stack: Stack) -> None:
    with Page(f"http://127.0.0.1:{stack.console_port}") as page:
        assert page.wait_kind("world")["name"] == "sim_house"
        assert page.done(do="simulation", pause=True).startswith("paused")
        assert page.done(do="simulation", pause=False).startswith("running")


@pytest.mark.compose
def test_keys_are_replaced_while_the_stack_runs(stack: Stack) -> None:
    store = KeyStore(stack.folder / "keys")
    old = store.path_of(OPERATOR).read_text()
    store.rotate(())
    for path in store.folder.iterdir():
        os.chown(path, stack.uid, stack.uid)
    for service in ("physics", "navigation", "recorder"):
        anew = functools.partial(says, stack, service, "signed in with a new key")
        wait_until(anew, 60.0, f"{service} signs in anew")
    assert opens(stack, OPERATOR)
    kept = stack.folder / "old.key"
    kept.write_text(old)
    with pytest.raises(BusUnavailableError, match="refuses the key"):
        open_session(BusConfig(connect=stack.endpoint, key_file=kept))
    assert stack.inspect("physics")["RestartCount"] == 0
