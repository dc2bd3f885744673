import pytest

from armsight.times import to_duration
from armsight.v1.safety_pb2 import STOP_ACTION_HEARTBEAT, STOP_ACTION_RELEASE, STOP_ACTION_STOP, StopAction, StopRequest
from armsight_sim.stop import MAX_SOURCES, StopRequestError, StopSources


def ask(
    stops: StopSources, action: StopAction, source: str = "page", heartbeat_s: float = 0.0, at_s: float = 0.0
) -> bool:
    heartbeat = to_duration(heartbeat_s) if heartbeat_s else None
    return stops.handle(StopRequest(action=action, source=source, heartbeat=heartbeat, reason="why"), at_s, 1)


@pytest.fixture
def stops() -> StopSources:
    return StopSources()


def test_it_starts_released(stops: StopSources) -> None:
    assert not stops.stopped


def test_each_source_releases_only_itself(stops: StopSources) -> None:
    ask(stops, STOP_ACTION_STOP, "page")
    ask(stops, STOP_ACTION_STOP, "cli")
    ask(stops, STOP_ACTION_RELEASE, "cli")
    assert stops.stopped
    assert [source.name for source in stops.message().sources if source.stopped] == ["page"]
    ask(stops, STOP_ACTION_RELEASE, "page")
    assert not stops.stopped


def test_releasing_what_was_not_stopped_names_who_did(stops: StopSources) -> None:
    ask(stops, STOP_ACTION_STOP, "page")
    with pytest.raises(StopRequestError, match="page"):
        ask(stops, STOP_ACTION_RELEASE, "somebody")


def test_only_a_source_that_asked_for_a_heartbeat_stops_by_silence(stops: StopSources) -> None:
    ask(stops, STOP_ACTION_STOP, "quiet")
    ask(stops, STOP_ACTION_RELEASE, "quiet")
    ask(stops, STOP_ACTION_HEARTBEAT, "deadman", heartbeat_s=0.5, at_s=10.0)
    assert not stops.check_heartbeats(10.4, 2)
    ask(stops, STOP_ACTION_HEARTBEAT, "deadman", at_s=10.4)
    assert not stops.check_heartbeats(10.8, 2)
    assert stops.check_heartbeats(11.0, 2)
    assert stops.stopped
    assert [source.name for source in stops.message().sources] == ["deadman"]
    assert not stops.check_heartbeats(20.0, 2), "the state changes once"


@pytest.mark.parametrize(
    ("action", "source"),
    [(STOP_ACTION_STOP, ""), (STOP_ACTION_STOP, "x" * 65), (0, "page"), (STOP_ACTION_HEARTBEAT, "page")],
)
def test_requests_that_make_no_sense_are_refused(stops: StopSources, action: StopAction, source: str) -> None:
    with pytest.raises(StopRequestError):
        ask(stops, action, source)
    assert not stops.stopped


def test_made_up_sources_do_not_fill_the_memory(stops: StopSources) -> None:
    for index in range(MAX_SOURCES):
        ask(stops, STOP_ACTION_STOP, f"source{index}")
    with pytest.raises(StopRequestError, match="release"):
        ask(stops, STOP_ACTION_STOP, "one more")
