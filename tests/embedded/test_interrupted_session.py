"""A program that is interrupted, or fails, while time passes in its session."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import JOINT_STATES, ODOM, SCAN
from mazebot.embedded.session import RefusedError, Session
from tests.worldgen import folder

AT_S = 0.5


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    worlds_dir = folder.make(tmp_path / "worlds")
    with Session("room", camera=False, worlds_dir=worlds_dir) as opened:
        opened.run_for(0.1)
        yield opened


def fail() -> None:
    raise KeyError("of my own")


def press_ctrl_c() -> None:
    signal.raise_signal(signal.SIGINT)


def run(session: Session, act: Callable[[], None], call: Callable[[], object]) -> int:
    """The steps done when a call was ended by what the user does in its middle."""

    def receive(_: object, scan: msg.LaserScan, __: object) -> None:
        if msg.ns_from_time(scan.header.stamp) >= AT_S * 1e9:
            end()
            act()

    end = session.watch((SCAN,), receive)
    with pytest.raises((KeyError, KeyboardInterrupt)):
        call()
    return session.stats.iterations


@pytest.mark.parametrize("act", [fail, press_ctrl_c])
def test_what_is_interrupted_is_paused(session: Session, act: Callable[[], None]) -> None:
    hashes = []
    for call in (
        lambda: session.run_for(60.0),
        lambda: session.step(10_000),
        lambda: session.wait(60.0),
        lambda: session.command(0.0, 0.0, for_s=60.0),
    ):
        session.reset()
        done = run(session, act, call)
        assert session.stats.paused
        assert done < 1.1 * AT_S * 240
        for steps in (1, 5):
            done += steps
            assert session.step(steps).iterations == done
        hashes.append((done, session.run_until(2.0).state_hash))
    # Nothing was left half done: the run is that of the other calls.
    session.reset()
    uninterrupted = session.run_until(2.0).state_hash
    assert hashes[:3] == [(hashes[0][0], uninterrupted)] * 3


def test_each_node_takes_its_step_to_the_end(session: Session) -> None:
    def receive(*_: object) -> None:
        end()
        joints.clear()
        fail()

    with session.watching(JOINT_STATES) as joints:
        end = session.watch((ODOM,), receive)
        with pytest.raises(KeyError):
            session.run_for(1.0)
        odom = session.latest(ODOM)
        assert odom is not None
        # Physics publishes the joints after the odometry.
        assert [one.header.stamp for one in joints[:1]] == [odom.header.stamp]


def test_a_refused_run_pauses_nothing(session: Session) -> None:
    session.resume()
    with pytest.raises(RefusedError):
        session.step(0)
    assert not session.stats.paused
