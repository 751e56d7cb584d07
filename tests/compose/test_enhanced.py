"""`docker compose up demo-world-enhanced`: one tour, and what is done to it on the way."""

from __future__ import annotations

import itertools
import os
import re
import socket
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages import topics
from mazebot.common.messages.messages import TwistStamped, ns_from_time
from mazebot.common.messages.topics import CMD_VEL
from mazebot.common.messages.wire import decode
from tests.compose.checks import (
    ACTIVE,
    check_nothing_compiled,
    check_recordings,
    check_table,
    is_active,
)
from tests.compose.control import control
from tests.compose.motion import Witness
from tests.compose.stack import (
    DEMOS,
    SERVICES,
    Stack,
    inspect_network,
    stack_of,
    wait_until,
)

pytestmark = [pytest.mark.compose, pytest.mark.usefixtures("image")]

DEMO = DEMOS["enhanced"]
TOUR_S = 300.0
Measured = Callable[[str, float], None]
WRITERS = "router", "recorder"
"""They write into folders of the clone, as its owner."""
READ_ONLY_PLACES = ("/", "/opt/mazebot", "/home/mazebot", "/etc", "/usr")
PAUSE_S = 60.0
AFTER = 20
"""Commands after the pause that are looked at: a second of them."""
LATE_S = 0.2
"""When the watchdog stops the robot: a busy machine delays a command, but not until then."""
ACCELERATION_M_S2 = 1.0
ALARM = re.compile(r"WARN|ERROR|error:|Traceback|waiting for")


@dataclass
class Tour:
    """A tour that a person started and watches."""

    stack: Stack
    process: subprocess.Popen[bytes]
    output: Path
    started_s: float


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tour]:
    output = tmp_path_factory.mktemp("up") / "output"
    with stack_of(os.getuid()) as stack, output.open("wb") as stream:
        started_s = time.monotonic()
        yield Tour(stack, stack.in_foreground(stream, "up", DEMO), output, started_s)


@pytest.fixture
def witness(tour: Tour) -> Iterator[Witness]:
    wait_until(lambda: is_active(tour.stack, DEMO), 60.0, tour.output.read_text())
    witness = Witness(tour.stack.session())
    yield witness
    witness.close()


def test_localization_and_navigation_are_active_within_20_s(tour: Tour, measured: Measured) -> None:
    wait_until(lambda: is_active(tour.stack, DEMO), 20.0, "both lines")
    taken_s = time.monotonic() - tour.started_s
    measured("up to active", taken_s)
    assert taken_s < 20.0


@pytest.mark.parametrize("service", [*SERVICES, DEMO])
def test_a_container_has_what_it_needs_and_no_more(tour: Tour, service: str) -> None:
    facts = tour.stack.inspect(service)
    host = facts["HostConfig"]
    assert host["ReadonlyRootfs"] is True
    assert host["Privileged"] is False
    assert host["CapDrop"] == ["ALL"]
    assert "no-new-privileges:true" in host["SecurityOpt"]
    assert not {"seccomp:unconfined", "apparmor:unconfined"} & set(host["SecurityOpt"])
    assert host["PidsLimit"] == 128
    assert 0 < host["Memory"] <= 2 * 1024**3
    assert host["PidMode"] == host["UTSMode"] == host["UsernsMode"] == ""
    assert host["IpcMode"] in ("private", "shareable")
    assert not host["Devices"]
    mounts = {mount["Destination"]: mount["RW"] for mount in facts["Mounts"]}
    handed_out = {f"/handout/{name}": True for name in ("router", *topics.SERVICES, "operator")}
    allowed = {
        "router": {"/keys": True, "/owner": False, **handed_out},
        "worldgen": {"/keys": False, "/worlds": False, "/textures": False, "/maps": False},
        "recorder": {"/keys": False, "/operator": False, "/recordings": True, "/owner": False},
    }
    assert mounts == allowed.get(service, {"/keys": False})
    if service in WRITERS:
        assert sorted(host["CapAdd"]) == ["CHOWN", "SETGID", "SETUID"]
    else:
        assert facts["Config"]["User"] == "10001:10001"
        assert not host["CapAdd"]


@pytest.mark.parametrize("service", [*SERVICES, DEMO])
def test_a_service_runs_without_any_right(tour: Tour, service: str) -> None:
    status = tour.stack.status_of_process(service)
    none = "0000000000000000"
    assert status["CapEff"] == status["CapPrm"] == status["CapInh"] == status["CapAmb"] == none
    assert status["NoNewPrivs"] == "1"
    assert status["Seccomp"] == "2"
    uid = str(tour.stack.uid) if service in WRITERS else "10001"
    assert status["Uid"].split() == [uid] * 4
    assert status["Gid"].split() == [uid] * 4


@pytest.mark.parametrize("service", [*SERVICES, DEMO])
def test_a_service_cannot_write_its_root(tour: Tour, service: str) -> None:
    code = f"""
import os
for place in {READ_ONLY_PLACES}:
    try:
        open(os.path.join(place, "x"), "w")
    except OSError:
        continue
    print(place)
"""
    assert tour.stack.inside(service, code) == ""


def test_no_network_leads_outside(tour: Tour) -> None:
    for service in (*SERVICES, DEMO):
        networks = {name.rsplit("_", 1)[1]: name for name in tour.stack.networks_of(service)}
        ours = {"bus", "edge"} if service in WRITERS else {"bus"}
        assert set(networks) == ours, service
        for short, name in networks.items():
            network = inspect_network(name)
            if short == "bus":
                assert network["Internal"] is True
            else:
                option = "com.docker.network.bridge.enable_ip_masquerade"
                assert network["Options"][option] == "false"


def test_only_the_loopback_has_ports(tour: Tour) -> None:
    published = {}
    for service in (*SERVICES, DEMO):
        bindings = tour.stack.inspect(service)["HostConfig"]["PortBindings"] or {}
        hosts = [binding for several in bindings.values() for binding in several]
        assert all(binding["HostIp"] == "127.0.0.1" for binding in hosts), service
        published[service] = sorted(int(binding["HostPort"]) for binding in hosts)
    stack = tour.stack
    assert {name: ports for name, ports in published.items() if ports} == {
        "router": [stack.router_port],
        "recorder": sorted([stack.viewer_port, stack.data_port, stack.foxglove_port]),
    }
    for port in (stack.router_port, stack.viewer_port, stack.data_port):
        with socket.create_connection(("127.0.0.1", port), timeout=5.0):
            pass


def test_every_service_is_healthy(tour: Tour) -> None:
    def healthy() -> bool:
        states = [tour.stack.inspect(service)["State"] for service in SERVICES]
        return all(state["Health"]["Status"] == "healthy" for state in states)

    wait_until(healthy, 30.0, "all healthy")


def test_the_viewer_is_served(tour: Tour) -> None:
    address = f"http://127.0.0.1:{tour.stack.viewer_port}/"
    with urllib.request.urlopen(address, timeout=20.0) as page:
        assert page.status == 200
        assert f"%3A{tour.stack.data_port}%2Fproxy" in page.url


def said(stack: Stack) -> dict[str, list[str]]:
    """The lines of every container."""
    return {service: stack.logs(service).splitlines() for service in (*SERVICES, DEMO)}


@pytest.mark.timeout(300)
def test_a_minute_s_pause_in_mid_drive_alarms_nobody(tour: Tour, witness: Witness) -> None:
    """Seen by the last tests, too: the tour ends as it should."""
    stack = tour.stack
    session = stack.session()
    commands: list[TwistStamped] = []
    subscription = subscribe(
        session, CMD_VEL, lambda data, _: commands.append(decode(CMD_VEL, data))
    )
    wait_until(witness.driving, 60.0, "driving")
    at = control(stack, pause=True)
    before, sent, begin_s = said(stack), len(commands), time.monotonic()
    wait_until(lambda: time.monotonic() - begin_s > PAUSE_S, PAUSE_S + 5.0, "a minute")
    assert control(stack).iterations == at.iterations
    assert len(commands) <= sent + 1
    for service, lines in said(stack).items():
        new = lines[len(before[service]) :]
        assert not [line for line in new if ALARM.search(line)], f"{service}: {new}"
        state = stack.inspect(service)["State"]
        assert state["Status"] == "running"
        assert state.get("Health", {}).get("Status", "healthy") == "healthy"
        assert stack.inspect(service)["RestartCount"] == 0
    control(stack, pause=False)
    wait_until(lambda: len(commands) >= sent + AFTER, 30.0, "commands after the pause")
    for first, after in itertools.pairwise(commands[sent - 1 : sent + AFTER]):
        elapsed_s = _elapsed_s(first, after)
        assert elapsed_s < LATE_S
        change_m_s = abs(after.twist.linear.x - first.twist.linear.x)
        assert change_m_s <= ACCELERATION_M_S2 * elapsed_s + 0.02, (first, after)
    del subscription
    session.close()  # type: ignore[no-untyped-call]


def _elapsed_s(first: TwistStamped, after: TwistStamped) -> float:
    return (ns_from_time(after.header.stamp) - ns_from_time(first.header.stamp)) * 1e-9


def test_a_second_world_is_refused_and_the_first_goes_on(tour: Tour, witness: Witness) -> None:
    refused = tour.stack.compose("up", DEMOS["original"])
    assert refused.returncode != 0
    # Compose may end by clearing a line of the terminal.
    words = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", refused.stdout)
    # What it says of its own stopping may come before or after the reason.
    told = [line for line in words.splitlines() if "didn't complete successfully" in line]
    assert told
    assert "demo-world-refused.another-world-runs.docker-compose-down-ends-it" in told[-1]
    assert "Traceback" not in refused.stdout
    reasons = [
        line
        for line in tour.stack.logs(
            "demo-world-refused.another-world-runs.docker-compose-down-ends-it"
        ).splitlines()
        if line.startswith("[ERROR]")
    ]
    assert len(reasons) == 1
    assert "sim_house_enhanced" in reasons[0]
    assert tour.stack.inspect(DEMO)["State"]["Running"]
    before = len(witness.seen)
    wait_until(lambda: len(witness.seen) > before + 30, 10.0, "the simulation to go on")


def killed_while_driving(
    tour: Tour, witness: Witness, measured: Measured, service: str
) -> tuple[float, float]:
    """Kill a service while the robot drives: the times (s) of that and of the robot at rest."""
    wait_until(witness.driving, 60.0, "the robot to drive")
    killed_s = tour.stack.kill(service)
    wait_until(lambda: witness.rest_after(killed_s) is not None, 5.0, "the robot to stand still")
    rest_s = witness.rest_after(killed_s)
    assert rest_s is not None
    measured(f"{service} killed to robot at rest", rest_s - killed_s)
    return killed_s, rest_s


def test_a_killed_navigation_stops_the_robot_and_comes_back(
    tour: Tour, witness: Witness, measured: Measured
) -> None:
    killed_s, rest_s = killed_while_driving(tour, witness, measured, "navigation")
    wait_until(
        lambda: witness.appeared_after("navigation", killed_s) is not None, 20.0, "navigation"
    )
    back_s = witness.appeared_after("navigation", killed_s)
    assert back_s is not None
    measured("navigation killed to navigation back", back_s - killed_s)
    wait_until(witness.driving, 30.0, "the robot to drive again")
    measured("navigation killed to robot driving again", time.monotonic() - killed_s)
    assert rest_s - killed_s <= 0.4
    assert back_s - killed_s <= 5.0


def test_a_killed_localization_stops_the_robot_which_then_drives_on(
    tour: Tour, witness: Witness, measured: Measured
) -> None:
    killed_s, rest_s = killed_while_driving(tour, witness, measured, "localization")
    wait_until(witness.driving, 60.0, "the robot to drive again")
    measured("localization killed to robot driving again", time.monotonic() - killed_s)
    # The drive's own ramp from full speed takes 0.45 s of it.
    assert rest_s - killed_s <= 0.7


def test_the_tour_ends_with_its_table(tour: Tour) -> None:
    assert tour.process.wait(TOUR_S) == 0
    log = tour.stack.logs(DEMO)
    check_table(log)
    assert tour.stack.compose("logs", DEMO).stdout.count(ACTIVE) == 2
    assert tour.stack.inspect(DEMO)["State"]["ExitCode"] == 0
    assert "tour finished" in tour.output.read_text()


@pytest.mark.parametrize("service", SERVICES)
def test_the_image_has_every_kernel(tour: Tour, service: str) -> None:
    tour.process.wait(TOUR_S)
    check_nothing_compiled(tour.stack, service)


def test_down_is_fast_and_closes_the_recording(tour: Tour, measured: Measured) -> None:
    tour.process.wait(TOUR_S)
    taken_s = tour.stack.down()
    measured("down", taken_s)
    assert taken_s <= 5.0
    assert tour.stack.containers() == []
    (summary,) = check_recordings(tour.stack)
    assert summary["world"] == "sim_house_enhanced"
    assert [goal["reached"] for goal in summary["goals"]] == [True] * 5
    assert summary["contacts"]["count"] == 0
    assert set(summary["markers_seen"]) == {"60", "80"}
