from __future__ import annotations

import re
from pathlib import Path

import pytest

from mazebot.common.config import ConfigError
from mazebot.common.files.limits import MAX_TREE_ELEMENTS
from mazebot.navigation.behavior.engine.tree import NodeStatus
from mazebot.navigation.behavior.nodes.node_kinds import NODE_KINDS, UNSUPPORTED
from mazebot.navigation.behavior.nodes.xml_loader import (
    DEFAULT_NAV_THROUGH_POSES,
    DEFAULT_NAV_TO_POSE,
    MAX_TREE_FILES,
    read_tree,
    read_tree_file,
)
from tests.navigation.behavior.nav2_usage import (
    CONTROLS,
    DECORATORS,
    LEAVES,
    NOT_RUNNING,
    document,
    element,
)
from tests.navigation.behavior.scripted_tree import run_over

TWO = "<AlwaysSuccess/><AlwaysFailure/>"


def usages() -> list[tuple[str, str]]:
    found = [(kind, element(kind, ports, TWO)) for kind, ports in CONTROLS.items()]
    found += [
        (kind, element(kind, ports, "<AlwaysSuccess/>")) for kind, ports in DECORATORS.items()
    ]
    return found + [(kind, element(kind, ports)) for kind, ports in LEAVES.items()]


@pytest.mark.parametrize(("kind", "text"), usages(), ids=[kind for kind, _ in usages()])
def test_a_node_that_nav2_ships_is_read_with_all_its_ports(kind: str, text: str) -> None:
    file = read_tree(document(text), "nav2.xml")
    assert file.warnings == file.unsupported == ()
    assert kind in file.kinds()
    node = file.build(run_over()).root
    assert type(node) is NODE_KINDS[kind]


@pytest.mark.parametrize(("kind", "ports"), NOT_RUNNING.items())
def test_a_node_that_does_not_run_here_is_named_in_one_line(
    kind: str, ports: dict[str, str]
) -> None:
    file = read_tree(document(element(kind, ports)), "routes.xml")
    assert file.unsupported == (f"routes.xml:1: {kind} is not supported: there is no route graph",)
    with pytest.raises(ConfigError) as caught:
        file.build(run_over())
    assert str(caught.value) == file.unsupported[0]


def test_nav2s_trees_use_53_kinds_and_one_has_another_name() -> None:
    kinds = {*CONTROLS, *DECORATORS, *LEAVES, *NOT_RUNNING}
    # IsPathValid is ValidatePath until Kilted; the smoother selector is in the catalogue alone.
    assert len(kinds - {"IsPathValid", "SmootherSelector"}) == 53
    assert kinds <= {*NODE_KINDS, *UNSUPPORTED}


@pytest.mark.parametrize("path", [DEFAULT_NAV_TO_POSE, DEFAULT_NAV_THROUGH_POSES])
def test_the_default_trees_are_read_without_a_word(path: Path) -> None:
    file = read_tree_file(path)
    assert file.warnings == file.unsupported == ()
    assert len(list(file.build(run_over()).root.walk())) > 30


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "t.xml:1: not well-formed XML: no element found"),
        ("<root>\n<a></b>", "t.xml:2: not well-formed XML: mismatched tag"),
        ("<tree/>", "t.xml:1: the first element is <tree>: must be <root>"),
        ('<root BTCPP_format="5"/>', "t.xml:1: BTCPP_format is '5': must be 3 or 4"),
        ('<root BTCPP_format="4"/>', "t.xml:1: no <BehaviorTree> found"),
        (
            document("<Wait/>", 'BTCPP_format="4" main_tree_to_execute="Mian"'),
            "t.xml:1: main_tree_to_execute is 'Mian': must be one of Main",
        ),
        (document(""), "t.xml:1: tree 'Main' has 0 root nodes: must be one"),
        (document("<Wait/><Wait/>"), "t.xml:1: tree 'Main' has 2 root nodes: must be one"),
        (
            document("\n<Sequence>\n<Spinn/></Sequence>"),
            "t.xml:3: Spinn is not a known node; did you mean Spin?",
        ),
        (document("<Sequence/>"), "t.xml:1: Sequence has 0 children: must have at least 1"),
        (
            document("<RecoveryNode><Wait/></RecoveryNode>"),
            "t.xml:1: RecoveryNode has 1 children: must have 2",
        ),
        (document("<Wait><Wait/></Wait>"), "t.xml:1: Wait has 1 children: must have 0"),
        (
            document('<Wait wait_duration="long"/>'),
            "t.xml:1: Wait, port 'wait_duration': must be a number (got 'long')",
        ),
        (
            document('<Spin disable_collision_checks="maybe"/>'),
            "t.xml:1: Spin, port 'disable_collision_checks': must be true or false (got 'maybe')",
        ),
        (
            document('<ComputePathToPose path="{path}"/>'),
            "t.xml:1: ComputePathToPose, port 'goal': is missing",
        ),
        (
            document('<FollowPath path="the_path"/>'),
            "t.xml:1: FollowPath, port 'path': must be a blackboard entry {...} (got 'the_path')",
        ),
        (
            document('<Wait _skipIf="a ==="/>'),
            "t.xml:1: Wait, port '_skipIf': cannot be read at '='",
        ),
        (
            document('<SubTree ID="Main" _while="true"/>'),
            "t.xml:1: SubTree, attribute '_while': must be at the first node of the tree instead",
        ),
        (
            document("\n<Sequence><Spinn/>\n<Fly/><Fallback><Dance/></Fallback></Sequence>"),
            "t.xml:2: Spinn is not a known node; did you mean Spin?; "
            "t.xml:3: Fly is not a known node; t.xml:3: Dance is not a known node",
        ),
        (
            document('<RecoveryNode number_of_retries="-1"><Wait/><Wait/></RecoveryNode>'),
            "t.xml:1: RecoveryNode, port 'number_of_retries': must be at least 0 (got '-1')",
        ),
        (
            document("<IfThenElse><Wait/></IfThenElse>"),
            "t.xml:1: IfThenElse has 1 children: must have 2 to 3",
        ),
        (
            document('<Script code="x := (1"/>'),
            "t.xml:1: Script, port 'code': must have ')' at its end",
        ),
        (
            document('<Precondition if="a > 1" else="MAYBE"><Wait/></Precondition>'),
            "t.xml:1: Precondition, port 'else': must be RUNNING, SUCCESS, FAILURE or SKIPPED "
            "(got 'MAYBE')",
        ),
        (
            document('<ClearEntireCostmap service_name="loca_costmap/clear"/>'),
            "t.xml:1: ClearEntireCostmap, port 'service_name': must begin with local_costmap/ or "
            "global_costmap/ (got 'loca_costmap/clear')",
        ),
        (
            document('<ClearEntireCostmap service_name="local_costmap/c" plugins="static_layer"/>'),
            "t.xml:1: ClearEntireCostmap, port 'plugins': must be empty or of obstacle_layer, "
            "voxel_layer, which can be cleared (got 'static_layer')",
        ),
        (document('<FollowPath path=""/>'), "t.xml:1: FollowPath, port 'path': is missing"),
        (
            document('<SubTree ID="Mains"/>'),
            "t.xml:1: SubTree: no tree with ID 'Mains'; did you mean Main?",
        ),
        (
            document('<Sequence><SubTree ID="Main"/></Sequence>'),
            "t.xml: a tree contains itself: Main in Main",
        ),
    ],
)
def test_a_mistake_is_told_in_one_line(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_tree(text, "t.xml")
    assert str(caught.value) == message


def test_entities_are_refused_before_they_grow() -> None:
    bomb = '<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>' + document("<Wait/>")
    with pytest.raises(ConfigError, match=r"t.xml:1: a DOCTYPE is not allowed"):
        read_tree(bomb, "t.xml")
    deep = document("<Inverter>" * 500 + "<Wait/>" + "</Inverter>" * 500)
    with pytest.raises(ConfigError, match="nested more than 200 deep"):
        read_tree(deep, "t.xml")


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"missing\.xml: No such file"):
        read_tree_file(tmp_path / "missing.xml")


def test_unknown_ports_are_ignored_with_a_word() -> None:
    file = read_tree(document('<Spin spin_distance="3"/>'), "t.xml")
    assert file.warnings == (
        "t.xml:1: Spin, port 'spin_distance': ignored: no such port; did you mean spin_dist?",
    )


@pytest.mark.parametrize(
    ("text", "warnings"),
    [
        ('<ControllerSelector topic_name="/controller_selector"/>', ()),
        ('<GoalCheckerSelector topic_name="goal_checker_selector"/>', ()),
        (
            '<ControllerSelector topic_name="my_selector"/>',
            ("ControllerSelector, port 'topic_name': 'my_selector': nothing is heard there",),
        ),
        (
            '<SmootherSelector topic_name="planner_selector"/>',
            ("SmootherSelector, port 'topic_name': 'planner_selector': nothing is heard there",),
        ),
        (
            '<IsPathValid path="{path}" layer_name="obstacle_layer" footprint="[]"/>',
            (
                "IsPathValid, port 'layer_name': 'obstacle_layer': ignored: the whole costmap is "
                "tested",
                "IsPathValid, port 'footprint': '[]': ignored: the robot's own is tested",
            ),
        ),
        ('<IsBatteryLow min_battery="0.2" battery_topic="/battery_status"/>', ()),
        (
            '<IsBatteryLow min_battery="0.2" battery_topic="/bms"/>',
            (
                "IsBatteryLow, port 'battery_topic': '/bms': ignored: the battery is heard on "
                "/battery_state",
            ),
        ),
    ],
)
def test_a_port_without_effect_is_told(text: str, warnings: tuple[str, ...]) -> None:
    file = read_tree(document(text), "t.xml")
    assert file.warnings == tuple(f"t.xml:1: {warning}" for warning in warnings)


@pytest.mark.parametrize("form", ['BTCPP_format="3" ', ""])
def test_a_tree_of_format_3_is_read_with_a_word(form: str) -> None:
    text = f"""
    <root {form}main_tree_to_execute="Main">
      <BehaviorTree ID="Main"><SequenceStar>
        <SetBlackboard output_key="mine" value="7"/>
        <SubTree ID="Below" inner="mine"/>
        <SubTreePlus ID="Shared" __autoremap="1"/>
        <SubTreePlus ID="Literal" key="mine" same="{{mine}}"/>
      </SequenceStar></BehaviorTree>
      <BehaviorTree ID="Below"><Script code="inner = inner + 1"/></BehaviorTree>
      <BehaviorTree ID="Shared"><Parallel success_threshold="1">
        <ScriptCondition code="mine == 8"/><AlwaysFailure/>
      </Parallel></BehaviorTree>
      <BehaviorTree ID="Literal">
        <ScriptCondition code="key == 'mine' &amp;&amp; same == 8"/>
      </BehaviorTree>
    </root>"""
    file = read_tree(text, "t.xml")
    (warning,) = file.warnings
    given = "BTCPP_format 3" if form else "no BTCPP_format"
    assert warning.startswith(f"t.xml:2: {given}: read as format 4, but")
    assert file.build(run_over()).tick(0) is NodeStatus.SUCCESS


MODEL = """<TreeNodesModel><SubTree ID="Below">
    <input_port name="times" default="5">How often</input_port>
    <output_port name="out" default="{mine}"/><input_port name="must"/>
    </SubTree></TreeNodesModel>"""


@pytest.mark.parametrize(
    ("given", "expected"),
    [('must="1"', 5.0), ('must=" {mine} " times="" ', 5.0), ('must="1" times=" {count} "', 3.0)],
)
def test_a_subtree_s_model_gives_defaults(given: str, expected: float) -> None:
    below = '<BehaviorTree ID="Below"><Script code="out := times"/></BehaviorTree>'
    text = document(
        f'<Sequence><Script code="count := 3"/><SubTree ID="Below" {given}/></Sequence>'
    )
    tree = read_tree(text.replace("</root>", f"{below}{MODEL}</root>"), "t.xml").build(run_over())
    assert tree.tick(0) is NodeStatus.SUCCESS
    assert float(str(tree.blackboard.get("mine"))) == expected


def test_a_port_without_a_default_must_be_given_unless_all_keys_are_shared() -> None:
    below = '<BehaviorTree ID="Below"><Script code="times := must"/></BehaviorTree>'
    text = document('<SubTree ID="Below" {}/>').replace("</root>", f"{below}{MODEL}</root>")
    said = "t.xml:1: SubTree 'Below': port 'must' is missing: its model in <TreeNodesModel> has no"
    with pytest.raises(ConfigError, match=re.escape(said)):
        read_tree(text.replace("{}", "", 1), "t.xml")
    tree = read_tree(text.replace("{}", '_autoremap="true"', 1), "t.xml").build(run_over())
    tree.blackboard.set("must", 2)
    assert tree.tick(0) is NodeStatus.SUCCESS
    assert tree.blackboard.get("times") == 2
    # Format 3 has no such models.
    assert read_tree(text.replace("{}", "", 1).replace('"4"', '"3"'), "t.xml").trees


def test_ports_that_groot_saves_empty_are_not_given() -> None:
    text = document(
        '<Sequence name=""><ComputePathToPose goal="{goal}" planner_id="" path="{path}" '
        'server_timeout="" _description=""/><Wait wait_duration="" _skipIf=""/>'
        '<SubTree ID="Below" key=""/></Sequence>'
    ).replace("</root>", '<BehaviorTree ID="Below"><Wait/></BehaviorTree></root>')
    file = read_tree(text, "t.xml")
    assert file.warnings == ()
    nodes = list(file.build(run_over()).root.walk())
    assert nodes[0].place.name == "Sequence"
    assert nodes[1].place.attributes == {"goal": "{goal}", "path": "{path}"}
    assert nodes[2].number("wait_duration") == 1.0


def test_scripts_decide_whether_a_node_is_ticked_and_run_after_it() -> None:
    text = document(
        """<Sequence>
        <Script code="ready := false; count := 0; far := 2.5"/>
        <AlwaysFailure _skipIf="!ready"/>
        <AlwaysFailure _successIf="far &gt; 2" _post="count += 10"/>
        <AlwaysSuccess _onSuccess="count += 1" _onFailure="count += 100"/>
        <Inverter><AlwaysSuccess _failureIf="ready == false"/></Inverter>
        </Sequence>"""
    )
    tree = read_tree(text, "t.xml").build(run_over())
    assert tree.tick(0) is NodeStatus.SUCCESS
    assert tree.blackboard.get("count") == 11.0


def test_a_node_stops_when_its_while_no_longer_holds() -> None:
    text = document(
        """<Parallel failure_count="2"><Sleep msec="100" _while="go" _onHalted="halted := 'yes'"/>
        <Delay delay_msec="50"><Script code="go := false"/></Delay></Parallel>"""
    )
    tree = read_tree(text, "t.xml").build(run_over())
    tree.blackboard.set("go", True)
    answers = [tree.tick(now_ns * 1_000_000).value for now_ns in (0, 50, 60)]
    assert answers == ["RUNNING", "RUNNING", "SUCCESS"]
    assert tree.blackboard.get("halted") == "yes"


@pytest.mark.parametrize(
    ("text", "node"),
    [
        ("<Sequence>\n<AlwaysSuccess/>\n<AlwaysFailure name='last'/></Sequence>", "'last', line 3"),
        ("<Sequence><Fallback><AlwaysFailure/><AlwaysSuccess/></Fallback>\n<Inverter name='not'>"
         "<AlwaysSuccess/></Inverter></Sequence>", "Inverter 'not', line 2"),
        ("<Fallback><AlwaysFailure/>\n<ScriptCondition code='1 > 2'/></Fallback>",
         "ScriptCondition 'ScriptCondition', line 2"),
    ],
)  # fmt: skip
def test_a_tree_that_fails_names_the_node(text: str, node: str) -> None:
    tree = read_tree(document(text), "t.xml").build(run_over())
    assert tree.tick(0) is NodeStatus.FAILURE
    failed = tree.failed_node()
    assert f"{failed}, line {failed.place.line}".endswith(node)


def test_explicit_tags_and_node_models_are_read() -> None:
    text = (
        '<root BTCPP_format="4"><BehaviorTree ID="Main"><Control ID="Sequence">'
        '<Action ID="AlwaysSuccess" name="first"/></Control></BehaviorTree>'
        '<TreeNodesModel><Action ID="Anything"/></TreeNodesModel></root>'
    )
    tree = read_tree(text, "t.xml").build(run_over())
    assert tree.tick(0) is NodeStatus.SUCCESS
    assert [(one.uid, one.kind, one.name, one.depth) for one in tree.snapshot()] == [
        (1, "Sequence", "Sequence", 0),
        (2, "AlwaysSuccess", "first", 1),
    ]


SUBTREES = """
<root BTCPP_format="4" main_tree_to_execute="Main">
  <BehaviorTree ID="Main">
    <Sequence>
      <SubTree ID="Below" input="{outer}" literal="words" {auto}/>
    </Sequence>
  </BehaviorTree>
  <BehaviorTree ID="Below">
    <Sequence>
      <SetBlackboard output_key="input" value="{literal}"/>
      <SetBlackboard output_key="inner" value="1"/>
      <SetBlackboard output_key="@root" value="2"/>
    </Sequence>
  </BehaviorTree>
</root>
"""


@pytest.mark.parametrize(("auto", "inner"), [("", None), ('_autoremap="true"', "1")])
def test_a_subtree_sees_the_keys_that_are_passed_to_it(auto: str, inner: str | None) -> None:
    tree = read_tree(SUBTREES.replace("{auto}", auto), "t.xml").build(run_over())
    assert tree.tick(0) is NodeStatus.SUCCESS
    board = tree.blackboard
    assert (board.get("outer"), board.get("inner"), board.get("root")) == ("words", inner, "2")


def test_the_snapshot_shows_what_the_last_tick_reached() -> None:
    text = document("<Fallback><AlwaysFailure/><AlwaysSuccess/><Wait/></Fallback>")
    tree = read_tree(text, "t.xml").build(run_over())
    assert all(one.status is NodeStatus.IDLE for one in tree.snapshot())
    tree.tick(0)
    assert [one.status.value for one in tree.snapshot()] == [
        *("SUCCESS", "FAILURE", "SUCCESS", "IDLE")
    ]


def test_what_lies_below_a_recovery_nodes_second_child_is_a_recovery() -> None:
    inside = '<Sequence><Spin name="{0}"/><SubTree ID="{1}"/></Sequence>'
    text = (
        '<root BTCPP_format="4" main_tree_to_execute="Main"><BehaviorTree ID="Main">'
        f"<RecoveryNode>{inside.format('task', 'Below')}{inside.format('recovery', 'Below')}"
        '</RecoveryNode></BehaviorTree><BehaviorTree ID="Below"><BackUp/></BehaviorTree></root>'
    )
    nodes = read_tree(text, "t.xml").build(run_over()).root.walk()
    places = [one.place for one in nodes if one.place.kind in ("Spin", "BackUp")]
    assert [place.in_recovery for place in places] == [False, False, True, True]


def test_the_cause_is_the_newest_failure_of_planning_or_control() -> None:
    run = run_over()
    assert run.cause() is None
    for tick, (action, code) in enumerate(
        [("FollowPath", 105), ("ComputePathToPose", 208), ("Spin", 703)]
    ):
        run.tick_number = tick
        run.failed(action, code, action)
    cause = run.cause()
    assert cause is not None
    # Nav2 reports 105, which was overcome.
    assert cause.code == 208
    run.failures = run.failures[2:]
    cause = run.cause()
    assert cause is not None
    assert cause.code == 703


def test_the_only_tree_needs_no_id() -> None:
    text = '<root BTCPP_format="4"><BehaviorTree><AlwaysSuccess/></BehaviorTree></root>'
    file = read_tree(text, "t.xml")
    assert list(file.trees) == [file.main_id]
    assert file.build(run_over()).tick(0) is NodeStatus.SUCCESS


@pytest.mark.parametrize(
    ("attributes", "more"),
    [
        ('main_tree_to_execute="Main"', ""),
        ("", '<BehaviorTree ID="Two"><AlwaysSuccess/></BehaviorTree>'),
    ],
)
def test_a_tree_that_is_named_elsewhere_needs_its_id(attributes: str, more: str) -> None:
    text = f"<root {attributes}>\n<BehaviorTree><AlwaysSuccess/></BehaviorTree>{more}</root>"
    with pytest.raises(ConfigError) as caught:
        read_tree(text, "t.xml")
    assert str(caught.value) == "t.xml:2: <BehaviorTree> has no ID"


MAIN = (
    '<root BTCPP_format="4" main_tree_to_execute="Main">\n<include path="{0}"/>\n'
    '<BehaviorTree ID="Main"><SubTree ID="Below"/></BehaviorTree></root>'
)
BELOW = '<root BTCPP_format="4">{0}<BehaviorTree ID="Below">\n{1}</BehaviorTree></root>'


def test_a_tree_includes_those_of_another_file(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "main.xml").write_text(MAIN.format("parts/below.xml"))
    # Each path starts at its own file, and a circle ends.
    again = '<include path="more.xml"/><include path="../main.xml"/>'
    (tmp_path / "parts" / "below.xml").write_text(BELOW.format(again, '<SubTree ID="More"/>'))
    (tmp_path / "parts" / "more.xml").write_text(
        '<root BTCPP_format="3"><BehaviorTree ID="More"><AlwaysFailure/></BehaviorTree></root>'
    )
    file = read_tree_file(tmp_path / "main.xml")
    assert set(file.trees) == {"Main", "Below", "More"}
    assert file.main_id == "Main"
    (warning,) = file.warnings
    assert warning.startswith(str(tmp_path / "parts" / "more.xml") + ":1: ")
    assert file.build(run_over()).tick(0) is NodeStatus.FAILURE


@pytest.mark.parametrize(
    ("include", "below", "message"),
    [
        ("gone.xml", "", "{0}/main.xml:2: <include>: 'gone.xml': No such file or directory"),
        ("/dev/zero", "", "{0}/main.xml:2: <include>: '/dev/zero': must be a file"),
        ("below.xml", "<Spinn/>", "{0}/below.xml:2: Spinn is not a known node; did you mean Spin?"),
        ("below.xml", "<Wait wait_duration='x'/>", "{0}/below.xml:2: Wait, port 'wait_duration': "
         "must be a number (got 'x')"),
        ("below.xml", "<", "{0}/below.xml:2: not well-formed XML: not well-formed (invalid token)"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_an_included_file_names_it(
    tmp_path: Path, include: str, below: str, message: str
) -> None:
    (tmp_path / "main.xml").write_text(MAIN.format(include))
    (tmp_path / "below.xml").write_text(BELOW.format("", below))
    with pytest.raises(ConfigError) as caught:
        read_tree_file(tmp_path / "main.xml")
    assert str(caught.value) == message.format(tmp_path)


@pytest.mark.parametrize(
    ("include", "message"),
    [
        ('<include path="a.xml"/>', "t.xml:1: <include>: must be in a file"),
        ("<include/>", "t.xml:1: <include>: path is missing"),
        (
            '<include ros_pkg="nav2" path="a.xml"/>',
            "t.xml:1: <include>: ros_pkg: there are no packages",
        ),
    ],
)
def test_what_cannot_be_included_is_told(include: str, message: str) -> None:
    text = f'<root BTCPP_format="4">{include}</root>'
    with pytest.raises(ConfigError) as caught:
        read_tree(text, "t.xml")
    assert str(caught.value).startswith(message)


def test_included_files_are_no_way_around_the_most_elements(tmp_path: Path) -> None:
    many = "<Sequence>" + "<AlwaysSuccess/>" * (MAX_TREE_ELEMENTS // 2) + "</Sequence>"
    trees = '<BehaviorTree ID="T{0}">' + many + "</BehaviorTree>"
    for n in range(3):
        following = f'<include path="{n + 1}.xml"/>' if n < 2 else ""
        text = f'<root BTCPP_format="4">{following}{trees.format(n)}</root>'
        (tmp_path / f"{n}.xml").write_text(text)
    with pytest.raises(ConfigError, match=f"must have at most {MAX_TREE_ELEMENTS} elements, with"):
        read_tree_file(tmp_path / "0.xml")


def test_a_tree_is_of_few_files(tmp_path: Path) -> None:
    for n in range(MAX_TREE_FILES + 1):
        (tmp_path / f"{n}.xml").write_text(
            f'<root BTCPP_format="4"><include path="{n + 1}.xml"/></root>'
        )
    with pytest.raises(ConfigError, match=f"99.xml:1: <include>: .* {MAX_TREE_FILES} files"):
        read_tree_file(tmp_path / "0.xml")


@pytest.mark.parametrize("declaration", ["\n <?xml version='1.0'?>", '<?xml version="0.0" ?>'])
def test_a_declaration_that_tinyxml_takes_is_taken(declaration: str) -> None:
    text = declaration + document("<AlwaysSuccess/>")
    assert read_tree(text, "t.xml").build(run_over()).tick(0) is NodeStatus.SUCCESS
