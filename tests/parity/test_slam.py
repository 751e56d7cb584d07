"""A robot that maps, in process, and through CDR and a real router: every message is the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from mazebot.bench.parts.loopback_router import running_router
from mazebot.common.messages.topics import (
    EXPLORATION_STATUS,
    GOAL_POSE,
    LOCALIZATION_STATUS,
    MAP,
    PARTICLE_CLOUD,
    POSE_GRAPH,
    TF,
)
from mazebot.common.node import log
from mazebot.common.node.executive import Executive
from mazebot.embedded.demo import DemoOptions, build_nodes
from tests.parity.processes import running_services
from tests.parity.test_parity import comparable, count_by_topic, differences
from tests.parity.transport import Record, RecordedMemoryTransport, ZenohTransport

EPISODE_S = 4.0


def episode(transport: RecordedMemoryTransport | ZenohTransport, out_dir: Path) -> Record:
    """Four seconds of exploring the original house, without the camera."""
    options = DemoOptions(
        world_name="sim_house", seed=7, out_dir=out_dir, record=False, slam=True, camera=False
    )
    executive = Executive(build_nodes(options), transport, log.configure())
    try:
        if isinstance(transport, ZenohTransport):
            transport.wait_until_matched()
        assert executive.run(lambda: executive.now_ns >= EPISODE_S * 1e9) is None
    finally:
        executive.close()
    return transport.record


@pytest.fixture(scope="module")
def in_process(tmp_path_factory: pytest.TempPathFactory) -> Record:
    return episode(RecordedMemoryTransport(), tmp_path_factory.mktemp("memory") / "run")


def test_it_explores_with_a_map_of_its_own(in_process: Record) -> None:
    counts = count_by_topic(in_process)
    assert counts[MAP.name] >= 2
    assert counts[POSE_GRAPH.name] >= 1
    assert counts[GOAL_POSE.name] >= 1
    assert counts[EXPLORATION_STATUS.name] >= 3
    assert counts[LOCALIZATION_STATUS.name] >= 7
    assert counts[TF.name] > 150
    assert PARTICLE_CLOUD.name not in counts


@pytest.mark.slow
def test_every_message_is_the_same_again_over_a_router(in_process: Record, tmp_path: Path) -> None:
    with running_router() as endpoint:
        over_router = episode(ZenohTransport(endpoint), tmp_path / "run")
    assert comparable(over_router) == comparable(in_process)


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_every_message_is_the_same_between_processes_in_lockstep(
    in_process: Record, tmp_path: Path
) -> None:
    settings = {
        "MAZEBOT_BRINGUP_SLAM": "true",
        "MAZEBOT_BRINGUP_WORLD_NAME": "sim_house",
        "MAZEBOT_PHYSICS_CAMERA_ENABLED": "false",
    }
    with (
        running_router() as endpoint,
        running_services(endpoint, tmp_path, settings, ("localization",)) as stack,
    ):
        stack.wait_for(count_by_topic(comparable(in_process)))
        assert differences(in_process, stack.record()) == []
