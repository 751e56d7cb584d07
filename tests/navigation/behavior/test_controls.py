from __future__ import annotations

import pytest

from mazebot.navigation.behavior.engine.tree import TreeError
from tests.navigation.behavior.scripted_tree import Ticked


@pytest.mark.parametrize(
    ("kind", "scripts", "answers", "ticked"),
    [
        # A running child is gone back to; those before it are not asked again.
        ("Sequence", ["S", "RS", "S"], "RS", [1, 2, 1]),
        ("Fallback", ["F", "RS", "S"], "RS", [1, 2, 0]),
        # After a failure a Sequence starts over, one with memory goes on where it failed.
        ("Sequence", ["S", "FS", "S"], "FS", [2, 2, 1]),
        ("SequenceWithMemory", ["S", "FS", "S"], "FS", [1, 2, 1]),
        # The reactive ones ask the first child in every tick.
        ("ReactiveSequence", ["S", "RRS"], "RRS", [3, 3]),
        ("ReactiveSequence", ["SF", "R"], "RF", [2, 1]),
        ("ReactiveFallback", ["FFS", "R"], "RRS", [3, 2]),
        # What is skipped is passed over; where all are, so is the parent.
        ("Sequence", ["K", "S"], "S", [1, 1]),
        ("Sequence", ["K", "K"], "K", [1, 1]),
        ("Fallback", ["K", "K"], "K", [1, 1]),
        ("ReactiveFallback", ["K", "F"], "F", [1, 1]),
        # A pipeline ticks what lies before the running child again, and passes it over.
        ("PipelineSequence", ["S", "RRS"], "RRS", [3, 3]),
        ("PipelineSequence", ["SR", "RRS"], "RRS", [3, 3]),
        ("PipelineSequence", ["SF", "R"], "RF", [2, 1]),
        ("PipelineSequence", ["RS", "S", "S"], "RS", [2, 1, 1]),
        # All children in every tick, whichever runs.
        ("NonblockingSequence", ["RS", "RRS"], "RRS", [3, 3]),
        ("NonblockingSequence", ["R", "F"], "F", [1, 1]),
        # One child a tick.
        ("AsyncSequence", ["S", "K", "S"], "RS", [1, 1, 1]),
        ("AsyncFallback", ["F", "F"], "RF", [1, 1]),
        # All children that have not ended, in every tick.
        ("Parallel", ["RS", "RRS"], "RRS", [2, 3]),
        ("Parallel", ["R", "F"], "F", [1, 1]),
        ("Parallel", ["K", "S"], "S", [1, 1]),
        ("Parallel", ["K", "K"], "K", [1, 1]),
        ("ParallelAll", ["F", "RRS"], "RRF", [1, 3]),
        ("ParallelAll", ["S", "RS"], "RS", [1, 2]),
        # The condition once, and its branch.
        ("IfThenElse", ["RS", "RS", "F"], "RRS", [2, 2, 0]),
        ("IfThenElse", ["F", "S", "RF"], "RF", [1, 0, 2]),
        ("IfThenElse", ["F", "S"], "F", [1, 0]),
        # The condition in every tick.
        ("WhileDoElse", ["SSF", "R", "RS"], "RRRS", [4, 2, 2]),
        ("WhileDoElse", ["SF", "R"], "RF", [2, 1]),
    ],
)
def test_a_control_node_ticks_its_children_in_its_order(
    kind: str, scripts: list[str], answers: str, ticked: list[int]
) -> None:
    tree = Ticked(kind, *scripts)
    assert tree.ticks(len(answers)) == answers
    assert tree.ticked() == ticked


def test_parallel_ends_with_as_many_children_as_its_ports_say() -> None:
    tree = Ticked("Parallel", "RRS", "F", "RS", success_count="1", failure_count="2")
    assert tree.ticks(2) == "RS"
    assert tree.ticked() == [2, 1, 2]
    assert tree.halted() == [1, 0, 0]
    assert Ticked("Parallel", "S", "F", "F", failure_count="-1").tick() == "F"
    all_but_one = Ticked("ParallelAll", "F", "F", "S", max_failures="-1")
    assert all_but_one.tick() == "S"
    with pytest.raises(TreeError, match=r"port 'success_count': 3: must be at most 2"):
        Ticked("Parallel", "S", "S", success_count="3").tick()


def test_a_switch_ticks_the_child_of_its_case() -> None:
    tree = Ticked("Switch2", "R", "S", "RF", variable="{mode}", case_1="fast", case_2="2")
    assert tree.tick() == "R"
    tree.blackboard.set("mode", "fast")
    assert tree.tick() == "R"
    # What ran for another case is halted.
    assert tree.halted() == [0, 0, 1]
    tree.blackboard.set("mode", 2.0)
    assert tree.tick() == "S"
    assert tree.halted() == [1, 0, 1]


def test_reactive_nodes_halt_what_ran_when_an_earlier_child_decides() -> None:
    tree = Ticked("ReactiveSequence", "SSF", "R")
    assert tree.ticks(3) == "RRF"
    assert tree.halted() == [0, 1]


def test_a_pipeline_that_fails_halts_what_runs() -> None:
    tree = Ticked("PipelineSequence", "SSF", "R")
    assert tree.ticks(3) == "RRF"
    assert tree.halted() == [0, 1]


def test_a_recovery_node_retries_after_each_recovery_until_none_is_left() -> None:
    tree = Ticked("RecoveryNode", "F", "S", number_of_retries="2")
    assert tree.tick() == "F"
    assert tree.ticked() == [3, 2]
    assert tree.run.number_of_recoveries == 2


def test_a_recovery_node_succeeds_with_its_first_child_and_begins_anew() -> None:
    tree = Ticked("RecoveryNode", "FSFS", "RS", number_of_retries="1")
    assert tree.ticks(2) == "RS"
    # The retry that was used is given back.
    assert tree.tick() == "S"
    assert tree.ticked() == [4, 3]


def test_a_recovery_that_fails_ends_the_recovery_node() -> None:
    tree = Ticked("RecoveryNode", "F", "F", number_of_retries="6")
    assert tree.tick() == "F"
    assert tree.ticked() == [1, 1]
    # A recovery that could not help at all is not counted as one.
    assert tree.run.number_of_recoveries == 0


def test_a_halted_recovery_node_begins_with_its_first_child() -> None:
    tree = Ticked("RecoveryNode", "FS", "R", number_of_retries="1")
    assert tree.tick() == "R"
    tree.node.halt()
    assert tree.halted() == [0, 1]
    assert tree.tick() == "S"


def test_a_round_robin_takes_the_next_child_at_each_call() -> None:
    tree = Ticked("RoundRobin", "S", "RS", "S", "S")
    assert tree.ticks(3) == "SRS"
    assert tree.ticked() == [1, 2, 0, 0]


def test_the_fourth_recovery_counts_and_the_fifth_is_the_first_again() -> None:
    # In Nav2 the success of the last child is a failure, and ends the navigation.
    tree = Ticked("RoundRobin", "S", "S", "S", "S")
    assert tree.ticks(6) == "SSSSSS"
    assert tree.ticked() == [2, 2, 1, 1]


def test_a_round_robin_goes_on_after_a_failure_and_ends_with_the_last() -> None:
    tree = Ticked("RoundRobin", "F", "S", "F")
    assert tree.ticks(2) == "SF"
    assert tree.ticked() == [1, 1, 1]
    assert tree.tick() == "S"


def test_a_round_robin_that_wraps_round_fails_only_after_all_have() -> None:
    tree = Ticked("RoundRobin", "FS", "S", "F", wrap_around="true")
    assert tree.ticks(2) == "SS"
    assert tree.ticked() == [2, 1, 1]
    all_fail = Ticked("RoundRobin", "F", "F", "F", wrap_around="true")
    assert all_fail.tick() == "F"
    assert all_fail.ticked() == [1, 1, 1]


def test_the_default_recoveries_are_all_used_by_six_retries() -> None:
    tree = Ticked("RoundRobin", "S", "S", "S", "S")
    order = []
    for _ in range(6):
        before = tree.ticked()
        tree.tick()
        order += [i for i, (a, b) in enumerate(zip(before, tree.ticked(), strict=True)) if a != b]
    assert order == [0, 1, 2, 3, 0, 1]


def test_a_persistent_sequence_keeps_its_place_on_the_blackboard() -> None:
    tree = Ticked("PersistentSequence", "S", "FS", "S", current_child_idx="{place}")
    assert tree.tick() == "F"
    assert tree.blackboard.get("place") == 1
    assert tree.tick() == "S"
    assert tree.ticked() == [1, 2, 1]
    assert tree.blackboard.get("place") == 0


def test_a_port_that_holds_nonsense_is_named() -> None:
    tree = Ticked("RecoveryNode", "F", "S", number_of_retries="{many}")
    tree.blackboard.set("many", "a lot")
    with pytest.raises(TreeError, match=r"number_of_retries.*must be a number \(got 'a lot'\)"):
        tree.tick()
