"""Random sequences of goals, cancels and resets, several at once, against a model of an action
server.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    CANCEL_GOAL,
    PAUSE_GOAL,
    SEND_GOAL,
    WORLD,
    Query,
)
from mazebot.embedded.session import Session
from tests.sequences.machine import asked_at_once, explained, run

ACTIVE_S = 30.0


@dataclass(frozen=True)
class Asked:
    """One request."""

    verb: str
    goal_id: str | None = None
    goal: act.ActionGoal | None = None
    is_free: bool = True
    pause: bool = False


@dataclass(frozen=True)
class State:
    """The goal in progress, and those that ended since the last look, as (id, status)."""

    goal_id: str = ""
    goal: act.ActionGoal | None = None
    ended: tuple[tuple[str, str], ...] = ()

    def without(self, status: str) -> tuple[tuple[str, str], ...]:
        """What has ended, with the goal in progress."""
        return (*self.ended, (self.goal_id, status)) if self.goal_id else self.ended


def applied(state: State, asked: Asked) -> tuple[bool, State]:
    """Whether the model does what is asked, and the state after it."""
    if asked.verb == "send":
        assert asked.goal_id
        if asked.goal_id == state.goal_id:
            return asked.goal == state.goal, state
        if asked.goal_id in dict(state.ended):
            return False, state
        if not asked.is_free:
            return False, state
        return True, State(asked.goal_id, asked.goal, state.without("aborted"))
    if not state.goal_id or asked.goal_id not in (None, state.goal_id):
        return False, state
    if asked.verb == "pause":
        return True, state
    return True, State(ended=state.without("canceled"))


class Goals(RuleBasedStateMachine):
    """Each goal that was accepted ends once, and no other does."""

    session: Session
    goals: tuple[tuple[act.ActionGoal, bool], ...]
    numbers = itertools.count(1)

    @initialize()
    def begin(self) -> None:
        """Without a goal, where the robot starts."""
        self.session.reset()
        self._wait_until_active()
        self.heard: list[Any] = []
        self.stop = self.session.watch(
            (ACTION_RESULT, ACTION_FEEDBACK), lambda _, message, __: self.heard.append(message)
        )
        self.state = State()
        self.over: set[str] = set()

    def teardown(self) -> None:
        """Whatever is left ends by a cancel."""
        if not hasattr(self, "stop"):
            return
        if self.state.goal_id:
            asked_at_once(self.session, [(CANCEL_GOAL, doc.CancelGoal())])
            assert self._ended() == {(self.state.goal_id, "canceled")}
        self.stop()

    @rule(data=st.data(), count=st.integers(1, 3))
    def ask(self, data: st.DataObject, count: int) -> None:
        """Send requests before the first is answered."""
        batch = [self._drawn(data) for _ in range(count)]
        replies = asked_at_once(self.session, [_request(asked) for asked in batch])
        done = [
            reply.accepted if isinstance(reply, act.SendGoalReply) else not reply.error
            for reply in replies
        ]
        ended = self._ended()
        found = [
            one for one in explained(self.state, batch, done, applied) if set(one.ended) == ended
        ]
        assert len({one.goal_id for one in found}) == 1, (self.state, batch, replies, ended)
        self.state = State(found[0].goal_id, found[0].goal)

    @rule(seconds=st.sampled_from((0.1, 1.0)))
    def drive(self, seconds: float) -> None:
        """Let time pass."""
        self.session.run_for(seconds)
        for goal_id, status in self._ended():
            assert goal_id == self.state.goal_id
            assert status != "canceled"
            self.state = State()

    @rule()
    def reset(self) -> None:
        """A reset ends the goal."""
        self.session.reset()
        self.session.step()
        results = [one for one in self.heard if isinstance(one, act.ActionResult)]
        assert {one.error_code for one in results} <= {int(ErrorCode.WORLD_RESTARTED)}
        assert self._ended() == set(self.state.without("aborted"))
        self.state = State()
        self._wait_until_active()

    def _wait_until_active(self) -> None:
        assert self.session._run_while(lambda: not self.session._is_active(), ACTIVE_S)

    def _ended(self) -> set[tuple[str, str]]:
        """The results since the last look; feedback of a goal that is over is none."""
        ended: list[tuple[str, str]] = []
        for one in self.heard:
            assert one.goal_id not in self.over, one
            if isinstance(one, act.ActionResult):
                self.over.add(one.goal_id)
                ended.append((one.goal_id, one.status))
        self.heard.clear()
        return set(ended)

    def _drawn(self, data: st.DataObject) -> Asked:
        verb = data.draw(st.sampled_from(("send", "send", "cancel", "pause")))
        if verb == "pause":
            return Asked(verb, pause=data.draw(st.booleans()))
        if verb == "cancel":
            ids = (None, self.state.goal_id or "none", "goal-1")
            return Asked(verb, data.draw(st.sampled_from(ids)))
        goal, is_free = data.draw(st.sampled_from(self.goals))
        again = self.state.goal_id and data.draw(st.integers(0, 3)) == 0
        goal_id = self.state.goal_id if again else f"goal-{next(self.numbers)}"
        return Asked(verb, goal_id, goal, is_free)


def _request(asked: Asked) -> tuple[Query[Any, Any], Any]:
    if asked.verb == "send":
        assert asked.goal is not None
        return SEND_GOAL, act.SendGoal(goal_id=str(asked.goal_id), goal=asked.goal)
    if asked.verb == "cancel":
        return CANCEL_GOAL, doc.CancelGoal(goal_id=asked.goal_id)
    return PAUSE_GOAL, act.PauseGoal(pause=asked.pause)


def to(x_m: float, y_m: float) -> act.NavigateToPose:
    return act.NavigateToPose(pose=doc.Planar(x_m=x_m, y_m=y_m, yaw_rad=0.0))


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_each_goal_that_is_accepted_ends_once() -> None:
    with Session("original", camera=False) as session:
        world = session.latest(WORLD)
        assert world is not None
        wall = world.walls[0]
        locations = [(one.x_m, one.y_m) for one in world.locations[:3]]

        class Here(Goals):
            goals = (
                *((to(*place), True) for place in locations),
                (act.Spin(target_yaw_rad=1.5), True),
                (act.Wait(duration_s=0.5), True),
                (to(wall.x_m, wall.y_m), False),
                (to(50.0, 50.0), False),
            )

        Here.session = session
        run(Here)
