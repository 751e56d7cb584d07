"""Nodes that watch, remove and use up entries of the blackboard, as BehaviorTree.CPP 4 has them."""

from __future__ import annotations

import logging

import pytest

from mazebot.common.config import ConfigError
from mazebot.navigation.behavior.engine.tree import BehaviorTree, TreeError
from mazebot.navigation.behavior.nodes.xml_loader import read_tree
from tests.navigation.behavior.nav2_usage import document
from tests.navigation.behavior.scripted_tree import run_over


def built(text: str) -> BehaviorTree:
    return read_tree(document(text), "t.xml").build(run_over())


def answers(tree: BehaviorTree, ticks: int) -> list[str]:
    return [tree.tick(tick).value for tick in range(ticks)]


def test_an_entry_is_removed() -> None:
    tree = built('<UnsetBlackboard key="door"/>')
    tree.blackboard.set("door", "open")
    # What is not there is removed as well.
    assert answers(tree, 2) == ["SUCCESS", "SUCCESS"]
    assert "door" not in tree.blackboard


@pytest.mark.parametrize("entry", ["door", "{door}"])
def test_an_entry_was_updated_since_the_last_tick(entry: str) -> None:
    tree = built(f'<WasEntryUpdated entry="{entry}"/>')
    assert answers(tree, 1) == ["FAILURE"]
    tree.blackboard.set("door", "open")
    assert answers(tree, 2) == ["SUCCESS", "FAILURE"]
    # To the same value is an update, too.
    tree.blackboard.set("door", "open")
    assert answers(tree, 2) == ["SUCCESS", "FAILURE"]
    tree.blackboard.unset("door")
    assert answers(tree, 1) == ["FAILURE"]


def test_an_update_is_seen_through_the_remapped_key_of_a_subtree() -> None:
    tree = read_tree(
        """<root BTCPP_format="4" main_tree_to_execute="Main">
        <BehaviorTree ID="Main"><SubTree ID="Below" inner="{door}"/></BehaviorTree>
        <BehaviorTree ID="Below"><WasEntryUpdated entry="{inner}"/></BehaviorTree></root>""",
        "t.xml",
    ).build(run_over())
    tree.blackboard.set("door", "open")
    assert answers(tree, 2) == ["SUCCESS", "FAILURE"]


@pytest.mark.parametrize(
    ("kind", "otherwise"), [("SkipUnlessUpdated", "SKIPPED"), ("WaitValueUpdate", "RUNNING")]
)
def test_a_child_is_ticked_once_an_update(kind: str, otherwise: str) -> None:
    child = '<Sequence><Script code="n += 1"/><Sleep msec="0"/></Sequence>'
    tree = built(f'<{kind} entry="{{door}}">{child}</{kind}>')
    tree.blackboard.set("n", 0.0)
    assert answers(tree, 1) == [otherwise]
    tree.blackboard.set("door", "open")
    assert answers(tree, 3) == ["SUCCESS", otherwise, otherwise]
    tree.blackboard.set("door", "open")
    assert answers(tree, 1) == ["SUCCESS"]
    assert tree.blackboard.get("n") == 2.0


def test_a_child_that_runs_goes_on_without_an_update() -> None:
    tree = built('<SkipUnlessUpdated entry="{door}"><Sleep msec="10"/></SkipUnlessUpdated>')
    tree.blackboard.set("door", "open")
    assert [tree.tick(ms * 1_000_000).value for ms in (0, 5, 10, 15)] == [
        "RUNNING", "RUNNING", "SUCCESS", "SKIPPED",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "queue", "seen"),
    [
        ("LoopInt", "1;2;3", [1, 2, 3]),
        ("LoopDouble", "0.5;-2", [0.5, -2.0]),
        ("LoopBool", "true;0", [True, False]),
        ("LoopString", "hall;kitchen", ["hall", "kitchen"]),
    ],
)
def test_a_loop_ticks_its_child_for_each_value(kind: str, queue: str, seen: list[object]) -> None:
    tree = built(f'<{kind} queue="{queue}" value="{{at}}"><AlwaysSuccess/></{kind}>')
    for _ in range(2):
        found = []
        while tree.tick(0).value == "RUNNING":
            found.append(tree.blackboard.get("at"))
        # The queue of the XML is there again at the next start.
        assert found == seen


@pytest.mark.parametrize("given", ["1;2", [1, 2]])
def test_a_queue_on_the_blackboard_is_used_up(given: object) -> None:
    tree = built('<LoopInt queue="{q}" value="{at}" if_empty="FAILURE"><AlwaysSuccess/></LoopInt>')
    # Without a queue there is nothing in it.
    assert answers(tree, 1) == ["FAILURE"]
    tree.blackboard.set("q", given)
    assert answers(tree, 4) == ["RUNNING", "RUNNING", "FAILURE", "FAILURE"]
    assert not tree.blackboard.get("q")
    assert given in ("1;2", [1, 2])


def test_a_loop_ends_with_its_child_and_holds_its_value_while_that_runs() -> None:
    tree = built(
        '<LoopInt queue="1;2;3" value="{at}"><Sequence><Sleep msec="10"/>'
        '<ScriptCondition code="at != 2"/></Sequence></LoopInt>'
    )
    seen = [
        (tree.tick(ms * 1_000_000).value, tree.blackboard.get("at")) for ms in (0, 10, 20, 25, 30)
    ]
    assert seen == [("RUNNING", 1), ("RUNNING", 1), ("RUNNING", 2), ("RUNNING", 2), ("FAILURE", 2)]


def test_a_queue_of_something_else_names_the_node_and_its_port() -> None:
    tree = built('<LoopInt name="rounds" queue="1;two"><AlwaysSuccess/></LoopInt>')
    with pytest.raises(TreeError, match="LoopInt 'rounds', port 'queue': must be a number"):
        tree.tick(0)
    tree = built('<LoopInt queue="{q}"><AlwaysSuccess/></LoopInt>')
    tree.blackboard.set("q", 7)
    with pytest.raises(TreeError, match="port 'queue': must be values"):
        tree.tick(0)


@pytest.mark.parametrize(
    ("level", "wanted"),
    [("INFO", logging.INFO), ("WARN", logging.WARNING), ("FATAL", logging.CRITICAL)],
)
def test_a_message_is_logged(level: str, wanted: int, caplog: pytest.LogCaptureFixture) -> None:
    tree = built(f'<Log level="{level}" message="{{text}}"/>')
    tree.blackboard.set("text", "at 100 % of the way")
    with caplog.at_level(logging.DEBUG, "navigation"):
        assert answers(tree, 1) == ["SUCCESS"]
    assert [(one.levelno, one.getMessage()) for one in caplog.records] == [
        (wanted, "at 100 % of the way")
    ]


def test_a_message_of_no_level_fails(caplog: pytest.LogCaptureFixture) -> None:
    assert answers(built('<Log level="{none}" message="lost"/>'), 1) == ["FAILURE"]
    (line,) = [one.getMessage() for one in caplog.records]
    assert "must be one of DEBUG, INFO, WARN, ERROR, FATAL" in line


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<UnsetBlackboard/>", "UnsetBlackboard, port 'key': is missing"),
        ("<WasEntryUpdated/>", "WasEntryUpdated, port 'entry': is missing"),
        ("<Log level='INFO'/>", "Log, port 'message': is missing"),
        ("<LoopInt queue='1' if_empty='MAYBE'><AlwaysSuccess/></LoopInt>", "must be RUNNING"),
    ],
)
def test_what_is_missing_is_told_when_the_tree_is_read(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        built(text)
