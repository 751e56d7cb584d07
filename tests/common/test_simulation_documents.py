"""Numbers of a simulation that no simulation has."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from mazebot.common.messages import cdr, document_types, wire
from mazebot.common.messages.topics import SIMULATION_CHECKPOINT, SIMULATION_STATS, Topic
from tests.common.samples import SAMPLES


@pytest.mark.parametrize("topic", [SIMULATION_STATS, SIMULATION_CHECKPOINT], ids=lambda t: t.name)
@pytest.mark.parametrize("field", ["seed", "epoch", "iterations"])
def test_a_seed_and_what_is_counted_fit_a_random_stream(topic: Topic[Any], field: str) -> None:
    message = dataclasses.replace(document_types.pack(SAMPLES[topic]), **{field: -1})
    with pytest.raises(wire.WireError, match=field):
        wire.decode(topic, cdr.encode(wire.type_name(topic), message))
    too_large = SAMPLES[topic].model_copy(update={field: 2**63})
    with pytest.raises(wire.WireError, match="wrong type"):
        wire.encode(topic, too_large)
