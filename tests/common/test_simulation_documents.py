"""Numbers of a simulation that no simulation has."""

from __future__ import annotations

import json
from typing import Any

import pytest

from mazebot.common.messages import cdr, wire
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import SIMULATION_CHECKPOINT, SIMULATION_STATS, Topic
from tests.common.samples import SAMPLES


@pytest.mark.parametrize("topic", [SIMULATION_STATS, SIMULATION_CHECKPOINT], ids=lambda t: t.name)
@pytest.mark.parametrize("field", ["seed", "epoch", "iterations"])
@pytest.mark.parametrize("value", [-1, 2**63])
def test_a_seed_and_what_is_counted_fit_a_random_stream(
    topic: Topic[Any], field: str, value: int
) -> None:
    document = json.loads(SAMPLES[topic].model_dump_json()) | {field: value}
    data = cdr.encode(msg.String.__msgtype__, msg.String(json.dumps(document)))
    with pytest.raises(wire.WireError, match=field):
        wire.decode(topic, data)
