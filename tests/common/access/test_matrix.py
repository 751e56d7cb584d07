"""What a router lets each role do, with a real session for each: exactly what its grants say."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from mazebot.bench.parts.loopback_router import free_port
from mazebot.common.access.grants import (
    AUTONOMY,
    OPERATOR,
    PEOPLE,
    ROBOT,
    ROLES,
    ROUTER,
    STANDS_IN_FOR,
    Verb,
    grants_of,
)
from mazebot.common.access.key_store import KeyStore
from mazebot.common.access.matrix import in_short, matrix, named
from mazebot.common.access.rules import access_control, decide
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.handover import HELD_PREFIX
from mazebot.common.bus.liveliness import alive, alive_key
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.session import BusUnavailableError, open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.client.robot import RobotError
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import SimulationControl
from mazebot.common.messages.keys import RELIABLE_QOS, Keys
from mazebot.common.messages.topics import (
    CLOCK,
    CMD_VEL,
    EDGE,
    ENTITIES,
    GOAL_POSE,
    GROUND_TRUTH_ODOM,
    SERVICES,
    SIMULATION_CONTROL,
    TOPICS,
    Topic,
    owned_by,
    read_by,
)
from mazebot.router.config import RouterConfig
from mazebot.router.router import Router

KEYS = Keys()
NAMED = named(KEYS)
TOPIC_KEYS = sorted({key for one in NAMED if one.is_topic for key in one.keys})
SERVICE_KEYS = sorted({key for one in NAMED if not one.is_topic for key in one.keys})
DEADLINE_S = 30.0
GRANTS = {role: grants_of(role, KEYS) for role in ROLES}
_NONE = msg.Vector3(0.0, 0.0, 0.0)
COMMAND = msg.TwistStamped(msg.header(0, "base_link"), msg.Twist(_NONE, _NONE))
GOAL = msg.PoseStamped(msg.header(0, "map"), msg.pose_from_se2(SE2(0.0, 0.0, 0.0)))
SOME: tuple[Topic[Any], ...] = (CMD_VEL, CLOCK, ENTITIES)
Received = dict[str, set[str]]


class Yard:
    """A router with keys, and a session of each role."""

    def __init__(self, folder: Path) -> None:
        self.store = KeyStore(folder)
        self.router = Router(
            RouterConfig(listen=f"tcp/127.0.0.1:{free_port()}", keys_dir=folder), KEYS
        )
        self.sessions = {role: self.open(role) for role in ROLES}

    def open(self, role: str) -> zenoh.Session:
        config = BusConfig(connect=self.router.endpoint, key_file=self.store.path_of(role))
        return open_session(config, timeout_s=DEADLINE_S)

    def settle(self) -> None:
        """Wait until the router has taken in whatever the sessions have sent before."""
        for session in self.sessions.values():
            alive(session, KEYS, timeout_s=DEADLINE_S)

    def close(self) -> None:
        for session in self.sessions.values():
            session.close()  # type: ignore[no-untyped-call]
        self.router.close()


@pytest.fixture(scope="module")
def yard(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Yard]:
    yard = Yard(tmp_path_factory.mktemp("access") / "keys")
    yield yard
    yard.close()


def granted(verb: Verb, keys: Iterable[str]) -> Received:
    """For each key those roles that may do something with it."""
    found = {key: {role for role in ROLES if decide(GRANTS[role], verb, key)[0]} for key in keys}
    return {key: roles for key, roles in found.items() if roles}


def wait_until(holds: Callable[[], object]) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not holds():
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.mark.parametrize("wire", ["rmw_zenoh", "plain"])
def test_who_sends_and_reads_what_is_as_the_tables_say(wire: str) -> None:
    keys = Keys(wire=wire)
    grants = {role: grants_of(role, keys) for role in ROLES}
    for topic in TOPICS:
        key = keys.of_topic(topic)
        senders = {role for role in ROLES if decide(grants[role], Verb.PUT, key)[0]}
        stand_ins = {role for role, names in STANDS_IN_FOR.items() if {*names} & {*topic.owners}}
        edge = {OPERATOR, AUTONOMY} if EDGE in topic.owners else set()
        assert senders == {*topic.owners} - {EDGE} | edge | stand_ins, topic.name
        readers = {role for role in ROLES if decide(grants[role], Verb.SUBSCRIBE, key)[0]}
        everyone = set(SERVICES) if topic is CLOCK else set()
        assert readers == {*topic.readers, *topic.keepers, *PEOPLE} | everyone, topic.name


def test_a_viewer_asks_only_what_changes_nothing() -> None:
    of_nodes = ("describe_parameters", "get_parameter_types", "get_parameters", "get_state",
                "list_parameters")  # fmt: skip
    may = {
        one.name
        for one in NAMED
        if not one.is_topic and decide(GRANTS["viewer"], Verb.QUERY, one.keys[0])[0]
    }
    assert {name for name in may if name.rpartition("/")[2] not in of_nodes} == {
        "/get_available_worlds", "/get_current_world", "/get_entities", "/get_entities_states",
        "/get_entity_bounds", "/get_entity_info", "/get_entity_state", "/get_named_poses",
            "/get_simulation_state", "/get_simulator_features", "/get_spawnables",
    }  # fmt: skip
    for role in (OPERATOR, AUTONOMY):
        assert all(decide(GRANTS[role], Verb.QUERY, key)[0] for key in SERVICE_KEYS)


def test_who_stands_in_for_a_service_answers_what_it_does_and_nothing_else() -> None:
    for role, services in STANDS_IN_FOR.items():
        may = {key for key in SERVICE_KEYS if decide(GRANTS[role], Verb.ANSWER, key)[0]}
        of_services = {
            key
            for key in SERVICE_KEYS
            for service in services
            if decide(GRANTS[service], Verb.ANSWER, key)[0]
        }
        assert may == of_services, role


def test_in_an_exam_the_ground_truth_is_for_the_grader_alone() -> None:
    truth = {topic.name for topic in TOPICS if topic.truth}
    assert GROUND_TRUTH_ODOM.name in truth
    for role in PEOPLE:
        hidden = {
            topic.name
            for topic in TOPICS
            if not decide(
                grants_of(role, KEYS, operator_sees_truth=False), Verb.SUBSCRIBE,
                KEYS.of_topic(topic),
            )[0]
        }  # fmt: skip
        assert hidden == (set() if role == "grader" else truth)


def test_a_query_and_the_service_of_its_name_are_for_the_same_roles() -> None:
    for name in {one.name for one in NAMED if not one.is_topic}:
        keys = [key for one in NAMED if one.name == name for key in one.keys]
        for verb in (Verb.QUERY, Verb.ANSWER):
            assert len({frozenset(granted(verb, [key]).get(key, ())) for key in keys}) == 1, name


def test_messages_come_in_from_those_alone_who_may_send_them(yard: Yard) -> None:
    received: Received = defaultdict(set)

    def hear(sample: zenoh.Sample) -> None:
        received[str(sample.key_expr)].add(sample.payload.to_string() or str(sample.kind))

    subscriber: Any = yard.router.session.declare_subscriber("**", hear)
    for role, session in yard.sessions.items():
        for key in TOPIC_KEYS:
            session.put(key, role)
            session.delete(key)
    yard.settle()
    subscriber.undeclare()
    assert received == granted(Verb.PUT, TOPIC_KEYS)


def test_messages_go_out_to_those_alone_who_may_read_them(yard: Yard) -> None:
    received: Received = defaultdict(set)
    wild: list[str] = []
    subscribers: list[Any] = []

    def hear(role: str) -> Callable[[zenoh.Sample], None]:
        return lambda sample: received[str(sample.key_expr)].add(role)

    for role, session in yard.sessions.items():
        subscribers += [session.declare_subscriber(key, hear(role)) for key in TOPIC_KEYS]
    # Another session: one hears what another subscriber of its own is let hear.
    another = yard.open(OPERATOR)
    for expression in ("**", "0/**", "*/*/*/*", "@ros2_lv/**"):
        subscribers.append(
            another.declare_subscriber(expression, lambda one: wild.append(str(one.key_expr)))
        )
    yard.settle()
    alive(another, KEYS, timeout_s=DEADLINE_S)
    last = KEYS.of_topic(CLOCK)
    for key in [key for key in TOPIC_KEYS if key != last] + [last]:
        yard.router.session.put(key, b"")
    expected = granted(Verb.SUBSCRIBE, TOPIC_KEYS)
    wait_until(lambda: received[last] == expected[last])
    for subscriber in subscribers:
        subscriber.undeclare()
    another.close()  # type: ignore[no-untyped-call]
    assert received == expected
    assert not wild


def test_services_are_asked_and_answered_by_those_alone_who_may(yard: Yard) -> None:
    asked: Received = defaultdict(set)

    def hear(query: zenoh.Query) -> None:
        with query:
            assert query.payload is not None
            asked[str(query.key_expr)].add(query.payload.to_string())

    queryables: list[Any] = [
        yard.router.session.declare_queryable(key, hear) for key in SERVICE_KEYS
    ]
    yard.settle()
    replies = [
        session.get(key, payload=role, timeout=DEADLINE_S)
        for role, session in yard.sessions.items()
        for key in SERVICE_KEYS
    ]
    for each in replies:
        list(each)
    for queryable in queryables:
        queryable.undeclare()
    assert asked == granted(Verb.QUERY, SERVICE_KEYS)

    answered: Received = defaultdict(set)

    def reply(role: str) -> Callable[[zenoh.Query], None]:
        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(query.key_expr, role)

        return answer

    queryables = [
        session.declare_queryable(key, reply(role))
        for role, session in yard.sessions.items()
        for key in SERVICE_KEYS
    ]
    yard.settle()
    # Of all who answer under one key.
    target, consolidation = zenoh.QueryTarget.ALL, zenoh.ConsolidationMode.NONE
    for key in SERVICE_KEYS:
        for one in yard.router.session.get(
            key, target=target, consolidation=consolidation, timeout=DEADLINE_S
        ):
            assert one.ok is not None
            answered[key].add(one.ok.payload.to_string())
    for queryable in queryables:
        queryable.undeclare()
    assert answered == granted(Verb.ANSWER, SERVICE_KEYS)


def test_nobody_says_that_another_one_is_there(yard: Yard) -> None:
    owner_of: dict[str, str] = {}
    for service in (ROUTER, *SERVICES):
        its = [alive_key(service, "forged", KEYS), KEYS.node_token("forged", 0, service)]
        for topic in SOME:
            its.append(KEYS.endpoint_token("forged", 0, 1, service, "MP", topic))
        owner_of |= dict.fromkeys(its, service)
    of_people = KEYS.node_token("forged", 0, "rviz")
    commands = KEYS.endpoint_token("forged", 0, 1, "rviz", "MP", CMD_VEL)
    senses = KEYS.endpoint_token("forged", 0, 1, "rviz", "MP", ENTITIES)
    of_nobody = KEYS.typed_token(
        "forged", 0, 1, "rviz", "SS", "/spawn_entity",
        "simulation_interfaces/srv/SpawnEntity", "RIHS01_0", RELIABLE_QOS,
    )  # fmt: skip
    tokens = [*owner_of, of_people, commands, senses, of_nobody]
    for role, session in yard.sessions.items():
        held = [session.liveliness().declare_token(token) for token in tokens]
        alive(session, KEYS, timeout_s=DEADLINE_S)
        found = {
            str(reply.ok.key_expr)
            for expression in ("**", "@ros2_lv/**")
            for reply in yard.router.session.liveliness().get(expression, timeout=DEADLINE_S)
            if reply.ok is not None
        } & set(tokens)
        may = {token for token in tokens if decide(GRANTS[role], Verb.DECLARE_TOKEN, token)[0]}
        assert found == may, role
        own = {role, *STANDS_IN_FOR.get(role, ())}
        assert {owner_of.get(token, role) for token in found} <= own, role
        assert (of_people in found) == (role in PEOPLE), role
        assert (commands in found) == (role in (OPERATOR, AUTONOMY)), role
        assert (senses in found) == (role == ROBOT), role
        assert of_nobody not in found, role
        for token in held:
            token.undeclare()  # type: ignore[no-untyped-call]
        alive(session, KEYS, timeout_s=DEADLINE_S)


def test_nobody_sees_the_router_itself(yard: Yard) -> None:
    of_router = f"@/{yard.router.session.zid()}/**"
    assert list(yard.router.session.get(of_router, timeout=DEADLINE_S))
    for role, session in yard.sessions.items():
        assert not list(session.get(of_router, timeout=DEADLINE_S)), role


def test_a_late_reader_gets_what_the_owner_has_latched_and_no_forged_one(yard: Yard) -> None:
    publishers = [
        publish(yard.sessions[role], ENTITIES, KEYS) for role in ("viewer", OPERATOR, "navigation")
    ]
    owner = publish(yard.sessions["physics"], ENTITIES, KEYS)
    for publisher in publishers:
        publisher.put(b"forged")
    owner.put(b"right")
    yard.settle()
    for role in ("viewer", OPERATOR, "recorder"):
        got: list[bytes] = []
        come = threading.Event()

        def take(data: bytes, _: Any, got: list[bytes] = got, come: Any = come) -> None:
            got.append(data)
            come.set()

        late = yard.open(role)
        subscriber: Any = subscribe(late, ENTITIES, take, KEYS)
        assert come.wait(DEADLINE_S), role
        alive(late, KEYS, timeout_s=DEADLINE_S)
        subscriber.undeclare()
        late.close()  # type: ignore[no-untyped-call]
        assert got == [b"right"], role
    for publisher in (*publishers, owner):
        publisher.undeclare()


def test_services_alone_hand_over_to_each_other_what_they_keep(yard: Yard) -> None:
    own = {role: KEYS.own(f"{HELD_PREFIX}{role}/source") for role in ROLES}
    everyone = KEYS.own(f"{HELD_PREFIX}*/*")

    def give(key: str) -> Callable[[zenoh.Query], None]:
        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(key, b"kept")

        return answer

    queryables: list[Any] = [
        session.declare_queryable(own[role], give(own[role]))
        for role, session in yard.sessions.items()
    ]
    # And one that says it is another.
    forged = own["physics"].replace("source", "forged")
    queryables.append(yard.sessions[OPERATOR].declare_queryable(forged, give(forged)))
    yard.settle()
    target, consolidation = zenoh.QueryTarget.ALL, zenoh.ConsolidationMode.NONE
    for role, session in yard.sessions.items():
        replies = session.get(
            everyone, target=target, consolidation=consolidation, timeout=DEADLINE_S
        )
        found = {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        others = {own[name] for name in SERVICES if role in SERVICES and role != name}
        # What it answers itself does not pass the router.
        assert found - {own[role], forged} == others, role
        assert forged not in found or role == OPERATOR
    for queryable in queryables:
        queryable.undeclare()


def test_what_is_denied_is_told_in_a_line(yard: Yard) -> None:
    config = BusConfig(connect=yard.router.endpoint, key_file=yard.store.path_of("viewer"))
    told = "viewer may not {} it, as viewer: see mazebot security explain viewer {}"
    with ZenohRobot(config) as robot:
        orders: list[tuple[Topic[Any], Any]] = [(CMD_VEL, COMMAND), (GOAL_POSE, GOAL)]
        for topic, message in orders:
            with pytest.raises(RobotError) as denied:
                robot.publish(topic, message)
            assert str(denied.value) == f"{topic.name}: {told.format('put', topic.name)}"
        with pytest.raises(RobotError) as denied:
            robot.ask(SIMULATION_CONTROL, SimulationControl(pause=True), DEADLINE_S)
        assert told.format("query", SIMULATION_CONTROL.name) in str(denied.value)
    with ZenohRobot(config.model_copy(update={"key_file": yard.store.path_of(OPERATOR)})) as robot:
        robot.publish(GOAL_POSE, GOAL)
        with pytest.raises(RobotError, match=r"physics is not running|no reply from physics"):
            robot.ask(SIMULATION_CONTROL, SimulationControl(pause=True), 0.5)


def test_who_has_no_key_or_a_wrong_one_is_refused(yard: Yard, tmp_path: Path) -> None:
    other = KeyStore(tmp_path)
    other.complete()
    other.add("bob", OPERATOR)
    endpoint = yard.router.endpoint
    for key_file, text in (
        (None, f"the router at {endpoint} does not answer, or asks for a key"),
        (other.path_of("physics"), f"or refuses the key {other.path_of('physics')}"),
        (other.path_of("bob"), f"or refuses the key {other.path_of('bob')}"),
        (tmp_path / "none.key", f"{tmp_path / 'none.key'}: No such file"),
    ):
        with pytest.raises(BusUnavailableError) as refused:
            open_session(BusConfig(connect=endpoint, key_file=key_file))
        assert text in str(refused.value)
        assert "\n" not in str(refused.value)


def test_the_rules_name_no_key_twice() -> None:
    section = access_control({role: role for role in ROLES}, KEYS)
    for rule in section["rules"]:
        assert len(rule["key_exprs"]) == len(set(rule["key_exprs"])), rule["id"]
    assert section["default_permission"] == "deny"


def test_the_table_says_who_may_do_what() -> None:
    rows = {row.name: row.roles for row in matrix(KEYS)}
    assert in_short(rows[CMD_VEL.name][Verb.PUT]) == "navigation, operator, autonomy"
    assert in_short(rows[CLOCK.name][Verb.SUBSCRIBE]) == "every service, people"
    assert in_short(rows["/spawn_entity"][Verb.ANSWER]) == "spawner"
    assert rows.keys() >= {topic.name for topic in (*owned_by("physics"), *read_by("recorder"))}
