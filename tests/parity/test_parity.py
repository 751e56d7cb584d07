"""One episode in process, and through CDR and a real router: every message is the same."""

import json
import re
import signal
from collections import Counter
from pathlib import Path

import pytest

from mazebot.bench.parts.loopback_router import running_router
from mazebot.cli.diff import diff_runs
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.query import ask
from mazebot.common.bus.serve import EXIT_OUT_OF_STEP
from mazebot.common.bus.session import open_session
from mazebot.common.messages.documents import GetEntities, SimulationControl
from mazebot.common.messages.topics import (
    BY_NAME,
    CLOCK,
    EVALUATION,
    GET_ENTITIES,
    PARAMETERS,
    ROSOUT,
    SIMULATION_CONTROL,
    SIMULATION_STATS,
    WORLD,
)
from mazebot.common.messages.wire import decode
from mazebot.common.node import log
from mazebot.common.node.executive import Executive
from mazebot.embedded.demo import DemoOptions, build_nodes, run
from tests.parity.processes import DEADLINE_S, busy, running_services
from tests.parity.transport import Record, RecordedMemoryTransport, ZenohTransport

EPISODE_S = 4.0
ANSWER_S = 10.0
NAMES_A_FOLDER = {EVALUATION.name, PARAMETERS.name, ROSOUT.name}


def episode(
    transport: RecordedMemoryTransport | ZenohTransport, out_dir: Path, seed: int = 7
) -> Record:
    """Four seconds of driving in the enhanced world, with the camera on."""
    options = DemoOptions(seed=seed, out_dir=out_dir, record=False)
    nodes = build_nodes(options)
    executive = Executive(nodes, transport, log.configure())
    try:
        if isinstance(transport, ZenohTransport):
            transport.wait_until_matched()
        assert executive.run(lambda: executive.now_ns >= EPISODE_S * 1e9) is None
    finally:
        executive.close()
    return transport.record


def comparable(record: Record) -> list[tuple[str, int, str, bytes]]:
    """The record without the topics that name the run's folder."""
    return [entry for entry in record if entry[0] not in NAMES_A_FOLDER]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the run in one process."""
    return tmp_path_factory.mktemp("memory") / "run"


@pytest.fixture(scope="module")
def in_process(folder: Path) -> Record:
    return episode(RecordedMemoryTransport(), folder)


def test_the_episode_is_one(in_process: Record) -> None:
    counts = {name: sum(entry[0] == name for entry in in_process) for name in BY_NAME}
    assert counts["/world"] == 1
    assert counts["/scan"] == EPISODE_S * 10
    assert counts["/camera/color/image_raw"] == EPISODE_S * 10
    # Those of the last picture come with the next.
    assert counts["/aruco/detections"] == EPISODE_S * 10 - 1
    assert counts["/cmd_vel"] > 40
    assert counts["/imu"] == EPISODE_S * 120


def test_every_message_is_the_same_again_over_a_router(in_process: Record, tmp_path: Path) -> None:
    with running_router() as endpoint:
        over_router = episode(ZenohTransport(endpoint), tmp_path / "run")
    ours, theirs = comparable(in_process), comparable(over_router)
    for index, (mine, other) in enumerate(zip(ours, theirs, strict=False)):
        assert mine[:3] == other[:3], f"message {index}"
        assert mine[3] == other[3], f"message {index} on {mine[0]} at {mine[1]} ns differs"
    assert len(ours) == len(theirs)


@pytest.mark.parametrize("slam", [False, True])
@pytest.mark.parametrize("camera", [False, True])
def test_a_node_in_one_process_says_the_same_as_the_service_of_its_configuration(
    tmp_path: Path, camera: bool, slam: bool
) -> None:
    options = DemoOptions(out_dir=tmp_path, record=False, camera=camera, slam=slam)
    for node in build_nodes(options):
        alone = type(node)(node._config)  # type: ignore[call-arg]
        assert (alone.waiting_for(), alone.warning()) == (node.waiting_for(), node.warning())
        assert alone.facts() == node.facts()
        node.close()
        alone.close()


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_every_message_is_the_same_between_processes_in_lockstep(
    in_process: Record, tmp_path: Path
) -> None:
    with running_router() as endpoint, running_services(endpoint, tmp_path) as stack:
        stack.wait_for(count_by_topic(comparable(in_process)))
        assert differences(in_process, stack.record()) == []
        session = open_session(BusConfig(connect=endpoint))
        markers = ask(session, GET_ENTITIES, GetEntities(), ANSWER_S).markers
        assert len(markers) == 2
        paused = ask(session, SIMULATION_CONTROL, SimulationControl(pause=True), ANSWER_S).stats
        assert paused is not None
        assert paused.paused
        stepped = ask(session, SIMULATION_CONTROL, SimulationControl(step=5), ANSWER_S).stats
        assert stepped is not None
        assert stepped.iterations == paused.iterations + 5
        session.close()  # type: ignore[no-untyped-call]
        stack.processes["navigation"].kill()
        assert stack.processes["physics"].wait(DEADLINE_S) == EXIT_OUT_OF_STEP
        said = (tmp_path / "physics.log").read_text().splitlines()[-1]
    assert re.fullmatch(
        r"error: lockstep: navigation disconnected at \d+\.\d{3} s of simulation time", said
    )


@pytest.mark.slow
@pytest.mark.xdist_group("real_time")
@pytest.mark.timeout(240)
@pytest.mark.parametrize(
    "burners", [*(pytest.param(few, marks=pytest.mark.longest) for few in (0, 1)), 2]
)
def test_lockstep_repeats_also_where_the_machine_is_busy(
    in_process: Record, tmp_path: Path, burners: int
) -> None:
    with busy(burners), running_router() as endpoint, running_services(endpoint, tmp_path) as stack:
        stack.wait_for(count_by_topic(comparable(in_process)))
        assert differences(in_process, stack.record()) == []


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_the_recording_of_services_in_lockstep_is_that_of_one_process(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(DemoOptions(out_dir=tmp_path / "inside", goal=(0.5, 0.0, 0.8))) == 0
    settings = {"MAZEBOT_RECORDER_RECORD": "true", "MAZEBOT_BRINGUP_GOAL": "[0.5, 0.0, 0.8]"}
    with running_router() as endpoint, running_services(endpoint, tmp_path, settings) as stack:
        processes = stack.processes
        assert processes.pop("bringup").wait(DEADLINE_S) == 0
        for process in processes.values():
            process.send_signal(signal.SIGTERM)
        assert [process.wait(5.0) for process in processes.values()] == [0] * len(processes)
    capsys.readouterr()
    assert diff_runs(tmp_path, "inside", "run") == 0
    told = capsys.readouterr().out.splitlines()
    assert told[0].startswith("same world (sim_house_enhanced), seed (7)")
    assert told[1].startswith("the same: ")


@pytest.mark.slow
def test_one_who_hangs_is_named_and_the_run_ends(tmp_path: Path) -> None:
    # Longer than a first step takes on a busy machine.
    timeout = {"MAZEBOT_BUS_LOCKSTEP_TIMEOUT_S": "6.5"}
    with running_router() as endpoint, running_services(endpoint, tmp_path, timeout) as stack:
        stack.wait_for({CLOCK.name: 30})
        stack.processes["navigation"].send_signal(signal.SIGSTOP)
        assert stack.processes["physics"].wait(DEADLINE_S) == EXIT_OUT_OF_STEP
        said = (tmp_path / "physics.log").read_text().splitlines()[-1]
    assert re.fullmatch(
        r"error: lockstep: navigation timed out after 6\.5 s, at \d+\.\d{3} s of simulation time",
        said,
    )


def count_by_topic(record: Record) -> dict[str, int]:
    """Messages of an episode, by topic."""
    return Counter(name for name, sent_ns, _, _ in record if sent_ns < EPISODE_S * 1e9)


def differences(one: Record, other: Record) -> list[str]:
    """What differs before the episode's end, topic by topic, whoever was heard first."""

    def by_topic(record: Record) -> dict[str, list[tuple[int, str, bytes]]]:
        topics: dict[str, list[tuple[int, str, bytes]]] = {}
        for name, sent_ns, world, data in sorted(comparable(record)):
            if sent_ns < EPISODE_S * 1e9:
                topics.setdefault(name, []).append((sent_ns, world, data))
        return topics

    ours, theirs = by_topic(one), by_topic(other)
    found = []
    for name in sorted({*ours, *theirs}):
        mine, others = ours.get(name, []), theirs.get(name, [])
        if mine != others:
            at = [x[0] for x, y in zip(mine, others, strict=False) if x != y]
            found.append(f"{name}: {len(mine)} and {len(others)}, first at {at[:1]} ns")
    return found


def test_another_seed_gives_other_bytes(in_process: Record, tmp_path: Path) -> None:
    other = episode(RecordedMemoryTransport(), tmp_path / "other", seed=8)
    assert last_state_hash(other) != last_state_hash(in_process)
    assert world_hash(other) == world_hash(in_process)


def last_state_hash(record: Record) -> str:
    """The hash that stands for the whole motion of the robot."""
    data = [entry[3] for entry in record if entry[0] == SIMULATION_STATS.name][-1]
    return decode(SIMULATION_STATS, data).state_hash


def world_hash(record: Record) -> str:
    """Hash of the world that ran."""
    data = next(entry[3] for entry in record if entry[0] == WORLD.name)
    return decode(WORLD, data).hash


def test_the_summary_says_the_same(in_process: Record, folder: Path) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["state_hash"] == last_state_hash(in_process)
    assert summary["seed"] == 7
