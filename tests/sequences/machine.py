"""How state machines run: as many sequences as SEQUENCES says, always the same ones."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from hypothesis import HealthCheck, settings
from hypothesis.stateful import RuleBasedStateMachine, run_state_machine_as_test

from mazebot.common.messages.topics import Query
from mazebot.embedded.session import Session

EXAMPLES = int(os.environ.get("SEQUENCES", "30"))
STEPS = 12

A = TypeVar("A")
R = TypeVar("R")
S = TypeVar("S")


def run(machine: type[RuleBasedStateMachine]) -> None:
    """Let hypothesis look for a sequence that the machine's model does not explain."""
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=EXAMPLES,
            stateful_step_count=STEPS,
            deadline=None,
            database=None,
            derandomize=True,
            suppress_health_check=list(HealthCheck),
        ),
    )


def explained(
    state: S,
    batch: Sequence[A],
    outcomes: Sequence[R],
    applied: Callable[[S, A], tuple[R, S]],
) -> list[S]:
    """The states to which an order of the requests leads that gives these outcomes. `applied` is
    the model: what comes of a request, and the state after it.
    """
    found: list[S] = []
    for order in itertools.permutations(range(len(batch))):
        after = state
        for index in order:
            outcome, after = applied(after, batch[index])
            if outcome != outcomes[index]:
                break
        else:
            if after not in found:
                found.append(after)
    return found


def asked_at_once(session: Session, requests: list[tuple[Query[Any, Any], Any]]) -> list[Any]:
    """The replies to requests that are sent before the first is answered, one to each."""
    replies: list[list[Any]] = [[] for _ in requests]
    for (query, message), mine in zip(requests, replies, strict=True):
        take: Callable[[Any], None] = mine.append
        assert session._transport.ask(query, message, take)
    session._turn_until(lambda: all(replies), "the requests")
    session.step()
    assert [len(mine) for mine in replies] == [1] * len(requests)
    return [mine[0] for mine in replies]
