"""What passes over a router with rights is what the contract's table says: nothing less, nothing more."""

import dataclasses
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from armsight import topics
from armsight.bus import Bus
from armsight.errors import NoReplyError, RefusedError
from armsight.session import DEFAULT_NAMESPACE, zenoh_settings
from armsight.topics import EACH, QUERIES, TOPICS, WHO, Query, Topic
from armsight.v1.safety_pb2 import STOP_ACTION_RELEASE, STOP_ACTION_STOP, StopRequest, StopResponse, StopState
from armsight_operator.certs.configuration import access_control, check_routers
from armsight_operator.certs.rights import rights
from armsight_operator.errors import CertificateError
from secure_bus import BEARERS, EDGE, SecureBus, gets_in

LATCHED = [topic for topic in TOPICS if topic.delivery == "latched"]

# Loopback takes milliseconds: what has not come this long after what may come does not come.
QUIET_S = 0.2
TIMEOUT_S = 10.0


BEHIND_EDGE = {"one router": (), "vision on an edge": ("sim", "vision")}
"""Who connects to a second router that is linked to the first; what passes is the same."""


@pytest.fixture(scope="module", params=list(BEHIND_EDGE.values()), ids=list(BEHIND_EDGE))
def secure(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecureBus]:
    secure = SecureBus(tmp_path_factory.mktemp("certs"), behind_edge=request.param)
    secure.start_router()
    yield secure
    secure.close()


@pytest.fixture
def places(secure: SecureBus) -> Iterator[Callable[[str], Bus]]:
    """Opens places on the bus, closed after the test."""
    opened: list[Bus] = []

    def place(role: str) -> Bus:
        opened.append(secure.bus(role))
        return opened[-1]

    yield place
    for bus in opened:
        bus.session.close()  # type: ignore[no-untyped-call]


def names(who: tuple[str, ...]) -> set[str]:
    """The roles that a column of the table stands for."""
    return {entry.partition("/")[0] for entry in who} - {"each"} | (set(EACH) if "each" in who else set())


def a_name(key: str, who: tuple[str, ...], role: str) -> str | None:
    """Something for {name}: one's own where the column says each, the given one where it says role/name."""
    if "{name}" not in key:
        return None
    if given := [entry.partition("/")[2] for entry in who if entry.startswith(f"{role}/")]:
        return given[0]
    if "each" in who and role in EACH:
        return role
    return "vision" if key.startswith(("health", "parameters", "{name}")) else "1"


def own_name(role: str, who: tuple[str, ...]) -> str:
    return "*" if role in who else a_name("{name}", who, role) or ""


def wait_until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.01)


def is_matched(publisher: zenoh.Publisher) -> bool:
    status: Any = publisher.matching_status
    return bool(status.matching)


class Heard:
    """Which role put what is heard: payloads are the names of roles."""

    def __init__(self) -> None:
        self.roles: list[str] = []

    def __call__(self, sample: zenoh.Sample) -> None:
        self.roles.append(sample.payload.to_bytes().decode())


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_only_publishers_of_a_topic_are_heard_on_it(places: Callable[[str], Bus], topic: Topic[Any]) -> None:
    heard = Heard()
    key = topic.key_for("*" if "{name}" in topic.key else None)
    places("operator").session.declare_subscriber(key, heard)
    buses = {role: places(role) for role in WHO}
    publishers = {
        role: bus.session.declare_publisher(topic.key_for(a_name(topic.key, topic.publishers, role)))
        for role, bus in buses.items()
    }
    expected = names(topic.publishers)
    wait_until(lambda: all(is_matched(publishers[role]) for role in expected), "no publisher hears of the listener")
    for role, publisher in publishers.items():
        publisher.put(role)
        # and without having declared anything, as one would who means harm
        buses[role].session.put(topic.key_for(a_name(topic.key, topic.publishers, role)), role)
    wait_until(lambda: len(heard.roles) >= 2 * len(expected), f"of {expected} only {heard.roles} are heard")
    time.sleep(QUIET_S)
    assert sorted(heard.roles) == sorted(2 * [*expected])


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_only_readers_of_a_topic_hear_it(places: Callable[[str], Bus], topic: Topic[Any]) -> None:
    heard = {role: Heard() for role in WHO}
    key = topic.key_for("*" if "{name}" in topic.key else None)
    everything = {role: Heard() for role in WHO}
    buses = {role: places(role) for role in WHO}
    for role, bus in buses.items():
        bus.session.declare_subscriber(key, heard[role])
        bus.session.declare_subscriber("**", everything[role])  # more than anybody may
    publisher = min(names(topic.publishers))
    sender = places(publisher).session.declare_publisher(topic.key_for(a_name(topic.key, topic.publishers, publisher)))
    wait_until(lambda: is_matched(sender), "the publisher hears of no reader")
    time.sleep(QUIET_S)  # for the other readers
    sender.put(publisher)
    wait_until(lambda: all(heard[role].roles for role in names(topic.readers)), f"not every reader hears {topic.key}")
    time.sleep(QUIET_S)
    assert {role for role in WHO if heard[role].roles} == names(topic.readers)
    # a subscription to more than one may read opens nothing that the narrow one doesn't
    assert {role for role in WHO if everything[role].roles} <= names(topic.readers)


@pytest.mark.parametrize("topic", LATCHED, ids=lambda topic: topic.name)
def test_late_readers_of_a_latched_topic_get_its_last_value(places: Callable[[str], Bus], topic: Topic[Any]) -> None:
    who = topic.publishers[0]
    publisher = "vision" if who == "each" else who
    wild = "*" if "{name}" in topic.key else None
    name = ("vision" if who == "each" else "1") if wild else None
    early = {role: places(role).subscriber(topic, wild) for role in sorted(names(topic.readers))}
    places(publisher).publisher(topic, name).put(topic.message())
    others = sorted(set(WHO) - names(topic.readers) - {publisher})
    late = {role: places(role).subscriber(topic, wild) for role in WHO if role != publisher}
    for role, subscriber in early.items():
        assert subscriber.recv(TIMEOUT_S) is not None, f"{role}, there before the publisher, did not get {topic.key}"
    for role in names(topic.readers):
        assert late[role].recv(TIMEOUT_S) is not None, f"{role}, late, did not get {topic.key}"
    for role in others:
        assert late[role].recv(QUIET_S) is None, f"{role} may not read {topic.key} and did"


def test_latched_value_put_while_the_router_is_away_reaches_its_readers(tmp_path: Path) -> None:
    secure = SecureBus(tmp_path)
    secure.start_router()
    try:
        state = secure.bus("control").subscriber(topics.STOP_STATE)
        publisher = secure.bus("sim").publisher(topics.STOP_STATE)
        publisher.put(StopState(stopped=False))
        assert state.recv(TIMEOUT_S) is not None
        secure.stop_router()
        publisher.put(StopState(stopped=True))
        assert state.recv(QUIET_S) is None
        secure.start_router()
        received = state.recv(TIMEOUT_S)
        assert received is not None, "what was said meanwhile is lost: the publisher's return was not noticed"
        assert received.message.stopped
    finally:
        secure.close()


@pytest.mark.parametrize("query", QUERIES, ids=lambda query: query.name)
def test_only_callers_of_a_query_are_answered(places: Callable[[str], Bus], query: Query[Any, Any]) -> None:
    server = "vision" if "each" in query.servers else query.servers[0]
    name = server if "{name}" in query.key else None
    asked: list[int] = []

    def answer(_: Any) -> Any:
        asked.append(1)
        return query.response()

    places(server).serve(query, answer, name)
    time.sleep(QUIET_S)
    answered = set()
    for role in WHO:
        before = len(asked)
        try:
            places(role).query(query, query.request(), name, timeout_s=0.5)
        except NoReplyError:
            assert len(asked) == before, f"{role} may not ask {query.key}, and it arrived"
        else:
            answered.add(role)
    # one of "each" may ask of itself alone
    assert answered == names(query.callers) - (set(EACH) - {server} if "each" in query.callers else set())


@pytest.mark.parametrize("query", QUERIES, ids=lambda query: query.name)
def test_only_the_server_of_a_query_can_answer_it(places: Callable[[str], Bus], query: Query[Any, Any]) -> None:
    server = "vision" if "each" in query.servers else query.servers[0]
    name = server if "{name}" in query.key else None
    caller = places("operator")
    for role in WHO:
        impostor = places(role)
        impostor.serve(query, lambda _: query.response(), name)
        time.sleep(QUIET_S)
        if role == server:
            caller.query(query, query.request(), name, timeout_s=2.0)
        else:
            with pytest.raises(NoReplyError):
                caller.query(query, query.request(), name, timeout_s=0.5)
        impostor.session.close()  # type: ignore[no-untyped-call]


def test_refusal_of_a_service_reaches_who_asked(places: Callable[[str], Bus]) -> None:
    def refuse(_: StopRequest) -> StopResponse:
        raise RefusedError("not now")

    places("sim").serve(topics.STOP, refuse)
    time.sleep(QUIET_S)
    with pytest.raises(RefusedError, match="not now"):
        places("operator").query(topics.STOP, StopRequest(action=STOP_ACTION_STOP, source="x"))


def test_presence_is_seen_by_its_watchers_and_only_of_who_is_there(places: Callable[[str], Bus]) -> None:
    watching = {role: places(role).presence() for role in WHO}
    vision = places("vision")
    own = vision.session.liveliness().declare_token("health/vision")
    other = vision.session.liveliness().declare_token("health/control")
    time.sleep(QUIET_S)
    # vision sees its own tokens without a router, so it is no witness
    seen = {role: presence.alive() for role, presence in watching.items() if presence.alive()}
    assert seen == {role: {"vision"} for role in topics.HEALTH.watchers}
    late = places("control").presence()
    time.sleep(QUIET_S)
    assert late.alive() == {"vision"}
    for token in (own, other):
        token.undeclare()  # type: ignore[no-untyped-call]
    time.sleep(QUIET_S)
    assert late.alive() == frozenset()


def test_a_key_outside_of_the_table_goes_nowhere(places: Callable[[str], Bus]) -> None:
    heard = {role: Heard() for role in WHO}
    for role in WHO:
        places(role).session.declare_subscriber("unlisted", heard[role])
    control = Heard()
    places("operator").session.declare_subscriber("target", control)
    sender = places("operator").session
    time.sleep(QUIET_S)
    sender.put("unlisted", "operator")
    sender.put("target", "operator")
    time.sleep(QUIET_S)
    assert control.roles == ["operator"]
    assert [got.roles for got in heard.values()] == [[]] * len(WHO)


def test_rights_are_of_one_robot(secure: SecureBus, places: Callable[[str], Bus]) -> None:
    heard, elsewhere = Heard(), Heard()
    places("operator").session.declare_subscriber("target", heard)
    config = dataclasses.replace(secure.config("operator"), namespace="robots/other")
    with zenoh.open(zenoh_settings(config)) as there, zenoh.open(zenoh_settings(config)) as other:
        there.declare_subscriber("target", elsewhere)
        time.sleep(QUIET_S)
        other.put("target", "other")
        places("operator").session.put("target", "ours")
        wait_until(lambda: heard.roles != [], "the robot's own target is not heard")
        time.sleep(QUIET_S)
    assert heard.roles == ["ours"]
    assert elsewhere.roles == []


def test_vision_cannot_command_the_arm_and_control_can(places: Callable[[str], Bus]) -> None:
    commands = places("sim").subscriber(topics.JOINT_COMMAND)
    intruder, control = (places(role).publisher(topics.JOINT_COMMAND) for role in ("vision", "control"))
    time.sleep(QUIET_S)
    intruder.put(topics.JOINT_COMMAND.message(hold=True))
    assert commands.recv(QUIET_S) is None
    control.put(topics.JOINT_COMMAND.message(hold=True))
    assert commands.recv(TIMEOUT_S) is not None


def test_viewer_may_stop_and_not_release_and_operator_both(places: Callable[[str], Bus]) -> None:
    stopped = {"by": False}

    def serve(request: StopRequest) -> StopResponse:
        stopped["by"] = request.action != STOP_ACTION_RELEASE
        return StopResponse(state=StopState(stopped=stopped["by"]))

    sim = places("sim")
    sim.serve(topics.STOP, serve)
    sim.serve(topics.RELEASE, serve)
    time.sleep(QUIET_S)
    places("viewer").query(topics.STOP, StopRequest(action=STOP_ACTION_STOP, source="me"))
    assert stopped["by"]
    release = StopRequest(action=STOP_ACTION_RELEASE, source="me")
    with pytest.raises(NoReplyError, match="may we ask"):
        places("viewer").query(topics.RELEASE, release, timeout_s=0.5)
    assert stopped["by"]
    places("operator").query(topics.RELEASE, release)
    assert not stopped["by"]


# two routers


def test_router_that_was_broken_into_speaks_for_those_behind_it_alone(tmp_path: Path) -> None:
    # setup: vision behind an edge whose own rules are gone
    secure = SecureBus(tmp_path, behind_edge=("sim", "vision"))
    lax = re.sub('"enabled": true', '"enabled": false', secure.file(EDGE).read_text(encoding="utf-8"))
    secure.file(EDGE).write_text(lax, encoding="utf-8")
    secure.start_router()
    try:
        behind, before = secure.bus("vision").session, secure.bus("operator").session
        keys = {topic.key for topic in (topics.JOINT_POSITIONS, topics.TARGET, topics.JOINT_COMMAND)}
        heard, heard_behind = {key: Heard() for key in keys}, {key: Heard() for key in keys}
        for key in keys:
            before.declare_subscriber(key, heard[key])
            secure.bus("sim").session.declare_subscriber(key, heard_behind[key])
        time.sleep(QUIET_S)
        # sim may put a target; neither sim nor vision a command
        for key in keys:
            behind.put(key, "intruder")
        positions, command = topics.JOINT_POSITIONS.key, topics.JOINT_COMMAND.key
        wait_until(lambda: bool(heard[positions].roles and heard_behind[command].roles), "what may pass does not")
        time.sleep(QUIET_S)
        # invariant: the first router lets no command in from there; behind the edge nobody is left to stop it
        assert {key for key in keys if heard[key].roles} == {positions, topics.TARGET.key}
        assert {key for key in keys if heard_behind[key].roles} == keys
    finally:
        secure.close()


def test_router_without_its_own_certificate_is_not_linked(tmp_path: Path) -> None:
    # setup: somebody with sim's key starts a router; the edge's is there for comparison
    secure = SecureBus(tmp_path, behind_edge=("vision",))
    for file in ("key.pem", "certificate.pem"):
        (secure.folder.path / EDGE / file).write_bytes((secure.folder.path / "sim" / file).read_bytes())
    commands = Heard()
    secure.start_router()
    try:
        sim = secure.bus("sim").session
        sim.declare_subscriber(topics.JOINT_COMMAND.key, commands)
        config = dataclasses.replace(secure.config("control"), endpoints=(secure.edge,))
        assert not gets_in(config), "a client trusts the name of its router, which sim is not"
        secure.bus("control").session.put(topics.JOINT_COMMAND.key, "control")
        wait_until(lambda: commands.roles == ["control"], "control is not heard")
    finally:
        secure.close()


@pytest.mark.parametrize(
    ("routers", "reason"),
    [
        ({"edge": ("king",)}, "can't speak for king"),
        ({"router": ("sim",)}, "is the first router"),
        ({}, "say for whom, such as --router edge=sim,vision"),
    ],
)
def test_for_whom_a_router_speaks_is_said_and_possible(routers: dict[str, tuple[str, ...]], reason: str) -> None:
    roles = BEARERS | {"edge": "router"}
    check_routers(roles, {"edge": ("sim", "vision")})
    with pytest.raises(CertificateError, match=reason):
        check_routers(roles, routers)


# without a router


def test_configuration_grants_what_the_table_grants_and_denies_the_rest() -> None:
    control = access_control(BEARERS, [DEFAULT_NAMESPACE])
    assert (control["enabled"], control["default_permission"]) == (True, "deny")
    assert {rule["permission"] for rule in control["rules"]} == {"allow"}
    granted = {
        (subject["id"], flow, message, key)
        for policy in control["policies"]
        for subject in control["subjects"]
        if subject["id"] in policy["subjects"]
        for rule in control["rules"]
        if rule["id"] in policy["rules"]
        for flow in rule["flows"]
        for message in rule["messages"]
        for key in rule["key_exprs"]
    }
    puts = {(role, key) for role, flow, message, key in granted if (flow, message) == ("ingress", "put")}
    assert puts == {
        (role, f"{DEFAULT_NAMESPACE}/{topic.key.replace('{name}', own_name(role, topic.publishers))}{heartbeat}")
        for topic in TOPICS
        for role in names(topic.publishers)
        for heartbeat in ("", "/@adv/pub/**")
        if not heartbeat or topic.delivery == "latched"
    }
    asks = {
        (role, key)
        for role, flow, message, key in granted
        if (flow, message) == ("ingress", "query") and "@adv" not in key
    }
    assert asks == {
        (role, f"{DEFAULT_NAMESPACE}/{query.key.replace('{name}', '*' if role in query.callers else role)}")
        for query in QUERIES
        for role in names(query.callers)
    } | {("operator", "@/*/router"), ("viewer", "@/*/router")}, "and who is connected to the router"
    assert {subject["id"]: subject["cert_common_names"] for subject in control["subjects"]} == {
        role: [role] for role in WHO
    }


def test_operator_has_the_health_of_its_page_and_of_nobody_else() -> None:
    operator = rights("operator", ["robots/a"])
    for right in ("put", "liveliness_token"):
        assert [key for key in operator["ingress", right] if "health" in key] == ["robots/a/health/page"]
    assert operator["ingress", "declare_queryable"] == (
        "robots/a/page/parameters",
        "robots/a/page/parameters/set",
        "robots/a/parameters/page/@adv/pub/**",
    )
    assert not [key for keys in rights("viewer", ["robots/a"]).values() for key in keys if "page" in key]


def test_a_topic_that_is_added_brings_its_rights() -> None:
    before = rights("vision", ["robots/a"])
    added = dataclasses.replace(topics.CLOCK, name="more", key="more", publishers=("vision",), readers=("control",))
    after = rights("vision", ["robots/a"], topics=(*TOPICS, added))
    assert set(after["ingress", "put"]) - set(before["ingress", "put"]) == {"robots/a/more"}
    assert "robots/a/more" in rights("control", ["robots/a"], topics=(*TOPICS, added))["egress", "put"]
    silent = dataclasses.replace(added, publishers=(), readers=())
    assert rights("vision", ["robots/a"], topics=(*TOPICS, silent)) == before


def test_two_robots_have_the_same_rights_each_under_its_own_name() -> None:
    both = rights("sim", ["robots/a", "robots/b"])["ingress", "put"]
    assert {key.removeprefix("robots/a/") for key in both if key.startswith("robots/a/")} == {
        key.removeprefix("robots/b/") for key in both if key.startswith("robots/b/")
    }
