"""Containers whose connections with the router are encrypted: docker/tls.yaml."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import yaml

from mazebot.common.files.root import ROOT
from tests.cli.test_app import mazebot
from tests.compose.access.test_keys import STANZAS
from tests.compose.checks import is_active
from tests.compose.stack import DEMOS, Stack, stack_of, wait_until

FILES = "docker-compose.yaml", "docker/tls.yaml"
ENCRYPTED = yaml.safe_load((ROOT / FILES[1]).read_text())["services"]
DEMO = DEMOS["original"]


def test_everyone_connects_by_tls() -> None:
    assert ENCRYPTED.keys() == STANZAS.keys()
    for name, stanza in ENCRYPTED.items():
        before = STANZAS[name]["environment"]["MAZEBOT_BUS_CONNECT"]
        after = stanza["environment"]["MAZEBOT_BUS_CONNECT"]
        assert after == before.replace("tcp/", "tls/")
    listen = STANZAS["router"]["command"][-1]
    assert ENCRYPTED["router"]["command"][-1] == listen.replace("tcp/", "tls/")


@pytest.fixture(scope="module")
def stack(person: int, image: str) -> Iterator[Stack]:
    with stack_of(person, {"COMPOSE_FILE": ":".join(FILES)}) as stack:
        started = stack.compose("up", "--detach", DEMO)
        assert started.returncode == 0, started.stdout
        wait_until(lambda: is_active(stack, DEMO), 60.0, "both lines")
        yield stack


@pytest.mark.compose
def test_a_goal_is_sent_by_tls_alone(stack: Stack) -> None:
    goal = ("goal", "-1.678", "-1.178", "--timeout", "0.5", "--connect")
    sent = mazebot(*goal, stack.endpoint.replace("tcp/", "tls/"), **stack.signs_in)
    assert sent.stdout.startswith("driving to"), sent.stderr
    refused = mazebot(*goal, stack.endpoint, **stack.signs_in)
    assert refused.returncode != 0
    assert "or encrypts: MAZEBOT_BUS_CONNECT=tls/" in refused.stderr
